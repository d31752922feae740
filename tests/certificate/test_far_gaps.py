"""Gaps and obstacles that cannot close change neither the bound nor the way to the solution; reasons are true."""

from typing import Any

import dolfinx.mesh
import numpy as np
import pytest
from elastic import box
from mpi4py import MPI

from signorini_fenicsx import Contact, Corners, Diffusion, Dirichlet, Elasticity, Neumann, Signorini
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.discrete.rounding import LOST, lost_digits
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.quantities import Mean
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
CURVED = "x^2/max(1 - x, 0.001)/4"
"""Under a round body: the gap along the normal grows without limit."""
STEEP = "-0.2*(1 + x)/max(1 - x, 0.01)"
STAIR = "-0.2 if x < -1/2 else (-0.4 if x < 0 else (-0.6 if x < 1/2 else -0.8))"
"""The mean of the membrane over it is about −0.3545."""


def pressed(gap: str, dim: int = 2) -> tuple[int, Any]:
    """A block that slides along its side and is pressed onto a foundation with this gap: iterations, and its bound."""
    sides = [Dirichlet("x0", components="x"), *([Dirichlet(["z0", "z1"], components="z")] if dim == 3 else [])]
    parts = {"y0": Contact("y0", gap), "y1": Neumann("y1", [0, -0.02, 0][:dim]), "x1": Neumann("x1")}
    problem = Elasticity(1.0, 0.25, conditions=[*sides, *parts.values()])
    solution = solve(box(COMM, 6 if dim == 2 else 2, [0.0] * dim, [1.0] * dim), problem)
    return len(solution.outcome.history), certify(solution)


@pytest.mark.parametrize("far", [CURVED, f"{CURVED} + (1e9 if x > 0.7 else 0)"])
def test_a_gap_that_cannot_close(far: str):
    """The sets and the bound are those of the gap that is cut off, and it is guaranteed."""
    (iterations, bound), (expected, near) = pressed(far), pressed(f"min({CURVED}, 1)")
    assert iterations == expected
    assert bound.bound == pytest.approx(near.bound, rel=1e-6)
    assert bound.guaranteed


@pytest.mark.parametrize("gap", ["0.02*(x - 0.3)^2", "0.02*abs(x - 0.69)"])
def test_open_facets_beside_given_displacements(gap: str):
    """Where the body moves off the foundation, what stands for the gap is not below a displacement that is given."""
    conditions = [Contact("y1", gap), Neumann("x1", [-0.15, 0]), Dirichlet(["x0", "y0"], [0, 0])]
    solution = solve(box(COMM, 3, [0.0, 0.0], [1.0, 1.0]), Elasticity(1.0, 0.3, f=[0.7, 0.3], conditions=conditions))
    certificate = certify(solution)
    assert certificate.bound < 0.021
    assert certificate.guaranteed


def membrane(n: int, psi: str, *, inside: bool = True) -> tuple[Solution, Certificate]:
    """A membrane on [−1, 1]² with 2 n² cells, under a load over an obstacle, or with its lower edge on it."""
    mesh = dolfinx.mesh.create_rectangle(COMM, [(-1, -1), (1, 1)], [n, n])
    edge = domain_of(mesh, {"bottom": lambda x: np.isclose(x[1], -1)})
    problem = Diffusion(f=-10, obstacle=psi) if inside else Diffusion(f=-1, conditions=[Signorini("bottom", psi)])
    solution = solve(edge, problem)
    return solution, certify(solution)


@pytest.mark.parametrize("inside", [True, False])
@pytest.mark.parametrize("far", [STEEP, f"{STEEP} - (1e4 if x > 0.85 else 0)"])
def test_an_obstacle_that_u_cannot_reach(far: str, inside: bool):
    """In Ω and on Γ_S, the bound is that of the obstacle that is cut off, and it is guaranteed."""
    (solution, bound), (other, near) = (membrane(8, psi, inside=inside) for psi in (far, f"max({STEEP}, -2)"))
    assert bound.bound == pytest.approx(near.bound, rel=1e-3)
    assert bound.guaranteed
    assert len(solution.outcome.history) <= len(other.outcome.history) + 1


def test_a_stair():
    """Where the obstacle jumps is said; with edges along the jumps the bound falls, and it is guaranteed."""
    found = [membrane(n, STAIR) for n in (8, 16, 10)]
    assert found[1][1].relative < 0.7 * found[0][1].relative < 0.35
    for solution, certificate in found:
        assert certificate.guaranteed
        (note,) = solution.notes()
        assert note.startswith("[problem] obstacle: jumps by 0.2 at (")
    mean = found[0][0].quantity(Mean())
    assert mean.lower < -0.3545 < mean.upper


def test_a_pressure_that_does_not_change():
    """The graph of a fluid in a crack is flat; the bound is that of a graph with another end, which is not reached."""
    bounds = []
    for before in (0.0, "vertical"):
        fluid = Corners("y0", corners=[(0.0, 0.1)], before=before)  # type: ignore[arg-type]
        problem = Elasticity(1.0, 0.25, conditions=[Dirichlet("y1"), fluid])
        bounds.append(certify(solve(box(COMM, 3, [0.0, 0.0], [1.0, 1.0]), problem)))
    assert bounds[0].bound == pytest.approx(bounds[1].bound, rel=1e-9)
    assert bounds[0].relative < 0.5
    assert bounds[0].guaranteed


def test_why_there_is_no_bound():
    """A κ that is 0 on a side is told; no solve fails for it."""
    square = build_domain(COMM, "square", 0.5, mesh="structured")
    problem = Diffusion(f="x", kappa="x", conditions=[Neumann(["left", "bottom", "top"])])
    certificate = certify(solve(square, problem))
    assert "kappa is not above 0 in all of the cell around (" in certificate.if_none


@pytest.mark.parametrize(
    ("data", "name"),
    [
        ({"f": "1e16 + x - 1e16"}, "f"),
        ({"f": "1 + sin(1e6*x)/1e9", "kappa": "1 + 1e12 + x - 1e12"}, "kappa"),
        ({"f": "1", "psi": "1e10 + x - 1e10 - 2"}, "psi"),
        ({"f": "(1 + x)^9 + 1e4 - 1e4"}, ""),
    ],
)
def test_texts_that_lose_digits(data: dict[str, str], name: str):
    """They are told, and the bound is not called guaranteed; what loses few digits does not matter."""
    square = build_domain(COMM, "square", 0.5, mesh="structured")
    given = {key: value for key, value in data.items() if key != "psi"}
    solution = solve(square, Diffusion(**given, conditions=[Signorini("bottom", data.get("psi", -1))]))
    assert lost_digits(solution) == ((name,) if name else ())
    certificate = certify(solution)
    assert certificate.guaranteed == (not name)
    assert not name or certificate.reservation == f"{name} {LOST}"
    assert name in ("f", "kappa") or solution.quantity(Mean()).guaranteed == (not name)
