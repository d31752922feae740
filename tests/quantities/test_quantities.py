"""Quantities are within their intervals, which shrink as they should; fluxes without bounds are told."""

import json
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import ufl
from agreement import on_one_rank
from commands import read_rows, signorini
from made_cases import case_of
from makers.quantities import random_row
from mpi4py import MPI

from signorini_fenicsx import (
    Contact,
    Corners,
    Diffusion,
    Dirichlet,
    Elasticity,
    Evolution,
    Friction,
    Neumann,
    Signorini,
    Solution,
    Wall,
    evolve,
    solve,
)
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.certificate.laws import gap, half_gap
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.expressions import read, values
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.solution import flux_through
from signorini_fenicsx.quantities import Energy, Flux, Integral, Kind, Mean
from signorini_fenicsx.quantities.bracket import Ends, Quantity, bracket
from signorini_fenicsx.quantities.weighted import Weighted

COMM = MPI.COMM_WORLD
LEFT = "1 if x < 0.5 else 0"


@cache
def exact_mean(text: str, low: float = 0.0) -> float:
    """The mean of an expression over the unit square whose left lower corner is (low, low)."""
    x, weights = np.polynomial.legendre.leggauss(8)
    nodes = low + (np.arange(100)[:, None] + (x + 1) / 2).ravel() / 100
    weights = np.tile(weights / 2, 100) / 100
    at = np.stack(np.meshgrid(nodes, nodes), axis=-1)
    return float(weights @ values(read(text, "xy"), at) @ weights)


@pytest.mark.parametrize("name", ["transition", pytest.param("dead_core", marks=pytest.mark.slow)])
def test_known_means(name: str):
    """The mean of a known u is inside, and the interval shrinks faster than h."""
    widths = []
    for h in (1 / 4, 1 / 8):
        solution = solve_case(load_case(name).with_values({"solve.h": h, "geometry.mesh": "structured"}))
        found = solution.quantity(Mean())
        assert found.guaranteed, found.reason
        text = case_of(solution).exact.u
        assert isinstance(text, str)
        assert found.lower <= exact_mean(text, solution.spaces.domain.box()[0, 0]) <= found.upper
        widths.append(found.width)
    assert widths[1] < widths[0] / 2


@pytest.mark.parametrize("why", ["", ": f by quadrature"])
def test_bounds_that_exclude_each_other_are_told(why: str):
    """Such as those of a problem without a solution, or with a load that is not enclosed, and then it is said why."""
    found = bracket(lambda tau: Ends(1.0, 0.5, 1.0, why.removeprefix(": ")), 1.0, 0.7)
    assert (found.lower, found.upper, found.guaranteed) == (0.5, 1.0, False)
    assert found.reason == f"the bounds exclude each other{why}"


def test_the_better_one_of_two_tau_is_followed():
    """If the τ that the first one suggests is worse than it, the search goes on from the first one."""

    def ends(tau: float) -> Ends:
        length = 1 + abs(math.log2(tau))
        return Ends(-length, length, 1024.0, "")

    assert bracket(ends, 2.0, 0.0).width == 2.0


def test_the_search_goes_far_and_beyond_a_longer_one():
    """The best τ may be 2^12 times smaller than the first one, with one behind which others are shorter again."""

    def ends(tau: float) -> Ends:
        length = math.sqrt(tau + 2.0**-24 / tau) * (0.9 if tau == 2.0**-5 else 0.5)
        return Ends(-length, length, 1.0, "")

    assert bracket(ends, 1.0, 0.0).width == 2.0**-5.5


def test_design_order():
    """The mean of u over one half with a load that changes sign: the interval shrinks with order 4/3."""
    problem = Diffusion(f="-10 if x < 0.5 else 10", conditions=[Signorini("bottom")])
    found = [
        solve(build_domain(COMM, "square", 1.001 * 2**0.5 / n, mesh="structured"), problem).quantity(
            Integral(weight=LEFT)
        )
        for n in (8, 16)
    ]
    known = -0.06277005058785651
    assert all(each.guaranteed and each.lower < known < each.upper for each in found)
    assert found[1].width < found[0].width / 2**1.2
    assert all(abs(each.middle - known) < each.width / 4 for each in found)


@cache
def strip(cells: int) -> Solution:
    """U = x⁴ − x/2, held by a law on the left and given on the right, with so many cells on a side."""
    conditions = [Signorini("left"), Dirichlet("right", "0.5"), Neumann(["top", "bottom"])]
    domain = build_domain(COMM, "square", 1.001 * 2**0.5 / cells, mesh="structured")
    return solve(domain, Diffusion(f="-12*x^2", conditions=conditions))


@pytest.mark.parametrize(("parts", "known"), [("left", 0.5), ("right", 3.5), (["left", "right"], 4.0)])
def test_known_fluxes(parts: str | list[str], known: float):
    """A known flux is inside, through a part where u is given, through one with a law, and through both."""
    widths = []
    for cells in (4, 8) if isinstance(parts, str) else (4,):
        found = strip(cells).quantity(Flux(parts))
        assert found.guaranteed, found.reason
        assert found.lower <= known + 1e-9
        assert found.upper >= known - 1e-9
        widths.append(found.width)
    assert widths[-1] < (widths[0] / 2**1.8 if isinstance(parts, str) else 1e-7)  # both are known but for rounding


def test_flux_through_one_of_two_levels():
    """Of a u_D that is given by cases, that of the part counts: its flux is guaranteed."""
    levels = Diffusion(f=0, u_D="0 if x < 1/2 else 1", conditions=[Signorini("bottom", psi=-1), Neumann("top")])
    found = solve(build_domain(COMM, "square", 1 / 2, mesh="structured"), levels).quantity(Flux("right"))
    assert found.guaranteed, found.reason
    assert found.lower <= 1 + 1e-9
    assert found.upper >= 1 - 1e-9
    assert found.width < 1e-6


def test_moved_data_stay_above_an_obstacle():
    """u_D that is moved below an obstacle makes no problem: bounds by such data excluded the flux."""
    membrane = Diffusion(f=-1, obstacle=0, u_D="x*(1 - x)*(1 - y)^2/20")
    one, other = (solve(build_domain(COMM, "square", h, mesh="structured"), membrane) for h in (1 / 8, 1 / 32))
    found = one.quantity(Flux("bottom", weight="x*(1 - x)"))
    x = ufl.SpatialCoordinate(other.spaces.mesh)
    assert found.guaranteed
    assert found.lower < flux_through(other.spaces, other.sigma, ["bottom"], x[0] * (1 - x[0])) < found.upper
    assert found.width < 0.2 * found.value


def test_energy():
    """The energy ½∫u'² − ∫fu of the strip is inside."""
    x, weights = np.polynomial.legendre.leggauss(8)
    x, weights = (x + 1) / 2, weights / 2
    known = weights @ ((4 * x**3 - 0.5) ** 2 / 2 + 12 * x**2 * (x**4 - x / 2))
    found = strip(8).quantity(Energy())
    assert found.guaranteed
    assert found.lower <= known <= found.upper
    assert found.width < 0.1 * known


@pytest.mark.parametrize(
    ("conditions", "known"),
    [
        ([Wall("left", beta=1, level=1), Dirichlet("right", 0)], 0.25),
        ([Friction("left", g=0.5), Dirichlet("right", 1)], 0.375),
        (
            [
                Neumann("left", 0.5),
                Dirichlet("right", 0),
                Corners([(0.0, -1.0), (0.0, 1.0)], before=1, beyond=1, region="all"),
            ],
            1.25**0.5 / 4 - math.asinh(0.5) / 2 - (1.25**0.5 - 1) / 2,
        ),
    ],
    ids=["wall", "friction", "inside"],
)
def test_energies_of_laws(conditions: list, known: float):
    """The energy of u = (1 − x)/2 and (1 + x)/2, and of cosh(a − x) − 1 with sinh a = ½, which a law in Ω stops."""
    problem = Diffusion(f=0, conditions=[*conditions, Neumann(["top", "bottom"])])
    found = solve(build_domain(COMM, "square", 1 / 8, mesh="structured"), problem).quantity(Energy())
    assert found.guaranteed, found.reason
    assert found.lower - 1e-12 <= known <= found.upper + 1e-12
    assert found.width < 1e-2


def test_inside_the_domain(monkeypatch: pytest.MonkeyPatch):
    """The flux across a crack, with a ramp, and the integral of the jump, of a known solution."""
    monkeypatch.setattr("signorini_fenicsx.quantities.bracket.MOST", 2)  # each takes long, as u_D has a root
    solution = solve_case(load_case("crack").with_values({"solve.h": 0.4}))
    through, jump = solution.quantity(Flux("slit", weight="x^2*(1 + x)^2")), solution.quantity(Integral(parts="slit"))
    assert through.guaranteed, through.reason  # the weight is no quadratic, up to the tip
    assert through.lower <= 1.5 * (0.5**5.5 / 5.5 - 0.5**4.5 / 3.5 + 0.5**1.5 / 24) <= through.upper
    assert through.width < 0.02
    assert jump.lower <= 0.8 * 0.5**2.5 <= jump.upper
    with pytest.raises(InputError, match="has no law; take 'slit'"):
        solution.quantity(Flux("slit (other side)"))


def test_step():
    """A quantity of a step is that of its own problem, and says so."""
    problem = Diffusion(f="-10*t", conditions=[Signorini("bottom", psi=-0.05)])
    *_, last = evolve(build_domain(COMM, "square", 1 / 4, mesh="structured"), problem, Evolution(end=1.0, steps=2))
    found = last.solution.quantity(Mean())
    assert found.proved
    assert not found.guaranteed
    assert found.summary()["guaranteed_for"] == "the exact solution of the step with the computed u of those before"
    assert found.summary()["guaranteed"] is False
    value = COMM.allreduce(float(last.solution.spaces.cell_measures @ last.solution.u.x.array))
    assert found.lower <= value <= found.upper


def test_unbounded_fluxes():
    """A part that meets another one with a given u has a flux without bounds, which is said."""
    solution = solve(
        build_domain(COMM, "square", 1 / 8, mesh="structured"), Diffusion(f=-10, conditions=[Signorini("bottom")])
    )
    found = solution.quantity(Flux("left"))
    assert not found.guaranteed
    assert found.width == math.inf
    assert found.value == solution.flux_through("left")
    assert found.reason.startswith("this flux is unbounded on the energy space")


def test_flux_with_a_ramp():
    """A flux that is unbounded has an interval with a weight that is 0 where the part ends, here of u = −xy."""
    problem, widths = Diffusion(u_D="-x*y", f=0, conditions=[Signorini("bottom")]), []
    for h in (1 / 2, 1 / 4):
        solution = solve(build_domain(COMM, "square", h, mesh="structured"), problem)
        found = solution.quantity(Flux("left", weight="4*y*(1 - y)"))
        assert found.guaranteed, found.reason
        assert found.lower <= 1 / 3 <= found.upper
        widths.append(found.width)
    assert widths[1] < widths[0] / 2**1.2
    ramp = solution.quantity(Flux("left", weight="min(1, 4*y, 4 - 4*y)"))
    assert ramp.lower <= 3 / 8 <= ramp.upper
    assert ramp.reason
    edge = solution.quantity(Flux("bottom", weight="4*x*(1 - x)"))
    assert edge.guaranteed, edge.reason
    assert edge.lower <= 1 / 3 <= edge.upper
    assert edge.width < 0.1


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (lambda: Flux("top"), "the flux through the part 'top' is given"),
        (lambda: Flux("nowhere"), "unknown part 'nowhere'"),
        (lambda: Flux([]), "needs the part"),
        (lambda: Integral(region="rock"), "unknown region 'rock'"),
        (lambda: Integral(region="rock", parts="left"), "leave out one"),
        (lambda: Integral(parts="right"), "u is given on the part 'right'"),
        (lambda: Mean(weight="x - 0.5"), "its integral is 0"),
        (lambda: Integral(weight="1 +"), "weight: "),
        (lambda: Integral(weight=lambda x: x[0]), "not functions of points"),
    ],
)
def test_refused(kind: Callable[[], Kind], words: str):
    """Quantities that are none are refused in a sentence."""
    with pytest.raises(InputError, match=words):
        strip(4).quantity(kind())


def test_half_gap():
    """It is the largest (η − σ·n)(v − u) over the graph, by many points of it, and at most the gap."""
    rng = np.random.default_rng(3)
    p, flux = np.sort(rng.uniform(-1, 1, (40, 3))), -np.sort(rng.uniform(-1, 1, (40, 3)))
    before, beyond = np.where(rng.random((2, 40)) < 0.3, np.inf, rng.uniform(0, 2, (2, 40)))
    law = Chains.through(p, flux, before, beyond)
    v, eta = (np.clip(rng.uniform(-2, 2, 40), *ends) for ends in (law.extent()[:2], law.extent()[2:]))
    steps = np.linspace(0, 1, 2001)
    u, s = (values[:, :-1, None] + np.diff(values)[:, :, None] * steps for values in (p, flux))
    ends = 60 * steps[:, None]
    u = [*np.moveaxis(u, 2, 0).transpose(0, 2, 1).reshape(-1, 40)]
    s = [*np.moveaxis(s, 2, 0).transpose(0, 2, 1).reshape(-1, 40)]
    for end, slope, sign in ((0, before, -1.0), (2, beyond, 1.0)):
        vertical = np.isinf(slope)
        u.extend(p[:, end] + sign * np.where(vertical, 0.0, ends))
        s.extend(flux[:, end] - sign * np.where(vertical, 1.0, slope) * ends)
    known = np.max((eta - np.array(s)) * (v - np.array(u)), axis=0)
    found = half_gap(law, v, eta)
    assert np.all(found >= known - 1e-12)
    assert np.all(found <= known + 1e-2 * (1 + known))
    assert np.all(found <= gap(law, v, eta) + 1e-12)


def test_weights_that_quadrature_misses():
    """They are not refused: enclosures find them, here about 0.3 on coarse cells, or know no integral."""
    domain = build_domain(COMM, "square", 1 / 2, mesh="structured")
    for weight in ("1 if abs(x - 0.3) < 1e-4 else 0", "exp(-((x - 0.3)*1e4)**2)"):
        Weighted.of(domain, Mean(weight=weight)).check_mean()
    assert Quantity(0.0, 1.0, 2.0, True).divided(0.0, 1.0).reason == "the integral of its weight is not known"


def test_weights_without_an_integral():
    """There is no mean with a weight whose integral is 0 but for rounding, here of a body."""
    body = Elasticity(1.0, 0.3, f=[0, -1], conditions=[Contact("bottom"), Neumann(["left", "right"])])
    solution = solve(build_domain(COMM, "square", 1 / 2, mesh="unstructured"), body)
    with pytest.raises(InputError, match="its integral is 0"):
        solution.quantity(Mean(weight="sin(2*pi*x)*exp(y)", direction=[0, 1]))


@pytest.mark.parametrize(
    "problem",
    [
        Diffusion(f=0, conditions=[Signorini("bottom", psi=-1000)]),
        Elasticity(1.0, 0.3, f=[0, 0], conditions=[Contact("bottom", gap=1000), Neumann(["left", "right"])]),
    ],
    ids=["diffusion", "elasticity"],
)
def test_bodies_at_rest_far_from_contact(problem: Diffusion | Elasticity):
    """Where u is 0 but for rounding, the problems beside it are so far away that u is no rounding there."""
    solution = solve(build_domain(COMM, "square", 1 / 2, mesh="unstructured"), problem)
    mean = solution.quantity(Mean(direction=[0, 1] if isinstance(problem, Elasticity) else None))
    assert mean.guaranteed
    assert mean.lower <= 0 <= mean.upper
    assert mean.width < 1e-5


@pytest.mark.slow
def test_random_problems():
    """Random quantities of random problems are in their intervals, by `scripts/random_runs.py quantities`."""
    rows = [random_row(seed, shapes=("square", "lshape")) for seed in range(40)]
    assert not [str(row) for row in rows if not row.holds]
    assert sum(row.found for row in rows) > len(rows) / 2


@pytest.mark.parallel(2)
def test_on_ranks(monkeypatch: pytest.MonkeyPatch):
    """Intervals do not depend on the number of ranks."""
    monkeypatch.setattr("signorini_fenicsx.quantities.bracket.MOST", 2)  # that they are short is not looked at
    problem = Diffusion(f="-10 if x < 0.5 else 10", conditions=[Signorini("bottom"), Neumann("right")])

    def intervals(comm: MPI.Comm) -> list[tuple[float, ...]]:
        solution = solve(build_domain(comm, "square", 1 / 2, mesh="structured"), problem)
        kinds = Integral(parts="bottom"), Flux(["left", "top", "bottom"])
        found = [solution.quantity(kind) for kind in kinds]
        return [(each.value, each.lower, each.upper, each.guaranteed) for each in found]

    for many, one in zip(intervals(COMM), on_one_rank(intervals), strict=True):
        assert many == pytest.approx(one, rel=1e-9, abs=1e-12)


CASE = """
[geometry]
shape = "square"
mesh = "structured"

[boundary]
signorini = ["bottom"]
neumann = ["right"]

[problem]
f = "-10 if x < 0.5 else 10"

[solve]
h = "1/4"

[[quantity]]
name = "left half"
kind = "integral"
weight = "1 if x < 0.5 else 0"

[[quantity]]
name = "inflow"
kind = "flux"
parts = ["left", "bottom", "top"]

[[quantity]]
name = "unbounded"
kind = "flux"
parts = "left"
"""


def test_case_file(folder: Path):
    """`solve` computes what [[quantity]] asks for; what is no quantity is refused before anything runs."""
    (folder / "case.toml").write_text(CASE, encoding="utf-8")
    printed = signorini(folder, "solve", "case.toml", "--output", "found").stdout
    assert "left half" in printed
    assert "without bounds: this flux is unbounded" in printed
    found = json.loads((folder / "found" / "summary.json").read_text(encoding="utf-8"))["quantities"]
    assert list(found) == ["left half", "inflow", "unbounded"]
    assert found["unbounded"]["lower"] is None or found["unbounded"]["upper"] is None
    expected = solve_case(load_case(folder / "case.toml")).quantity(Integral(weight=LEFT))
    assert found["left half"] == expected.summary()
    for change, words in (
        ('quantity.1.parts="nowhere"', "unknown part 'nowhere'"),
        ('quantity.1.kind="flow"', "Flow: diffusion problems have Integral, Mean, Flux and Energy"),
        ('quantity.1.name="left half"', "name of two quantities"),
        ('quantity.0.weight="1 +"', "quantity.0.weight: "),
        (
            'quantity.1.weigth="1"',
            "unknown key 'weigth' of the quantity 'flux'; known are kind, name, symbol, unit, sign, parts, weight",
        ),
    ):
        refused = signorini(folder, "solve", "case.toml", "--set", change, "--output", "refused")
        assert refused.returncode == 2
        assert words in refused.stderr
        assert not (folder / "refused").exists()


def test_adapt(folder: Path):
    """`adapt` refines until an interval is short enough, and fails if it has too few cells for that."""
    only = CASE.replace('parts = ["left", "bottom", "top"]', 'parts = "left"').split('[[quantity]]\nname = "unbounded')
    (folder / "case.toml").write_text(only[0], encoding="utf-8")
    wanted = "adapt", "case.toml", "--h", "0.71", "--quantity", "left half", "--width"
    ended = signorini(folder, *wanted, "1e-2", "--output", "found")
    assert ended.returncode == 0, ended.stderr
    found = json.loads((folder / "found" / "summary.json").read_text(encoding="utf-8"))["quantities"]["left half"]
    rows = read_rows(folder / "found" / "adapt.csv")
    lower, upper = ([float(row[f"quantities.left half.{end}"]) for row in rows] for end in ("lower", "upper"))
    assert found["upper"] - found["lower"] <= 1e-2 < upper[0] - lower[0]
    assert lower[-1] == found["lower"]
    assert {"quantities.inflow.value", "quantities.inflow.reason"} <= set(rows[0])
    assert signorini(folder, *wanted, "1e-9", "--max-cells", "10", "--output", "failed").returncode == 1
    for arguments, words in (
        (("--quantity", "left half"), "belong together"),
        (("--quantity", "nothing", "--width", "1"), "case has left half, inflow"),
    ):
        refused = signorini(folder, "adapt", "case.toml", *arguments, "--output", "refused")
        assert refused.returncode == 2
        assert words in refused.stderr
