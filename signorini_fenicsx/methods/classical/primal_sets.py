"""Primal-dual active set for (VI) and semismooth Newton for (P_ε), in P1: until the vertices in contact repeat."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from signorini_fenicsx.discrete.conditions import Condition, FacetConditions
from signorini_fenicsx.methods.classical.primal import P1History, P1System, primal_outcome
from signorini_fenicsx.methods.classical.task import Task
from signorini_fenicsx.methods.loop import Outcome

type Array = npt.NDArray[np.float64]
type Set = npt.NDArray[np.bool_]


def primal_dual_active_set(task: Task) -> Outcome:
    """Solve with u = 0 where λ − u > 0, λ = 0 elsewhere on Γ_S, from the solution with λ = 0 (collective).

    After one step one of u and λ is 0 at each vertex, so a factor in front of u would change no iterate.

    Raises:
        LinearSolveFailure: If a linear system cannot be solved.
    """
    system = P1System(task.spaces, task.data)

    def solve(contact: Set) -> tuple[Array, Set]:
        fixed = system.signorini[contact]
        system.change_matrix(fixed=fixed)
        b = system.load.copy()
        b[fixed] = 0.0
        u = system.solve(b)
        u[fixed] = 0.0
        reaction = np.where(contact, (system.times(u) - system.load)[system.signorini], 0.0)
        return u, reaction - u[system.signorini] > 0

    return _until_repeated(task, system, solve, Condition.ZERO_TRACE)


def primal_penalty(task: Task) -> Outcome:
    """Solve with λ = −u/ε where u < 0, λ = 0 elsewhere on Γ_S, from the solution with λ = 0 (collective).

    Newton's method for a piecewise linear problem: the same set has the same solution.

    Raises:
        LinearSolveFailure: If a linear system cannot be solved.
    """
    system = P1System(task.spaces, task.data)

    def solve(contact: Set) -> tuple[Array, Set]:
        system.change_matrix(added=np.where(contact, system.weights / task.eps, 0.0))
        u = system.solve(system.load)
        return u, u[system.signorini] < 0

    return _until_repeated(task, system, solve, Condition.ROBIN, task.eps)


def _until_repeated(
    task: Task,
    system: P1System,
    solve: Callable[[Set], tuple[Array, Set]],
    kind: Condition,
    eps: float = 0.0,
) -> Outcome:
    """Solve with a set and take the set that the solution asks for, until nothing changes."""
    comm = task.spaces.mesh.comm
    beta = 1 / eps if eps else 1.0

    def facets(contact: Set) -> FacetConditions:
        return system.conditions(contact, kind, beta)

    contact = np.zeros(len(system.signorini), dtype=bool)
    u, wanted = solve(contact)
    history = P1History(task, system, u, facets(contact))
    failure = None
    while changed := comm.allreduce(int(np.count_nonzero(wanted != contact))):
        if len(history.steps) == task.max_iterations:
            failure = f"{changed} vertices still change after {task.max_iterations} iterations"
            break
        contact = wanted
        u, wanted = solve(contact)
        history.add(u, facets(contact))
    return primal_outcome(
        system,
        history,
        u,
        facets(contact),
        failure,
        reason="the vertex sets repeat",
        solver=system.solver(),
        eps=eps,
    )
