"""How diffusion problems are solved: the system on a mesh, and what is checked before."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import Stopwatch
from signorini_fenicsx.base.signals import LoopInterruption
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.contact.backend import Backend, Iterate
from signorini_fenicsx.contact.chains import Condition
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.contact.kept_backend import KeptBackend
from signorini_fenicsx.contact.laws import LAWS
from signorini_fenicsx.contact.residuals import Residuals
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.discrete.known import Known
from signorini_fenicsx.discrete.linear_traces import linear_from_means
from signorini_fenicsx.meshes.dolfinx_meshes import check_parts
from signorini_fenicsx.meshes.domain import Boundary, Domain
from signorini_fenicsx.meshes.meshing import coarser_domains
from signorini_fenicsx.methods.registry import methods_that
from signorini_fenicsx.physics.diffusion.discrete.data import Data, project_data
from signorini_fenicsx.physics.diffusion.discrete.quasilinear import has_soils
from signorini_fenicsx.physics.diffusion.discrete.rt1_data import RT1Data, rt1_data
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces, Spaces, build_spaces, rt1_spaces
from signorini_fenicsx.physics.diffusion.evolution import DiffusionSteps
from signorini_fenicsx.physics.diffusion.problem import NO_RT0, Problem
from signorini_fenicsx.physics.diffusion.rt1_solution import RT1Solution
from signorini_fenicsx.physics.diffusion.show.notes import notes_of
from signorini_fenicsx.physics.diffusion.soil_steps import SoilSteps
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.solve.hybrid import HybridBackend
from signorini_fenicsx.physics.diffusion.solve.mixed import MixedBackend, RT1MixedBackend
from signorini_fenicsx.physics.diffusion.solve.residuals import far_bound
from signorini_fenicsx.physics.diffusion.solve.rt1_backend import RT1Backend
from signorini_fenicsx.physics.diffusion.solve.rt1_residuals import RT1Iterate
from signorini_fenicsx.physics.diffusion.solve.solvability import check_solvability
from signorini_fenicsx.physics.diffusion.solve.task import DiffusionTask, RT1Task
from signorini_fenicsx.solving.evolution import Evolution
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import Remesh, Wish

FARTHER = 10.0
"""A ψ so many times as far below u as u is large is replaced by a nearer one, if digits of u are lost otherwise."""


class System:
    """The spaces of diffusion on a mesh, with the backend and the means of data of the last solve.

    Attributes:
        spaces: The discrete spaces.
        boundary: The parts that are Γ_S and Γ_N, and those inside the domain; the rest is Γ_D.
        kept: Makes the backend, and keeps the last one.
    """

    def __init__(self, domain: Domain, problem: Problem):
        """Set up the spaces (collective).

        Raises:
            InputError: If a part is unknown, empty or not on the boundary.
        """
        self.boundary = problem.boundary
        check_parts(domain, self.boundary.named)
        self.spaces = _spaces(domain, self.boundary)
        self._known = Known(domain.mesh.comm)
        self.kept = KeptBackend()
        self._stores = False  # before there are steps with soils

    @cached_property
    def rt1_spaces(self) -> RT1Spaces:
        """The spaces of RT1 (collective when first used)."""
        return rt1_spaces(self.spaces)

    def _is_rt1(self, options: Options) -> bool:
        """Whether the element is RT1, which is the only one for pairs.

        Raises:
            InputError: If another one was asked for pairs.
        """
        if self.boundary.pairs and options.element == "RT0":
            raise InputError(NO_RT0)
        return options.element == "RT1" or len(self.boundary.pairs) > 0

    def prepared(self, problem: Problem, wish: Wish) -> "DiffusionRun":
        """Read the data and check them (collective).

        Raises:
            InputError: If the problem cannot be discretised as asked.
        """
        spaces: Any = self.spaces
        options = wish.options
        linear = self._is_rt1(options)
        _check_same(self.boundary, problem.boundary)
        data: Any = project_data(spaces, problem, self._known)
        remesh = wish.remesh or (coarser_domains(spaces.domain) if data.inside else None)  # else 1/h steps
        _check(options, spaces, data, wish.start)
        if linear:
            lacking = _lacking(options, inside=bool(data.inside))
            if lacking:
                instead = "pairs take alg1 to alg4 and vi" if self.boundary.pairs else "take RT0"
                raise InputError(f"element: {lacking}; {instead}")
            spaces, data = self.rt1_spaces, rt1_data(self.rt1_spaces, data)
        data = data.after(wish.memory)
        check_solvability(spaces, data)
        # The unknown is u − constant: else ∇u would be lost in rounding. In stabilised methods −εu depends on it.
        constant = 0.0 if options.method.stabilised else data.common_constant(spaces)
        in_cells = bool(data.inside)  # then the cells are sites too
        made_for = options.backend, linear, options.tuning, in_cells
        task: Any = (RT1Task if linear else DiffusionTask)(
            spaces=spaces,
            data=data.less(spaces, constant),
            rho=options.rho,
            eps=options.eps,
            max_iterations=options.max_iterations
            or options.method.most_iterations(
                data.chains.corners, spaces.mesh.comm.allreduce(len(spaces.site_kinds["facet"])), in_cells=in_cells
            ),
            on_step=wish.on_step,
            backend=partial(self.kept.take, made_for, partial(_backend, options)),
            start=wish.start,
            alone=_alone,
            predict=options.predict
            and data.quasilinear is None
            and (in_cells or len(spaces.part_names) > 0),  # else the problem is linear
            whole=in_cells,
            tuning=options.tuning,
            watch=wish.watch,
        )
        if remesh is not None:
            task = replace(task, coarser=partial(_coarser, task, remesh, problem))
        kind = RT1Run if linear else DiffusionRun
        return kind(task, options, data, constant, self.kept)

    def check(self, problem: Problem) -> list[str]:
        """Read the data and check them, see `solving.solver.System` (collective).

        Raises:
            InputError: If the problem cannot be discretised.
        """
        data = project_data(self.spaces, problem, self._known)
        if not self._stores:  # what soil stores balances any load
            check_solvability(self.spaces, data)
        return notes_of(self.spaces, data)

    def steps(self, problem: Problem, evolution: Evolution, start: Solution | None, options: Options) -> DiffusionSteps:
        """The steps of a problem in time, see `solving.evolution.Steps` (collective).

        Raises:
            InputError: If a datum is not what it has to be, or the start is on another domain.
        """
        spaces = self.rt1_spaces if self._is_rt1(options) else self.spaces
        self._stores = has_soils(problem.kappa)
        return (SoilSteps if self._stores else DiffusionSteps)(spaces, problem, evolution, start)


@dataclass
class DiffusionRun:
    """A problem on its mesh, ready to be solved.

    Attributes:
        task: What the method gets: the problem for u − constant.
        options: Algorithm, backend and their parameters.
        data: The data on the mesh.
        constant: What is taken from u.
        kept: Keeps the backend.
        trace: u − constant on Γ_S where u − ψ has too few digits of it; None if it has not.
    """

    task: DiffusionTask
    options: Options
    data: Data
    constant: float
    kept: KeptBackend
    trace: Array | None = None

    def remarks(self) -> list[str]:
        """Data that jump and should not, in words (collective)."""
        return notes_of(self.task.spaces, self.data)

    def outcome(self) -> Outcome:
        """Run the method; if it is interrupted, return its last state (collective).

        Where ψ is so far below u that too few digits of u are left in u − ψ, it runs again with a nearer one, and is
        left as it is if u touches that.
        """
        try:
            with self.task.watch.phase("solve"):
                outcome = self.options.method.run(self.task)
                if not outcome.converged or self.options.method.rule is None:
                    return outcome
                kkt = outcome.kkt or self.task.kkt(outcome.iterate, self.options.method.penalty)
                nearer = self._nearer(outcome) if kkt.violation() else None
                if nearer is None:
                    return replace(outcome, kkt=kkt)
                task = replace(self.task, data=nearer)
                again = self.options.method.run(task)
                facet = task.spaces.site_kinds["facet"]
                touched = facet.of(again.conditions.kind != Condition.NO_FLUX) & (nearer.bound != self.task.data.bound)
                if not again.converged or task.spaces.mesh.comm.allreduce(int(touched.sum())) > 0:
                    return replace(outcome, kkt=kkt)
                self.trace, p = facet.of(again.iterate.p) + nearer.bound, again.iterate.p.copy()
                facet.of(p)[:] = self.trace - self.task.data.bound
                as_given = replace(again.iterate, p=p)
                kkt = again.kkt or task.kkt(again.iterate, self.options.method.penalty)
                return replace(again, iterate=as_given, kkt=kkt)
        except LoopInterruption as interruption:
            return Outcome.interrupted(interruption, self.options.backend_name)

    def _nearer(self, outcome: Outcome) -> Data | None:
        """The data with a ψ that is nearer to u where it is far below, and open; None if it is nowhere (collective).

        Signorini's conditions hold there with both: what matters is that u is above ψ, and that the flux is q_S.
        """
        spaces, data, facet = self.task.spaces, self.task.data, self.task.spaces.site_kinds["facet"]
        reach = spaces.mesh.comm.allreduce(float(np.abs(outcome.iterate.u.x.array).max(initial=0.0)), MPI.MAX)
        p = facet.of(outcome.iterate.p)
        far = facet.of(outcome.conditions.kind == Condition.NO_FLUX) & (p > FARTHER * reach)
        if not data.chains.plain or spaces.mesh.comm.allreduce(int(far.sum())) == 0:
            return None
        return data.with_bound(spaces, np.where(far, data.bound + p - reach, data.bound))

    def judged(self, outcome: Outcome) -> tuple[Outcome, Residuals]:
        """Judge an outcome by its own residual if it has one, else by its KKT residuals (collective)."""
        kkt = outcome.kkt or self.task.kkt(outcome.iterate, self.options.method.penalty)
        violation, residual = kkt.violation(), outcome.own_residual
        if residual is not None:
            violation = None if residual <= KKT else f"the residual of its own problem is {residual:.1e}, above {KKT:g}"
        elif violation is not None:
            violation += far_bound(self.task.spaces, self.task.data, outcome.iterate.u)
        return outcome.ended(violation if outcome.converged else outcome.reason), kkt

    def _data_found(self) -> Any:
        """The data, where κ depends on u with the one that was found (collective)."""
        if self.task.last_run.data is None:
            return self.data
        present, data = self.task.present, self.data
        if data.quasilinear is not None and present.quasilinear is not None:
            data = replace(data, quasilinear=replace(data.quasilinear, storing=present.quasilinear.storing))
        return data.with_kappa(self.task.spaces, present.kappa_values, present.stored)

    def solution(self, outcome: Outcome, **about: Any) -> Solution:
        """The solution, with the constant that was taken from u (collective)."""
        spaces = self.task.spaces
        data = self._data_found()
        outcome.iterate.u.x.array[:] += self.constant
        trace = spaces.site_kinds["facet"].of(outcome.iterate.p) + self.data.psi_h
        if self.trace is not None:
            trace = self.trace + (self.data.psi_h - self.task.data.psi_h)  # the difference is the constant
        self.kept.solved(outcome, self.task.present)
        return Solution(
            spaces=spaces,
            data=data,
            p=spaces.multiplier(trace),
            outcome=outcome,
            **about,
        )


@dataclass
class RT1Run(DiffusionRun):
    """A problem with RT1, ready to be solved."""

    task: RT1Task
    data: RT1Data

    def solution(self, outcome: Outcome, **about: Any) -> RT1Solution:
        """The solution, with the constant that was taken from u (collective)."""
        spaces, iterate = self.task.spaces, outcome.iterate
        assert isinstance(iterate, RT1Iterate)
        iterate.u.x.array[:] += self.constant
        iterate.means[spaces.outer_sites] += self.constant
        self.kept.solved(outcome, self.task.present)
        return RT1Solution(
            spaces=spaces,
            data=self._data_found(),
            p=spaces.linear_multiplier(linear_from_means(spaces.site_kinds["facet"].rows_of(iterate.means))),
            outcome=outcome,
            **about | {"options": replace(about["options"], element="RT1")},
        )


def _spaces(domain: Domain, boundary: Boundary) -> Spaces:
    """The spaces for a boundary (collective)."""
    return build_spaces(domain, boundary.signorini, boundary.neumann, boundary.inner, boundary.pairs)


def refining(problem: Problem, options: Options) -> tuple[Options, str]:
    """The options with RT1 where it is there, else with RT0 and why."""
    lacking = _lacking(options, inside=problem.has_laws_inside)
    return replace(options, element="RT0" if lacking else "RT1"), lacking


def _lacking(options: Options, *, inside: bool) -> str:
    """What of a problem or its method RT1 is not there for; empty if it is."""
    for lacking, what in (
        (not options.method.takes_order_two, options.algorithm_name),
        (inside and options.method.rule is None, f"laws in Ω by {options.algorithm_name}"),
        (not isinstance(options.backend, str), "a backend of one's own"),
    ):
        if lacking:
            return f"there is no RT1 for {what}"
    return ""


def _alone(name: str) -> Callable[..., Outcome]:
    """What runs a method for diffusion alone; SciPy and PIQP, which some of them need, are slow to import."""
    from signorini_fenicsx.physics.diffusion.solve.alone import METHODS

    return METHODS[name]


def _backend(options: Options, spaces: Spaces, data: Data) -> Backend[Iterate]:
    """The backend that the options choose (collective)."""
    if isinstance(spaces, RT1Spaces) and isinstance(data, RT1Data):
        hybrid = options.backend == "hybrid"
        return RT1Backend(spaces, data, options.tuning) if hybrid else RT1MixedBackend(spaces, data)
    if not isinstance(options.backend, str):
        return options.backend(spaces, data)
    return (
        HybridBackend(spaces, data, tuning=options.tuning)
        if options.backend == "hybrid"
        else MixedBackend(spaces, data)
    )


def _coarser(task: DiffusionTask, remesh: Remesh, problem: Problem, factor: float) -> DiffusionTask:
    """The task on a coarser mesh, whose sets are settled at any size (collective)."""
    spaces = _spaces(remesh(factor), problem.boundary)
    data = project_data(spaces, replace(problem, exact=None))
    backend: Any = partial(HybridBackend, tuning=task.tuning, multigrid=not task.whole, prefix="coarse_")
    if isinstance(task, RT1Task):
        spaces = rt1_spaces(spaces)
        data, backend = rt1_data(spaces, data), partial(RT1Backend, tuning=task.tuning)
    return replace(
        task,
        spaces=spaces,
        data=data,
        on_step=lambda step: None,
        backend=backend,
        start=None,
        coarser=lambda further: _coarser(task, remesh, problem, factor * further),
        tuning=task.tuning if task.whole else replace(task.tuning, predict_from=0),
        watch=Stopwatch(),
    )


def _check_same(boundary: Boundary, other: Boundary) -> None:
    """Refuse a problem whose parts are not those of the system.

    Raises:
        InputError: If they are not.
    """
    if boundary.pairs != other.pairs:
        raise InputError("problem: has other pairs than that which the solver was set up for")
    for (key, parts), others in zip(boundary.named.items(), other.named.values(), strict=True):
        if sorted(parts) != sorted(others):
            raise InputError(
                f"problem: has other parts in {key}, {', '.join(others) or 'none'}, than that which the solver was set "
                f"up for, {', '.join(parts) or 'none'}"
            )


def _check(options: Options, spaces: Spaces, data: Data, start: Segments | None) -> None:
    """Make sure that there is a solution, that the method can find it, and that it can use this start (collective).

    Raises:
        InputError: If there is none, or the method cannot.
    """
    method = options.method
    if data.inside and not method.laws_inside:
        what = "an obstacle" if data.inside.is_obstacle else "laws in Ω"
        usable = methods_that(lambda other: other.laws_inside)
        raise InputError(f"{options.algorithm_name} does not take {what}; {usable} do")
    if data.quasilinear is not None and (
        method.rule is None or method.rule.penalty is not None or options.backend != "hybrid"
    ):
        raise InputError("[problem] kappa: one that depends on u takes alg1 or alg2 with the hybrid backend")
    if data.b is not None and method.rule is None:
        raise InputError("[problem] b: a given flux takes alg1 to alg4")
    if method.needs_dirichlet and not spaces.has_dirichlet:
        raise InputError(f"{options.algorithm_name} needs a part of the boundary where u = u_D")
    if spaces.several and not method.takes_inner:
        usable = methods_that(lambda other: other.takes_inner)
        what = "pairs" if spaces.pairs else "parts inside the domain"
        raise InputError(f"{options.algorithm_name} does not take {what}; {usable} do")
    if spaces.pairs and options.backend != "hybrid":
        raise InputError("[solve] backend: pairs take the hybrid one; leave it out")
    for part in data.laws.of_parts:
        if part.name and method.laws is not None and not isinstance(part.law, method.laws):
            takes = " and ".join(name for name, law in LAWS.items() if law in method.laws) or "none in [[law]]"
            raise InputError(
                f"{options.algorithm_name} does not take the law '{part.law.name}' of {part.name}, it takes {takes}; "
                "alg1, alg2 and qp take every law"
            )
    _check_size(options, spaces)
    if start is not None and not method.starts_from_sets:
        usable = methods_that(lambda other: other.starts_from_sets)
        raise InputError(f"{options.algorithm_name} has no facet sets to start from; {usable} have them")


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
