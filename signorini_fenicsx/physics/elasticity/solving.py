"""How problems of elastic contact are solved: the system on a mesh, and what is checked before."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.signals import LoopInterruption
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.contact.kept_backend import KeptBackend
from signorini_fenicsx.contact.set_rules import SetRule
from signorini_fenicsx.discrete.points import in_facets
from signorini_fenicsx.discrete.unjoined import note_facing
from signorini_fenicsx.meshes.dolfinx_meshes import check_parts
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.methods.registry import Method
from signorini_fenicsx.physics.elasticity.discrete.boundary_nodes import check_against_foundation
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData, elastic_data
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces, build_elastic_spaces
from signorini_fenicsx.physics.elasticity.evolution import ElasticSteps
from signorini_fenicsx.physics.elasticity.problem import ElasticProblem
from signorini_fenicsx.physics.elasticity.show.notes import direction_of_gap, notes_of
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.solve.backend import ElasticBackend
from signorini_fenicsx.physics.elasticity.solve.residuals import ElasticKKT
from signorini_fenicsx.physics.elasticity.solve.rigid_motions import check_rigid_motions, slides
from signorini_fenicsx.physics.elasticity.solve.slipping import is_large
from signorini_fenicsx.physics.elasticity.solve.task import ElasticTask
from signorini_fenicsx.solving.evolution import Evolution
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import Remesh, Wish

MORE_WITH_FRICTION = 4
"""So many times the iterations of other problems are allowed for each bound in the plane, and in space for large μ."""


class System:
    """The spaces of elastic contact on a mesh.

    Attributes:
        spaces: The discrete spaces.
        boundary: The parts that are in contact, loaded or fixed.
        kept: Has the backend of the last solve, which serves derivatives.
    """

    steps_type: ClassVar[type[ElasticSteps]] = ElasticSteps
    solution_type: ClassVar[type[ElasticSolution]] = ElasticSolution

    def __init__(self, domain: Domain, problem: ElasticProblem):
        """Set up the spaces (collective).

        Raises:
            InputError: If a part is unknown, empty or not on the boundary, or fixed where a law is.
        """
        self.boundary = problem.boundary
        check_parts(domain, self.boundary.named)
        problem.check_fixed()
        self.spaces = build_elastic_spaces(domain, self.boundary, problem.rough)
        self._rough = sorted(problem.rough)
        self.kept = KeptBackend()

    def prepared(self, problem: ElasticProblem, wish: Wish) -> ElasticRun:
        """Read the data and check them (collective).

        Raises:
            InputError: If the problem cannot be discretised as asked, or the body can move rigidly.
        """
        spaces, options = self.spaces, wish.options
        rule_of(options)
        for key in ("backend", "element", "rho", "eps"):
            if getattr(options, key) != getattr(Options, key):
                raise InputError(f"{key}: elastic contact has no such option")
        if problem.boundary != self.boundary or sorted(problem.rough) != self._rough:
            raise InputError("problem: has other parts, or others with friction, than the solver was set up for")
        data = elastic_data(spaces, problem, wish.memory)
        check_against_foundation(spaces, data)
        data = replace(data, motions=check_rigid_motions(spaces, data))
        _note_foundations(spaces, data)
        task = ElasticTask(
            spaces=spaces,
            data=data,
            rho=None,
            eps=options.eps,
            max_iterations=options.max_iterations or _most_iterations(spaces, data, options.method),
            on_step=wish.on_step,
            backend=partial(self.kept.take, options.tuning, partial(ElasticBackend, tuning=options.tuning)),
            start=wish.start,
            predict=options.predict and len(spaces.part_names) > 0,  # else the problem is linear
            coarser=wish.remesh and partial(_coarser, wish.remesh, problem, wish),
            whole=True,
            tuning=options.tuning,
            watch=wish.watch,
            kept=self.kept,
        )
        return ElasticRun(task, options, self.solution_type)

    def check(self, problem: ElasticProblem) -> list[str]:
        """Read the data and check them, see `solving.solver.System` (collective).

        Raises:
            InputError: If the problem cannot be discretised.
        """
        return self.prepared(problem, Wish(Options())).remarks()

    def steps(
        self, problem: ElasticProblem, evolution: Evolution, start: ElasticSolution | None, options: Options
    ) -> ElasticSteps:
        """The steps of loads, see `solving.evolution.Steps` (collective).

        Raises:
            InputError: If a text cannot be read, or the start is on another domain.
        """
        plain = Evolution(evolution.end, evolution.steps)
        if evolution != plain:
            raise InputError("[time]: steps of loads have no initial, capacity and scheme")
        return self.steps_type(self.spaces, problem, evolution)


def _note_foundations(spaces: ElasticSpaces, data: ElasticData) -> None:
    """Note where bodies face each other within their gaps, each with a foundation of its own (collective)."""
    facets = spaces.contact.take(spaces.outer_rows)
    middles = in_facets(spaces.mesh, facets.facets, np.full((1, spaces.dim - 1), 1 / spaces.dim))
    note_facing(spaces, facets.vertices, facets.normals, data.gap.values(middles)[:, 0])


@dataclass
class ElasticRun:
    """An elastic problem on its mesh, ready to be solved.

    Attributes:
        task: What the method gets.
        options: Algorithm and its parameters.
        solution_type: The class of its solutions.
    """

    task: ElasticTask
    options: Options
    solution_type: type[ElasticSolution]

    def remarks(self) -> list[str]:
        """Data that jump and should not, and along what the gap is measured (collective)."""
        spaces, data = self.task.spaces, self.task.data
        return [*notes_of(spaces, data), *direction_of_gap(spaces, data)]

    def outcome(self) -> Outcome:
        """Run the method; if it is interrupted, return its last state (collective)."""
        try:
            with self.task.watch.phase("solve"):
                return self.options.method.run(self.task)
        except LoopInterruption as interruption:
            backend = self.task.kept.present
            return Outcome.interrupted(interruption, backend.name, backend.dofs, backend.solver())

    def judged(self, outcome: Outcome) -> tuple[Outcome, ElasticKKT]:
        """The outcome, which has converged only if its residuals are small, and these (collective)."""
        kkt = outcome.kkt if isinstance(outcome.kkt, ElasticKKT) else self.task.kkt(outcome.iterate, None)
        failure = kkt.violation() if outcome.converged else outcome.reason
        if outcome.converged and failure is None and self.task.kept.present.lost > KKT:
            failure = (
                f"of what flows through cells {self.task.kept.present.lost:.1e} is lost: the viscosity jumps too far"
            )
        friction = self.task.data.friction
        if failure is not None and friction and (outcome.converged or friction.in_space):
            failure = slides(self.task.spaces, self.task.kept.present.data_found()) or failure
        return outcome.ended(failure), kkt

    def solution(self, outcome: Outcome, **about: Any) -> ElasticSolution:
        """The solution."""
        self.task.kept.solved(outcome, self.task.data)
        return self.solution_type(
            spaces=self.task.spaces,
            data=self.task.kept.present.data_found(),
            outcome=outcome,
            bound_changes=tuple(self.task.changes),
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


def _coarser(remesh: Remesh, problem: ElasticProblem, wish: Wish, factor: float) -> ElasticTask:
    """The task on a coarser mesh (collective)."""
    return (
        System(remesh(factor), problem)
        .prepared(problem, Wish(wish.options, remesh=lambda further: remesh(factor * further)))
        .task
    )


def _most_iterations(spaces: ElasticSpaces, data: ElasticData, method: Method) -> int:
    """Iterations allowed unless the options say otherwise (collective)."""
    comm, in_space = spaces.mesh.comm, data.friction.in_space
    longer = is_large(comm, data.friction) if in_space else data.friction
    sites = comm.allreduce(len(spaces.site_kinds))
    return method.most_iterations(1, sites) * (MORE_WITH_FRICTION if longer else 1)
