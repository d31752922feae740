"""The bound of RT1: order two, near known errors under every law, never below finer solutions."""

import math

import dolfinx.mesh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from made_cases import EXACT, on_grid
from makers.bounds import examine
from mpi4py import MPI

from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import adapt_case, solve_case
from signorini_fenicsx.certificate.adaptive import AdaptRow, adapt
from signorini_fenicsx.certificate.certify import bound_field, certify
from signorini_fenicsx.contact.laws import Neumann, Signorini
from signorini_fenicsx.discrete.bernstein import basis, coefficients_of, jet, nodes
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.bound import relaxation
from signorini_fenicsx.physics.diffusion.problem import Diffusion
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
RT1 = Options(element="RT1")


def with_all_data(dim: int, n: int) -> Solution:
    """Contact at the bottom with u = ψ and σ·n = q_S + 1, a flux on the right; all data vary, κ within cells."""
    u, q_S, g_N, f = (
        (
            "sin(2*x + y)",
            "-(1 + x)*cos(2*x + y) - 1",
            "2*(1 + x)*cos(2*x + y)",
            "5*(1 + x)*sin(2*x + y) - 2*cos(2*x + y)",
        )
        if dim == 2
        else ("x^3*y + z^2", "-2*z*(1 + x) - 1", "3*(1 + x)*x^2*y", "-6*(1 + x)*x*y - 2*(1 + x) - 3*x^2*y")
    )
    conditions = [Signorini("bottom", psi=u, q_S=q_S), Neumann("right", g_N)]
    problem = Diffusion(f=f, kappa="1 + x", u_D=u, exact=u, conditions=conditions)
    shape = "square" if dim == 2 else "cube"
    return solve(build_domain(COMM, shape, 1.0001 * math.sqrt(dim) / n, mesh="structured"), problem, RT1)


@pytest.mark.parametrize(("dim", "numbers", "most"), [(2, (8, 16), 1.2), (3, (2, 4), 1.35)])
def test_all_data(dim: int, numbers: tuple[int, int], most: float):
    """Of second order, and guaranteed."""
    bounds = []
    for n in numbers:
        solution = with_all_data(dim, n)
        errors, certificate = solution.errors(), certify(solution)
        assert errors is not None
        assert certificate.guaranteed, certificate.reservation
        assert errors["energy"] < certificate.sigma_bound < certificate.bound
        bounds.append(certificate.bound)
    assert certificate.bound < most * errors["energy"]
    assert math.log2(bounds[0] / bounds[1]) > 1.9


@pytest.mark.parametrize(
    ("name", "most"), [("transition", 1.15), ("singular", 1.06), ("biactive", 1.1), *((name, 1.55) for name in EXACT)]
)
def test_known_solutions(name: str, most: float):
    """Transitions inside facets, both pairs 0 on a half of Γ_S, every law; where f has kinks these are in the bound."""
    solution = on_grid(name, 16, solve__element="RT1")
    errors, certificate = solution.errors(), certify(solution)
    assert errors is not None
    assert certificate.guaranteed
    assert errors["energy"] < certificate.sigma_bound < 1.25 * errors["energy"]
    assert certificate.bound < most * errors["energy"]


@pytest.mark.parametrize(("algorithm", "eps"), [("alg3", 0.01), ("alg4", 1e-9)])
def test_penalties(algorithm: str, eps: float):
    """With `for_signorini` the bound has the error by ε in it."""
    solution = on_grid("transition", 8, solve__element="RT1", solve__algorithm=algorithm, solve__eps=eps)
    errors, certificate = solution.errors(), certify(solution, for_signorini=True)
    assert errors is not None
    assert errors["energy"] < certificate.sigma_bound < 1.6 * errors["energy"]
    assert certify(solution).of == "the exact solution of the penalty problem"


@pytest.mark.parametrize(("name", "most"), [("crack", 1.6), ("fault", 1.25)])
def test_parts_inside_the_domain(name: str, most: float):
    """The transition of the crack is inside a facet."""
    solution = solve_case(load_case(name).with_values({"solve.element": "RT1"}), COMM)
    errors, certificate = solution.errors(), certify(solution)
    assert errors is not None
    assert certificate.guaranteed
    assert errors["energy"] < certificate.sigma_bound < most * errors["energy"]


@pytest.mark.parametrize(
    ("seed", "jumps", "most"),
    [(9, "across", 1.4), (11, "aligned", 1.4), pytest.param(0, "aligned", 2.5, marks=pytest.mark.slow)],  # 0: in space
)
def test_random_problems(seed: int, jumps: str, most: float):
    """Against solutions on the mesh refined twice, with waves for all data; κ jumps by 1e6, also within cells."""
    row = examine(seed, jumps, COMM, "RT1")
    assert not row.wrong
    assert 1 < row.ratio < most


def test_adaptive_runs():
    """One per cent of example 1 with some 700 cells, where RT0 needs 85 000, and with the best slope."""
    case, rows = load_case("example1").with_values({"solve.element": "RT1", "solve.h": 0.2}), []
    _, certificate = adapt_case(case, COMM, target=0.01, on_row=rows.append)
    assert certificate.guaranteed
    assert certificate.relative <= 0.01
    assert rows[-1].cells < 750
    slope = math.log(rows[-1].bound / rows[1].bound) / math.log(rows[-1].unknowns / rows[1].unknowns)
    assert -1.15 < slope < -0.95


@pytest.mark.parallel([1, 2])
def test_many_steps_with_jumps_of_kappa(monkeypatch):
    """On graded meshes whose κ jumps by 1e4 across corners CG for v needs few iterations, whatever the mesh is."""
    taken, solve_with, rows = list[int](), FacetSolver.solve, list[AdaptRow]()

    def counted(solver, *vectors):
        solve_with(solver, *vectors)
        taken.append(solver.ksp.getIterationNumber())

    monkeypatch.setattr(relaxation, "FacetSolver", type("Counted", (FacetSolver,), {"solve": counted}))
    mesh = dolfinx.mesh.create_unit_square(COMM, 8, 8)
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    x, y, _ = dolfinx.mesh.compute_midpoints(mesh, 2, cells).T
    upper = (x - 0.5) * (y - 0.5) > 0
    sides = {"bottom": lambda x: np.isclose(x[1], 0), "sides": lambda x: np.isclose(x[0] * (1 - x[0]), 0)}
    domain = domain_of(mesh, sides, {"one": cells[upper], "other": cells[~upper]})
    conditions = [Signorini("bottom", psi=-0.05), Neumann("sides")]
    problem = Diffusion(f="40*(x - 0.6)", kappa={"one": 1, "other": 1e4}, conditions=conditions)
    _, certificate = adapt(domain, problem, max_cells=1500, on_row=rows.append)
    assert len(taken) > len(rows)
    assert max(taken) <= 8
    assert certificate.bound == pytest.approx(0.405460, rel=1e-4)


def test_fields():
    """How wrong a function of another program is, from both sides."""
    solution = on_grid("transition", 8, solve__element="RT1")
    mesh = solution.spaces.mesh
    v, x = fem.Function(fem.functionspace(mesh, ("Lagrange", 2))), ufl.SpatialCoordinate(mesh)
    v.interpolate(lambda x: np.maximum(x[0] - 0.413, 0) ** 3 - x[1] * np.maximum(0.413 - x[0], 0) ** 3)
    slope = ufl.grad(v - (ufl.max_value(x[0] - 0.413, 0) ** 3 - x[1] * ufl.max_value(0.413 - x[0], 0) ** 3))
    error = math.sqrt(fem.assemble_scalar(fem.form(ufl.inner(slope, slope) * ufl.dx(degree=12))))
    found = bound_field(solution, v)
    assert found.guaranteed
    assert found.lower <= error <= found.bound < 1.8 * error


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_bernstein(dim: int, degree: int):
    """Coefficients give back values in nodes, and values and gradients of a polynomial."""
    cell = SIMPLEX[dim]

    def p(x: np.ndarray) -> np.ndarray:
        return (1 + x @ np.arange(1.0, dim + 1)) ** degree

    x = nodes(cell, degree)
    coefficients = coefficients_of(p(x)[None], cell)
    np.testing.assert_allclose(basis(cell, degree, x) @ coefficients[0], p(x))
    points, slope = np.full((1, dim), 0.2), np.arange(1.0, dim + 1)
    barycentric = np.column_stack([1 - points.sum(axis=1), points])
    value, *gradient = jet(coefficients, barycentric[None], np.vstack([-np.ones(dim), np.eye(dim)])[None])[0, 0]
    assert value == pytest.approx(p(points)[0])
    np.testing.assert_allclose(gradient, degree * (1 + points[0] @ slope) ** (degree - 1) * slope)
