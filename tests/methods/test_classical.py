"""The classical algorithms against Algorithm 1, against each other, and against theory."""

import itertools
import math

import numpy as np
import pytest
import ufl
from dolfinx import fem
from made_cases import case_of
from measuring.methods import compare_methods, distance, mass_imbalance
from mpi4py import MPI

from signorini_fenicsx import Domain, NumericalFailure, load_case, solve_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.comparing.convergence import Vary, convergence_study, fitted_slopes
from signorini_fenicsx.methods.registry import METHODS
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.solution import Solution

COMM = MPI.COMM_WORLD

MIXED = ("mixed-uzawa1", "mixed-uzawa2", "mixed-uzawa-h12", "mixed-uzawa-wang", "qp")
PRIMAL = ("uzawa", "psor", "primal-pdas")
CLASSICAL = (*MIXED, *PRIMAL, "primal-penalty", "slimane")


def example(name: str, h: float = 1 / 8, **values: object) -> Case:
    return load_case(name).with_values(
        {"solve.h": h, "solve.algorithm": "alg1"} | {f"solve.{key}": value for key, value in values.items()}
    )


def solved(case: Case, method: str, domain: Domain, **values: object) -> Solution:
    values = {f"solve.{key}": value for key, value in values.items()}
    return solve_case(case.with_values({"solve.algorithm": method} | values), COMM, domain=domain)


def test_all_are_registered():
    """And can be imported when they run."""
    assert set(METHODS) == {*CLASSICAL, *(f"alg{i}" for i in range(1, 5)), "snes1", "snes2", "vi"}
    assert all(algorithm.title and algorithm.reference for algorithm in METHODS.values())


def test_mixed_methods_equal_algorithm_1():
    """The Uzawa iterations, the interior-point method and SNESVI solve (MLM-I)_h, every unknown up to 1e-8."""
    for name in ("example2", "example5", "transition"):
        exact = solve_case(example(name, h=1 / 4), COMM)
        for method in (*MIXED, "vi"):
            solution = solved(case_of(exact), method, exact.spaces.domain)
            assert distance(solution, exact) < 1e-8, method
            assert solution.contact == exact.contact, method
            assert max(vars(solution.kkt).values()) < 1e-8, method
            assert solution.outcome.own_residual is None


def test_primal_methods_solve_one_problem():
    """Uzawa, over-relaxation and active sets agree; (9a) and p ≥ 0 hold; mass balance does not, as reported.

    Where u_D ≠ 0, (9a) holds up to the error of u_D by its vertex values.
    """
    for name in ("example6", "transition"):
        first = solve_case(example(name, h=1 / 4, algorithm="primal-pdas"), COMM)
        for method in PRIMAL:
            solution = solved(case_of(first), method, first.spaces.domain)
            assert distance(solution, first) < 1e-8, method
            assert solution.contact == first.contact, method
            assert solution.outcome.own_residual is not None
            assert solution.outcome.own_residual < 1e-8
            assert solution.converged
            assert solution.kkt.primal < 1e-9
            assert solution.kkt.stationarity < (0.1 if name == "transition" else 1e-9)
            assert solution.kkt.mass_balance > 0.01
            assert mass_imbalance(solution) > 0.1


def test_primal_order_on_an_exact_solution():
    """P1 with σ projected to RT0 and u by its cell means is of order 1 in both."""
    found = [solve_case(example("transition", h, algorithm="primal-pdas"), COMM) for h in (1 / 8, 1 / 16)]
    (h0, coarse), (h1, fine) = ((solution.spaces.domain.h, solution.errors()) for solution in found)
    for name, bound in (("sigma_L2", 0.28), ("u_L2", 0.058)):
        assert math.log(coarse[name] / fine[name]) / math.log(h0 / h1) > 0.93
        assert fine[name] < bound * h1


@pytest.mark.slow
def test_orders_in_eps():
    """Slimane's form tends to Algorithm 1 and the primal penalty to the active set in P1, both with order 1 in ε."""
    rows = convergence_study(example("example4", algorithm="slimane"), Vary.EPS, range(1, 6), 0)
    slopes = fitted_slopes(rows, Vary.EPS)
    assert [slopes[name] for name in ("sigma_V", "u_Q", "p_Lambda")] == pytest.approx([1.0] * 3, abs=0.05)

    limit = solve_case(example("example4", algorithm="primal-pdas"))
    far, near = (
        distance(solved(case_of(limit), "primal-penalty", limit.spaces.domain, eps=eps), limit) for eps in (1e-3, 1e-5)
    )
    assert math.log(far / near) / math.log(100) == pytest.approx(1.0, abs=0.05)


def test_slimane_is_off_by_eps_u():
    """∇·σ + f_h = εu in every cell; it is reported as the violated mass balance of a converged run."""
    solution = solve_case(example("example2", algorithm="slimane", eps=0.5), COMM)
    divergence = fem.Function(solution.spaces.Q)
    divergence.interpolate(fem.Expression(ufl.div(solution.sigma), solution.spaces.Q.element.interpolation_points))
    np.testing.assert_allclose(
        divergence.x.array + solution.data.f_h.x.array, 0.5 * solution.u.x.array, atol=1e-12, rtol=1e-9
    )
    assert solution.converged
    assert solution.kkt.mass_balance > 1e-3
    assert solution.violation()["mass_balance"] == pytest.approx(0.5 * solution.norms()["u_L2"])


@pytest.mark.slow
def test_iterations_over_h():
    """Uzawa and over-relaxation take O(1/h) iterations, H^{1/2}, minimisation Uzawa and the active sets O(1)."""
    counts: dict[str, list[int]] = {}
    for h in (1 / 4, 1 / 8, 1 / 16):
        case = example("example1", h=h)
        domain = mesh_case(case, COMM)
        for method in (*PRIMAL, *MIXED[:4], "alg1"):
            counts.setdefault(method, []).append(len(solved(case, method, domain).outcome.history))
    for method in ("uzawa", "psor", "mixed-uzawa1", "mixed-uzawa2"):
        for few, many in itertools.pairwise(counts[method]):
            assert 1.4 < many / few < 2.8, method
    for method in ("mixed-uzawa-h12", "mixed-uzawa-wang"):
        assert max(counts[method]) < 1.5 * min(counts[method]), method
    for method in ("primal-pdas", "alg1"):
        assert max(counts[method]) <= min(counts[method]) + 3, method


def test_no_method_is_another():
    """Each method has its own iterates."""
    case = example("example2", h=1 / 4, eps=1e-2)
    domain = mesh_case(case, COMM)
    changes = {
        method: [step.sigma_change for step in solved(case, method, domain).outcome.history]
        for method in (*CLASSICAL, "alg1", "alg3", "vi")
    }
    for one, two in itertools.combinations(changes, 2):
        assert changes[one] != pytest.approx(changes[two], rel=1e-3), (one, two)


def test_no_load():
    for method in CLASSICAL:
        solution = solve_case(example("example1", h=1 / 4, algorithm=method).with_values({"problem.f": "0"}), COMM)
        assert max(solution.norms().values()) == 0, method
        assert solution.converged


@pytest.mark.parametrize(
    ("method", "outside"),
    [
        ("mixed-uzawa1", 4),
        pytest.param("mixed-uzawa2", 1.3, marks=pytest.mark.slow),
        ("mixed-uzawa-h12", 1.3),
        ("uzawa", 4),
    ],
)
def test_range_of_rho(method: str, outside: float):
    """For ρ inside the reported range it converges to the same solution; far outside it fails and says why.

    In σ·n and λ the eigenvector of λ_max is smooth and not only in the contact set, so a larger ρ still converges.
    """
    case = example("example1", algorithm=method)
    automatic = solve_case(case)
    limit = automatic.outcome.details["rho_limit"]
    assert automatic.outcome.details["rho"] == pytest.approx(0.75 * limit)
    inside = solved(case, method, automatic.spaces.domain, rho=0.9 * limit)
    assert distance(inside, automatic) < 1e-8
    with pytest.raises(NumericalFailure, match="outside of its range") as failed:
        solved(case, method, automatic.spaces.domain, rho=outside * limit, max_iterations=300)
    assert failed.value.solution is not None


def test_comparison():
    fine = solve_case(example("example1", h=1 / 8))
    methods = ("primal-pdas", "slimane", "qp")
    rows = {row.method: row for row in compare_methods(example("example1"), 1 / 4, fine, methods)}
    assert tuple(rows) == methods
    for row in rows.values():
        assert 0.1 < row.flux < 0.6
        assert 0 < row.contact < 0.2
    assert rows["qp"].distance < 1e-8 < rows["primal-pdas"].distance
    assert rows["qp"].mass < 1e-12 < rows["slimane"].mass < 1e-8 < rows["primal-pdas"].mass
