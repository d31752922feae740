"""From a domain, a boundary and a problem to the solution: spaces, data, method, KKT check."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.parallel import Stopwatch, collector_off, peak_memory
from signorini_fenicsx.base.signals import LoopInterruption
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.backend import Backend, Iterate, Renewable
from signorini_fenicsx.contact.history import OnStep, Outcome
from signorini_fenicsx.contact.laws import LAWS
from signorini_fenicsx.contact.residuals import Residuals
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.discrete.known import Known
from signorini_fenicsx.meshes.domain import Boundary, Domain
from signorini_fenicsx.meshes.meshing import coarser_domains
from signorini_fenicsx.meshes.own import check_parts
from signorini_fenicsx.meshes.sampling import curve_gap
from signorini_fenicsx.methods.registry import METHODS, Method
from signorini_fenicsx.methods.task import Task
from signorini_fenicsx.physics.diffusion.data import Data, project_data
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.residuals import far_bound
from signorini_fenicsx.physics.diffusion.spaces import Spaces, build_spaces
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solution import Solution

type Remesh = Callable[[float], Domain]
"""Maps a factor > 1 to a mesh of the domain that is coarser by this factor (collective). Raises InputError if there is
no such mesh."""


class Solver:
    """A domain with its boundary conditions, set up once and solved on for one problem after another.

    Spaces, forms, matrices and, as long as κ stays, factorisations are kept. The results are those of `solve`.

    >>> from mpi4py import MPI
    >>> from signorini_fenicsx.meshes.meshing import build_domain
    >>> solver = Solver(build_domain(MPI.COMM_WORLD, "square", 0.1, mesh="structured"), Boundary(signorini=["bottom"]))
    >>> for load in (-1, -2, -3):
    ...     print(solver.solve(Problem(f=load, psi=-0.1)).contact()[0])
    3
    9
    11

    Attributes:
        spaces: The discrete spaces; `spaces.mesh` is the mesh, which must not move.
    """

    @collector_off()
    def __init__(self, domain: Domain, boundary: Boundary):
        """Set up the spaces (collective).

        Args:
            domain: The mesh with its parts.
            boundary: The parts that are Γ_S and Γ_N, and those inside the domain; the rest is Γ_D.

        Raises:
            InputError: If a part is unknown, empty or not on the boundary.
        """
        check_kind("boundary", boundary, Boundary)
        check_parts(domain, vars(boundary))
        self.spaces = build_spaces(domain, boundary.signorini, boundary.neumann, boundary.inner)
        self._boundary = boundary
        self._known = Known(domain.mesh.comm)
        self._backend: Backend[Iterate] | None = None
        self._made_for: tuple[object, Tuning, bool] | None = None

    @collector_off()
    def solve(
        self,
        problem: Problem,
        options: Options | None = None,
        *,
        start: Solution | Segments | None = None,
        remesh: Remesh | None = None,
        name: str = "problem",
        title: str = "",
        source: object = None,
        watch: Stopwatch | None = None,
        on_step: OnStep = lambda step: None,
        memory: fem.Function | None = None,
    ) -> Solution:
        """Solve a problem with these boundary conditions (collective). The arguments are those of `solve`.

        `start` may also be segments alone. One is added: `memory`, a load in P0 besides f, which the step of a problem
        in time takes from those before.

        Raises:
            InputError: If the problem cannot be discretised as asked.
            NumericalFailure: If the sets do not settle or a KKT residual is too large; its `solution` is the last
                state.
        """
        options, watch, spaces = Options.of(options), watch or Stopwatch(), self.spaces
        method, boundary, comm = options.method, self._boundary, spaces.mesh.comm
        with watch.phase("assembly"):
            data = project_data(spaces, problem, self._known).after(memory)
            remesh = remesh or (coarser_domains(spaces.domain) if data.obstacle else None)  # else 1/h steps
            _check(options, spaces, data, start)
            # The unknown is u − constant: else ∇u would be lost in rounding. In stabilised methods −εu depends on it.
            constant = 0.0 if method.stabilised else data.common_constant(spaces)
            task = Task(
                spaces=spaces,
                data=data.less(spaces, constant),
                rho=options.rho,
                eps=options.eps,
                max_iterations=options.max_iterations or method.most_iterations(data),
                on_step=on_step,
                backend=partial(self._kept_backend, options),
                start=start.segments() if isinstance(start, Solution) else start,
                predict=options.predict,
                coarser=remesh and (lambda factor: _discretised(remesh(factor), boundary, problem)),
                tuning=options.tuning,
                watch=watch,
            )
        outcome = _run(task, options)
        with watch.phase("kkt"):
            outcome, kkt = _judged(task, outcome, method)
            outcome.iterate.u.x.array[:] += constant
            PETSc.garbage_cleanup(comm)  # in parallel PETSc frees objects only here
        solution = Solution(
            name=name,
            title=title,
            source=source,
            boundary=boundary,
            problem=problem,
            options=options,
            spaces=spaces,
            data=data,
            p=spaces.multiplier(outcome.iterate.p + data.psi_h),
            outcome=outcome,
            kkt=kkt,
            timings=watch.longest(comm),
            peak_memory=peak_memory(comm),
        )
        if not solution.converged:
            self._backend = None
            raise NumericalFailure(solution.outcome.reason, solution)
        return solution

    def _kept_backend(self, options: Options, spaces: Spaces, data: Data) -> Backend[Iterate]:
        """The backend of the last solve with these data, or a new one (collective)."""
        wanted = options.backend, options.tuning, data.obstacle is not None  # with an obstacle the cells are sites too
        kept, self._backend = self._backend, None
        renewed = wanted == self._made_for and isinstance(kept, Renewable) and kept.renew(data)
        backend = kept if kept is not None and renewed else options.make_backend(spaces, data)
        self._backend, self._made_for = backend, wanted
        return backend


@collector_off()
def solve(
    domain: Domain,
    boundary: Boundary,
    problem: Problem,
    options: Options | None = None,
    *,
    start: Solution | None = None,
    remesh: Remesh | None = None,
    name: str = "problem",
    title: str = "",
    source: object = None,
    watch: Stopwatch | None = None,
    on_step: OnStep = lambda step: None,
) -> Solution:
    """Solve a Signorini problem (collective).

    Args:
        domain: The mesh with its parts.
        boundary: The parts that are Γ_S and Γ_N; the rest is Γ_D. Parts with a law of the problem belong to Γ_S.
        problem: The data.
        options: Algorithm, backend and their parameters; None for the defaults.
        start: Solution on any mesh of the domain; its contact set is the first one.
        remesh: Makes coarser meshes, from which the sets of a large problem are predicted.
        name: Name of the results.
        title: A longer name in words.
        source: The case from which the problem was read, see `Solution`.
        watch: A stopwatch that has measured the earlier phases; None for a new one.
        on_step: Called on all ranks after each iteration.

    Raises:
        InputError: If the problem cannot be discretised as asked.
        NumericalFailure: If the sets do not settle or a KKT residual is too large; its `solution` is the last state.
    """
    watch = watch or Stopwatch()
    with watch.phase("assembly"):
        solver = Solver(domain, gamma_s(boundary, problem))
    return solver.solve(
        problem,
        options,
        start=start,
        remesh=remesh,
        name=name,
        title=title,
        source=source,
        watch=watch,
        on_step=on_step,
    )


def _run(task: Task, options: Options) -> Outcome:
    """Run the method; if it is interrupted, return its last state (collective)."""
    try:
        with task.watch.phase("solve"):
            return options.method.run(task)
    except LoopInterruption as interruption:
        return Outcome.interrupted(interruption, options.backend_name)


def _judged(task: Task, outcome: Outcome, method: Method) -> tuple[Outcome, Residuals]:
    """Judge an outcome by its own residual if it has one, else by its KKT residuals (collective)."""
    kkt = outcome.kkt or task.kkt(outcome.iterate, method.penalty)
    violation = kkt.violation()
    if outcome.own_residual is not None:
        within = outcome.own_residual <= KKT
        violation = None if within else f"the residual of its own problem is {outcome.own_residual:.1e}, above {KKT:g}"
    elif violation is not None:
        violation += far_bound(task.spaces, task.data, outcome.iterate.u)
    return outcome.ended(violation if outcome.converged else outcome.reason), kkt


def _discretised(domain: Domain, boundary: Boundary, problem: Problem) -> tuple[Spaces, Data]:
    boundary, problem = gamma_s(boundary, problem), replace(problem, exact=None)
    spaces = build_spaces(domain, boundary.signorini, boundary.neumann, boundary.inner)
    return spaces, project_data(spaces, problem)


def gamma_s(boundary: Boundary, problem: Problem) -> Boundary:
    """The boundary with the parts of all laws in Γ_S.

    Raises:
        InputError: If they are something else.
    """
    check_kind("boundary", boundary, Boundary)
    check_kind("problem", problem, Problem)
    parts = [*boundary.signorini, *(part for law in problem.laws for part in law.parts)]
    return replace(boundary, signorini=list(dict.fromkeys(parts)))


def check_solvability(spaces: Spaces, data: Data) -> None:
    """Check that there is one solution; without Γ_D, and with c = 0, the total load decides (collective).

    Then the balance of the flux is ∫ (σ·n − q_S) on Γ_S = −m with m = ∫f + ∫g_N + ∫q_S, and the left side is
    ≥ 0. If it is 0, u solves the Neumann problem, and any large enough constant may be added to it. It is the same with
    the smallest flux that other laws allow in the place of q_S, and with the largest.

    Raises:
        InputError: If there is no solution, or more than one.
    """
    lowest, highest = data.total_load
    if data.holds(spaces) or lowest < 0 < highest:
        return
    verdict = "u is not unique" if 0 in data.total_load else "there is no solution"
    if data.laws.listed:
        raise InputError(
            "no part of the boundary is left for u = u_D, and ∫f + ∫g_N plus the flux that the laws allow is between "
            f"{lowest:.3g} and {highest:.3g}: {verdict}; 0 must be in between, or leave part of the boundary to Γ_D"
        )
    raise InputError(
        "no part of the boundary is left for u = u_D, and the total load ∫f + ∫g_N + ∫q_S is "
        f"{lowest:.3g}: {verdict}; make it negative, or leave part of the boundary to Γ_D"
    )


def _check(options: Options, spaces: Spaces, data: Data, start: Solution | Segments | None) -> None:
    """Make sure that there is a solution, that the method can find it, and that it can use this start (collective).

    Raises:
        InputError: If there is none, or the method cannot.
    """
    method = options.method
    if data.obstacle is None and not spaces.part_names:
        raise InputError("signorini: lists no part, and there are no laws and no obstacle")
    if data.obstacle is not None and not method.obstacle:
        *others, last = (name for name, other in METHODS.items() if other.obstacle)
        raise InputError(f"{options.algorithm_name} does not take an obstacle; {', '.join(others)} and {last} do")
    check_solvability(spaces, data)
    if method.needs_dirichlet and not spaces.has_dirichlet:
        raise InputError(f"{options.algorithm_name} needs a part of the boundary where u = u_D")
    if spaces.inner.present and not method.takes_inner:
        usable = ", ".join(name for name, other in METHODS.items() if other.takes_inner)
        raise InputError(f"{options.algorithm_name} does not take parts inside the domain; these do: {usable}")
    for part in data.laws.of_parts:
        if part.name and method.laws is not None and not isinstance(part.law, method.laws):
            takes = " and ".join(name for name, law in LAWS.items() if law in method.laws) or "none in [[law]]"
            raise InputError(
                f"{options.algorithm_name} does not take the law '{part.law.name}' of {part.name}, it takes {takes}; "
                "alg1, alg2 and qp take every law"
            )
    _check_size(options, spaces)
    if start is None:
        return
    check_start(spaces, start)
    if not method.starts_from_sets:
        *others, last = (name for name, other in METHODS.items() if other.starts_from_sets)
        usable = f"{', '.join(others)} or {last}"
        raise InputError(f"{options.algorithm_name} has no facet sets to start from; use {usable}")


def check_start(spaces: Spaces, start: object) -> None:
    """Refuse a start that is no solution of a scalar problem, or on another domain (collective).

    Raises:
        InputError: If it is.
    """
    if not isinstance(start, Solution | Segments):
        raise InputError(f"start: must be a Solution of a scalar problem, not {type(start).__name__}")
    if not same_domain(spaces.domain, start.spaces.domain):
        raise InputError(f"the start was solved on '{start.spaces.domain.name}', not on '{spaces.domain.name}'")


def _check_size(options: Options, spaces: Spaces) -> None:
    """Refuse problems that are too large for a method that works on one rank.

    Raises:
        InputError: If there are more cells, or facets of Γ_S, than it takes.
    """
    method, tuning = options.method, options.tuning
    for limited, space, most, what in (
        (method.on_one_rank, spaces.Q, tuning.on_one_rank_up_to, "cells"),
        (method.dense, spaces.Lambda, tuning.dense_up_to, "facets of Γ_S"),
    ):
        number = space.dofmap.index_map.size_global
        if limited and number > most:
            raise InputError(
                f"{options.algorithm_name} works on one rank, with at most {most} {what}, and there are {number}; alg1 "
                "to alg4 have no such limit"
            )


def same_domain(domain: Domain, other: Domain) -> bool:
    """Whether two meshes are of one domain: shapes have the same name, files the same bounding box (collective)."""
    if domain is other:
        return True
    if domain.is_shape and other.is_shape:
        return domain.name == other.name
    if domain.mesh.topology.dim != other.mesh.topology.dim:
        return False
    distance = np.abs(domain.box() - other.box()).max()
    return bool(distance <= curve_gap(domain) + curve_gap(other))
