"""Quantities of elastic bodies are within their intervals, with all kinds of contact and friction."""

from functools import partial

import pytest
from mpi4py import MPI

from signorini_fenicsx import (
    Contact,
    Coulomb,
    Dirichlet,
    Elasticity,
    Evolution,
    Neumann,
    Signorini,
    Tresca,
    Wall,
    evolve,
    solve,
)
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.quantities import Energy, Flux, Force, Integral, Kind, Mean, Moment, Quantity
from signorini_fenicsx.quantities.of_solution import check_quantities

COMM = MPI.COMM_WORLD


def pressed(friction: Tresca | Coulomb | None) -> Elasticity:
    """A block that is pushed over a foundation that is nowhere far from it, by a force along x, and pressed onto it."""
    touching = Contact("bottom", gap="0.05*x", friction=friction)
    walls = [Dirichlet("top", ["0", "-0.1"]), Neumann(["left", "right"])]
    return Elasticity(young=1.0, poisson=0.3, f=["0.1", "-0.2*x"], conditions=[touching, *walls])


def test_elastic():
    """The force along x is what f and the friction leave; the mean meets that on a finer mesh."""
    mean = Mean(direction=[0, 1])
    square = partial(build_domain, COMM, "square", mesh="structured")
    coarse, fine = (solve(square(1.001 * 2**0.5 / n), pressed(Tresca(0.02))) for n in (2, 4))
    force, one, other = coarse.quantity(Force("top", [1, 0])), coarse.quantity(mean), fine.quantity(mean)
    assert all(each.guaranteed for each in (force, one, other))
    assert force.lower - 1e-12 <= -0.08 <= force.upper + 1e-12
    assert one.lower <= other.middle <= one.upper
    assert other.width < one.width / 2
    smooth = solve(coarse.spaces.domain, pressed(None)).quantity(Force("bottom", [1, 0]))
    assert smooth.lower < 0 < smooth.upper < 1e-11


SLIDING = (
    (Mean(parts="bottom", direction=[1, 0]), 0.05),
    (Energy(), 0.0064),
    (Force("bottom", [1, 0]), -0.02),
    (Integral(parts="bottom", direction=[2, 1], weight="x"), 0.05),
    (Integral(parts="bottom", direction=[1, 0], weight="x^3"), 0.0125),
    (Mean(parts="bottom"), 0.0),
    (Force("bottom", [0, 1]), 0.1),
    (Force(["top", "bottom"], [0, 1]), 0.0),
    (Force("top", [1, 0]), 0.02),
    (Moment("bottom"), 0.05),
    (Mean(direction=[1, 0]), 0.07),
    (Integral(direction=[1, 0], weight="y"), 0.025 + 0.04 / 3),
    (Integral(direction=[0, 1], parts="right", weight="2*y"), -0.2 / 3),
)
"""Quantities of the body of `sliding`."""


def sliding(friction: Tresca | Coulomb, dim: int = 2, factor: str = "1") -> Elasticity:
    """A body that slides by 0.05: u = (0.05 + 0.04h, −0.1h) at height h, shear 0.02, pressure 0.1."""
    none, shear = [0.0] * (dim - 2), 0.02
    sides = [Neumann("right", [0, *none, shear]), Neumann("left", [0, *none, -shear])]
    if dim == 3:
        sides.append(Neumann(["front", "back"], 0))
    top = Dirichlet("top", [f"0.09*{factor}", *none, "-0.1"])
    return Elasticity(1.0, 0.0, conditions=[Contact("bottom", friction=friction), top, *sides])


def inside(found: Quantity, known: float, width: float = 1e-6) -> bool:
    """Whether a short interval has this value in it, but for rounding."""
    return found.lower - 1e-9 <= known <= found.upper + 1e-9 and found.width < width


@pytest.mark.parametrize(
    "friction", [pytest.param(Tresca(0.02), marks=pytest.mark.slow), Coulomb(0.2)], ids=["tresca", "coulomb"]
)
def test_sliding(friction: Tresca | Coulomb):
    """All quantities of a body in a uniform state; under Coulomb's friction they have the name of Tresca's problem."""
    solution = solve(build_domain(COMM, "square", 1 / 2, mesh="structured"), sliding(friction))
    for kind, known in SLIDING if isinstance(friction, Tresca) else SLIDING[:3]:
        found = solution.quantity(kind)
        assert inside(found, known, 4e-4 if isinstance(kind, Integral | Mean) else 1e-6), (kind, found)
        assert found.proved
        summary = found.summary()
        assert summary["guaranteed"] is found.guaranteed is isinstance(friction, Tresca)
        assert ("Tresca" in str(summary.get("guaranteed_for"))) is isinstance(friction, Coulomb)


def test_sliding_in_space():
    """In space, too, the slip of a foundation moves with it, and has two components."""
    solution = solve(build_domain(COMM, "cube", 1.8, mesh="structured"), sliding(Tresca(0.02), dim=3))
    slip, moment = Mean(parts="bottom", direction=[1, 0, 0]), Moment("bottom", [0, 1, 0])
    for kind, known, width in ((moment, -0.05, 1e-5), (slip, 0.05, 2e-3)):
        assert inside(solution.quantity(kind), known, width), kind


def test_sliding_in_steps():
    """The friction of a step is against its own slip; its quantities are those of the step."""
    domain, problem = build_domain(COMM, "square", 1 / 2, mesh="structured"), sliding(Tresca(0.02), factor="(1 + t)")
    *_, last = evolve(domain, problem, Evolution(end=2.0, steps=2))
    for kind, known in ((Force("bottom", [1, 0]), -0.02), (Energy(), 0.0054 + 0.02 * 0.09)):
        found = last.solution.quantity(kind)
        assert inside(found, known), found
        assert found.of.endswith("the step after the computed slip of the last one")


@pytest.mark.parametrize("law", [Wall("bottom", beta=1), Signorini("bottom", psi=-0.05)], ids=["wall", "level"])
def test_laws(law: Wall | Signorini):
    """A body on springs, and one that is pressed onto a foundation."""
    block = Elasticity(1.0, 0.0, conditions=[law, Dirichlet("top", [0, "-0.1"]), Neumann(["left", "right"])])
    solution = solve(build_domain(COMM, "square", 1 / 2, mesh="structured"), block)
    energy = 0.0025 if isinstance(law, Wall) else 0.00125
    moved = Mean(parts="bottom", direction=[0, 1])
    for kind, known in ((Energy(), energy), (Force("bottom", [0, 1]), 0.05), (moved, -0.05)):
        assert inside(solution.quantity(kind), known), kind


def test_a_load_that_would_lift_the_body():
    """Where the first load beside a small one is larger than it, smaller ones are tried."""
    top = Neumann("top", ["0", "-0.01"])
    soft = Elasticity(
        0.01, 0.0, conditions=[Contact("bottom"), top, Neumann("right"), Dirichlet("left", components="x")]
    )
    found = solve(build_domain(COMM, "square", 1 / 2, mesh="structured"), soft).quantity(Mean(direction=[0, 1]))
    assert found.guaranteed, found.reason
    assert found.lower - 1e-8 <= -0.5 <= found.upper + 1e-8
    assert found.width < 1e-3


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (Force("left", [0, 1]), "the traction on the part 'left' is given"),
        (Force("nowhere", [0, 1]), "unknown part 'nowhere'"),
        (Force("top"), "direction: needs 2 numbers"),
        (Mean(direction=[1]), "direction: needs 2 numbers"),
        (Mean(direction=[1, 0], parts="top"), "in contact or loaded; on 'top' u is given"),
        (Mean(direction=[1, 0], region="rock"), "unknown region 'rock'"),
        (Mean(direction=[1, 0], weight=lambda x: x[0]), "weight: must be a number or a text"),
        (Flux("top"), "elastic contact has Integral, Mean, Force, Moment and Energy"),
    ],
)
def test_refused_of_bodies(kind: Kind, words: str):
    """Quantities that elastic contact has not are refused in a sentence."""
    domain = build_domain(COMM, "square", 1 / 2, mesh="structured")
    with pytest.raises(InputError, match=words):
        check_quantities(domain, pressed(None).on(domain), [kind])


@pytest.mark.parallel(2)
def test_bodies_on_ranks(monkeypatch: pytest.MonkeyPatch):
    """Intervals of elastic contact do not depend on the number of ranks."""
    monkeypatch.setattr("signorini_fenicsx.quantities.bracket.MOST", 2)  # that they are short is not looked at
    one, many = (
        solve(build_domain(comm, "square", 1 / 2, mesh="structured"), pressed(Tresca(0.02))).quantity(Moment("top"))
        for comm in (MPI.COMM_SELF, COMM)
    )
    for name in ("value", "lower", "upper"):
        assert getattr(many, name) == pytest.approx(getattr(one, name), rel=1e-8)
