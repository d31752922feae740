"""The hybrid backend against the mixed one, iterate by iterate, with both of its linear solvers."""

import tempfile
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from agreement import assert_same_iterates
from made_cases import make_case, petsc_options
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx import NumericalFailure, Options, Solver, load_case, solve_case
from signorini_fenicsx.base.errors import LinearSolveFailure
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.contact.chains import SiteConditions
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.linear.two_level import choose_smoother
from signorini_fenicsx.meshes.uniform import refined_uniformly
from signorini_fenicsx.physics.diffusion.discrete.data import project_data
from signorini_fenicsx.physics.diffusion.discrete.spaces import build_spaces
from signorini_fenicsx.physics.diffusion.solve import hybrid
from signorini_fenicsx.physics.diffusion.solve.hybrid import HybridBackend

COMM = MPI.COMM_WORLD
MULTIGRID, DIRECT = Tuning(direct_up_to=0), Tuning(direct_up_to=10**6)


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("name", ["example3", "example5"])
def test_direct_solver(name: str):
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
    assert_same_iterates(load_case("example6").with_values({"solve.h": 1 / 16}), 1e-10, MULTIGRID)


@pytest.mark.parallel([1, 2])
def test_cube_and_random_loads(folder: Path):
    rng = np.random.default_rng(3)
    for tuning, mesh in ((MULTIGRID, "structured"), (DIRECT, "unstructured")):
        a, b, c = rng.uniform(1, 8, 3)
        f = f"50*sin({a}*x + {b}*y)*cos({c}*z)"
        case = make_case(folder, shape="cube", mesh=mesh, parts=["bottom", "left"], f=f, h=0.4)
        assert_same_iterates(case, 1e-10, tuning)


@pytest.mark.parallel([1, 2])
def test_multigrid_iterations_do_not_grow():
    """CG to 1e-12 takes at most 20 iterations in 2D, in every step and mesh, from any start of the sets."""
    for name, algorithm, h in (("example1", "alg1", 1 / 8), ("example1", "alg1", 1 / 64), ("example5", "alg4", 1 / 32)):
        solution = solve_case(
            load_case(name).with_values({"solve.h": h, "solve.algorithm": algorithm}), COMM, tuning=MULTIGRID
        )
        assert solution.outcome.linear_solver == "cg+mg"
        assert max(step.linear_iterations for step in solution.outcome.history) <= 20
        assert max(vars(solution.kkt).values()) < 1e-9


@pytest.mark.parametrize("name", ["crack", "sphere", "wall"])
def test_fluxes_of_iterates(name: str):
    """What decides about the sets while an iterative solver runs is what its solution has in the end."""
    solution = solve_case(load_case(name).with_values({"solve.h": 0.5}), MPI.COMM_SELF)
    backend = HybridBackend(solution.spaces, solution.data, tuning=Tuning(direct_up_to=0))
    conditions = solution.outcome.conditions
    done = backend.solve(conditions)
    p, flux = backend.solve_until(conditions, lambda p, flux: False)
    np.testing.assert_allclose(p, done.p, atol=1e-13)
    np.testing.assert_allclose(flux, done.flux, atol=1e-9 * np.abs(done.flux).max())


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
    for tuning, name in ((MULTIGRID, "example2"), (DIRECT, "example3")):
        case = load_case(name).with_values({"solve.h": 1 / 16})
        loop = solve_case(case, COMM, tuning=tuning)
        vi = solve_case(case.with_values({"solve.algorithm": "vi"}), COMM, domain=loop.spaces.domain, tuning=tuning)
        assert vi.outcome.linear_solver.startswith("vinewtonrsls")
        np.testing.assert_array_equal(loop.outcome.conditions.kind, vi.outcome.conditions.kind)
        for one, two in [(loop.sigma, vi.sigma), (loop.u, vi.u), (loop.p, vi.p)]:
            np.testing.assert_allclose(one.x.array, two.x.array, atol=1e-9)
        assert len(vi.outcome.history) <= 15


def test_bad_cells():
    """Aspect ratio 20 and obtuse angles slow CG down, but sets and fields are those of the saddle point."""
    tuning = Tuning(direct_up_to=0, predict_from=0)
    case = load_case("example1").with_values({"geometry.mesh": "structured", "solve.h": 1 / 16})
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


def test_user_options_choose_the_solver():
    """Any KSP and PC can be chosen; one that does not solve the problem is a failure, not a result."""
    case = load_case("example1").with_values({"solve.h": 1 / 8})
    with petsc_options(ksp_type="cg", pc_type="gamg", ksp_rtol="1e-13") as options:
        assert solve_case(case).outcome.linear_solver == "cg+gamg"
        options["ksp_max_it"] = 1
        with pytest.raises(NumericalFailure, match=r"cg\+gamg stopped"):
            solve_case(case)
        del options["ksp_max_it"]
        options["ksp_type"] = "preonly"
        with pytest.raises(NumericalFailure, match="KKT residuals above"):
            solve_case(case)


def test_a_factorisation_takes_over_from_a_solver_that_the_user_chose():
    """With far too few iterations the result is that of the factorisation, not of one step of the chosen solver."""
    case = load_case("example1").with_values({"solve.h": 1 / 8})
    with petsc_options(facet_pc_type="jacobi", facet_ksp_max_it=3):
        found = solve_case(case, tuning=Tuning(predict_from=0))
    solver = found.outcome.linear_solver
    assert solver.startswith("preonly+cholesky+mumps because the linear solver cg+jacobi stopped")
    assert found.norms() == pytest.approx(solve_case(case).norms(), rel=1e-12)


def test_an_option_with_a_prefix_is_for_some_solvers_and_nothing_stays():
    """An option without prefix is for all solvers, one with a prefix overrides it; PETSc's database is restored."""
    case = load_case("example1").with_values({"solve.h": 1 / 8})
    chosen = {"ksp_type": "cg", "pc_type": "gamg", "ksp_rtol": "1e-13", "mixed_ksp_type": "preonly"}
    chosen |= {"mixed_pc_type": "lu", "vi_ksp_type": "preonly", "vi_pc_type": "cholesky", "snes_max_it": "40"}
    with petsc_options(**chosen) as options:
        before = dict(options.getAll())
        facet, mixed, vi, primal = (
            solve_case(case.with_values({f"solve.{key}": value})).outcome.linear_solver
            for key, value in (("backend", "hybrid"), ("backend", "mixed"), ("algorithm", "vi"), ("algorithm", "uzawa"))
        )
        assert (facet, primal) == ("cg+gamg", "cg+gamg")
        assert mixed.startswith("preonly+lu")
        assert vi.startswith("vinewtonrsls+preonly+cholesky")
        assert options.getAll() == before
    assert not {name for name in options.getAll() if name.startswith(("mat_mumps", "snes_vi"))}
