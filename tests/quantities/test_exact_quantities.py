"""Loads and weights with jumps and kinks off the mesh: exact values are within all intervals that are guaranteed."""

import numpy as np
import pytest
from makers.quantities import Line, Text, against_exact, total
from mpi4py import MPI

from signorini_fenicsx import Contact, Diffusion, Dirichlet, Elasticity, Neumann, Signorini, solve
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.expressions import read
from signorini_fenicsx.expressions.products import products
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.quantities import Energy, Force, Integral, Mean, Moment, Quantity
from signorini_fenicsx.quantities.bracket import Ends, bracket

COMM = MPI.COMM_WORLD
JUMP = "1 if x < 0.3 else 0"


def square(cells: int) -> Domain:
    """A mesh with so many cells on a side."""
    return build_domain(COMM, "square", 1.001 * 2**0.5 / cells, mesh="structured")


def proved(found: Quantity, known: float, share: float) -> bool:
    """Whether an interval is guaranteed, has this value in it, and is not longer than a share of it."""
    return found.guaranteed and found.lower <= known <= found.upper and found.width <= share * abs(known)


@pytest.mark.parametrize("level", [1.0, 1000.0])
def test_jump_of_load_and_weight(level: float):
    """The energy and an integral, or a mean, of u'' = −1 for x < 0.3, which do not fit the mesh, also for a large u."""
    problem = Diffusion(f=JUMP, u_D=level, conditions=[Signorini("bottom", psi=-1), Neumann("top")])
    solution = solve(square(8), problem)
    kind, length = (Integral, 1.0) if level == 1 else (Mean, 0.3)
    assert proved(solution.quantity(Energy()), 0.0034875 - 0.3 * level - 0.006975, 2e-3)
    assert proved(solution.quantity(kind(weight=JUMP)), (0.006975 + 0.3 * level) / length, 3e-3)


def test_kinks_on_the_boundary():
    """A flux with a kink on Γ_N, in the energy, and a weight with one on Γ_S, of u = 2 − x."""
    problem = Diffusion(f=0, conditions=[Signorini("left", psi=2), Dirichlet("right", 1), Neumann(["top", "bottom"])])
    found = solve(square(4), problem).quantity(Integral(parts="left", weight="abs(y - 0.3)"))
    assert proved(found, 2 * (0.09 + 0.49) / 2, 1e-3)


@pytest.mark.parametrize("parts", ["left", ["left", "bottom"]])
def test_force_of_a_load_with_a_kink(parts: str | list[str]):
    """On all that holds a body the force, or the moment, is that of loads that quadrature does not integrate."""
    below = Contact("bottom", gap=0.01) if "bottom" in parts else Neumann("bottom")
    conditions = [below, Dirichlet("left", [0, 0]), Neumann("top", ["abs(x - 0.37)", 0]), Neumann("right")]
    solution = solve(square(3), Elasticity(1.0, 0.3, f=["0.5*abs(x - 0.43)", "0.1"], conditions=conditions))
    top, inside = (0.37**2 + 0.63**2) / 2, (0.43**2 + 0.57**2) / 4
    if parts == "left":
        assert proved(solution.quantity(Force(parts, [1, 0])), -top - inside, 0.1)
    else:
        assert proved(solution.quantity(Moment(parts)), -0.05 + inside / 2 + top, 0.1)


def test_energy_of_a_bar():
    """The energy of a clamped bar under a load with a kink is proved."""
    f = Text("abs(x - 0.3)", (0.3,))
    line = Line(f, Text("2"), s=total(f, f.places), start=0.0)
    conditions = [Dirichlet("left", [0, 0]), Neumann(["top", "bottom"]), Contact("right", gap=1)]
    found = solve(square(3), Elasticity(2.0, 0.0, f=[f.text, 0], conditions=conditions)).quantity(Energy())
    assert proved(found, line.energy(), 1e-2)


def test_products():
    """Integrals of a polynomial times what jumps, along lines and circles, are enclosed."""
    spaces = solve(square(4), Diffusion(f=0, conditions=[Signorini("bottom", psi=-1)])).spaces
    vertices, measure = corners(spaces.mesh), spaces.cell_measures
    cases = (
        ("1 if y < 0.2 + x/3 else 0", 0.2 + 1 / 6),
        ("abs(x - 0.3)", 0.29),
        ("1 if x^2 + y^2 < 1/2 else 0", np.pi / 8),
    )
    for text, known in cases:
        found = products(
            read(text, "xy"), vertices, measure, lambda own, x: np.ones(x.shape[:2]), 0, spaces.frame, 1e-4
        )
        value, radius = COMM.allreduce(found.total)
        assert abs(value - known) <= radius < 1e-2, text


@pytest.mark.slow
def test_random_exact():
    """Random jumps and kinks, also with |u| of 1000, see `scripts/random_runs.py exact`."""
    rows = [row for seed in range(30) for row in against_exact(seed)]
    assert not [words for words, guaranteed, inside in rows if guaranteed and not inside]
    assert sum(guaranteed for _, guaranteed, _ in rows) > len(rows) / 2


@pytest.mark.parametrize("best", [-12, -13, 11])
def test_the_search_is_fast_where_intervals_are_proportional(best: int):
    """Longer steps find the best τ as well, in either direction."""
    tried = list[float]()

    def ends(tau: float) -> Ends:
        tried.append(tau)
        length = (tau / 2.0**best + 2.0**best / tau) / 2
        return Ends(-length, length, 1.0, "")

    assert bracket(ends, 1.0, 0.0).width == 2
    assert len(tried) <= 11


@pytest.mark.parametrize(
    "lengths",
    [[257, 106, 27.7, 8.17, 5.01, 5.50, 9.56], [28, 14, 7, 4, 3, 4, 8, 16]],
    ids=["faster than proportional", "after a long step"],
)
def test_the_search_passes_no_best(lengths: list[float]):
    """Steps are longer only where the best τ is far; one that was too long is taken back."""

    def ends(tau: float) -> Ends:
        return Ends(0.0, dict(enumerate(lengths)).get(round(-np.log2(tau)), 1000.0), 1.0, "")

    assert bracket(ends, 1.0, 0.0).width == min(lengths)


def test_the_search_ends_where_a_quantity_is_known():
    """Where each smaller τ gives a shorter interval, because the quantity is known but for rounding."""
    tried = list[float]()

    def ends(tau: float) -> Ends:
        tried.append(tau)
        return Ends(1.0, 1 + 1e-3 * tau, 1.0, "")

    assert 0 < bracket(ends, 1.0, 1.0).width <= 1e-8
    assert min(tried) == 2.0**-18
    assert len(tried) == 7
