"""Set updates where they could go wrong: cycles, ties, scales, Γ_S of any extent, ranks with nothing to do."""

import itertools

import numpy as np
import pytest
from mpi4py import MPI
from own_mesh import own_domain

from signorini_fenicsx.case import Case, load_case
from signorini_fenicsx.geometry import Domain
from signorini_fenicsx.errors import NumericalFailure
from signorini_fenicsx.solver import Solution, solve

COMM = MPI.COMM_WORLD


def problem(**values: object) -> Case:
    """Γ_S is "bottom"; keys of [problem] and [solve] stand alone."""
    sections = {"f": "problem", "u_D": "problem"}
    return load_case("example1").with_values(
        {"boundary.signorini": ["bottom"]} | {f"{sections.get(key, 'solve')}.{key}": v for key, v in values.items()}
    )


def assert_same_fields(a: Solution, b: Solution, tolerance: float) -> None:
    """Every degree of freedom agrees, relative to the largest of its field."""
    for one, two in [(a.sigma, b.sigma), (a.u, b.u), (a.p, b.p)]:
        largest = COMM.allreduce(np.abs(one.x.array).max(initial=0.0), MPI.MAX)
        np.testing.assert_allclose(one.x.array, two.x.array, rtol=0, atol=tolerance * largest)


CYCLING = [  # points of a strip of triangles, corners of the one facet of Γ_D, f, u_D
    ([(0.731, 0), (1.461, 0.039), (2.091, 0), (2.783, 0.055), (2.955, 0)], (3, 4), "22.2 - 16.7*x + 8.7*y", 0.56),
    ([(0.121, 0), (1.014, 0.039), (1.758, 0), (2.326, 0.112), (2.457, 0), (2.984, 0.171)], (3, 5),
     "-33 + 16.3*x + 8.1*y", 0.22),
    ([(0.231, 0), (0.998, 0.077), (1.508, 0), (1.727, 0.066), (1.76, 0), (1.822, 0.583), (2.186, 0)], (3, 5),
     "-18.3 + 11.3*x - 7*y", 0.29),
]  # fmt: skip


def strip(points: list[tuple[float, float]], dirichlet: tuple[int, int]) -> Domain:
    midpoint = np.mean([points[i] for i in dirichlet], axis=0)
    cells = [(i, i + 1, i + 2) for i in range(len(points) - 2)]
    return own_domain(COMM, points, cells, lambda x: ~np.isclose(x[:2].T, midpoint).all(axis=1))


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("backend", ["hybrid", "mixed"])
def test_cycles_end_by_single_changes(backend: str):
    """Obtuse cells on which all four algorithms cycle with period 3; the fallback ends in the solution of the quadratic programme."""
    for points, dirichlet, f, u_D in CYCLING:
        domain = strip(points, dirichlet)
        case = problem(f=f, u_D=str(u_D), backend=backend, eps=1e-10)
        expected = solve(case.with_values({"solve.algorithm": "qp"}), domain=domain)
        for algorithm in ("alg1", "alg2", "alg3", "alg4"):
            solution = solve(case.with_values({"solve.algorithm": algorithm}), domain=domain)
            assert "by changing single facets from iteration" in solution.reason, algorithm
            assert "cycle with period 3" in solution.reason
            assert min(step.changed for step in solution.history if step.changed) == 1
            assert len(solution.history) < 20
            assert_same_fields(solution, expected, 1e-9)
