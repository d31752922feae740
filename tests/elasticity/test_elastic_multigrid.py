"""CG with multigrid for elastic systems: flat iterations, the same results, the way back to a factorisation."""

from dataclasses import replace

import dolfinx.mesh
import numpy as np
import pytest
from elastic import box
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix
from signorini_fenicsx.meshes.dolfinx_meshes import domain_of
from signorini_fenicsx.physics.elasticity.case import ElasticCase
from signorini_fenicsx.physics.elasticity.conditions import Contact
from signorini_fenicsx.physics.elasticity.discrete.data import elastic_data
from signorini_fenicsx.physics.elasticity.discrete.spaces import build_elastic_spaces
from signorini_fenicsx.physics.elasticity.problem import Dirichlet, ElasticBoundary, Elasticity, ElasticProblem, Neumann
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve.system import ElasticSystem
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
MULTIGRID, DIRECT = (Tuning(direct_up_to=size) for size in (0, 10**9))


def pressed(comm: MPI.Comm, dim: int, n: int, nu: float, tuning: Tuning = MULTIGRID) -> ElasticSolution:
    """A block that is pressed onto a curved foundation; only contact holds it up."""
    low, high = ([-1.0, 0.0], [1.0, 1.0]) if dim == 2 else ([0.0] * 3, [1.0] * 3)
    last = "xyz"[dim - 1]
    fixed = {"x0": "n"} if dim == 2 else {"x0": "n", "y0": "y"}
    boundary = ElasticBoundary([f"{last}0"], neumann=[f"{last}1", "x1"], fixed=fixed)
    load = {f"{last}1": ["0"] * (dim - 1) + ["-0.1"]}
    problem = ElasticProblem("1 + x^2", nu, g_N=load, gap="0.5*(x - 0.1)^2")
    return solve(box(comm, n, low, high), replace(problem, boundary=boundary), Options(tuning=tuning))


def iterations(solution: ElasticSolution) -> int:
    """The most that a solve took."""
    assert solution.outcome.linear_solver == "cg+mg"
    return max(step.linear_iterations for step in solution.outcome.history)


@pytest.mark.parametrize(("dim", "nu", "most"), [(2, 0.4999, 28), (3, 0.3, 41)])
def test_iterations_do_not_grow(dim: int, nu: float, most: int):
    """From mesh to mesh they stay the same, down to a residual of 1e-13, and hardly more where nothing compresses."""
    found = [iterations(pressed(MPI.COMM_SELF, dim, n, nu)) for n in ((6, 12) if dim == 2 else (2, 3))]
    assert max(found) <= most
    assert found[-1] <= 1.25 * found[0] + 2


@pytest.mark.parallel(2)
@pytest.mark.parametrize(("dim", "nu"), [(2, 0.4), (3, 0.4999)])
def test_same_as_factorisation(dim: int, nu: float):
    """Sets and norms are those of a factorisation by one process."""
    n = {2: 6, 3: 2}[dim]
    direct, found = pressed(MPI.COMM_SELF, dim, n, nu, DIRECT), pressed(COMM, dim, n, nu)
    assert (direct.outcome.linear_solver, iterations(found) > 1) == ("preonly+cholesky+mumps", True)
    sets = [[(step.no_flux, step.zero_trace) for step in one.outcome.history] for one in (direct, found)]
    assert sets[0] == sets[1]
    assert 0 < found.contact[0] == direct.contact[0] < found.spaces.Lambda.dofmap.index_map.size_global * dim
    assert found.norms() == pytest.approx(direct.norms(), rel=1e-9)
    if COMM.size == 1:
        np.testing.assert_allclose(found.stresses, direct.stresses, atol=1e-8)


@pytest.mark.parallel([1, 2])
def test_factorisation_where_iterations_would_be_too_many():
    """If CG stops before its tolerance, the system is factorised, and the summary says why."""
    PETSc.Options().setValue("facet_ksp_max_it", "3")
    try:
        found = pressed(COMM, 2, 4, 0.3)
    finally:
        PETSc.Options().delValue("facet_ksp_max_it")
    solver = found.summary()["linear_solver"]
    assert solver.startswith("preonly+cholesky+mumps because the linear solver cg+mg stopped with PETSc's reason -3")
    assert found.norms() == pytest.approx(pressed(COMM, 2, 4, 0.3, DIRECT).norms(), rel=1e-10)


@pytest.mark.parallel(2)
def test_sets_predicted_from_coarser_meshes():
    """Hertz's case starts from the set of a much coarser mesh: fewer iterations to the same result.

    CG stops as soon as the next set is known, and its last solve is that of the loop.
    """
    case = load_case("hertz").with_values({"solve.h": 1 / 16})
    assert isinstance(case, ElasticCase)
    cold = solve_case(case, COMM, tuning=Tuning(predict_from=10**9))
    warm = solve_case(case, COMM, tuning=replace(MULTIGRID, predict_from=300, coarsening=8.0))
    assert "prediction" in warm.timings
    assert "prediction" not in cold.timings
    assert (cold.outcome.rough_steps, len(warm.outcome.history)) == (0, warm.outcome.rough_steps + 1)
    assert 0 < warm.outcome.rough_steps == warm.summary()["rough_steps"] < len(cold.outcome.history)
    np.testing.assert_array_equal(warm.touching, cold.touching)
    assert warm.norms() == pytest.approx(cold.norms(), rel=1e-9)
    assert certify(warm).gap == pytest.approx(certify(cold).gap, rel=1e-10)  # no linear solver in it


@pytest.mark.parallel(2)
@pytest.mark.parametrize("tuning", [MULTIGRID, DIRECT])
def test_sets_that_do_not_hold_the_body(tuning: Tuning):
    """Pressed off the middle of a ridge, the body may turn about a single vertex; springs hold it for that step."""
    load = ["0", "-0.1*exp(-100*(x - 0.6)^2)"]
    held = [Contact("y0", "abs(x - 0.5)"), Dirichlet("y1", 0, components="x")]
    problem = Elasticity(1.0, 0.3, conditions=[*held, Neumann("y1", load), Neumann(["x0", "x1"], 0)])
    solution = solve(box(COMM, 4, [0.0, 0.0], [1.0, 1.0]), problem, Options(tuning=tuning))
    assert [step.zero_trace for step in solution.outcome.history] == [2, 1, 4, 3, 2]
    assert solution.outcome.linear_solver == ("cg+mg" if tuning is MULTIGRID else "preonly+cholesky+mumps")
    assert np.abs(solution.resultants()["sum"]).max() < 1e-12


@pytest.mark.parallel(2)
def test_the_copy_in_blocks_takes_new_conditions():
    """With two bodies it has the blocks of the traces, and under one set after another, with springs, the products."""
    mesh = dolfinx.mesh.create_rectangle(COMM, [[0.0, 0.0], [1.0, 1.0]], [4, 4])
    parts = {name: lambda x, y=y: np.isclose(x[1], y) for name, y in (("low", 0.0), ("joint", 0.5), ("high", 1.0))}
    parts["sides"] = lambda x: np.isclose(x[0] * (1 - x[0]), 0.0)
    domain = domain_of(mesh, parts, inner=["joint"])
    conditions = [Dirichlet("low", ["0", "0"]), Contact("joint"), Neumann("high", ["0", "-1"]), Neumann("sides")]
    problem = Elasticity(1.0, 0.3, conditions=conditions).on(domain)
    spaces = build_elastic_spaces(domain, problem.boundary, problem.rough)
    operator = ConstrainedMatrix(ElasticSystem(spaces, elastic_data(spaces, problem)).matrix, PETSc.Mat.Option.SPD)
    copy, sites = operator.in_blocks(), spaces.site_kinds["normal"].unknown
    assert copy.getBlockSizes() == (4, 4)
    x, expected, found = (operator.matrix.createVecLeft() for _ in range(3))
    x.array_w[:] = np.random.default_rng(COMM.rank).random(len(x.array_r))
    for held in (sites[::2], sites[:0]):
        rows, columns = sites[:-1:2], sites[1::2]
        springs = np.arange(1.0, len(rows) + 1)
        both = np.append(rows, columns), np.append(springs, springs), np.append(columns, rows)
        operator.impose(held, *both)
        for matrix, product in ((operator.matrix, expected), (copy, found)):
            matrix.mult(x, product)
        np.testing.assert_allclose(found.array_r, expected.array_r, rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(found.array_r[held], x.array_r[held])
    operator.mult(x, found)
    operator.natural.mult(x, expected)
    np.testing.assert_allclose(found.array_r, expected.array_r, rtol=1e-12, atol=1e-12)
