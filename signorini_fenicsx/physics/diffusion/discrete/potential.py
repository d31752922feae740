"""A potential of second order, cell by cell: from u_h and σ_h of RT0 a quadratic that is exact where these are.

With ξ = x − x_T and σ_h = c + sξ on a cell T, as in `cell_flux`, κ_h⁻¹σ_h is the gradient of κ_h⁻¹c·ξ + sm/2, where
m = ξ·κ_h⁻¹ξ, also if κ_h is a matrix. With the mean M of m over T, the potential with this gradient and the mean u_h is

    ũ = u_h + κ_h⁻¹c·ξ + s(m − M)/2.

u_h is near the mean of u to second order and κ_h⁻¹σ_h near ∇u to first order, so the error of ũ is of second order in
L², and its jumps are. The linear part alone is of this order too, but where f has one sign it is on one side of u in
all vertices. Averages over the cells around a node are nearer to u, but no longer have the flux σ_h and the means u_h.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import cell_dofs, owned_cells, owned_values
from signorini_fenicsx.base.small_matrices import inverses, squares_of, times
from signorini_fenicsx.discrete.cell_shapes import mean_moments, squared_arms
from signorini_fenicsx.discrete.points import Points, in_cells
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux
from signorini_fenicsx.physics.diffusion.discrete.data import Data


@dataclass(frozen=True)
class Potential:
    """ũ on the owned cells.

    Attributes:
        centroid: ũ(x_T), shape (cells,).
        flux: σ_h.
        inverse: κ_h⁻¹, shape (cells, dim, dim).
    """

    centroid: Array
    flux: CellFlux
    inverse: Array

    @classmethod
    def of(cls, data: Data, flux: CellFlux, u: fem.Function) -> Self:
        """The potential of a flux and of means in P0."""
        inverse = np.broadcast_to(inverses(data.matrices(flux.spaces)), (len(flux.slope), *flux.centroid.shape[1:] * 2))
        moment = mean_moments(squared_arms(flux.spaces.mesh, inverse))
        return cls(owned_values(u) - flux.slope * moment / 2, flux, inverse)

    def at(self, points: Points) -> Array:
        """ũ in points, shape (n, points)."""
        cells, arms = points.rows, points.arms
        inverse, slope = self.inverse[cells], self.flux.slope[cells, None]
        gradient = times(self.flux.centroid[cells, None], inverse)[:, 0]
        values = np.einsum("npi,ni->np", arms, gradient) + slope / 2 * squares_of(arms, inverse)
        return np.asarray(self.centroid[cells, None] + values)

    def in_nodes(self, nodes: Array) -> Array:
        """ũ in points of the reference cell, by default of all cells, shape (cells, points) (collective)."""
        mesh = self.flux.spaces.mesh
        return np.concatenate([self.at(points) for points in in_cells(mesh, owned_cells(mesh), nodes)])

    def function(self) -> fem.Function:
        """ũ as a function, quadratic on each cell and not continuous (collective)."""
        u = fem.Function(fenicsx.function_space(self.flux.spaces.mesh, ("DG", 2)), name="u")
        u.x.array[cell_dofs(u.function_space)] = self.in_nodes(u.function_space.element.interpolation_points)
        u.x.scatter_forward()
        return u
