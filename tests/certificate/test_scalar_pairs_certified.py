"""Scalar pairs of surfaces: the bound beside finer meshes and matching ones, quantities, derivatives, any ranks."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import ufl
from bodies_apart import joined, two
from boxes import box
from dolfinx import fem
from made_cases import refined
from makers.bounds import difference
from mpi4py import MPI

from signorini_fenicsx.api import (
    Diffusion,
    Dirichlet,
    Friction,
    Neumann,
    Options,
    Pair,
    Regulator,
    Signorini,
    Solution,
    Tied,
    TwoSided,
    Wall,
    certify,
    domain_of_bodies,
    solve,
)
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.quantities.kinds import Flux, Mean

SIDES = "up.bottom", "low.top"
HELD = "x*(1 + y)**2/4"
LAWS = {
    "tied": Tied(),
    "wall": Wall((), beta=4),
    "stiff": Wall((), beta=300),
    "friction": Friction((), g=0.3),
    "contact": Signorini((), psi=-0.02),
    "between": TwoSided((), psi_upper=0.02, psi=-0.01),
    "regulator": Regulator((), k=5, g_low=-0.3, g_high=0.3),
}


def boxes(
    upper: int,
    lower: int,
    dim: int = 2,
    left: float = 0.0,
    height: float = 0.0,
    comm: MPI.Intracomm = MPI.COMM_SELF,
    pairs: Sequence[Sequence[str]] = (SIDES,),
) -> Domain:
    """Two boxes with so many cells along an edge of each, the upper one from `left` on and so high above the other."""
    aside, ends = [0.0] * (dim - 2), [1.0] * (dim - 1)
    up = box([left, *aside, height], [*ends, height + 1.0], [upper] * dim, comm)
    low = box([0.0, *aside, -1.0], [*ends, 0.0], [lower] * dim, comm)
    return domain_of_bodies({"up": up, "low": low}, pairs=pairs)


def posed(law: Any, dim: int = 2, **more: Any) -> Diffusion:
    """A problem of two boxes on one another."""
    names = ["left", "right"] + ["front", "back"] * (dim == 3)
    sides = [f"{body}.{name}" for body in ("up", "low") for name in names]
    held = [Dirichlet("up.top", "1 - 2*x + x**2"), Dirichlet("low.bottom", 0)]
    return Diffusion(f="1 - x", conditions=[*held, Neumann(sides), Pair(*SIDES, law)], **more)


@pytest.mark.parametrize(
    ("name", "dim", "left", "most"),
    [
        *((name, 2, 0.0, 1.4) for name in LAWS if name not in ("wall", "between")),
        ("tied", 2, 0.17, 1.7),
        ("friction", 2, 0.17, 1.5),
        pytest.param("tied", 3, 0.0, 1.7, marks=pytest.mark.slow),
        ("contact", 3, 0.17, 2.0),
    ],
)
def test_beside_finer_meshes(name: str, dim: int, left: float, most: float) -> None:
    """The bound is guaranteed, not below the distance to a finer solution, and not far above.

    Also where bodies are apart, or one ends inside facets of the other.
    """
    domain, problem = boxes(3 - (dim == 3), 4 - (dim == 3), dim, left, 0.05 * (name == "tied")), posed(LAWS[name], dim)
    solution = solve(domain, problem)
    certificate = certify(solution)
    error = difference(solution, solve(refined(domain, 4 - dim), problem))
    assert certificate.guaranteed
    assert error < certificate.sigma_bound < most * error


@pytest.mark.parametrize(
    ("name", "held"),
    [
        *((name, "") for name in ("tied", "contact", "between")),
        *(pytest.param(name, "", marks=pytest.mark.slow) for name in ("stiff", "regulator", "friction")),
        *((name, HELD) for name in ("tied", "friction")),
    ],
)
def test_a_matching_mesh_as_one_cut_inside(name: str, held: str) -> None:
    """Where both surfaces have the same facets the bound is that of a part inside the domain.

    Also where u is given, by laws, at the ends of the surfaces.
    """
    law, given = LAWS[name], [Dirichlet("l10", 0), Dirichlet("u11", "x" if held else "1 - 2*x + x**2")]
    sides = partial(Dirichlet, value=held) if held else Neumann
    cases = [(two(MPI.COMM_SELF, (4, 3), (4, 3)), sides([f"{body}0{end}" for body in "ul" for end in (0, 1)]))]
    cases.append((joined((4, 3)), sides(["x0", "x1"])))
    inner = TwoSided("u10", psi_upper=0) if name == "tied" else type(law)("u10", **law.data())
    found = []
    for (domain, sides), meeting in zip(cases, (Pair("u10", "l11", law), inner), strict=True):
        problem = Diffusion(f="1 + x", c=0.5, conditions=[*given, sides, meeting])
        found.append(certify(solve(domain, problem, Options(element="RT1"))).bound)
    exact = name in ("tied", "friction", "contact", "between") and not held
    assert found[0] == pytest.approx(found[1], rel=1e-9 if exact else 1e-3)


def test_quantities() -> None:
    """The values of a finer solution are in the intervals."""
    domain, problem = boxes(1, 2, left=0.17, height=0.05), posed(LAWS["wall"])
    coarse, fine = (solve(refined(domain, times), problem) for times in (0, 2))
    cells = fine.spaces.domain.regions["up"]
    mean = np.average(fine.u.x.array[cells], weights=fine.spaces.cell_measures[cells])
    for kind, value in ((Mean(region="up"), mean), (Flux("up.bottom"), fine.flux_through("up.bottom"))):
        found = coarse.quantity(kind)
        assert found.proved
        assert found.lower < value < found.upper


def test_derivatives() -> None:
    """Derivatives by a load, κ and a law are those of differences."""
    domain, at, step = boxes(2, 3, left=0.17), np.array([1.0, 2.0, 4.0]), 1e-4
    controls = [fem.Constant(domain.mesh, value) for value in at]
    f, kappa, beta = controls
    problem = replace(posed(Wall((), beta=beta)), f=f, kappa=kappa)

    def J(solution: Solution) -> ufl.Form:
        return solution.u**2 * ufl.dx

    solution = solve(domain, problem)
    found = solution.gradient(J(solution), controls).gradients
    for control, derivative in zip(controls, found, strict=True):
        ends, value = [], float(control.value)
        for sign in (-1, 1):
            control.value = value + sign * step
            ends.append(fem.assemble_scalar(fem.form(J(solve(domain, problem)))))
        control.value = value
        assert derivative == pytest.approx((ends[1] - ends[0]) / (2 * step), rel=1e-5)


@pytest.mark.parallel([2, 3])
def test_several_ranks() -> None:
    """The bound is that of one rank if both sides of a pair are on one of them; else the reason is told."""
    cases = [("contact", 2), ("friction", 2), ("tied", 3)]

    def bounds(comm: MPI.Intracomm) -> list[float]:
        found = []
        for name, dim in cases:
            domain = boxes(*((4, 5) if dim == 2 else (2, 2)), dim, 0.17, 0.05, comm)
            found.append(certify(solve(domain, posed(LAWS[name], dim, c=0.5))).bound)
        return found

    world = MPI.COMM_WORLD
    alone = world.bcast(bounds(MPI.COMM_SELF) if world.rank == 0 else [])
    assert bounds(world) == pytest.approx(alone, rel=1e-9)
    apart = solve(boxes(4, 5, left=0.17, comm=world, pairs=()), posed(LAWS["tied"]))
    assert "give these parts as `pairs` where the domain is made" in certify(apart).if_none
    with pytest.raises(InputError, match="Mean: both sides of the pair"):
        apart.quantity(Mean(region="up"))
