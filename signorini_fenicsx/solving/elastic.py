"""From a domain, a boundary and an elastic problem to the solution."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np
from petsc4py import PETSc

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.parallel import Stopwatch, collector_off, peak_memory
from signorini_fenicsx.base.signals import LoopInterruption
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.conditions import Condition, SiteConditions
from signorini_fenicsx.contact.history import History, OnStep, Outcome
from signorini_fenicsx.contact.loop import Parameters, iterate_sets
from signorini_fenicsx.contact.set_rules import ALGORITHM_1, ALGORITHM_2
from signorini_fenicsx.discrete.contact_sets import transferred
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.own import check_parts
from signorini_fenicsx.methods.prediction import Prediction
from signorini_fenicsx.physics.elasticity.backend import ElasticBackend
from signorini_fenicsx.physics.elasticity.boundary_nodes import check_against_foundation
from signorini_fenicsx.physics.elasticity.data import ElasticData, elastic_data
from signorini_fenicsx.physics.elasticity.problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.physics.elasticity.residuals import ElasticKKT, elastic_kkt
from signorini_fenicsx.physics.elasticity.rigid_motions import check_rigid_motions, slides
from signorini_fenicsx.physics.elasticity.spaces import ElasticSpaces, build_elastic_spaces
from signorini_fenicsx.solving.elastic_solution import ElasticSolution
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import Remesh, same_domain

RULES = {"alg1": ALGORITHM_1, "alg2": ALGORITHM_2}
"""What solves elastic contact."""
BOUND_CHANGE = 1e-9
"""Coulomb's fixed point ends where the bound of the shear changes by this share of itself."""
MOST_BOUNDS = 100
MORE_WITH_FRICTION = 4
"""By default so many times the iterations of problems without friction are allowed for each bound."""


@collector_off()
def solve_elastic(
    domain: Domain,
    boundary: ElasticBoundary,
    problem: ElasticProblem,
    options: Options | None = None,
    *,
    start: ElasticSolution | None = None,
    remesh: Remesh | None = None,
    name: str = "problem",
    title: str = "",
    source: object = None,
    watch: Stopwatch | None = None,
    on_step: OnStep = lambda step: None,
) -> ElasticSolution:
    """Solve an elastic contact problem (collective).

    Args:
        domain: The mesh with its parts.
        boundary: Which parts are in contact, loaded or fixed.
        problem: The data.
        options: The algorithm, alg1 or alg2, its number of iterations, and whether large problems start from predicted
            sets.
        start: Solution whose contact set is taken for the first one, on any mesh of the domain.
        remesh: Makes coarser meshes, from which the sets of a large problem are predicted.
        name: What results are called.
        title: The same in more words.
        source: What the problem was read from.
        watch: Has measured what went before.
        on_step: Called on all ranks after each iteration.

    Raises:
        InputError: If the problem cannot be discretised as asked, or the body can move rigidly.
        NumericalFailure: If the sets do not settle or a residual is large; its `solution` holds the last state.
    """
    options, watch = Options.of(options), watch or Stopwatch()
    if options.algorithm not in RULES:
        raise InputError(f"algorithm: elastic contact is solved by {' or '.join(RULES)}, not {options.algorithm_name}")
    boundary = _with_rough_parts(boundary, problem)
    with watch.phase("assembly"):
        check_parts(domain, boundary.named)
        _check_start(domain, start)
        spaces = build_elastic_spaces(domain, boundary, problem.rough)
        data = elastic_data(spaces, problem)
        check_against_foundation(spaces, data)
        motions = check_rigid_motions(spaces, data)
        held_by_contact = motions.shape[1] > 0
        backend = ElasticBackend(spaces, data, options.tuning, motions)
    large = options.predict and backend.dofs >= options.tuning.elastic_predict_from
    if start is None and remesh is not None and large:
        with watch.phase("prediction"):
            start = _on_coarser_mesh(remesh, boundary, problem, options)
    first = _first(backend, start, held_by_contact=held_by_contact)
    outcome, changes = _run(backend, options, first, watch, on_step, predict=large)
    data = replace(data, friction=backend.friction)
    with watch.phase("kkt"):
        kkt = elastic_kkt(spaces, data, spaces.split.values(outcome.iterate.sigma), outcome.iterate.p)
        PETSc.garbage_cleanup(domain.mesh.comm)  # in parallel PETSc only queues what Python lets go
    solution = ElasticSolution(
        name=name,
        title=title,
        boundary=boundary,
        problem=problem,
        options=options,
        spaces=spaces,
        data=data,
        outcome=outcome.ended(_failure(spaces, data, outcome, kkt)),
        kkt=kkt,
        bound_changes=tuple(changes),
        source=source,
        timings=watch.longest(domain.mesh.comm),
        peak_memory=peak_memory(domain.mesh.comm),
    )
    if solution.converged:
        return solution
    raise NumericalFailure(solution.outcome.reason, solution)


def _failure(spaces: ElasticSpaces, data: ElasticData, outcome: Outcome, kkt: ElasticKKT) -> str | None:
    """Why there is no solution; None if there is one (collective)."""
    if not outcome.converged:
        return outcome.reason
    failure = kkt.violation()
    return failure if failure is None or data.friction is None else slides(spaces, data) or failure


def _with_rough_parts(boundary: ElasticBoundary, problem: ElasticProblem) -> ElasticBoundary:
    """The boundary with the parts with friction in Γ_C.

    Raises:
        InputError: If they are something else.
    """
    check_kind("boundary", boundary, ElasticBoundary)
    check_kind("problem", problem, ElasticProblem)
    return boundary.touching_on(problem.rough)


def _check_start(domain: Domain, start: ElasticSolution | None) -> None:
    """Refuse a start that is no elastic solution, or on another domain (collective).

    Raises:
        InputError: If it is.
    """
    if start is None:
        return
    check_kind("start", start, ElasticSolution)
    if not same_domain(domain, start.spaces.domain):
        raise InputError(f"the start was solved on '{start.spaces.domain.name}', not on '{domain.name}'")


def _on_coarser_mesh(
    remesh: Remesh, boundary: ElasticBoundary, problem: ElasticProblem, options: Options
) -> ElasticSolution | None:
    """The solution on a coarser mesh, itself predicted from a coarser one; None if there is none (collective)."""
    factor = options.tuning.coarsening

    def coarser(further: float) -> Domain:
        return remesh(factor * further)

    with contextlib.suppress(InputError, NumericalFailure):
        return solve_elastic(remesh(factor), boundary, problem, options, remesh=coarser)
    return None


def _run(
    backend: ElasticBackend,
    options: Options,
    first: SiteConditions | None,
    watch: Stopwatch,
    on_step: OnStep,
    *,
    predict: bool,
) -> tuple[Outcome, list[float]]:
    """Predict the sets and run the loop; if one is interrupted, return the last state (collective).

    Returns:
        The outcome, and how much the bound of Coulomb's friction changed after each loop, relative to itself.
    """
    history, changes = History(backend.comm, on_step), list[float]()
    before: Iterate | None = None
    try:
        if predict and backend.inexact is not None:
            with watch.phase("prediction"):
                first, before = _settled(backend, options, first, history)
        with watch.phase("solve"):
            return _with_friction(backend, options, first, before, history, changes), changes
    except LoopInterruption as interruption:
        return Outcome.interrupted(interruption, backend.name, backend.dofs, backend.solver()), changes


def _settled(
    backend: ElasticBackend, options: Options, first: SiteConditions | None, history: History
) -> tuple[SiteConditions, Iterate | None]:
    """Conditions from solves that stop as soon as the next ones are known, and the last iterate (collective)."""
    rule = RULES[str(options.algorithm)]
    prediction = Prediction(rule, rho=1.0, eps=1.0, coarser=None, tuning=options.tuning)
    first = first or backend.chains.conditions(rule.first(backend.chains))
    history.start_from(first)
    return prediction.settle(backend, backend, backend.spaces, first, history)


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
    rule = RULES[str(options.algorithm)]
    most = options.method.max_iterations * (1 if backend.friction is None else MORE_WITH_FRICTION)
    parameters = Parameters(max_iterations=options.max_iterations or most)
    spaces = backend.spaces
    while True:
        outcome = iterate_sets(backend, rule, parameters, start=first, before=before, history=history)
        present = backend.friction
        if present is None or not present.by_pressure or not outcome.converged:
            return outcome
        pressure = outcome.iterate.flux[: len(spaces.sites)].reshape(-1, spaces.dim)[spaces.rough_rows]
        following = present.following(pressure)
        changes.append(present.change(following, spaces))
        if changes[-1] <= BOUND_CHANGE:
            return outcome
        if len(changes) == MOST_BOUNDS:
            reason = f"the bound of the friction still changes by {changes[-1]:.1e} after {MOST_BOUNDS} steps"
            return outcome.ended(reason)
        segments = backend.chains.segments(outcome.conditions)
        backend.friction, before = following, outcome.iterate
        first = backend.chains.conditions(segments)


def _first(backend: ElasticBackend, start: ElasticSolution | None, *, held_by_contact: bool) -> SiteConditions | None:
    """The conditions to begin with: those of the start, contact if that has to hold the body, or None (collective).

    Where there is friction, nothing slips then.
    """
    spaces = backend.spaces
    touching = np.full(len(spaces.contact.facets), held_by_contact)
    if start is not None:
        found = transferred(start.contact_set(), spaces)
        if not held_by_contact or spaces.mesh.comm.allreduce(int(found.sum())) > 0:
            touching = found
    elif not held_by_contact:
        return None
    kinds = np.where(np.repeat(touching, spaces.dim), Condition.ZERO_TRACE, Condition.NO_FLUX)
    sticking = np.full(len(spaces.slip_sites), Condition.ZERO_TRACE)
    conditions = SiteConditions(np.concatenate([kinds, sticking]).astype(np.int8))
    return backend.chains.conditions(backend.chains.segments(conditions))
