"""PETSc options that end an iteration early: what then is called a solution is one."""

import functools

import numpy as np
import pytest
from made_cases import case_of, petsc_options
from petsc4py import PETSc

from signorini_fenicsx import NumericalFailure, Solution, load_case, solve_case
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.residuals import relative
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix, Imposed
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.linear.gmres import DIRECTIONS
from signorini_fenicsx.linear.kept_factors import KeptFactors

EARLY = [
    ("snes_atol=1", ["snes1", "snes2"]),
    ("snes_stol=0.1", ["snes1", "snes2"]),
    ("snes_type=ksponly", ["snes1", "snes2"]),
    ("snes_max_it=1", ["snes1", "vi"]),
    ("snes_convergence_test=skip snes_max_it=1", ["snes1", "snes2"]),
    ("ksp_type=cg pc_type=jacobi ksp_rtol=0.9", ["alg1", "alg4", "vi", "psor", "primal-pdas", "slimane"]),
    ("ksp_type=cg pc_type=jacobi ksp_atol=1e3", ["alg2", "primal-penalty", "mixed-uzawa1"]),
    ("ksp_type=richardson pc_type=jacobi ksp_norm_type=none ksp_max_it=1", ["alg1", "snes1", "vi"]),
]


@functools.cache
def undisturbed(algorithm: str) -> Solution:
    """Example 1 without options."""
    return solve_case(load_case("example1").with_values({"solve.h": 1 / 6, "solve.algorithm": algorithm}))


@pytest.mark.parametrize(("given", "algorithm"), [(given, name) for given, names in EARLY for name in names])
def test_an_early_end_is_no_solution(given: str, algorithm: str):
    """Either the run fails, or its fields are those without the options."""
    expected = undisturbed(algorithm)
    with petsc_options(**dict(entry.split("=") for entry in given.split())):
        try:
            found = solve_case(case_of(expected), domain=expected.spaces.domain, tuning=Tuning(predict_from=0))
        except NumericalFailure:
            return
    largest = np.abs(expected.sigma.x.array).max()
    np.testing.assert_allclose(found.sigma.x.array, expected.sigma.x.array, atol=1e-6 * largest)


def test_gmres_without_more_steps_is_not_at_its_end():
    """A matrix with a spring at its first row and a share of its second row, by factors without both."""
    rows = np.diag(np.arange(1.0, 7)) + np.diag(np.full(5, 0.1), 1) + np.diag(np.full(5, 0.1), -1)
    matrix, load = PETSc.Mat().createDense((6, 6), array=rows.T.copy(), comm=PETSc.COMM_SELF), np.arange(1.0, 7)
    matrix.assemble()
    operator = ConstrainedMatrix(matrix.convert("aij"), PETSc.Mat.Option.SPD)
    solver: FacetSolver = FacetSolver(operator.matrix, "facet_", {}, None, None)
    sites, none = np.arange(2, dtype=np.int32), np.array([], dtype=np.int32)
    factors = KeptFactors(solver, operator, none, sites, 2, np.array([[0], [1]]), np.array([[1], [0]]))
    x, free = matrix.createVecLeft(), np.zeros(2, dtype=bool)
    factors.solve_anew(load, x, Imposed(free, np.zeros((2, 1)), np.zeros((2, 1))))
    np.testing.assert_allclose(rows @ x.array_r, load, rtol=1e-13)
    imposed = Imposed(free, np.array([[3.0], [0.0]]), np.array([[0.5], [0.0]]))
    rows[0] += 0.5 * rows[1]
    rows[0, 0] += 3.0
    found = []
    for most in (1, DIRECTIONS):
        x.set(0.0)
        _, at_end = factors.coupled(load, x, imposed, 0.0, most)
        found.append((at_end, bool(np.linalg.norm(rows @ x.array_r - load) < 1e-8)))
    assert found == [(False, False), (True, True)]
    assert factors.coupled(load, x, imposed, 0.0) == (0, True)  # from the solution
    x.set(0.0)
    assert factors.coupled(0.0 * load, x, imposed, 0.0) == (0, True)


def test_a_failed_line_search_goes_on_with_full_steps():
    """A line search of SNESVI that asks for more than steps gain."""
    expected = undisturbed("vi")
    with petsc_options(snes_linesearch_type="bt", snes_linesearch_alpha=0.99, snes_linesearch_minlambda=0.5):
        found = solve_case(case_of(expected), domain=expected.spaces.domain)
    assert found.outcome.reason.startswith("SNESVI converged, by full steps after SNES reason -6")
    assert found.norms() == pytest.approx(expected.norms(), rel=1e-10)


def test_nothing_is_no_solution_of_a_problem_with_loads():
    """With σ = 0 and u = 0 there is no size to compare with; the residual is not 0."""
    case = load_case("example1").with_values({"solve.h": 1 / 6, "solve.algorithm": "snes1"})
    with petsc_options(snes_atol=1), pytest.raises(NumericalFailure, match="above 1e-08: mass_balance inf"):
        solve_case(case)


def test_relative_sizes():
    """0 stays 0 whatever it is compared with, all else beside 0 is infinite, and NaN is not lost."""
    zero, one = np.zeros(2), np.array([0.0, 1.0])
    with np.errstate(all="ignore"):
        assert relative(zero, zero) == 0
        assert relative(one, zero) == np.inf
        assert relative(one, np.array([2.0, 4.0])) == 0.25
        assert np.isnan(relative(np.array([np.nan, 1.0]), one + 1))
