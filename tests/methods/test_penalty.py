"""Algorithms 3 and 4 and both SNES forms against each other, Algorithm 1 and the residuals of (25), (26)."""

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem, la
from made_cases import petsc_options
from mpi4py import MPI

from signorini_fenicsx import Domain, load_case, solve_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.comparing.convergence import Vary, convergence_study, fitted_slopes, level_values
from signorini_fenicsx.forms.mixed import Fields
from signorini_fenicsx.forms.penalty import mp_eps_1, mp_eps_2
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.show.differences import slobodeckij_norm
from signorini_fenicsx.physics.diffusion.solution import Solution

COMM = MPI.COMM_WORLD


def penalised(name: str, algorithm: str, eps: float, h: float = 1 / 16, **values: object) -> Case:
    return load_case(name).with_values(
        {"solve.h": h, "solve.algorithm": algorithm, "solve.eps": eps}
        | {key.replace("_", ".", 1): value for key, value in values.items()}
    )


def distance(a: Solution, b: Solution) -> float:
    """Largest difference of any degree of freedom, over all ranks."""
    pairs = [(a.sigma, b.sigma), (a.u, b.u), (a.p, b.p)]
    local = max(np.abs(x.x.array - y.x.array).max(initial=0.0) for x, y in pairs)
    return COMM.allreduce(local, MPI.MAX)


@pytest.mark.parallel([1, 2])
def test_set_algorithms_equal_newton():
    """Algorithm 3 = snes1 and Algorithm 4 = snes2 from ε = 1 to 1e-12, in few steps."""
    for name, eps in (("example2", 1.0), ("example6", 1e-8), ("example4", 1e-12)):
        domain = mesh_case(penalised(name, "alg3", eps), COMM)
        for algorithm, newton in (("alg3", "snes1"), ("alg4", "snes2")):
            one = solve_case(penalised(name, algorithm, eps), COMM, domain=domain)
            two = solve_case(penalised(name, newton, eps), COMM, domain=domain)
            assert distance(one, two) < 1e-11
            assert one.contact == two.contact
            assert max(len(one.outcome.history), len(two.outcome.history)) <= 12


@pytest.mark.parallel([1, 2])
def test_small_penalty_equals_no_penalty():
    """At ε = 1e-10 both penalties have the norms and the contact set of Algorithm 1, up to 1e-8."""
    for name in ("example2", "example5"):
        exact = solve_case(penalised(name, "alg1", 1.0), COMM)
        for algorithm in ("alg3", "alg4"):
            solution = solve_case(penalised(name, algorithm, 1e-10), COMM, domain=exact.spaces.domain)
            assert solution.norms() == pytest.approx(exact.norms(), abs=1e-8)
            assert solution.contact == exact.contact


@pytest.mark.parallel([1, 2])
def test_solutions_satisfy_the_literal_forms():
    """Algorithm 3 solves (25) and Algorithm 4 solves (26), with 1/ε."""
    for eps in (1.0, 1e-3):
        for algorithm, problem in (("alg3", mp_eps_1), ("alg4", mp_eps_2)):
            solution = solve_case(penalised("example4", algorithm, eps), COMM)
            spaces = solution.spaces
            fields = Fields(solution.sigma, solution.u, solution.p)
            tests = Fields(*(ufl.TestFunction(space) for space in (spaces.V, spaces.Q, spaces.Lambda)))
            for form in problem(fields, tests, solution.data.f_h, ufl.as_ufl(eps), spaces.n, ufl.dx, spaces.ds):
                residual = fem.assemble_vector(spaces.form(form))
                residual.scatter_reverse(la.InsertMode.add)
                assert la.norm(residual) < 1e-11


@pytest.mark.parallel([1, 2])
def test_what_the_penalty_leaves():
    """(MPε-I) keeps σ·n ≥ 0 and violates p ≥ 0 by O(ε); (MPε-II) the reverse. Both satisfy their laws."""
    for algorithm, violated, kept in (("alg3", "trace", "flux"), ("alg4", "flux", "trace")):
        large, small = (solve_case(penalised("example4", algorithm, eps), COMM) for eps in (1e-3, 1e-5))
        for solution in (large, small):
            assert solution.violation()[kept] < 1e-14
            assert max(vars(solution.kkt).values()) < 1e-11
        assert large.violation()[violated] / small.violation()[violated] == pytest.approx(100, rel=0.05)


SHEARED = [  # cells, stretch of y, shear, diagonal, f: cells with two Γ_S facets, on which the clip (36) cycles
    (2, 0.433, 3.72, "left", "40*sin(0.67 - 9.4*x)*cos(4.8*y - 0.76)"),
    (3, 0.543, 2.88, "left", "60*sin(0.95 - 3*x)*cos(6.2*y + 0.35)"),
    (4, 0.554, 3.92, "left", "30*sin(0.95 - 3.4*x)"),
    (3, 0.396, -3.7, "right", "-72*sin(-9.3*x - 0.64)*cos(0.81 - 8.5*y)"),
]


def sheared(n: int, stretch: float, shear: float, diagonal: str, f: str) -> tuple[Case, Domain]:
    case = load_case("example4").with_values(
        {
            "geometry.mesh": "structured",
            "geometry.diagonal": diagonal,
            "boundary.signorini": ["left", "top", "right"],
            "problem.f": f,
            "solve.h": 1.5 / n,
            "solve.eps": 1e-6,
        }
    )
    domain = mesh_case(case, COMM)
    x = domain.mesh.geometry.x
    x[:, 1] *= stretch
    x[:, 0] += shear * x[:, 1]
    return case, domain


@pytest.mark.parallel([1, 2])
def test_clip_that_cycles_is_given_up_and_reported():
    for parameters in SHEARED:
        case, domain = sheared(*parameters)
        solution = solve_case(case.with_values({"solve.algorithm": "alg3"}), COMM, domain=domain)
        newton = solve_case(case.with_values({"solve.algorithm": "snes1"}), COMM, domain=domain)
        assert "without the clip (36)" in solution.outcome.reason
        assert "cycle with period 2" in solution.outcome.reason
        assert any(step.clipped for step in solution.outcome.history)
        assert distance(solution, newton) < 1e-9
        assert solution.converged


@pytest.mark.parametrize("option", ["snes_linesearch_type bt", "snes_type newtontr"])
def test_snes_obeys_the_user(option: str):
    """Other line searches and a trust region, given as PETSc options, end in the same solution."""
    name, value = option.split()
    expected = solve_case(penalised("example4", "alg3", 1e-4))
    with petsc_options(**{name: value}) as options:
        found = solve_case(penalised("example4", "snes1", 1e-4), domain=expected.spaces.domain)
        assert options.getString(name) == value
    assert distance(found, expected) < 1e-9
    assert ("newtontr" in found.outcome.linear_solver) == (value == "newtontr")


def test_continuation_when_the_direct_start_fails():
    """With too few steps per ε the direct start fails, and continuation in ε from 1 down succeeds."""
    case = penalised("example5", "snes1", 1e-3, h=1 / 8)
    direct = solve_case(case)
    with petsc_options(snes_max_it=len(direct.outcome.history) - 1):
        continued = solve_case(case, domain=direct.spaces.domain)
    assert "by continuation from ε = 1: the direct start ended with SNES reason" in continued.outcome.reason
    assert distance(direct, continued) < 1e-11


def test_slope_in_eps():
    """At fixed h the penalty error is of order 1 in ε, and that of √ε‖e_σ·n‖ of order 3/2."""
    for algorithm in ("alg3", "alg4"):
        rows = convergence_study(penalised("example4", algorithm, 1.0, h=1 / 8), Vary.EPS, range(2, 7), 0)
        slopes = fitted_slopes(rows, Vary.EPS)
        assert slopes.pop("flux_scaled") == pytest.approx(1.5, abs=0.1)
        assert list(slopes.values()) == pytest.approx([1.0] * 4, abs=0.05)


@pytest.mark.parametrize("vary", [Vary.H, Vary.EPS_H, Vary.EPS_H2])
def test_order_in_h(vary: Vary):
    """Order 1 for a fixed ε = 1e-8, for ε = h and for ε = h²."""
    case = penalised("transition", "alg4", 1e-8)
    coarse, fine = (solve_case(case.with_values(level_values(vary, level))).errors() for level in (3, 4))
    for name in ("sigma_L2", "u_L2", "p_L2"):
        assert 0.9 < math.log2(coarse[name] / fine[name]) < 1.4


def test_a_study_of_h_and_eps():
    """Its reference has no penalty, and a finer mesh than all rows."""
    rows = convergence_study(penalised("example4", "alg4", 1.0), Vary.EPS_H2, [1, 2], 3)
    assert [row.eps for row in rows] == [1 / 4, 1 / 16]
    assert rows[1].errors["sigma_V"] < 0.6 * rows[0].errors["sigma_V"]


@pytest.mark.parallel([1, 2])
def test_half_norm():
    """On one side of the unit square ‖1‖ = 1 and ‖x‖² = 1/3 + 1: the double integral of (x − x')²/|x − x'|² is 1."""
    solution = solve_case(load_case("example1").with_values({"boundary.signorini": ["top"], "solve.h": 1 / 32}), COMM)
    x = solution.spaces.Lambda.tabulate_dof_coordinates()[: len(solution.spaces.facets), 0]
    facet = solution.spaces.facet_measure.max(initial=0.0)
    assert slobodeckij_norm(solution, np.ones_like(x)) == pytest.approx(1.0)
    assert slobodeckij_norm(solution, x) ** 2 == pytest.approx(4 / 3 - COMM.allreduce(facet, MPI.MAX), rel=1e-3)
