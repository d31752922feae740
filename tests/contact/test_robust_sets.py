"""Set updates in difficult situations: cycles, ties, scales, any size of Γ_S, ranks with nothing to do."""

from collections.abc import Callable

import numpy as np
import pytest
from mpi4py import MPI
from own_mesh import Array, Mask, own_domain

from signorini_fenicsx import (
    Contact,
    Diffusion,
    Domain,
    Elasticity,
    NumericalFailure,
    Options,
    Signorini,
    load_case,
    solve,
    solve_case,
)
from signorini_fenicsx.contact.chains import Condition
from signorini_fenicsx.meshes.grids import Share
from signorini_fenicsx.meshes.shapes import SHAPES
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.solution import Solution

COMM = MPI.COMM_WORLD
SET_ALGORITHMS = ("alg1", "alg2", "alg3", "alg4")
ALGORITHMS = (*SET_ALGORITHMS, "snes1", "snes2", "vi")
WAYS = [(name, "mixed" if name in ("alg2", "alg4") else "hybrid") for name in ALGORITHMS]


def BOTTOM(x: Array) -> Mask:
    return x[1] < 1e-9


def problem(**values: object) -> Case:
    """Γ_S is "bottom"; keys of [problem] and [solve] stand alone."""
    sections = {"f": "problem", "u_D": "problem"}
    return load_case("example1").with_values(
        {"boundary.signorini": ["bottom"]} | {f"{sections.get(key, 'solve')}.{key}": v for key, v in values.items()}
    )


def square(
    comm: MPI.Comm, n: int, diagonal: str, *, scale: float = 1.0, part: Callable[[Array], Mask] = BOTTOM
) -> Domain:
    """A structured mesh of (0, scale)² with n facets per side; Γ_S is a part of the boundary of (0, 1)²."""
    assert SHAPES["square"].grid is not None
    points, cells = SHAPES["square"].grid((1 if diagonal == "crossed" else np.sqrt(2)) / n, diagonal, Share())
    return own_domain(comm, scale * points, cells, lambda x: part(x / scale))


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


@pytest.mark.parallel([1, 2])
def test_cycles_end_by_single_changes():
    """Obtuse cells on which all four algorithms cycle with period 3; the fallback finds the right solution."""
    for points, dirichlet, f, u_D in CYCLING:
        domain = strip(points, dirichlet)
        case = problem(f=f, u_D=str(u_D), eps=1e-10)
        expected = solve_case(case.with_values({"solve.algorithm": "qp"}), domain=domain)
        for algorithm, backend in WAYS[:4]:
            way = {"solve.algorithm": algorithm, "solve.backend": backend}
            solution = solve_case(case.with_values(way), domain=domain)
            assert "by changing single facets from iteration" in solution.outcome.reason, algorithm
            assert "cycle with period 3" in solution.outcome.reason
            assert min(step.changed for step in solution.outcome.history if step.changed) == 1
            assert len(solution.outcome.history) < 20
            assert_same_fields(solution, expected, 1e-9)


@pytest.mark.parallel([1, 2])
def test_max_iterations_holds_for_single_changes():
    points, dirichlet, f, u_D = CYCLING[0]
    with pytest.raises(NumericalFailure, match="still change after 5 iterations, by changing single facets") as caught:
        solve_case(problem(f=f, u_D=str(u_D), max_iterations=5), domain=strip(points, dirichlet))
    assert len(caught.value.solution.outcome.history) == 5


def middle_facet(n: int) -> Callable[[Array], Mask]:
    return lambda x: BOTTOM(x) & (np.abs(x[0] - 0.5) < 0.5 / n)


TIES = [(5, "crossed", "50*(x - 1/2)", "sin(3*(x - 1/2))"), (9, "right", "0", "x - 1/2")]  # u and ∂_n u odd in x − 1/2


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize(("n", "diagonal", "f", "u_D"), TIES)
def test_rounding_decides_nothing(n: int, diagonal: str, f: str, u_D: str):
    """By symmetry p = σ·n = 0 on the only facet: each algorithm decides as its rule does for 0, with any solver."""
    domain = square(COMM, n, diagonal, part=middle_facet(n))
    for algorithm in SET_ALGORITHMS:
        solution = solve_case(problem(f=f, u_D=u_D, algorithm=algorithm), domain=domain)
        assert solution.contact[0] == (algorithm in ("alg1", "alg3"))
        assert solution.outcome.reason == "the facet sets repeat"
        assert len(solution.outcome.history) == 1


@pytest.mark.parallel(2)
def test_biactive_sets_do_not_depend_on_ranks():
    """U = σ·n = 0 on half of Γ_S, where discretisation errors of all sizes decide."""
    for algorithm in ("alg1", "alg3"):
        case = load_case("biactive").with_values({"solve.algorithm": algorithm, "solve.h": 1 / 16})
        together, alone = solve_case(case, COMM), solve_case(case, MPI.COMM_SELF)
        assert together.outcome.reason == alone.outcome.reason == "the facet sets repeat"
        assert together.contact[0] == alone.contact[0]
        assert [step.changed for step in together.outcome.history] == [step.changed for step in alone.outcome.history]


SCALES = [(1e12, 1.0, 1.0), (1e-12, 1.0, 1.0), (1.0, 1e50, 1.0), (1.0, 1e-50, 1e12)]  # L, U, K


@pytest.mark.parametrize(("algorithm", "backend"), [WAYS[0], WAYS[2], WAYS[3], WAYS[4], WAYS[6]])
def test_units_do_not_matter(algorithm: str, backend: str):
    """Lengths times L, u times U, κ times K, with ε ~ L/K (I) or K/L (II): the same iterations, sets and fields."""

    def scaled(L: float, U: float, K: float) -> Solution:
        f, kappa = lambda x: 20 * U * K / L**2 * np.sin(9 * x[0] / L + 1), lambda x: np.full_like(x[0], K)
        eps = 1e-6 * (L / K if algorithm in ("alg3", "snes1") else K / L)
        options = Options(algorithm=algorithm, backend=backend, eps=eps)
        given = Diffusion(f=f, kappa=kappa, u_D=0.1 * U, conditions=[Signorini("bottom")])
        return solve(square(COMM, 7, "right", scale=L), given, options)

    expected = scaled(1.0, 1.0, 1.0)
    assert 0 < expected.contact[0] < 7
    for L, U, K in SCALES:
        found = scaled(L, U, K)
        np.testing.assert_array_equal(found.outcome.conditions.kind, expected.outcome.conditions.kind)
        late = len(found.outcome.history) - len(expected.outcome.history)
        assert abs(late) <= algorithm.startswith("snes")  # which tests the step in all unknowns together
        found.sigma.x.array[:] /= K
        for field in (found.sigma, found.u, found.p):
            field.x.array[:] /= U
        assert_same_fields(found, expected, 1e-12 if K == 1 or backend == "hybrid" else 1e-8)  # κ⁻¹ = 1e-12 beside ∇·


def coarse(algorithm: str, **values: object) -> Case:
    of_problem = {f"problem.{key}": value for key, value in values.items()}
    solver = {"geometry.mesh": "structured", "solve.h": 0.25, "solve.algorithm": algorithm, "solve.eps": 1e-12}
    return load_case("example1").with_values(solver | of_problem)


@pytest.mark.parametrize("algorithm", ["qp", "alg1", "snes1", "psor"])
def test_a_constant_does_not_matter(algorithm: str):
    """u_D and ψ plus 1e6: the same σ, and u and p plus 1e6."""
    small = solve_case(coarse(algorithm, u_D="0.1*x", psi="-0.1*y"))
    large = solve_case(coarse(algorithm, u_D="1e6 + 0.1*x", psi="1e6 - 0.1*y"), domain=small.spaces.domain)
    for field in (large.u, large.p):
        field.x.array[:] -= 1e6
    assert_same_fields(large, small, 1e-8)


def test_a_large_constant_hides_nothing():
    """σ is 1e-9 with u = 1 and ψ = 0, so rounding leaves 6 digits of σ: not converged."""
    with pytest.raises(NumericalFailure, match="mass_balance"):
        solve_case(coarse("alg1", f="0", u_D="1 + 1e-9*x"))
    assert solve_case(coarse("alg1", f="0", u_D="1")).converged
    assert solve_case(coarse("alg1", f="0", psi="-1")).converged
    assert solve_case(coarse("alg1", f="0", psi="-1e20*x")).converged
    assert solve_case(coarse("alg1", f="0", c="1", psi="-1 if y > 0.5 else 1e-16*x")).converged


@pytest.mark.parametrize("given", [{}, {"f": "0", "u_D": "x"}, {"f": "0", "q_S": "-1"}])
def test_a_bound_that_is_far_away_hides_nothing(given: dict[str, str]):
    """With loads or a varying u_D a tiny σ beside ψ is no rounding: that of ψ makes it wrong; the reason says so."""
    with pytest.raises(NumericalFailure, match=r"stationarity .*give a ψ that is nearer to u"):
        solve_case(coarse("alg1", psi="-1e20*(1 + x)", **given))


def test_jump_of_kappa():
    """κ jumps by 1e12: u is 1e5 on one side and 1e-7 on the other; signs matter on both. PIQP cannot resolve them."""
    kappa = "1e-6 if x < 0.5 else 1e6"
    expected = solve_case(coarse("vi", kappa=kappa))
    for algorithm, backend in (("alg1", "mixed"), ("alg2", "hybrid"), ("alg2", "mixed"), ("alg3", "hybrid")):
        case = coarse(algorithm, kappa=kappa).with_values({"solve.backend": backend})
        found = solve_case(case, domain=expected.spaces.domain)
        assert found.contact == expected.contact
        assert_same_fields(found, expected, 1e-5 if algorithm == "alg3" else 1e-9)  # εκ = 1e-6
    with pytest.raises(NumericalFailure, match="KKT residuals above 1e-08: complementarity"):
        solve_case(coarse("qp", kappa=kappa), domain=expected.spaces.domain)


EXTENTS = {
    "two cells": (1, BOTTOM),
    "one facet": (4, lambda x: BOTTOM(x) & (x[0] < 0.25)),
    "all facets but one": (4, lambda x: ~(BOTTOM(x) & (x[0] < 0.25))),
    "beside Γ_D": (4, lambda x: BOTTOM(x) | (x[0] < 1e-9)),
}


def assert_as_alone(extent: str, *runs: tuple[str, str, str]) -> None:
    """For each f, u_D and algorithm all ranks together find the result that each rank finds alone."""
    n, part = EXTENTS[extent]
    domain, alone = (square(comm, n, "right", part=part) for comm in (COMM, MPI.COMM_SELF))
    for f, u_D, algorithm in runs:
        case = problem(f=f, u_D=u_D, algorithm=algorithm)
        found, expected = solve_case(case, domain=domain), solve_case(case, domain=alone)
        assert found.contact[0] == expected.contact[0]
        assert len(found.outcome.history) == len(expected.outcome.history)
        assert found.norms() == pytest.approx(expected.norms(), rel=1e-10, abs=1e-12)


@pytest.mark.parallel(2)
def test_extents():
    """Any size of Γ_S; u_D ≠ 0 without a load, and u_D = 0 where Γ_S meets Γ_D."""
    touching = "(1 - x)*x + y"
    for number, extent in enumerate(EXTENTS):
        algorithm = ("alg4", "snes1")[number % 2]
        assert_as_alone(extent, ("0", "1/2 - x", "alg1"), ("-30", touching, algorithm))


@pytest.mark.parallel([3, 4])
def test_ranks_without_cells():
    algorithms = ("alg3", "vi", "uzawa", "primal-pdas", "qp")
    assert_as_alone("two cells", *(("50*(x - 0.3)", "x*y", algorithm) for algorithm in algorithms))
    assert_as_alone("one facet", ("50*(x - 0.3)", "x*y", "primal-penalty"), ("50*(x - 0.3)", "x*y", "mixed-uzawa2"))
    body = Elasticity(young=1.0, poisson=0.3, f=["0", "-x"], conditions=[Contact("bottom")])
    together, alone = (solve(square(comm, 1, "right", part=BOTTOM), body).norms() for comm in (COMM, MPI.COMM_SELF))
    assert together == pytest.approx(alone, rel=1e-10)


@pytest.mark.parallel(2)
def test_nothing_to_solve():
    """F = 0 and u_D = 0: u = 0, and each algorithm decides ties as its rule does for 0."""
    domain = square(COMM, 4, "right")
    for algorithm in (*SET_ALGORITHMS, "vi"):
        solution = solve_case(problem(f="0", algorithm=algorithm), domain=domain)
        assert max(solution.norms().values()) == 0
        assert solution.contact[0] == (0 if algorithm in ("alg2", "alg4") else 4)


@pytest.mark.parametrize("algorithm", ["alg1", "alg4", "snes1", "vi"])
def test_thousands_of_contacts(algorithm: str):
    """A load that changes sign from facet to facet: 1000 contacts, in a few steps, and the same for all algorithms."""
    n = 2000
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(n + 1), [0, 1]))
    i = np.arange(n)
    cells = np.concatenate([[i, i + 1, i + n + 2], [i, i + n + 2, i + n + 1]], axis=1).T
    domain = own_domain(COMM, np.stack([x, y], axis=1), cells, BOTTOM)
    solution = solve_case(problem(f="sin(pi*x)", algorithm=algorithm, eps=1e-10), domain=domain)
    contact = solution.outcome.conditions.kind == (
        Condition.ROBIN if algorithm in ("alg3", "snes1") else Condition.ZERO_TRACE
    )
    order = np.argsort(solution.spaces.Lambda.tabulate_dof_coordinates()[: len(contact), 0])
    assert np.count_nonzero(np.diff(contact[order].astype(int)) == 1) > 0.45 * n
    assert len(solution.outcome.history) <= 6


@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("backend", ["hybrid", "mixed"])
def test_a_bound_far_below_where_kappa_is_large(backend: str):
    """κ up to 5e8 makes the rounding of u − ψ a flux; a ψ that u does not touch changes nothing."""
    case = problem(f="3", u_D="0", backend=backend).with_values({"problem.kappa": "exp(20*x)"})
    domain = square(COMM, 8, "left")
    solution, near = (solve_case(case.with_values({"problem.psi": psi}), domain=domain) for psi in ("-1", "-0.005"))
    assert solution.contact.facets == 0
    assert solution.kkt.stationarity < 1e-9
    assert solution.norms()["sigma_L2"] == pytest.approx(near.norms()["sigma_L2"], rel=1e-9)
    facets = solution.p.x.array[: len(solution.spaces.facets)]
    assert facets == pytest.approx(near.p.x.array[: len(facets)], abs=1e-12)
