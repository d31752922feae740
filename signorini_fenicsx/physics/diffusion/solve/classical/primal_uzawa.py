"""Uzawa's iteration for (VL) in P1: a multiplier λ ≥ 0 per vertex of Γ_S, and one factorisation for all steps."""

import math

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.physics.diffusion.solve.classical.primal import P1History, P1System, primal_outcome
from signorini_fenicsx.physics.diffusion.solve.classical.projection import iterate_projection, scattered, step_length
from signorini_fenicsx.physics.diffusion.solve.task import DiffusionTask


def primal_uzawa(task: DiffusionTask) -> Outcome:
    """λ^(n) = max(0, λ^(n−1) − ρu^(n−1)), u^(n) the solution with reaction w_i λ_i^(n), from λ^(0) = 0 (collective).

    The map λ ↦ u on Γ_S is the inverse of the discrete Dirichlet-to-Neumann map. Its largest eigenvalue does not depend
    on h and its smallest is of order h, so the iteration takes O(1/h) steps.

    Raises:
        LinearSolveFailure: If a linear system cannot be solved.
    """
    system = P1System(task.spaces, task.data)
    on, weights = system.signorini, system.weights
    u = system.solve(system.load)
    scale = system.energy_norm(u) or 1.0
    length = math.sqrt(system.dot(np.ones(len(weights)), weights)) or 1.0  # 0 if all vertices of Γ_S are on Γ_D

    def trace(multiplier: Array) -> Array:
        nonlocal u
        u = system.solve(system.load + system.at_signorini(weights * multiplier))
        return u[on]

    def inner(x: Array, y: Array) -> float:
        return system.dot(weights, x * y)

    def conditions(multiplier: Array) -> SiteConditions:
        return system.conditions(multiplier > 0, Condition.ZERO_TRACE)

    start = np.zeros(len(on))
    history = P1History(task, system, u, conditions(start))
    step = step_length(
        task.rho,
        lambda x: system.solve(system.at_signorini(weights * x))[on],
        inner,
        scattered(system.space.tabulate_dof_coordinates()[on], task.spaces),
    )
    multiplier, failure = iterate_projection(
        start,
        trace,
        lambda x, change: np.maximum(0, x - change),
        lambda change: math.sqrt(inner(change, change)) / (length * scale),
        step=step,
        max_iterations=task.max_iterations,
        record=lambda x: history.add(u, conditions(x)),
    )
    return primal_outcome(
        system,
        history,
        u,
        conditions(multiplier),
        failure,
        reason="the last step is below the tolerance",
        solver=system.solver(),
        details=step.details(),
    )
