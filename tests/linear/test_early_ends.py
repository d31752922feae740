"""PETSc options that end an iteration early: what then is called a solution is one."""

import numpy as np
import pytest
from petsc4py import PETSc

from signorini_fenicsx.base.errors import NumericalFailure
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.contact.residuals import relative
from signorini_fenicsx.linear import gmres

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


@pytest.mark.parametrize(("given", "algorithm"), [(given, name) for given, names in EARLY for name in names])
def test_an_early_end_is_no_solution(given: str, algorithm: str):
    """Either the run fails, or its fields are those without the options."""
    case = load_case("example1").with_values({"solve.h": 1 / 6, "solve.algorithm": algorithm})
    expected = solve_case(case)
    options = PETSc.Options()
    chosen = dict(entry.split("=") for entry in given.split())
    for name, value in chosen.items():
        options[name] = value
    try:
        found = solve_case(case, domain=expected.spaces.domain, tuning=Tuning(predict_from=0))
    except NumericalFailure:
        return
    finally:
        for name in chosen:
            options.delValue(name)
    largest = np.abs(expected.sigma.x.array).max()
    np.testing.assert_allclose(found.sigma.x.array, expected.sigma.x.array, atol=1e-6 * largest)


def test_gmres_without_more_steps_is_not_at_its_end(monkeypatch: pytest.MonkeyPatch):
    """A matrix with a share of its second row added to the first one."""
    rows = np.diag(np.arange(1.0, 7)) + np.diag(np.full(5, 0.1), 1) + np.diag(np.full(5, 0.1), -1)
    matrix, load = PETSc.Mat().createDense((6, 6), array=rows.T.copy(), comm=PETSc.COMM_SELF), np.arange(1.0, 7)
    matrix.assemble()
    preconditioner = PETSc.PC().create(PETSc.COMM_SELF)
    preconditioner.setOperators(matrix)
    preconditioner.setType("none")
    added = np.array([0]), np.array([1]), np.array([0.5])
    found = []
    for most in (gmres.DIRECTIONS, 2):
        monkeypatch.setattr(gmres, "DIRECTIONS", most)
        x = matrix.createVecLeft()
        _, at_end = gmres.coupled(matrix, matrix, preconditioner, load, np.array([], dtype=np.int32), added, x, 0, 1e-9)
        left = rows @ x.array_r + 0.5 * np.eye(6)[0] * (rows @ x.array_r)[1] - load
        found.append((at_end, bool(np.linalg.norm(left) < 1e-8)))
    assert found == [(True, True), (False, False)]


def test_nothing_is_no_solution_of_a_problem_with_loads():
    """With σ = 0 and u = 0 there is no size to compare with; the residual is not 0."""
    options = PETSc.Options()
    options["snes_atol"] = 1
    try:
        with pytest.raises(NumericalFailure, match="KKT residuals above 1e-08: mass_balance inf"):
            solve_case(load_case("example1").with_values({"solve.h": 1 / 6, "solve.algorithm": "snes1"}))
    finally:
        options.delValue("snes_atol")


def test_relative_sizes():
    """0 stays 0 whatever it is compared with, all else beside 0 is infinite, and NaN is not lost."""
    zero, one = np.zeros(2), np.array([0.0, 1.0])
    with np.errstate(all="ignore"):
        assert relative(zero, zero) == 0
        assert relative(one, zero) == np.inf
        assert relative(one, np.array([2.0, 4.0])) == 0.25
        assert np.isnan(relative(np.array([np.nan, 1.0]), one + 1))
