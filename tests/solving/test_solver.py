"""A solver that is set up once: the results of separate solves, no form made again, nothing that grows."""

import contextlib
import gc
import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import dolfinx.jit
import numpy as np
import pytest
from dolfinx import fem
from made_cases import make_case
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx import (
    Contact,
    Coulomb,
    Diffusion,
    Elasticity,
    Evolution,
    Neumann,
    Signorini,
    evolve,
)
from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.comparing.convergence import Vary, convergence_study
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.quantities import Mean
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import Solver, solve

COMM = MPI.COMM_WORLD


def posed(f: object, psi: object = 0, q_S: object = 0, g_N: object = 0, **data: object) -> Diffusion:
    return Diffusion(f=f, conditions=[Signorini(["bottom", "left"], psi, q_S), Neumann("right", g_N)], **data)


PROBLEMS = [
    posed(f="20*(x - 0.6)"),
    posed(f="8*sin(5*x)", psi="0.02*sin(9*x) - 0.01", q_S="-0.3*cos(7*x)", g_N="x - y", u_D="x*y"),
    posed(f="-2", psi="-0.05", u_D="3 + x/10", q_S="-0.2"),
    posed(f="20*(x - 0.6)", kappa="1 + x*y"),
    posed(f="9*(x - 0.6)", kappa="1 + x*y", psi="-0.01*x"),
    posed(f="20*(x - 0.6)", kappa=[["2", "0.3"], ["0.3", "1 + x"]]),
    posed(f=lambda x: 20 * (x[0] - 0.6), kappa=2.5),
]


def setting() -> Domain:
    return build_domain(COMM, "square", 0.2, mesh="unstructured")


def assert_same(one: Solution, other: Solution, tolerance: float) -> None:
    """The same sets and fields; without a prediction the same steps as well."""
    if not one.options.predict:
        assert [step.changed for step in one.outcome.history] == [step.changed for step in other.outcome.history]
    assert np.array_equal(one.outcome.conditions.kind, other.outcome.conditions.kind)
    for a, b in [(one.sigma, other.sigma), (one.u, other.u), (one.p, other.p)]:
        size = COMM.allreduce(np.abs(b.x.array).max(initial=0.0), MPI.MAX)
        np.testing.assert_allclose(a.x.array, b.x.array, atol=tolerance * size, rtol=0)


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("backend", ["hybrid", "mixed"])
def test_an_obstacle_that_comes_and_goes(backend: str):
    domain = setting()
    solver, options = Solver(domain, posed(0)), Options(backend=backend, predict=False)
    for obstacle in (None, -0.02, -0.01, None):
        problem = posed(f="20*(x - 0.6)", obstacle=obstacle)
        assert_same(solver.solve(problem, options), solve(domain, problem, options), 1e-12)


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("backend", ["hybrid", "mixed"])
def test_results_are_those_of_separate_solves(backend: str):
    """κ, the conditions and all data change from each problem to the next."""
    domain = setting()
    solver = Solver(domain, posed(0))
    options = itertools.cycle(
        [
            Options(backend=backend, predict=False),
            Options(algorithm="alg3", eps=1e-2, backend=backend, predict=False),
            Options(algorithm="alg4", eps=1e-2, backend=backend),
        ]
    )
    problems = PROBLEMS + PROBLEMS[:2] if COMM.size == 1 else PROBLEMS[:5]
    for problem, option in zip(problems, options, strict=False):
        assert_same(solver.solve(problem, option), solve(domain, problem, option), 1e-12)


def test_other_methods_and_multigrid():
    domain = setting()
    solver = Solver(domain, posed(0))
    for problem in PROBLEMS[2:4]:
        for name in ("snes1", "vi", "primal-pdas", "slimane"):
            option = Options(algorithm=name, eps=1e-3)
            assert_same(solver.solve(problem, option), solve(domain, problem, option), 1e-12)
        option = Options(tuning=Tuning(direct_up_to=0))
        assert_same(solver.solve(problem, option), solve(domain, problem, option), 1e-9)


@pytest.mark.parametrize("kind", [Diffusion, Elasticity])
def test_a_problem_is_sorted_once(kind: Any, monkeypatch: pytest.MonkeyPatch):
    """In `solve`, and by a solver that solves the problem that it was set up for, in time too."""
    sorts, on = [], kind.on
    monkeypatch.setattr(kind, "on", lambda problem, domain: sorts.append(1) or on(problem, domain))
    domain = build_domain(COMM, "square", 0.5, mesh="structured")
    given = {"f": "x"} if kind is Diffusion else {"young": 1, "poisson": 0.3, "f": ["0", "-x"]}
    problem = kind(**given, conditions=[(Signorini if kind is Diffusion else Contact)("bottom")])
    for run in (
        lambda: solve(domain, problem),
        lambda: Solver(domain, problem).solve(problem),
        lambda: list(evolve(domain, problem, Evolution(1.0, 2))),
    ):
        run()
        assert len(sorts) == 1
        sorts.clear()


@pytest.mark.parallel([1, 2])
def test_one_factorisation_for_all_sets(monkeypatch: pytest.MonkeyPatch):
    """With the same κ as before, here one that jumps, no conditions are imposed on the matrix."""
    domain = setting()
    solver = Solver(domain, posed(0))
    problems = [posed(f=f"{load}*(x - 0.5)", kappa="100 if x > 0.6 else 1/50", psi=-0.01) for load in range(9, 14)]
    for problem in problems[:2]:
        solver.solve(problem)
    imposed: list[int] = []
    impose = ConstrainedMatrix.impose

    def counted(self: ConstrainedMatrix, *arguments: Any) -> None:
        imposed.append(1)
        impose(self, *arguments)

    monkeypatch.setattr(ConstrainedMatrix, "impose", counted)
    for problem in problems[2:]:
        without = solve(domain, problem)
        assert imposed
        imposed.clear()
        found = solver.solve(problem)
        assert_same(found, without, 1e-10)
        assert not imposed
        assert len(found.outcome.history) == 1 < len(without.outcome.history)  # the sets are predicted on Γ_S
        every_step = solver.solve(problem, Options(predict=False))
        assert_same(every_step, without, 1e-10)
        assert len(every_step.outcome.history) == len(without.outcome.history)


@pytest.mark.parallel(2)
def test_what_fails_does_not_spoil_what_follows():
    domain = setting()
    solver = Solver(domain, posed(0))
    expected = solve(domain, PROBLEMS[1])
    with pytest.raises(NumericalFailure):
        solver.solve(PROBLEMS[0], Options(max_iterations=1, predict=False))
    assert_same(solver.solve(PROBLEMS[1]), expected, 1e-12)
    with pytest.raises(InputError, match="kappa: must be positive"):
        solver.solve(posed(f=1, kappa=-1))
    assert_same(solver.solve(PROBLEMS[1]), expected, 1e-12)
    with pytest.raises(InputError, match="unknown part 'roof'"):
        Solver(domain, Diffusion(0, conditions=[Signorini("roof")]))


def test_earlier_solutions_stay():
    domain = setting()
    solver = Solver(domain, posed(0))
    first = solver.solve(PROBLEMS[1])
    functions = (first.sigma, first.u, first.p, first.data.f_h, first.data.u_lift)
    fields = [function.x.array.copy() for function in functions]
    norms = first.norms()
    solver.solve(PROBLEMS[2])
    for function, values in zip(functions, fields, strict=True):
        assert np.array_equal(function.x.array, values)
    assert first.norms() == norms


def test_no_form_is_made_again(monkeypatch: pytest.MonkeyPatch):
    domain = setting()
    solver = Solver(domain, posed(0))
    for problem in (PROBLEMS[1], PROBLEMS[4], PROBLEMS[5]):
        solver.solve(problem, Options(algorithm="alg3", eps=1e-3))
    looked_for: list[Any] = []
    compiled: Callable[..., Any] = fenicsx.compiled

    def counted(*arguments: Any, **options: Any) -> Any:
        looked_for.append(arguments)
        return compiled(*arguments, **options)

    monkeypatch.setattr(fenicsx, "compiled", counted)
    theirs = dolfinx.jit.ffcx_jit
    fenicsx.form(fem.Constant(domain.mesh, 1.0) * solver.spaces.ds)
    assert len(looked_for) == 1  # it counts
    for problem in (PROBLEMS[3], PROBLEMS[2], PROBLEMS[5]):
        solver.solve(problem, Options(algorithm="alg3", eps=1e-2))
    assert len(looked_for) == 1
    assert dolfinx.jit.ffcx_jit is theirs  # the compiler of the user's forms is as it was


@pytest.mark.parallel(2)
@pytest.mark.parametrize(
    "problem",
    [
        Diffusion(f="20*(x - 0.6)", conditions=[Signorini("bottom")]),
        Elasticity(1.0, 0.3, f=[0, -0.1], conditions=[Contact("bottom", gap=0.01, friction=Coulomb(0.3))]),
    ],
    ids=["diffusion", "elasticity"],
)
def test_a_mesh_leaves_nothing_behind(
    problem: Diffusion | Elasticity, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    """What is of no use any more is freed while the mesh is there; on several ranks it could not be freed later.

    MPICH has 2048 communicators, so a study or an evolution must not keep any of a solve.
    """
    monkeypatch.setattr("signorini_fenicsx.quantities.bracket.MOST", 1)  # the intervals are not looked at
    domain, direction = build_domain(COMM, "square", 1 / 2, mesh="structured"), [0, 1]
    k = fem.Constant(domain.mesh, 1.0)
    problem = replace(problem, **({"kappa": k} if isinstance(problem, Diffusion) else {"young": k}))
    left = []
    for tuning in (Tuning(), Tuning(direct_up_to=0)):
        for _ in range(2):
            solution = solve(domain, problem, Options(tuning=tuning))
            solution.certify()
            solution.derivative({k: 1.0})
            solution.quantity(Mean(direction=direction if isinstance(problem, Elasticity) else None))
            del solution
            for _ in evolve(domain, problem, Evolution(end=0.2, steps=1)):
                pass
            gc.collect()
            PETSc.garbage_cleanup(domain.mesh.comm)
            left.append(communicators())
    assert left[1] == left[0]
    assert left[3] == left[2]
    PETSc.garbage_view(domain.mesh.comm)
    if COMM.rank == 0:
        assert "Rank 0:: Total entries: 0" in capfd.readouterr().out


def communicators() -> int:
    """How many communicators this process could still make."""
    made: list[MPI.Comm] = []
    handler = MPI.COMM_SELF.Get_errhandler()
    MPI.COMM_SELF.Set_errhandler(MPI.ERRORS_RETURN)
    with contextlib.suppress(MPI.Exception):
        while len(made) < 3000:
            made.append(MPI.COMM_SELF.Dup())
    MPI.COMM_SELF.Set_errhandler(handler)
    for communicator in made:
        communicator.Free()
    return len(made)


def test_a_study_over_eps_is_set_up_once(folder: Path, monkeypatch: pytest.MonkeyPatch):
    made: list[Solver] = []
    begin = Solver.__init__

    def counted(self: Solver, *arguments: Any) -> None:
        made.append(self)
        begin(self, *arguments)

    monkeypatch.setattr(Solver, "__init__", counted)
    case = make_case(folder, parts=["bottom"], f="20*(x - 0.6)", h=0.2).with_values({"solve.algorithm": "alg3"})
    rows = convergence_study(case, Vary.EPS, [1, 2, 3], 0)
    assert len(made) == 1
    assert rows[0].errors["sigma_V"] > rows[1].errors["sigma_V"] > rows[2].errors["sigma_V"]
