"""A flux of RT0 cell by cell, without quadrature.

On a cell T with vertices x_v the basis function of the facet opposite to x_i is (a_i / d|T|) (x − x_i), where a_i = ∫_T
∇·φ_i is its flux out of T. With ξ = x − x_T, y_i = x_i − x_T and the fluxes w_i = a_i σ_i through the facets

    σ = (Wξ − z) / (d|T|),   W = Σ_i w_i = ∫_T ∇·σ,   z = Σ_i w_i y_i,

and as ∫_T ξ = 0, for a symmetric matrix B, with m = (1/|T|) ∫_T ξ·Bξ = Σ_v y_v·By_v / ((d + 1)(d + 2)),

    (Bσ, φ_i)_T = a_i (W m + z·By_i) / (d²|T|),   (Bσ, σ)_T = (W² m + z·Bz) / (d²|T|).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from dolfinx import fem, la

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.spaces import Spaces

type Weight = Array | float
"""B: a number, one for each cell, or matrices of shape (d, d, cells)."""


@dataclass(frozen=True)
class CellFlux:
    """A flux of RT0 on the owned cells, which are the last axis of all arrays, so that NumPy is fast.

    Attributes:
        spaces: The discrete spaces.
        out: W, what flows out of each cell.
        moment: z, shape (d, cells).
        arms: y_i, shape (d + 1, d, cells).
    """

    spaces: Spaces
    out: Array
    moment: Array
    arms: Array

    @classmethod
    def of(cls, spaces: Spaces, sigma: fem.Function) -> CellFlux:
        """That of a function with up-to-date ghost values."""
        geometry = spaces.mesh.geometry
        vertices = np.stack([x.take(geometry.dofmaps[0].T) for x in geometry.x.T[: geometry.dim]], axis=1)
        y = vertices - vertices.mean(axis=0)
        through = spaces.outflow * sigma.x.array.take(spaces.V.dofmap.list.T)
        return cls(spaces, through.sum(axis=0), (through[:, None] * y).sum(axis=0), y)

    def squares(self, weight: Weight) -> Array:
        """(Bσ, σ)_T of each cell."""
        of_moment = (_times(weight, self.moment) * self.moment).sum(axis=0)
        return (self.out**2 * self._mean(weight) + of_moment) / self._scale

    def tested(self, weight: Weight) -> Array:
        """(Bσ, φ_i)_T / a_i of each cell, shape (d + 1, cells)."""
        of_moment = (_times(weight, self.moment) * self.arms).sum(axis=1)
        return (of_moment + self.out * self._mean(weight)) / self._scale

    def mass_diagonal(self, weight: Weight) -> Array:
        """(Bφ, φ) for each basis function φ; complete for owned entries (collective)."""
        of_arms = (_times(weight, self.arms) * self.arms).sum(axis=1)
        return self.joined(self.spaces.outflow**2 * (of_arms + self._mean(weight)) / self._scale)

    def joined(self, of_cells: Array) -> Array:
        """The sum over the cells, of shape (d + 1, cells), for each basis function; complete for owned entries.

        Collective.
        """
        V = self.spaces.V
        total = fem.Function(V)
        total.x.array[:] = np.bincount(V.dofmap.list.T.ravel(), of_cells.ravel(), len(total.x.array))
        total.x.scatter_reverse(la.InsertMode.add)
        return np.asarray(total.x.array, dtype=np.float64)

    def _mean(self, weight: Weight) -> Array:
        """The mean m of ξ·Bξ."""
        return weight * self._plain_mean if np.ndim(weight) < 3 else self._mean_of(_times(weight, self.arms))

    @cached_property
    def _plain_mean(self) -> Array:
        """The same for B = 1."""
        return self._mean_of(self.arms)

    def _mean_of(self, images: Array) -> Array:
        dim = len(self.moment)
        return (images * self.arms).sum(axis=(0, 1)) / ((dim + 1) * (dim + 2))

    @property
    def _scale(self) -> Array:
        return len(self.moment) ** 2 * self.spaces.cell_measures


def _times(weight: Weight, vectors: Array) -> Array:
    """B times vectors of shape (…, d, cells)."""
    return np.einsum("kln,...ln->...kn", weight, vectors) if np.ndim(weight) == 3 else weight * vectors
