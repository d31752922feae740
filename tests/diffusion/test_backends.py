"""The hybrid backend against the mixed one, iterate by iterate, with both of its linear solvers."""

import itertools
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from agreement import assert_same_iterates
from made_cases import make_case
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.errors import LinearSolveFailure, NumericalFailure
from signorini_fenicsx.base.owned import cell_dofs, owned_values
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.contact.chains import SiteConditions
from signorini_fenicsx.contact.loop import Parameters, iterate_sets
from signorini_fenicsx.contact.set_rules import ALGORITHM_1
from signorini_fenicsx.discrete.cell_shapes import arms, corners
from signorini_fenicsx.discrete.hybrid_system import eliminate
from signorini_fenicsx.discrete.linear_traces import blocks_of_cells, facet_normals
from signorini_fenicsx.discrete.matrices import OfCells
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.linear.two_level import choose_smoother
from signorini_fenicsx.meshes.uniform import refined_uniformly
from signorini_fenicsx.physics.diffusion.discrete.data import Data, project_data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces, build_spaces
from signorini_fenicsx.physics.diffusion.solve import hybrid
from signorini_fenicsx.physics.diffusion.solve.facet_system import FacetSystem
from signorini_fenicsx.physics.diffusion.solve.hybrid import HybridBackend
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import Solver

COMM = MPI.COMM_WORLD
MULTIGRID, DIRECT = Tuning(direct_up_to=0), Tuning(direct_up_to=10**6)


@pytest.mark.parallel([1, 2])
def test_direct_solver():
    for name in [f"example{i}" for i in range(1, 7)] if COMM.size == 1 else ["example3", "example5"]:
        assert_same_iterates(load_case(name).with_values({"solve.h": 1 / 8}), 1e-12)


def test_a_solve_that_failed_is_done_again():
    """The next solve under the same sets took what was left for the solution."""
    case = load_case("example1").with_values({"solve.h": 0.3})
    spaces = solve_case(case, COMM).spaces
    backend, held = HybridBackend(spaces, project_data(spaces, case.posed(2))), np.ones(len(spaces.facets), np.int8)
    with pytest.MonkeyPatch.context() as during:
        during.setattr(FacetSolver, "solve", Mock(side_effect=LinearSolveFailure("made up")))
        with pytest.raises(LinearSolveFailure):
            backend.solve(SiteConditions(held))
    expected = HybridBackend(spaces, backend.data).solve(SiteConditions(held))
    np.testing.assert_allclose(backend.solve(SiteConditions(held)).flux, expected.flux, rtol=1e-12)


@pytest.mark.parallel(2)
def test_multigrid():
    for name in ["example2", "example4", "example6"] if COMM.size == 1 else ["example6"]:
        assert_same_iterates(load_case(name).with_values({"solve.h": 1 / 16}), 1e-10, MULTIGRID)


@pytest.mark.parallel([1, 2])
def test_cube_and_random_loads(folder: Path):
    rng = np.random.default_rng(3)
    for tuning, mesh in itertools.product((MULTIGRID, DIRECT), ("structured", "unstructured")[: 3 - COMM.size]):
        a, b, c = rng.uniform(1, 8, 3)
        f = f"50*sin({a}*x + {b}*y)*cos({c}*z)"
        case = make_case(folder, shape="cube", mesh=mesh, parts=["bottom", "left"], f=f, h=0.4)
        assert_same_iterates(case, 1e-10, tuning)


@pytest.mark.parallel([1, 2])
def test_multigrid_iterations_do_not_grow():
    """CG to 1e-12 takes at most 20 iterations in 2D, in every step and mesh, from any start of the sets."""
    examples = [("example1", "alg1"), ("example5", "alg4")]
    for (name, algorithm), h in itertools.product(examples, (1 / 8, 1 / 32, 1 / 64)[: 4 - COMM.size]):
        solution = solve_case(
            load_case(name).with_values({"solve.h": h, "solve.algorithm": algorithm}), COMM, tuning=MULTIGRID
        )
        assert solution.outcome.linear_solver == "cg+mg"
        assert max(step.linear_iterations for step in solution.outcome.history) <= 20
        assert max(vars(solution.kkt).values()) < 1e-9


def cells_of(spaces: Spaces, data: Data) -> Iterator[OfCells]:
    """The cells after elimination: fluxes that are constant, and (x − x_T)/(d|T|) for the one with a divergence."""
    mesh, dim, dofs = spaces.mesh, spaces.mesh.topology.dim, cell_dofs(spaces.crouzeix_raviart)
    inverses = np.broadcast_to(np.linalg.inv(data.matrices(spaces)), (len(dofs), dim, dim))
    c = np.zeros(len(dofs)) if data.c_h is None else owned_values(data.c_h)
    for numbers in blocks_of_cells(mesh):
        measure, arm, inverse = spaces.cell_measures[numbers], arms(mesh, numbers), inverses[numbers]
        tractions = np.full((len(numbers), dim + 1, dim + 1), 1 / (dim + 1))
        tractions[:, :, :dim] = facet_normals(corners(mesh, numbers))
        product = np.zeros_like(tractions)
        product[:, :dim, :dim] = measure[:, None, None] * inverse
        moments = np.einsum("nvi,nij,nvj->n", arm, inverse, arm) / ((dim + 1) * (dim + 2))
        product[:, dim, dim] = moments / (dim**2 * measure)
        reaction = (c[numbers] * measure)[:, None, None]
        block = eliminate(numbers, None, tractions, product, np.zeros((len(numbers), 1)), 0.0, reaction)
        yield dofs[numbers], block.matrix


@pytest.mark.parametrize("name", ["example1", "crack", "cube"])
def test_closed_form_is_the_elimination_of_the_cells(name: str):
    """With κ a matrix that varies, cu, and jumps inside the domain."""
    dim = 3 if name == "cube" else 2
    kappa = [[f"{3 if i == j else 0.5} + x*y" for j in range(dim)] for i in range(dim)]
    case = load_case(name).with_values({"solve.h": 0.4, "problem.kappa": kappa, "problem.c": "2 + x"})
    system = FacetSystem(spaces := solve_case(case).spaces, data := project_data(spaces, case.posed(dim)))
    difference = system.sum_of(cells_of(spaces, data))
    difference.axpy(-1.0, system.matrix)
    assert difference.norm() < 1e-13 * system.matrix.norm()


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("name", ["regulator", "crack"])
def test_traces_are_those_of_the_recovered_flux(name: str):
    """For any x, any conditions, with cu and with jumps: rows of the matrix and the recovered flux give the same."""
    case = load_case(name).with_values({"solve.h": 0.3})
    spaces = solve_case(case, COMM).spaces
    backend = HybridBackend(spaces, project_data(spaces, case.posed(2)))
    rng = np.random.default_rng(COMM.rank)
    conditions = SiteConditions(rng.integers(0, 2, len(spaces.facets)).astype(np.int8))
    backend.x.array_w[:] = rng.uniform(-1, 1, backend.x.getLocalSize())
    p, flux = backend._pairs(backend.x, conditions)
    expected = backend.recovered(conditions, refine=False)
    np.testing.assert_array_equal(p, expected.p)
    np.testing.assert_allclose(flux, expected.flux, atol=1e-11)


@pytest.mark.parallel(2)
def test_sweeps_reduce_every_error():
    """Also where each unknown of a flat cell is on another rank; with ω = 1 that error would grow."""
    matrix = PETSc.Mat().createDense((3, 3), comm=COMM)
    first, end = matrix.getOwnershipRange()
    matrix.setValues(range(first, end), range(3), 1 + 1e-3 * np.eye(3)[first:end])
    matrix.assemble()
    matrix = matrix.convert("aij")
    multigrid = PETSc.PC().create(COMM)
    multigrid.setType("mg")
    multigrid.setMGLevels(2)
    choose_smoother(multigrid, 1, 2)
    x, b = matrix.createVecs()
    b.set(0.0)
    for start in [*np.eye(3).tolist(), [1.0, 1.0, 1.0]]:
        x.array_w[:] = start[first:end]
        before = energy(matrix, x)
        for smoother in (multigrid.getMGSmootherDown(1), multigrid.getMGSmootherUp(1)):
            smoother.setOperators(matrix)
            smoother.setInitialGuessNonzero(True)
            smoother.solve(b, x)
        assert energy(matrix, x) < before


def energy(matrix: PETSc.Mat, x: PETSc.Vec) -> float:
    """The square of the energy norm."""
    image = matrix.createVecLeft()
    matrix.mult(x, image)
    return float(x.dot(image))


def test_smoothers_are_safe_without_estimates(folder: Path):
    """No eigenvalue is above 1, where the interval of Chebyshev ends, on any level, for flat cells and any set."""
    case = make_case(folder, shape="cube", mesh="structured", parts=["bottom"], f="1", h=0.45)
    case = case.with_values({"problem.kappa": "1 + 1e4*exp(-100*(x - y)**2)"})
    domain = mesh_case(case, COMM)
    domain.mesh.geometry.x[:, 2] *= 0.05
    spaces = build_spaces(domain, case.boundary.signorini, case.boundary.neumann)
    backend = HybridBackend(spaces, project_data(spaces, case.posed(3)), multigrid=True)
    rng = np.random.default_rng(1)
    for _ in range(2):
        backend.solve(SiteConditions(rng.integers(0, 2, len(spaces.facets)).astype(np.int8)))
        levels = backend._solver.ksp.getPC()
        coarse = levels.getMGCoarseSolve().getPC()
        smoothers = [levels.getMGSmoother(1), *(coarse.getMGSmoother(i) for i in range(1, coarse.getMGLevels()))]
        for smoother in smoothers:
            matrix, into = smoother.getOperators()[0], smoother.getPC()
            ones, scale = matrix.createVecs()
            ones.set(1.0)
            into.apply(ones, scale)
            root = np.sqrt(scale.array_r)
            dense = matrix.convert("dense", PETSc.Mat()).getDenseArray()
            assert np.linalg.eigvalsh(root[:, None] * dense * root).max() <= 1 + 1e-12
            assert "min 0.1, max 1." in view(smoother)


def view(solver: PETSc.KSP) -> str:
    """What PETSc prints of a solver."""
    with tempfile.NamedTemporaryFile("r") as file:
        viewer = PETSc.Viewer().createASCII(file.name)
        solver.view(viewer)
        viewer.flush()
        viewer.destroy()
        return file.read()


@pytest.mark.parallel(2)
def test_levels_of_a_refined_mesh():
    """The meshes from which it was refined are levels: fewer iterations than by GAMG, the same solution."""
    case = load_case("example1")
    domain = mesh_case(case.with_values({"solve.h": 1 / 8}), COMM)
    for _ in range(2):
        domain = refined_uniformly(domain)
    one, two = (
        solve_case(case, COMM, domain=each, tuning=MULTIGRID) for each in (domain, replace(domain, coarser=None))
    )
    np.testing.assert_array_equal(one.outcome.conditions.kind, two.outcome.conditions.kind)
    np.testing.assert_allclose(one.sigma.x.array, two.sigma.x.array, atol=1e-9)
    fewer, more = (max(step.linear_iterations for step in each.outcome.history) for each in (one, two))
    assert fewer < more


@pytest.mark.parallel([1, 2])
def test_snesvi_finds_the_same():
    """SNESVI, which uses neither rule nor loop, finds the sets and fields of Algorithm 1."""
    for tuning, name in itertools.product((MULTIGRID, DIRECT), ("example2", "example3")):
        case = load_case(name).with_values({"solve.h": 1 / 16})
        loop = solve_case(case, COMM, tuning=tuning)
        vi = solve_case(case.with_values({"solve.algorithm": "vi"}), COMM, domain=loop.spaces.domain, tuning=tuning)
        assert vi.outcome.linear_solver.startswith("vinewtonrsls")
        np.testing.assert_array_equal(loop.outcome.conditions.kind, vi.outcome.conditions.kind)
        for one, two in [(loop.sigma, vi.sigma), (loop.u, vi.u), (loop.p, vi.p)]:
            np.testing.assert_allclose(one.x.array, two.x.array, atol=1e-9)
        assert len(vi.outcome.history) <= 15


@pytest.mark.parallel(2)
def test_bad_cells():
    """Aspect ratio 20 and obtuse angles slow CG down, but sets and fields are those of the saddle point."""
    tuning = Tuning(direct_up_to=0, predict_from=0)
    case = load_case("example1").with_values({"geometry.mesh": "structured", "solve.h": 1 / 32})
    domain = mesh_case(case, COMM)
    x = domain.mesh.geometry.x
    x[:, 1] *= 0.05
    x[:, 0] += 0.05 * np.sin(50 * x[:, 1] * 20) * np.sin(np.pi * x[:, 0])
    mixed, facet = (
        solve_case(case.with_values({"solve.backend": backend}), COMM, domain=domain, tuning=tuning)
        for backend in ("mixed", "hybrid")
    )
    assert facet.outcome.linear_solver == "cg+mg"
    np.testing.assert_array_equal(mixed.outcome.conditions.kind, facet.outcome.conditions.kind)
    for one, two in [(mixed.sigma, facet.sigma), (mixed.u, facet.u), (mixed.p, facet.p)]:
        np.testing.assert_allclose(one.x.array, two.x.array, atol=1e-9 * np.abs(one.x.array).max(initial=1.0))


@pytest.mark.parallel(2)
def test_a_factorisation_takes_over(monkeypatch: pytest.MonkeyPatch):
    """A system of medium size is factorised if CG takes too many iterations.

    It is from the second problem on.
    """
    case = load_case("example1").with_values({"geometry.mesh": "structured", "solve.h": 1 / 16})
    domain = mesh_case(case, COMM)
    expected = solve_case(case, COMM, domain=domain)
    monkeypatch.setattr(hybrid, "MOST_ITERATIONS", 5)
    for predict in (True, False):
        found = solve_case(
            case.with_values({"solve.predict": predict}), COMM, domain=domain, tuning=Tuning(predict_from=0)
        )
        assert found.outcome.linear_solver.startswith("preonly+cholesky+mumps because the linear solver cg+mg stopped")
        np.testing.assert_array_equal(found.outcome.conditions.kind, expected.outcome.conditions.kind)
        np.testing.assert_allclose(found.sigma.x.array, expected.sigma.x.array, atol=1e-12)
    monkeypatch.undo()
    solver, problem = Solver(domain, case.posed(domain.mesh.geometry.dim)), case.posed(2)
    tuning = Tuning(predict_from=0)
    found = [solver.solve(replace(problem, f=f"{f}*(x - 0.3*{f})"), Options(tuning=tuning)) for f in (1, 2)]
    assert [each.outcome.linear_solver for each in found] == ["cg+mg", "preonly+cholesky+mumps"]


def test_wrong_prediction_is_corrected():
    """Algorithm 1 finds the same solution from any start conditions."""
    case = load_case("example1").with_values({"solve.h": 1 / 16})
    expected = solve_case(case)
    backend = HybridBackend(expected.spaces, expected.data)
    rng = np.random.default_rng(1)
    for _ in range(5):
        random = SiteConditions(rng.integers(0, 2, len(expected.spaces.facets)).astype(np.int8))
        outcome = iterate_sets(backend, ALGORITHM_1, Parameters(), start=random)
        np.testing.assert_array_equal(outcome.conditions.kind, expected.outcome.conditions.kind)
        np.testing.assert_allclose(outcome.iterate.sigma.x.array, expected.sigma.x.array, atol=1e-11)


def test_user_options_choose_the_solver():
    """Any KSP and PC can be chosen; one that does not solve the problem is a failure, not a result."""
    options = PETSc.Options()
    case = load_case("example1").with_values({"solve.h": 1 / 8})
    chosen = {"ksp_type": "cg", "pc_type": "gamg", "ksp_rtol": "1e-13"}
    for name, value in chosen.items():
        options[name] = value
    try:
        assert solve_case(case).outcome.linear_solver == "cg+gamg"
        options["ksp_max_it"] = 1
        with pytest.raises(NumericalFailure, match=r"cg\+gamg stopped"):
            solve_case(case)
        del options["ksp_max_it"]
        options["ksp_type"] = "preonly"
        with pytest.raises(NumericalFailure, match="KKT residuals above"):
            solve_case(case)
    finally:
        for name in (*chosen, "ksp_max_it"):
            options.delValue(name)


def test_a_factorisation_takes_over_from_a_solver_that_the_user_chose():
    """With far too few iterations the result is that of the factorisation, not of one step of the chosen solver."""
    case = load_case("example1").with_values({"solve.h": 1 / 8})
    options = PETSc.Options()
    options["facet_pc_type"], options["facet_ksp_max_it"] = "jacobi", 3
    try:
        found = solve_case(case, tuning=Tuning(predict_from=0))
    finally:
        for name in ("facet_pc_type", "facet_ksp_max_it"):
            options.delValue(name)
    solver = found.outcome.linear_solver
    assert solver.startswith("preonly+cholesky+mumps because the linear solver cg+jacobi stopped")
    assert found.norms() == pytest.approx(solve_case(case).norms(), rel=1e-12)


def test_an_option_with_a_prefix_is_for_some_solvers_and_nothing_stays():
    """An option without prefix is for all solvers, one with a prefix overrides it; PETSc's database is restored."""
    options = PETSc.Options()
    case = load_case("example1").with_values({"solve.h": 1 / 8})
    chosen = {"ksp_type": "cg", "pc_type": "gamg", "ksp_rtol": "1e-13", "mixed_ksp_type": "preonly"}
    chosen |= {"mixed_pc_type": "lu", "vi_ksp_type": "preonly", "vi_pc_type": "cholesky", "snes_max_it": "40"}
    for name, value in chosen.items():
        options[name] = value
    before = dict(options.getAll())
    try:
        facet, mixed, vi, primal = (
            solve_case(case.with_values({f"solve.{key}": value})).outcome.linear_solver
            for key, value in (("backend", "hybrid"), ("backend", "mixed"), ("algorithm", "vi"), ("algorithm", "uzawa"))
        )
        assert (facet, primal) == ("cg+gamg", "cg+gamg")
        assert mixed.startswith("preonly+lu")
        assert vi.startswith("vinewtonrsls+preonly+cholesky")
        assert options.getAll() == before
    finally:
        for name in chosen:
            options.delValue(name)
    assert not {name for name in options.getAll() if name.startswith(("mat_mumps", "snes_vi"))}


@pytest.mark.parallel(2)
def test_one_factorisation_for_any_conditions(folder: Path):
    """All kinds at once, with a β and a value on each site, as by a factorisation for these conditions alone."""
    case = make_case(folder, shape="lshape", parts=["bottom", "left"], f="x - y", h=0.3)
    spaces = solve_case(case, COMM).spaces
    data = project_data(spaces, case.with_values({"problem.psi": "0.1*x", "problem.u_D": "x"}).posed(2))
    backend = HybridBackend(spaces, data)
    assert backend.renew(data)
    rng = np.random.default_rng(COMM.rank)
    for _ in range(4):
        number = len(spaces.facets)
        values = rng.uniform(-1, 1, number)
        conditions = SiteConditions(rng.integers(0, 3, number).astype(np.int8), rng.uniform(0.1, 9, number), values)
        one, other = backend.solve(conditions), HybridBackend(spaces, data).solve(conditions)
        np.testing.assert_allclose(one.p, other.p, atol=1e-12)
        np.testing.assert_allclose(one.flux, other.flux, atol=1e-11)
        for a, b in ((one.sigma, other.sigma), (one.u, other.u)):
            np.testing.assert_allclose(a.x.array, b.x.array, atol=1e-12)
