"""From a domain, a boundary and an elastic problem to the solution."""

from __future__ import annotations

import contextlib

import numpy as np
from petsc4py import PETSc

from signorini_fenicsx.backends.elastic import ElasticBackend
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.parallel import Stopwatch, peak_memory
from signorini_fenicsx.base.signals import LoopInterruption
from signorini_fenicsx.discrete.conditions import Condition, SiteConditions
from signorini_fenicsx.discrete.contact_sets import transferred
from signorini_fenicsx.discrete.elastic_data import elastic_data
from signorini_fenicsx.discrete.elastic_kkt import elastic_kkt
from signorini_fenicsx.discrete.elastic_problem import ElasticBoundary, ElasticProblem
from signorini_fenicsx.discrete.elastic_spaces import ElasticSpaces, build_elastic_spaces
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.own import check_parts
from signorini_fenicsx.methods.history import OnStep, Outcome
from signorini_fenicsx.methods.loop import Parameters, iterate_sets
from signorini_fenicsx.methods.set_rules import ALGORITHM_1, ALGORITHM_2
from signorini_fenicsx.solving.elastic_solution import ElasticSolution
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.rigid_motions import check_rigid_motions
from signorini_fenicsx.solving.solver import Remesh

RULES = {"alg1": ALGORITHM_1, "alg2": ALGORITHM_2}
"""What solves elastic contact."""


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
    options, watch = options or Options(), watch or Stopwatch()
    if options.algorithm not in RULES:
        raise InputError(f"algorithm: elastic contact is solved by {' or '.join(RULES)}, not {options.algorithm_name}")
    rule = RULES[str(options.algorithm)]
    parameters = Parameters(max_iterations=options.max_iterations or options.method.max_iterations)
    with watch.phase("assembly"):
        check_parts(domain, boundary.named)
        spaces = build_elastic_spaces(domain, boundary)
        data = elastic_data(spaces, problem)
        motions = check_rigid_motions(spaces, data)
        held_by_contact = motions.shape[1] > 0
        backend = ElasticBackend(spaces, data, options.tuning, motions)
    if start is None and remesh is not None and options.predict and backend.dofs >= options.tuning.predict_from:
        with watch.phase("prediction"):
            start = _on_coarser_mesh(remesh, boundary, problem, options)
    with watch.phase("solve"):
        first = _first(spaces, start, held_by_contact=held_by_contact)
        try:
            outcome = iterate_sets(backend, rule, parameters, start=first, on_step=on_step)
        except LoopInterruption as interruption:
            outcome = Outcome.interrupted(interruption, backend.name, backend.dofs, backend.solver())
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
        outcome=outcome.ended(kkt.violation() if outcome.converged else outcome.reason),
        kkt=kkt,
        source=source,
        timings=watch.longest(domain.mesh.comm),
        peak_memory=peak_memory(domain.mesh.comm),
    )
    if solution.converged:
        return solution
    raise NumericalFailure(solution.outcome.reason, solution)


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


def _first(spaces: ElasticSpaces, start: ElasticSolution | None, *, held_by_contact: bool) -> SiteConditions | None:
    """The conditions to begin with: those of the start, contact if that has to hold the body, or None (collective)."""
    touching = np.full(len(spaces.contact.facets), held_by_contact)
    if start is not None:
        found = transferred(start.contact_set(), spaces.scalar)
        if not held_by_contact or spaces.mesh.comm.allreduce(int(found.sum())) > 0:
            touching = found
    elif not held_by_contact:
        return None
    kinds = np.where(np.repeat(touching, spaces.dim), Condition.ZERO_TRACE, Condition.NO_FLUX)
    return SiteConditions(kinds.astype(np.int8))
