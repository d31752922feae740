"""What soil stores in a step in time: aθ(u) on each cell, as a part of the sources.

With y_T = −∇·σ and u_T = ū_T + m_T y_T on a cell, see `sources`, the balance y_T = f + Σ_k w_k θ_(n−k) − aθ(u_T) is one
equation for u_T, which grows with it. So θ needs no unknown of its own. Around that u_T it is linear, aθ ≈ cu − load,
and what the step leaves is the θ that its balance has.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete import cell_shapes
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces

STEPS = 100
"""Newton's steps or bisections for u_T; each of the latter halves the interval."""
CLOSE = 4e-16
"""A step of this share of u is none."""


@dataclass(frozen=True)
class WaterBefore:
    """What a step with soils takes from those before.

    Attributes:
        content: Σ_k w_k θ_(n−k).
        traces: û on the facets of the owned cells, shape (cells, d + 1), from which the step begins.
        rate: a.
    """

    content: fem.Function
    traces: Array
    rate: float = 0.0


@dataclass(frozen=True)
class Storing:
    """aθ(u) of soils on the owned cells.

    Attributes:
        spaces: The discrete spaces.
        content: θ and its derivative for u on these cells, see `Quasilinear.content`.
        rate: a.
        f: The means of f.
        before: Σ_k w_k θ_(n−k).
        traces: û on the facets of cells at the last solution.
    """

    spaces: Spaces
    content: Callable[[Array], tuple[Array, Array]]
    rate: float
    f: Array
    before: Array
    traces: Array

    @cached_property
    def _moments(self) -> Array:
        """m_T for κ = 1, see `sources.mean_moments`."""
        return cell_shapes.mean_moments(self.spaces.squared_arms) / self.spaces.mesh.topology.dim**2

    def linear(self, means: Array, kappa: Array) -> tuple[Array, Array]:
        """C and load with aθ = cu − load around the u_T of each cell.

        Args:
            means: ū_T.
            kappa: The mean of κ.
        """
        inverse, given = kappa / self._moments, self.f + self.before

        def left(u: Array) -> tuple[Array, Array]:
            theta, slope = self.content(u)
            return inverse * (u - means) + self.rate * theta - given, inverse + self.rate * slope

        u = means.copy()
        value, slope = left(u)
        far = u - value / inverse  # the derivative is not below 1/m
        low, high = np.minimum(u, far), np.maximum(u, far)
        for _ in range(STEPS):
            low, high = np.where(value > 0, low, u), np.where(value > 0, u, high)
            step = u - value / slope
            step = np.where((step >= low) & (step <= high), step, (low + high) / 2)
            moved, u = np.abs(step - u), step
            value, slope = left(u)
            if (moved <= CLOSE * (np.abs(u) + np.abs(means))).all():
                break
        theta, rise = self.content(u)
        return self.rate * rise, self.rate * (rise * u - theta)

    def left(self, u: Array, c: Array, load: Array) -> Array:
        """The θ that a balance has, with u on the owned cells."""
        return (c * u - load) / self.rate

    def change(self, u: Array, c: Array, load: Array) -> float:
        """The largest amount by which it differs from θ(u), over all cells (collective)."""
        off = np.abs(self.left(u, c, load) - self.content(u)[0])
        return float(self.spaces.mesh.comm.allreduce(float(off.max(initial=0.0)), MPI.MAX))
