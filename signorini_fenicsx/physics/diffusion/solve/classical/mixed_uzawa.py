"""The projection iterations for (MLM-I)_h and (MLM-II)_h: in σ·n or in p, in L²(Γ_S) or in H^{1/2}(Γ_S).

With the discrete Dirichlet-to-Neumann map S on Λ_h, σ·n = Sp + g_0 for given p and p = S⁻¹(σ·n − g_0) for given σ·n.
The spectrum of S reaches from O(1) to O(1/h), so

    mixed-uzawa1     σ·n ← max(0, σ·n − ρp)         converges for ρ < 2 λ_min(S),
    mixed-uzawa2     p ← max(0, p − ρσ·n)           converges for ρ < 2/λ_max(S),

both in O(1/h) iterations. Each iteration is a back substitution; there is one factorisation for all. mixed-uzawa-h12
projects in H^{1/2}(Γ_S) instead, and its number of iterations does not depend on h (see `half_uzawa`).
"""

import math
from collections.abc import Callable

import numpy as np
import ufl

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.conditions import Condition, SiteConditions
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solve.classical.half_norm import HalfNorm
from signorini_fenicsx.physics.diffusion.solve.classical.projection import (
    StepLength,
    iterate_projection,
    scattered_values,
    step_length,
)
from signorini_fenicsx.physics.diffusion.solve.mixed import MixedBackend
from signorini_fenicsx.physics.diffusion.solve.recorder import Recorder
from signorini_fenicsx.physics.diffusion.solve.task import DiffusionTask


class _Response:
    """The iterate that belongs to facet values x: σ·n = x or p = x on Γ_S."""

    def __init__(self, task: DiffusionTask, *, by_flux: bool):
        self._system = MixedBackend(task.spaces, task.data)
        self._by_flux = by_flux
        kind = Condition.NO_FLUX if by_flux else Condition.ZERO_TRACE
        self._given = SiteConditions.everywhere(kind, len(task.spaces.facets))
        self.start = np.zeros(len(task.spaces.facets))
        self.gradient(self.start)
        self.scale = _scale(task.spaces, self.iterate)
        self._recorder = Recorder(task.spaces, self.iterate, self._conditions(self.start), task.on_step)

    def gradient(self, x: Array) -> Array:
        """The trace p for given σ·n, or σ·n for given p; the iterate is kept (collective)."""
        self.iterate: Iterate = self._system.respond(self._given, flux=x, trace=x)
        return self.iterate.p if self._by_flux else self.iterate.flux

    def slope(self, x: Array) -> Array:
        """The linear part of `gradient`, S⁻¹ or S, applied to x (collective)."""
        response = self._system.respond(self._given, flux=x, trace=x, loaded=False)
        return response.p if self._by_flux else response.flux

    def record(self, x: Array) -> None:
        """Add the current iterate to the history (collective)."""
        self._recorder.add(self.iterate, self._conditions(x))

    def outcome(self, x: Array, step: StepLength, failure: str | None) -> Outcome:
        """The outcome of the iteration."""
        state, reason = (self.iterate, self._conditions(x)), failure or "the last step is below the tolerance"
        system = self._system.name, self._system.dofs, self._system.solver()
        return self._recorder.outcome(state, reason, system, converged=failure is None, details=step.details())

    def _conditions(self, x: Array) -> SiteConditions:
        at_bound, free = (
            (Condition.NO_FLUX, Condition.ZERO_TRACE) if self._by_flux else (Condition.ZERO_TRACE, Condition.NO_FLUX)
        )
        return SiteConditions(np.where(x > 0, free, at_bound).astype(np.int8))


def flux_uzawa(task: DiffusionTask) -> Outcome:
    """σ·n^(n) = max(0, σ·n^(n−1) − ρp^(n−1)), from σ·n^(0) = 0 (collective).

    The step divided by ρ is a trace; it is measured like the KKT residual of p ≥ 0.
    """
    return _pointwise(task, by_flux=True)


def trace_uzawa(task: DiffusionTask) -> Outcome:
    """p^(n) = max(0, p^(n−1) − ρσ·n^(n−1)), from p^(0) = 0 (collective).

    The step divided by ρ is a flux; it is measured like the KKT residual of σ·n ≥ 0.
    """
    return _pointwise(task, by_flux=False)


def _pointwise(task: DiffusionTask, *, by_flux: bool) -> Outcome:
    response, length = _Response(task, by_flux=by_flux), task.spaces.length
    unit = 1 / length if by_flux else length

    def inner(x: Array, y: Array) -> float:
        return float(task.spaces.mesh.comm.allreduce(float(task.spaces.facet_measure @ (x * y))))

    return _projected(task, response, response.slope, inner, lambda x, change: np.maximum(0, x - change), unit)


def half_uzawa(task: DiffusionTask) -> Outcome:
    """p^(n) = P(p^(n−1) − ρ R σ·n^(n−1)) in H^{1/2}(Γ_S), from p^(0) = 0 (collective).

    R is the Riesz map of the discrete H^{1/2} inner product (p, q)_H = pᵀHq (see `half_norm`), R = H⁻¹M with M the mass
    matrix of Λ_h. The projection is that of this inner product,

        P(z) = argmin over q ≥ 0 of ½(q − z)ᵀH(q − z),

    a small bound-constrained quadratic programme, which is solved exactly. Its fixed points solve (10c) because
    (z − P(z), q − P(z))_H ≤ 0 for all q ≥ 0; max(0, z), facet by facet, would have other fixed points. H is spectrally
    equivalent to S, so the number of iterations is bounded as h → 0. The algebra is dense and on rank 0, so this is for
    up to a few thousand Γ_S facets.
    """
    response, half = _Response(task, by_flux=False), HalfNorm(task.spaces)
    return _projected(task, response, lambda x: half.riesz(response.slope(x)), half.inner, half.project)


def _projected(
    task: DiffusionTask,
    response: _Response,
    slope: Callable[[Array], Array],
    inner: Callable[[Array, Array], float],
    project: Callable[[Array, Array], Array],
    unit: float = 1.0,
) -> Outcome:
    """The outcome of the iteration with these operators, in whose inner product steps of size 1/√unit are 1."""
    step = step_length(task.rho, slope, inner, scattered_values(task.spaces))
    x, failure = iterate_projection(
        response.start,
        response.gradient,
        project,
        lambda change: math.sqrt(unit * max(inner(change, change), 0.0)) / response.scale,
        step=step,
        max_iterations=task.max_iterations,
        record=response.record,
    )
    return response.outcome(x, step, failure)


def _scale(spaces: Spaces, iterate: Iterate) -> float:
    """‖σ‖ of the start, or 1 if it is 0 (collective)."""
    return math.sqrt(spaces.integrate(l2(iterate.sigma, ufl.dx))) or 1.0
