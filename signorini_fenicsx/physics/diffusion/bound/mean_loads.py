"""Bounds of loads that are known per cell only by enclosures of their means: sup (c, w)/|w| over w = 0 on Γ_D.

Take z with −∇·z = 1, z·n = 0 on Γ_N and Γ_S, and let s be the largest κ^-½|z|. For all w = 0 on Γ_D

    |w|² ≥ (2tw z, ∇w) − ‖tκ^-½ wz‖² ≥ (t − t²s²)‖w‖² = ‖w‖²/4s²   with t = 1/2s²,   so (c, w) ≤ 2s‖c‖ |w|.

If c is large in few cells only, this is far too much. With z_c for the load |c| and its largest κ^-½|z_c|, s_c,

    (|c|, w²) = (2w z_c, ∇w) ≤ 2s_c‖w‖ |w| ≤ 4s s_c|w|²,   so (c, w) ≤ ‖c‖₁^½ (|c|, w²)^½ ≤ 2(‖c‖₁ s s_c)^½ |w|.

If c is known well, the flux z for it gives (c, w) = (z, ∇w) ≤ ‖z‖ |w|. Where c ≥ γ > 0 in a term cu, also (c, w) ≤
‖γ^-½c‖ ‖γ^½w‖.
"""

import math
from dataclasses import replace

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, squares_of
from signorini_fenicsx.base.errors import LinearSolveFailure
from signorini_fenicsx.base.owned import function_of
from signorini_fenicsx.expressions.intervals import Interval
from signorini_fenicsx.physics.diffusion.bound.equilibrated import balancing_flux, distance
from signorini_fenicsx.physics.diffusion.bound.local_fields import CellMetric
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces

DIGITS = 1e-5
"""A constant that comes from a linear solve is rounded up to about this relative size, so that it does not depend on
the number of ranks."""
WORTH = 0.5
"""A load is balanced by a flux only if at most this share of it is uncertain."""
EVERYWHERE = 1e-3
"""So much of the mean of |c| is added to |c|, so that z_c is no rounding where c = 0."""


def load_left(
    spaces: Spaces, data: Data, metric: CellMetric, load: Interval, least: Array | None, enough: float
) -> float:
    """Bound of a load that is enclosed per owned cell, as small as is enough (collective).

    It is infinite if there is neither a Γ_D nor a term cu, or if a linear solve fails.

    Args:
        spaces: The discrete spaces.
        data: The data.
        metric: Metric of the owned cells.
        load: The load.
        least: Lower bound of the factor in the term cu per owned cell; None without one.
        enough: No better bound is looked for below this.
    """
    comm, volume = spaces.mesh.comm, metric.volume
    ends = load.largest
    middle = (load.lo + load.hi) / 2
    rest = np.nextafter(np.maximum(load.hi - middle, middle - load.lo), np.inf)
    whole, left = np.sqrt(comm.allreduce(np.array([volume @ ends**2, volume @ rest**2]))).tolist()
    if whole == 0:
        return 0.0
    bound = np.inf
    if least is not None:
        with np.errstate(all="ignore"):
            squares = np.where(ends > 0, ends**2 / least, 0.0)
        bound = math.sqrt(comm.allreduce(volume @ squares))
    if not spaces.held or not np.isfinite(whole) or bound <= enough:
        return bound
    bounds = _Bounds(spaces, replace(data, c_h=None, inside=None), metric)
    try:
        bound = min(bound, bounds.constant() * whole)
        if bound > enough:
            bound = min(bound, bounds.of_size(ends))
        if bound > enough and left <= WORTH * whole:
            uncertain = min(bounds.constant() * left, bounds.of_size(rest))
            bound = min(bound, bounds.of_load(middle) + uncertain)
    except LinearSolveFailure:
        pass
    return bound


class _Bounds:
    """The bounds of ‖z‖ that the module proves."""

    def __init__(self, spaces: Spaces, data: Data, metric: CellMetric):
        self._spaces, self._data, self._metric = spaces, data, metric
        self._constant: float | None = None

    def constant(self) -> float:
        """The constant 2s: a bound of ‖z‖ beside ‖c‖ (collective)."""
        if self._constant is None:
            self._constant = 2 * self._largest(np.ones(len(self._metric.volume)))
        return self._constant

    def of_size(self, size: Array) -> float:
        """2(‖c‖₁ s s_c)^½ for |c| ≤ size (collective)."""
        comm, volume = self._spaces.mesh.comm, self._metric.volume
        integral, measure = comm.allreduce(np.array([volume @ size, volume.sum()])).tolist()
        if integral == 0:
            return 0.0
        spread = EVERYWHERE * integral / measure
        return math.sqrt(2 * (1 + EVERYWHERE) * integral * self.constant() * self._largest(size + spread))

    def of_load(self, load: Array) -> float:
        """The norm ‖z‖ for a load (collective)."""
        return distance(self._spaces, self._metric, self._flux(load), fem.Function(self._spaces.V))

    def _flux(self, load: Array) -> fem.Function:
        of_cells = function_of(self._spaces.Q, load)
        return balancing_flux(self._spaces, self._data, fem.Function(self._spaces.V), of_cells).sigma

    def _largest(self, size: Array) -> float:
        """The largest κ^-½|z| for a z with −∇·z ≥ size > 0 (collective)."""
        comm, flux = self._spaces.mesh.comm, CellFlux.of(self._spaces, self._flux(size))
        squares = squares_of(flux.in_vertices(), self._metric.inverse).max(axis=1, initial=0.0) / self._metric.low
        s = comm.allreduce(np.sqrt(squares.max(initial=0.0)), MPI.MAX)
        m = comm.allreduce((-flux.divergence / size).min(initial=np.inf), MPI.MIN)
        return _rounded_up(s / m) if m > 0 else np.inf


def _rounded_up(value: float) -> float:
    """The next multiple of a power of 2 that is about DIGITS of a positive value."""
    step = 2.0 ** math.floor(math.log2(DIGITS * value))
    return math.ceil(value / step) * step
