"""How problems of elastic contact are solved: the system on a mesh, and Coulomb's friction around the loop."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any
from weakref import ref

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError, LinearSolveFailure, NumericalFailure
from signorini_fenicsx.base.signals import LoopInterruption
from signorini_fenicsx.contact.backend import Iterate, Pairs
from signorini_fenicsx.contact.conditions import SiteConditions
from signorini_fenicsx.contact.history import History, Outcome
from signorini_fenicsx.contact.loop import Parameters, iterate_sets
from signorini_fenicsx.contact.set_rules import SetRule
from signorini_fenicsx.discrete.contact_sets import transferred
from signorini_fenicsx.discrete.points import in_facets
from signorini_fenicsx.discrete.unjoined import note_facing
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.own import check_parts
from signorini_fenicsx.methods.prediction import Prediction
from signorini_fenicsx.physics.elasticity.backend import ElasticBackend
from signorini_fenicsx.physics.elasticity.boundary_nodes import check_against_foundation
from signorini_fenicsx.physics.elasticity.coulomb import CHANGE, balanced, by_path
from signorini_fenicsx.physics.elasticity.data import ElasticData, elastic_data
from signorini_fenicsx.physics.elasticity.evolution import ElasticSteps, spread
from signorini_fenicsx.physics.elasticity.notes import direction_of_gap, notes_of
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.physics.elasticity.residuals import ElasticKKT, elastic_kkt
from signorini_fenicsx.physics.elasticity.rigid_motions import check_rigid_motions, slides
from signorini_fenicsx.physics.elasticity.slipping import is_large, slipped
from signorini_fenicsx.physics.elasticity.solution import ElasticSegments, ElasticSolution
from signorini_fenicsx.physics.elasticity.spaces import ElasticSpaces, build_elastic_spaces
from signorini_fenicsx.solving.evolution import Evolution
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import solve
from signorini_fenicsx.solving.system import Remesh, Wish, check_start

PREDICT_FROM = 15_000
"""Number of unknowns from which a prediction saves more than it costs."""
REACH = 0.1
"""Gaps larger than the least one by this share of the body are open at the start where contact has to hold it,"""
ENOUGH = 0.01
"""if the other ones hold each rigid motion by this share at least of what all of them do, in squares of its means."""
MORE_WITH_FRICTION = 4
"""So many times the iterations of other problems are allowed for each bound in the plane, and in space for large μ."""


class System:
    """The spaces of elastic contact on a mesh.

    Attributes:
        spaces: The discrete spaces.
        boundary: The parts that are in contact, loaded or fixed.
        solved: The last outcome and its backend, which serves derivatives; None before the first.
    """

    def __init__(self, domain: Domain, boundary: ElasticBoundary, problem: ElasticProblem):
        """Set up the spaces (collective).

        Raises:
            InputError: If a part is unknown, empty or not on the boundary.
        """
        self.boundary = _with_parts_of_laws(boundary, problem)
        check_parts(domain, self.boundary.named)
        self.spaces = build_elastic_spaces(domain, self.boundary, problem.rough)
        self._rough = sorted(problem.rough)
        self.solved: tuple[ref[Outcome], ElasticBackend] | None = None

    def prepared(self, given: tuple[ElasticBoundary, ElasticProblem], wish: Wish) -> ElasticRun:
        """Read the data and check them; predict the sets of a large problem on coarser meshes (collective).

        Raises:
            InputError: If the problem cannot be discretised as asked, or the body can move rigidly.
        """
        self.solved, options, (boundary, problem) = None, wish.options, given
        rule_of(options)
        for key in ("backend", "rho", "eps"):
            if getattr(options, key) != getattr(Options, key):
                raise InputError(f"{key}: elastic contact has no such option")
        if _with_parts_of_laws(boundary, problem) != self.boundary or sorted(problem.rough) != self._rough:
            raise InputError("problem: has other parts, or others with friction, than the solver was set up for")
        check_start(self.spaces.domain, wish.start, ElasticSolution, ElasticSegments)
        data = elastic_data(self.spaces, problem, wish.memory)
        check_against_foundation(self.spaces, data)
        motions = check_rigid_motions(self.spaces, data)
        _note_foundations(self.spaces, data)
        return ElasticRun(self.spaces, motions, self.boundary, problem, data, wish, self)

    def check(self, given: tuple[ElasticBoundary, ElasticProblem]) -> None:
        """Read the data and check them, see `solving.system.System` (collective).

        Raises:
            InputError: If the problem cannot be discretised.
        """
        self.prepared(given, Wish(Options()))

    def steps(self, problem: ElasticProblem, evolution: Evolution, start: ElasticSolution | None) -> ElasticSteps:
        """The steps of loads, see `solving.evolution.Steps` (collective).

        Raises:
            InputError: If a text cannot be read, or the start is on another domain.
        """
        check_kind("problem", problem, ElasticProblem)
        check_start(self.spaces.domain, start, ElasticSolution)
        plain = Evolution(evolution.end, evolution.steps)
        if evolution != plain:
            raise InputError("[time]: loads on an elastic body have no initial, capacity and scheme")
        return ElasticSteps(self.spaces, problem, evolution)

    def backend_of(self, outcome: Outcome) -> ElasticBackend | None:
        """The backend of this outcome; None if there is another since."""
        return self.solved[1] if self.solved is not None and self.solved[0]() is outcome else None

    def forget(self) -> None:
        """Drop the backend of the last solve."""
        self.solved = None


def _note_foundations(spaces: ElasticSpaces, data: ElasticData) -> None:
    """Note where bodies face each other within their gaps, each with a foundation of its own (collective)."""
    facets = spaces.contact.take(spaces.outer_rows)
    middles = in_facets(spaces.mesh, facets.facets, np.full((1, spaces.dim - 1), 1 / spaces.dim))
    note_facing(spaces, facets.vertices, facets.normals, data.gap.values(middles)[:, 0])


@dataclass
class ElasticRun:
    """An elastic problem on its mesh, ready to be solved.

    Attributes:
        spaces: The discrete spaces.
        motions: The rigid motions that only contact prevents, see `ElasticBackend`.
        boundary: The parts of each kind of boundary.
        problem: The data as given.
        data: The data on the mesh; in the end with the last bounds of the friction.
        wish: How it is to be solved.
        system: What it was prepared by.
        changes: Of the steps of Coulomb's friction, see `ElasticSolution.bound_changes`.
        backend: What solves it; None before.
    """

    spaces: ElasticSpaces
    motions: Array
    boundary: ElasticBoundary
    problem: ElasticProblem
    data: ElasticData
    wish: Wish
    system: System
    changes: Sequence[float] = ()
    backend: ElasticBackend | None = None

    def remarks(self) -> list[str]:
        """Data that jump and should not, and along what the gap is measured (collective)."""
        return [*notes_of(self.spaces, self.data), *direction_of_gap(self.spaces, self.data)]

    def outcome(self) -> Outcome:
        """Run the loop, with Coulomb's friction once for each bound of the shear (collective).

        If it fails from predicted or given sets, it begins again without them. If it is interrupted, the last state is
        the outcome.
        """
        options, watch = self.wish.options, self.wish.watch
        with watch.phase("assembly"):
            self.backend = backend = ElasticBackend(self.spaces, self.data, options.tuning, self.motions)
        try:
            return self._from_best_start(backend, History(backend.comm, self.wish.on_step))
        except LoopInterruption as interruption:
            self._take(self.data, backend)
            return Outcome.interrupted(interruption, backend.name, backend.dofs, backend.solver())

    def _from_best_start(self, backend: ElasticBackend, history: History) -> Outcome:
        """Run the loop from predicted or given sets, and if these fail without them (collective)."""
        options, start, data = self.wish.options, self.wish.start, self.data
        predict = options.predict and len(self.spaces.part_names) > 0  # else the problem is linear
        large = predict and options.tuning.predicts(backend.dofs, PREDICT_FROM)
        if start is None and self.wish.remesh is not None and large:
            with self.wish.watch.phase("prediction"):
                start = _on_coarser_mesh(self.wish.remesh, self.boundary, self.problem, options)
                if start is not None:
                    start = _carried(start, backend)
        near = self._near() if self.motions.shape[1] > 0 else None
        if not large and start is None:
            return self._run(backend, _first(backend, None, near), history, predict=False)
        with contextlib.suppress(LinearSolveFailure):
            goes_on = isinstance(start, ElasticSegments)
            first = _continued(backend, start, near) if goes_on else _first(backend, start, near)
            outcome, kkt = self.judged(self._run(backend, first, history, predict=large))
            if outcome.converged:
                return replace(outcome, kkt=kkt)
        self.data = data
        backend.turn(data.friction)
        outcome = self._run(backend, _first(backend, None, near), history, predict=False)
        return replace(outcome, reason=f"{outcome.reason}, from a cold start because the predicted one failed")

    def _run(
        self, backend: ElasticBackend, first: SiteConditions | None, history: History, *, predict: bool
    ) -> Outcome:
        """Predict the sets and run the loop; the data get the last bounds of the friction (collective)."""
        options, watch, before = self.wish.options, self.wish.watch, None
        self.changes = changes = list[float]()
        if predict and backend.inexact is not None and backend.friction.slipping is None:
            with watch.phase("prediction"):
                first, before = _settled(backend, options, first, history)
        with watch.phase("solve"):
            outcome = _with_friction(backend, options, first, before, history, changes)
        self._take(self.data, backend)
        return outcome

    def _take(self, data: ElasticData, backend: ElasticBackend) -> None:
        """Take the last bounds of the friction, and where tools have moved to."""
        self.data = replace(data.after(self.spaces, backend.tools.rho), friction=backend.friction)

    def _near(self) -> Mask:
        """The facet vertices whose contact holds the body at the start: those with small gaps (collective).

        A gap that is large beside the body does not close, and contact with it would tear the body apart. The reach is
        doubled until what is in it holds the body nearly as well as all of Γ_C does.
        """
        spaces, comm = self.spaces, self.spaces.mesh.comm
        into, along = np.split(self.motions, [len(spaces.sites)])
        slips = comm.allreduce(along.T @ along)

        def held(near: Mask) -> Array:
            return np.asarray(comm.allreduce(into[near].T @ into[near]) + slips)

        gap = self.data.lift[spaces.sites]
        everything, least = held(np.ones(len(gap), dtype=bool)), comm.allreduce(gap.min(initial=np.inf), MPI.MIN)
        reach = REACH * float(np.ptp(spaces.domain.box(), axis=0).max())
        while True:
            near = gap <= least + reach
            if np.linalg.eigvals(np.linalg.solve(everything, held(near))).real.min() >= ENOUGH:
                return near
            reach *= 2

    def judged(self, outcome: Outcome) -> tuple[Outcome, ElasticKKT]:
        """The outcome, which has converged only if its residuals are small, and these (collective)."""
        kkt = outcome.kkt
        if not isinstance(kkt, ElasticKKT):
            stresses = self.spaces.split.values(outcome.iterate.sigma)
            kkt = elastic_kkt(self.spaces, self.data, stresses, outcome.iterate.p)
        return outcome.ended(_failure(self.spaces, self.data, outcome, kkt)), kkt

    def solution(self, outcome: Outcome, kkt: ElasticKKT, **about: Any) -> ElasticSolution:
        """The solution."""
        if self.backend is not None:
            self.system.solved = ref(outcome), self.backend
        return ElasticSolution(
            boundary=self.boundary,
            problem=self.problem,
            options=self.wish.options,
            spaces=self.spaces,
            data=self.data,
            outcome=outcome,
            kkt=kkt,
            bound_changes=tuple(self.changes),
            system=ref(self.system),
            **about,
        )


def rule_of(options: Options) -> SetRule:
    """The set rule that solves elastic contact.

    Raises:
        InputError: If the method runs none, or one with a penalty or a clip.
    """
    rule = options.method.rule
    if rule is None or rule.penalty is not None or rule.clip is not None:
        known = "alg1 or alg2, or in Python by a rule of your own without penalty and clip"
        raise InputError(f"algorithm: elastic contact is solved by {known}, not by {options.algorithm_name}")
    return rule


def _failure(spaces: ElasticSpaces, data: ElasticData, outcome: Outcome, kkt: ElasticKKT) -> str | None:
    """Why there is no solution; None if there is one (collective)."""
    if not outcome.converged and data.friction.slipping is None:
        return outcome.reason
    failure = kkt.violation() if outcome.converged else outcome.reason
    return failure if failure is None or not data.friction else slides(spaces, data) or failure


def _with_parts_of_laws(boundary: ElasticBoundary, problem: ElasticProblem) -> ElasticBoundary:
    """The boundary with the parts with laws in Γ_C.

    Raises:
        InputError: If they are something else.
    """
    check_kind("boundary", boundary, ElasticBoundary)
    check_kind("problem", problem, ElasticProblem)
    return boundary.touching_on(problem.touching)


def _on_coarser_mesh(
    remesh: Remesh, boundary: ElasticBoundary, problem: ElasticProblem, options: Options
) -> ElasticSolution | None:
    """The solution on a coarser mesh, itself predicted from a coarser one; None if there is none (collective)."""
    factor = options.tuning.coarsening

    def coarser(further: float) -> Domain:
        return remesh(factor * further)

    with contextlib.suppress(InputError, NumericalFailure):
        coarse: ElasticSolution = solve(remesh(factor), (boundary, problem), options, remesh=coarser)
        return coarse
    return None


@dataclass(frozen=True)
class _Traces:
    """A problem whose solution is known at the sites, see `coulomb.Solved`."""

    iterate: Pairs
    conditions: SiteConditions
    converged: bool


def _settled(
    backend: ElasticBackend, options: Options, first: SiteConditions | None, history: History
) -> tuple[SiteConditions, Iterate | None]:
    """Conditions from solves for traces, which stop as soon as the next ones are known, and the last iterate.

    With Coulomb's law the bounds of the friction are found as well. Collective.
    """
    rule = rule_of(options)
    prediction = Prediction(rule, rho=1.0, eps=1.0, coarser=None, tuning=options.tuning)
    conditions = first or backend.chains.conditions(rule.first(backend.chains))
    history.start_from(conditions)
    before: Iterate | None = None
    segments = backend.chains.segments(conditions)

    def tresca() -> _Traces:
        nonlocal conditions, before, segments
        chains = backend.chains
        conditions = chains.conditions(segments)  # with the values of this bound
        conditions, before = prediction.settle(backend, backend, backend.spaces, conditions, history)
        segments = chains.segments(conditions)
        p, flux = backend.solve_until(conditions, lambda *_: False)
        wanted = prediction.wanted(chains, segments, p, flux)
        return _Traces(Pairs(p, flux, 0), conditions, wanted.same(conditions, backend.comm))

    balanced(backend, tresca, [], roughly=True)
    return conditions, before


def _carried(start: ElasticSolution, backend: ElasticBackend) -> ElasticSegments:
    """The segments and the bounds of the shear of a solution on another mesh (collective)."""
    theirs, spaces, own, dim = start.spaces, backend.spaces, start.segments(), start.spaces.dim
    normal, along = np.split(own.segment, [len(theirs.sites)])
    states = along.reshape(-1, dim, dim - 1)[:, :, 0]
    rows = [normal.reshape(-1, dim), *(spread(theirs, each) for each in (states, own.bound, start.slip_vectors))]
    functions = [theirs.linear_multiplier(each.astype(np.float64)) for each in rows]
    on_normal, *on_rough = spaces.near_vertices(functions, theirs.domain)
    on_states, bounds, slip = (each[spaces.rough_rows] for each in on_rough)
    segment = np.rint(np.append(on_normal, np.repeat(on_states, dim - 1))).astype(np.int64)
    # Coulomb's bounds are found sooner from no slip than from that under bounds that are not quite right
    given = dim == 3 and not backend.friction.by_pressure
    in_space = spaces.in_frames(slip).reshape(-1, dim, dim - 1) if given else None
    return ElasticSegments(spaces, segment, bounds, in_space)


def _with_friction(
    backend: ElasticBackend,
    options: Options,
    first: SiteConditions | None,
    before: Iterate | None,
    history: History,
    changes: list[float],
) -> Outcome:
    """Run the loop over the sets; with Coulomb's friction once for each bound of the shear (collective).

    Returns:
        The outcome with the iterations of all loops. How much the bound changed after each is added to the changes.
    """
    rule = rule_of(options)
    in_space = backend.friction.slipping is not None
    more = is_large(backend) if in_space else backend.friction
    sites = 0 if in_space else backend.comm.allreduce(backend.sites)  # in space the law turns in each step
    most = options.method.most_iterations(1, sites) * (MORE_WITH_FRICTION if more else 1)
    parameters = Parameters(max_iterations=options.max_iterations or most)
    last: Indices | None = None

    def loop(segments: Indices | None = None, follow: Callable[[Pairs], bool] = lambda iterate: False) -> Outcome:
        nonlocal before, last
        segments = last if segments is None else segments
        start = first if segments is None else backend.chains.conditions(segments)  # with the values of this bound
        outcome = iterate_sets(backend, rule, parameters, start=start, before=before, history=history, follow=follow)
        before, last = outcome.iterate, backend.chains.segments(outcome.conditions)
        return outcome

    if not in_space:
        outcome = balanced(backend, loop, changes)
        found = not changes or changes[-1] <= CHANGE
        return outcome if found or not outcome.converged else by_path(backend, loop, changes)
    return slipped(backend, lambda follow: loop(None, follow), changes, parameters.max_iterations)


def _continued(backend: ElasticBackend, start: ElasticSegments, near: Mask | None) -> SiteConditions | None:
    """The conditions of the last step in time, and its bounds of the shear for Coulomb's friction (collective)."""
    spaces = backend.spaces
    slope = np.take_along_axis(backend.chains.slope, start.segment[:, None], axis=1)[: len(spaces.sites)]
    if near is not None and backend.comm.allreduce(int((slope > 0).sum())) == 0:
        return _first(backend, None, near)
    backend.friction = backend.friction.with_bounds(start.bound)
    if start.slip is not None and backend.friction:
        backend.friction = backend.friction.along(start.slip)
    return backend.chains.conditions(start.segment)


def _first(backend: ElasticBackend, start: ElasticSolution | None, near: Mask | None) -> SiteConditions | None:
    """The conditions to begin with: those of the start, contact if that has to hold the body, or None (collective).

    Where there is friction, nothing slips then.

    Args:
        backend: The backend.
        start: Another solution, whose contact is taken.
        near: The facet vertices whose contact holds the body; None if it is held without.
    """
    spaces, touching = backend.spaces, near
    if start is not None:
        found = transferred(start.contact_set(), spaces)
        if touching is None or spaces.mesh.comm.allreduce(int(found.sum())) > 0:
            touching = np.repeat(found, spaces.dim)
    if touching is None:
        return None
    chains = backend.chains
    steep = np.append(touching, np.ones(len(spaces.slip_sites), dtype=bool))
    return chains.conditions(np.where(steep, chains.steepest(), chains.beside_reference(steep=False)))
