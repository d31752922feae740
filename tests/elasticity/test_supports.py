"""Elastic supports: exact states, bodies on springs alone, rates, bounds, quantities, derivatives, files, refusals."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from commands import signorini
from elastic import box, smooth, stress
from mpi4py import MPI

from signorini_fenicsx.api import (
    Contact,
    Coulomb,
    Elasticity,
    InputError,
    Neumann,
    Support,
    certify,
    compare,
    load_case,
    load_solution,
    solve,
    solve_case,
)
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.forms.elasticity import strain
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.quantities import Energy, Force, Integral, Mean
from signorini_fenicsx.solving.options import Options

COMM = MPI.COMM_WORLD
STRESS = np.array([[0.1, 0.02, 0.03], [0.02, -0.05, 0.01], [0.03, 0.01, -0.2]])
MATRIX = np.array([[2, 0.5, 0], [0.5, 1, 0], [0, 0, 3.0]])


def in_a_uniform_state(dim: int) -> Elasticity:
    """A body in a uniform stress, moved and turned, that springs of three kinds alone hold."""
    sigma, shift = STRESS[:dim, :dim], [0.03, -0.02, 0.05]
    gradient = 1.3 * sigma - 0.3 * (np.trace(sigma) if dim == 3 else 1.3 * np.trace(sigma)) * np.eye(dim)
    gradient[0, 1], gradient[1, 0] = gradient[0, 1] + 0.1, gradient[1, 0] - 0.1
    rows = [[*map(float, row)] for row in gradient]
    u = [
        "+".join([str(c), *(f"({g!r})*{x}" for g, x in zip(row, "xyz", strict=False))])
        for row, c in zip(rows, shift, strict=False)
    ]
    conditions: list[Any] = []
    for axis, letter in enumerate("xyz"[:dim]):
        for end, sign in (("0", -1.0), ("1", 1.0)):
            part, n = f"{letter}{end}", sign * np.eye(dim)[axis]
            along, across = np.outer(n, n), np.eye(dim) - np.outer(n, n)
            springs: dict[str, tuple[Any, np.ndarray]] = {
                "x0": ([4, 0.7], 4 * along + 0.7 * across),
                "x1": (MATRIX[:dim, :dim].tolist(), MATRIX[:dim, :dim]),
                "y0": ([0, "3/2"], 1.5 * across),
                "y1": (2, 2 * np.eye(dim)),
            }
            given, matrix = springs.get(part, (None, np.zeros((dim, dim))))
            pulls = [
                f"{float(sigma[i] @ n)!r}" + "".join(f"+({float(matrix[i, j])!r})*({u[j]})" for j in range(dim))
                for i in range(dim)
            ]
            conditions += [Neumann(part, pulls)] + ([] if given is None else [Support(part, given)])
    return Elasticity(1.0, 0.3, exact=u, conditions=conditions)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parallel([1, 3])
def test_uniform_state_is_exact(dim: int):
    """Springs along n, across it, and by a matrix, with loads besides: the solution is exact, and so is its bound."""
    solution = solve(box(COMM, 2, [0.0] * dim, [1.0] * dim), in_a_uniform_state(dim))
    errors, bound = solution.errors(), solution.certify()
    assert errors is not None
    assert max(errors["energy"], errors["u_L2"]) < 1e-12
    assert bound.guaranteed
    assert bound.bound < 1e-8
    assert solution.resultants()["x0"][:dim] == pytest.approx(-STRESS[0, :dim], abs=1e-12)


@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_smooth_solution(dim: int):
    """The stress has order 2, the bound is above its error, and near it."""
    errors, bounds = [], []
    for n in (1, 2) if dim == 3 else (4, 8):
        domain = box(COMM, n, [0.0] * dim, [1.0] * dim)
        young, u, f = smooth(domain, 0.3)
        last, springs = "yz"[dim - 2], {"x1": 2.0, f"{'xyz'[dim - 1]}1": [3.0, 0.5]}
        sigma = stress(strain(u), young / 1.3, 0.3 if dim == 2 else 0.3 / 1.3)
        conditions: list[Any] = [Contact(f"{last}0")]
        for part, given in springs.items():
            normal = np.eye(dim)[0 if part == "x1" else dim - 1]
            along, across = given if isinstance(given, list) else (given, given)
            matrix = ufl.as_matrix(((along - across) * np.outer(normal, normal) + across * np.eye(dim)).tolist())
            pull = sigma * ufl.as_vector(normal.tolist()) + matrix * u
            conditions += [Support(part, given), Neumann(part, pull)]
        solution = solve(domain, Elasticity(young, 0.3, f=f, u_D=u, exact=u, conditions=conditions))
        errors.append(solution.errors()["energy"])
        bounds.append(certify(solution).sigma_bound)
    share = 0.3 if dim == 2 else 0.35
    assert errors[1] < share * errors[0]
    assert bounds[1] < share * bounds[0]
    ratios = np.array(bounds) / errors
    assert ratios.min() > 1
    assert ratios.max() < (2 if dim == 2 else 3)


def rocking(n: int, **more: Any) -> Elasticity:
    """A block on springs alone, pressed obliquely onto a rough stop."""
    conditions = [
        Support("x0", [1.0, 0.2]),
        Support("y0", [[0.1, 0.05], [0.05, 0.3]]),
        Contact("x1", gap=0.01, friction=Coulomb(0.3)),
        Neumann("y1", [0.05, "-0.1*x"]),
    ]
    return Elasticity(1.0, 0.3, conditions=conditions, **more)


def test_bound_on_springs_alone():
    """It is above the distance to a finer solution, and not far above."""
    coarse, fine = (solve(box(COMM, n, [0.0, 0.0], [1.0, 1.0]), rocking(n)) for n in (3, 9))
    assert coarse.contact.facets > 0
    distance, bound = compare(fine, coarse).norms.energy, certify(coarse)
    assert distance < bound.bound + certify(fine).bound
    assert bound.bound < 1.6 * distance
    assert coarse.quantities()["balance"] < 1e-13


@pytest.mark.parallel([1, 3])
def test_multigrid():
    """CG with multigrid finds what a factorisation finds."""
    domain = box(COMM, 8, [0.0, 0.0], [1.0, 1.0])
    direct = solve(domain, rocking(8))
    iterated = solve(domain, rocking(8), Options(tuning=Tuning(direct_up_to=0)))
    assert iterated.outcome.linear_solver == "cg+mg"
    np.testing.assert_allclose(iterated.stresses, direct.stresses, atol=1e-9)


def test_derivative():
    """By E and a load, against differences."""
    domain = box(COMM, 3, [0.0, 0.0], [1.0, 1.0])

    def solved(young: float) -> Any:
        conditions = [Support("y0", [1.0, 0.3]), Contact("x1", gap=0.01), Neumann(["x0", "y1"], [0.1, "-0.1"])]
        return solve(domain, Elasticity(young, 0.3, conditions=conditions))

    def work(of: Any) -> ufl.Form:
        return ufl.inner(of.sigma, of.sigma) * ufl.dx(of.sigma.function_space.mesh)

    solution = solved(1.0)
    _, (gradient,) = solution.gradient(work(solution), ["problem.young"])
    above, below = (each.spaces.integrate(work(each)) for each in (solved(1 + 1e-5), solved(1 - 1e-5)))
    assert (above - below) / 2e-5 == pytest.approx(gradient, rel=1e-5)


CASE = """physics = "elasticity"
geometry = {shape = "square", mesh = "structured"}
boundary = {contact = ["bottom"], neumann = ["left", "right", "top"]}
solve = {h = "1/4"}
[problem]
young = 1
poisson = 0.3
gap = 0.05
g_N = {top = [0.02, -0.1]}
support = {left = [0.5, 0.2], right = "1/4", top = [[0.1, 0], [0, 0.2]]}
"""


def test_case_file(tmp_path: Path):
    """On the command line; the supports are told, and the file can be read."""
    (tmp_path / "springs.toml").write_text(CASE, encoding="utf-8")
    done = signorini(tmp_path, "solve", "springs.toml", "--output", "out")
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["quantities"]["balance"] < 1e-13
    assert "elastic support" in signorini(tmp_path, "check", "springs.toml").stdout
    bound = certify(load_solution(tmp_path / "out"))
    assert bound.guaranteed
    assert bound.bound == pytest.approx(certify(solve_case(load_case(tmp_path / "springs.toml"))).bound, rel=1e-8)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"y0": 1}, "support.y0: a support is on a part in neumann"),
        ({"x0": -1}, "support.x0: must not be negative"),
        ({"x0": [0, 0]}, "must not be negative, and not 0 in all directions"),
        ({"x0": "x"}, "support.x0: must be a number"),
        ({"x0": [[1, 2], [2, 1]]}, "must be symmetric and not 0, with no negative eigenvalue"),
        ({"x0": [[2, 1], [0, 2]]}, "must be symmetric and not 0, with no negative eigenvalue"),
        ({"x0": [1, 2, 3]}, "a number, two along n and across it, or a matrix of 2 rows"),
        ({"x0": [0, 1]}, "the body can move rigidly"),
    ],
)
def test_refusals(given: dict[str, Any], message: str):
    """What is no stiffness, and springs that do not hold the body."""
    load = {"x1": [0.1, 0.0], "y1": [0.0, -0.1]}
    posed = ElasticProblem(1.0, 0.3, g_N=load, support=given, boundary=ElasticBoundary(["y0"], ["x0", "x1", "y1"]))
    with pytest.raises(InputError, match=message):
        solve(box(COMM, 1, [0.0, 0.0], [1.0, 1.0]), posed)


def test_symmetric_up_to_rounding():
    """The stiffness and the strain of a body that was turned are symmetric up to rounding alone."""
    turned, load = float(np.nextafter(0.1, 1)), {"x1": [0.1, 0.0], "y1": [0.0, -0.1]}
    both: dict[str, Any] = {"support": {"x0": [[2, 0.1], [turned, 2]]}, "eigenstrain": [[0.2, turned], [0.1, 0]]}
    posed = ElasticProblem(1.0, 0.3, g_N=load, **both, boundary=ElasticBoundary(["y0"], ["x0", "x1", "y1"]))
    assert solve(box(COMM, 1, [0.0, 0.0], [1.0, 1.0]), posed).kkt.equilibrium < 1e-12


ON_SPRINGS = (
    Energy(),
    Mean(direction=[1, 0]),
    Integral(direction=[0.6, 0.8], parts="x0", weight="1 + y"),
    Force("x1", [1, 0]),
)
"""Quantities of a body on springs; the second part is on springs itself, the last one in contact."""


def test_intervals_in_a_uniform_state():
    """Energy and integrals over springs are known to rounding."""
    solution = solve(box(COMM, 1, [0.0, 0.0], [1.0, 1.0]), in_a_uniform_state(2))
    sigma, shift = STRESS[:2, :2], np.array([0.03, -0.02])
    gradient = 1.3 * sigma - 0.39 * np.trace(sigma) * np.eye(2) + [[0, 0.1], [-0.1, 0]]
    simpson = [(0.0, 1 / 6), (0.5, 4 / 6), (1.0, 1 / 6)]
    springs = {(0, 0): np.diag([4, 0.7]), (0, 1): MATRIX[:2, :2], (1, 0): np.diag([1.5, 0]), (1, 1): 2 * np.eye(2)}
    energy, on_x0 = 0.5 * np.sum(sigma * gradient), 0.0
    for (axis, end), stiffness in springs.items():
        for along, weight in simpson:
            u = shift + gradient @ np.insert([along], axis, end)
            pull = sigma[axis] * (2 * end - 1) + stiffness @ u
            energy += weight * (u @ stiffness @ u / 2 - pull @ u)
            on_x0 += weight * (1 + along) * (u @ [0.6, 0.8]) * ((axis, end) == (0, 0))
    for kind, known in zip(ON_SPRINGS[::2], (energy, on_x0), strict=True):
        found = solution.quantity(kind)
        assert found.guaranteed, found.reason
        assert found.lower - 1e-12 <= known <= found.upper + 1e-12
        assert found.width < 1e-7
