"""The loop that all active/inactive-set algorithms share: rule, solve, until the facet sets repeat."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem

from forms.norms import l2, v_norm
from signorini_fenicsx.algorithms import Algorithm
from signorini_fenicsx.backend import Backend, Iterate, LinearSolveFailure
from signorini_fenicsx.conditions import Condition, FacetConditions
from signorini_fenicsx.spaces import Spaces


@dataclass(frozen=True)
class Step:
    """One row of the history: iteration n of the algorithm, the start solve being n = 0 and not listed.

    Attributes:
        iteration: n, from 1.
        no_flux: Γ_S facets with σ·n = 0.
        zero_trace: Γ_S facets with p = 0.
        changed: Facets whose condition differs from iteration n − 1.
        sigma_change: ‖σ^(n) − σ^(n−1)‖_V.
        u_change: ‖u^(n) − u^(n−1)‖_Q.
        linear_iterations: Iterations of the linear solver.
        seconds: Wall time of the iteration.
    """

    iteration: int
    no_flux: int
    zero_trace: int
    changed: int
    sigma_change: float
    u_change: float
    linear_iterations: int
    seconds: float


@dataclass(frozen=True)
class Outcome:
    """How the loop ended.

    Attributes:
        iterate: Last solution.
        conditions: Facet conditions it was solved with.
        history: One step per iteration.
        failure: Why the sets did not settle, or None if they did.
    """

    iterate: Iterate
    conditions: FacetConditions
    history: list[Step]
    failure: str | None


class _ChangeNorms:
    """‖σ − σ'‖_V and ‖u − u'‖_Q of successive iterates, with the forms compiled once."""

    def __init__(self, spaces: Spaces):
        self._comm = spaces.mesh.comm
        self._sigma, self._u = fem.Function(spaces.V), fem.Function(spaces.Q)
        self._forms = [fem.form(v_norm(self._sigma, ufl.dx)), fem.form(l2(self._u, ufl.dx))]

    def __call__(self, new: Iterate, old: Iterate) -> tuple[float, float]:
        self._sigma.x.array[:] = new.sigma.x.array - old.sigma.x.array
        self._u.x.array[:] = new.u.x.array - old.u.x.array
        local = np.array([fem.assemble_scalar(form) for form in self._forms])
        sigma_change, u_change = np.sqrt(self._comm.allreduce(local)).tolist()
        return sigma_change, u_change


def iterate_sets(
    backend: Backend,
    algorithm: Algorithm,
    *,
    rho: float,
    max_iterations: int,
    on_step: Callable[[Step], None] = lambda step: None,
) -> Outcome:
    """Run an algorithm until the facet sets repeat (collective).

    A set that equals its predecessor ends the loop without another solve: the same set has the same solution. A set
    seen earlier means that the algorithm cycles, because the next set depends on the present one only.

    Args:
        backend: Solves under given facet conditions.
        algorithm: Start and rule.
        rho: ρ > 0 of the rule.
        max_iterations: Solves allowed after the start.
        on_step: Called on all ranks after each iteration.

    Raises:
        LinearSolveFailure: If the start cannot be solved. Later failures end the loop and are told in the outcome.
    """
    comm = backend.spaces.mesh.comm
    change_norms = _ChangeNorms(backend.spaces)
    facets = len(backend.spaces.facets)
    start = FacetConditions(np.full(facets, algorithm.start, dtype=np.int8))
    solved_with, iterate = start, backend.solve(start)
    conditions = FacetConditions(algorithm.rule(np.zeros(facets), np.zeros(facets), rho))
    seen: list[FacetConditions] = []
    history: list[Step] = []

    while True:
        began = time.perf_counter()
        changed = int(conditions.changes([solved_with], comm)[0])
        previous = iterate
        if changed:
            try:
                iterate = backend.solve(conditions)
            except LinearSolveFailure as failure:
                return Outcome(previous, solved_with, history, str(failure))
        solved_with = conditions
        counts = conditions.counts(comm)
        step = Step(
            len(history) + 1,
            counts[Condition.NO_FLUX],
            counts[Condition.ZERO_TRACE],
            changed,
            *change_norms(iterate, previous),
            iterate.linear_iterations if changed else 0,
            time.perf_counter() - began,
        )
        history.append(step)
        on_step(step)

        seen.append(conditions)
        conditions = FacetConditions(algorithm.rule(iterate.p, iterate.flux, rho))
        *earlier, last = conditions.changes(seen, comm).tolist()
        if last == 0:
            return Outcome(iterate, solved_with, history, None)
        if 0 in earlier:
            period = len(seen) - earlier.index(0)
            return Outcome(iterate, solved_with, history, f"the facet sets cycle with period {period}")
        if len(history) == max_iterations:
            return Outcome(
                iterate, solved_with, history, f"{last} facets still change after {max_iterations} iterations"
            )
