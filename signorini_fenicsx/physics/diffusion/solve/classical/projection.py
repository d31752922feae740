"""The iteration of all Uzawa methods: x^(n) = P(x^(n−1) − ρ g(x^(n−1))), with P a projection and g affine.

Let the linear part T of g be symmetric and positive in the inner product of P. Then x^(n) converges for 0 < ρ <
2/λ_max(T) to the solution of the variational inequality of g, at the rate 1 − ρ λ_min(T) of gradient descent.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import dolfinx.mesh
import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.base.tolerances import STEP
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces

POWER_STEPS = 30
"""Power iterations for λ_max. Their error is small compared with the distance of RELAXATION from 2."""
RELAXATION = 1.5
"""ρ λ_max(T) if ρ is automatic."""
DIVERGED = 1e8
"""Scale-free size of a step. A larger step means divergence."""


@dataclass(frozen=True)
class StepLength:
    """ρ, and the end of the range of ρ in which the iteration converges for certain.

    Contact removes unknowns from the iteration, so a larger ρ may converge too.

    Attributes:
        rho: ρ > 0.
        limit: 2/λ_max(T).
    """

    rho: float
    limit: float

    def details(self) -> dict[str, float]:
        """The numbers that a run reports."""
        return {"rho": self.rho, "rho_limit": self.limit}

    def warning(self) -> str:
        """The remark of a failed run about ρ, empty if ρ is in its range."""
        return "" if self.rho < self.limit else f"; ρ = {self.rho:.3g} is outside of its range (0, {self.limit:.3g})"


def step_length(
    rho: float | None,
    slope: Callable[[Array], Array],
    inner: Callable[[Array, Array], float],
    start: Array,
) -> StepLength:
    """ρ and its range by power iterations (collective).

    Args:
        rho: ρ, or None for an automatic one.
        slope: T.
        inner: Inner product in which T is symmetric (collective).
        start: Start vector on this rank; it should not be nearly orthogonal to the eigenvector of λ_max.
    """
    x, eigenvalue = start, 0.0
    for _ in range(POWER_STEPS):
        size = math.sqrt(inner(x, x))
        if size == 0:
            break
        x = x / size
        image = slope(x)
        eigenvalue = inner(x, image)
        x = image
    limit = 2 / eigenvalue if eigenvalue > 0 else math.inf
    automatic = RELAXATION * limit / 2 if math.isfinite(limit) else 1.0
    return StepLength(rho or automatic, limit)


def scattered_values(spaces: Spaces) -> Array:
    """A pseudo-random value per Γ_S facet that depends only on its midpoint, not on the ranks."""
    dim = spaces.mesh.topology.dim
    return scattered(dolfinx.mesh.compute_midpoints(spaces.mesh, dim - 1, spaces.facets), spaces)


def scattered(x: Array, spaces: Spaces) -> Array:
    """A pseudo-random value per point of the domain; x has shape (points, 3) (collective)."""
    inside = (x - spaces.domain.box()[0]) / spaces.length
    return np.sin(1e3 * (inside @ np.sqrt([2.0, 3.0, 5.0]))) + 0.5


def iterate_projection(
    start: Array,
    evaluate: Callable[[Array], Array],
    project: Callable[[Array, Array], Array],
    size: Callable[[Array], float],
    *,
    step: StepLength,
    max_iterations: int,
    record: Callable[[Array], None],
) -> tuple[Array, str | None]:
    """Repeat x ← P(x − ρ g(x)) until the step is small (collective).

    Args:
        start: x^(0) on this rank.
        evaluate: g.
        project: Maps x and ρ g(x) to P(x − ρ g(x)).
        size: Scale-free norm of a step divided by ρ (collective).
        step: ρ.
        max_iterations: Iterations allowed.
        record: Called after each iteration with its x; the last call of `evaluate` was with this x.

    Returns:
        The last x, and why it is no solution, or None.
    """
    x = start
    gradient = evaluate(x)
    for _ in range(max_iterations):
        new = project(x, step.rho * gradient)
        change = size((new - x) / step.rho)
        if change <= STEP:
            return x, None
        if not change <= DIVERGED:
            return x, "the iteration diverges" + step.warning()
        x = new
        gradient = evaluate(x)
        record(x)
    return x, f"a step still has size {change:.1e} after {counted(max_iterations, 'iteration')}" + step.warning()
