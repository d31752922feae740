"""A potential of second order, cell by cell: from u_h and σ_h of RT0 a quadratic that is exact where these are.

With ξ = x − x_T and σ_h = c + sξ on a cell T, as in `cell_flux`, κ_h⁻¹σ_h is the gradient of κ_h⁻¹c·ξ + sm/2, where
m = ξ·κ_h⁻¹ξ, also if κ_h is a matrix. With the mean M of m over T, the potential with this gradient and the mean u_h is

    ũ = u_h + κ_h⁻¹c·ξ + s(m − M)/2.

u_h is near the mean of u to second order and κ_h⁻¹σ_h near ∇u to first order, so the error of ũ is of second order in
L², and its jumps are. The linear part alone is of this order too, but where f has one sign it is on one side of u in
all vertices. Averages over the cells around a node are nearer to u, but no longer have the flux σ_h and the means u_h.
"""

from dataclasses import dataclass
from typing import Self, cast

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, inverses, inverted, scaled, squares_of, times
from signorini_fenicsx.base.owned import cell_dofs, function_at, owned_cells, owned_values
from signorini_fenicsx.base.reference_cells import positive_quadrature
from signorini_fenicsx.discrete.bernstein import basis, jet
from signorini_fenicsx.discrete.cell_shapes import mean_moments, squared_arms
from signorini_fenicsx.discrete.points import Points, in_cells
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux, RT1Flux, means_in_cells
from signorini_fenicsx.physics.diffusion.discrete.data import Data

DEGREE = 3
"""Of the potential of RT1."""


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
        """The potential of a flux and of means in P0; of RT1 a `CubicPotential` (collective).

        With a given flux b in σ_h it is that of σ_h − b, and a `CubicPotential` too.
        """
        flux = data.driving(flux)
        if isinstance(flux, RT1Flux):
            return cast(Self, CubicPotential.of(data, flux, u))
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
        space = fenicsx.function_space(self.flux.spaces.mesh, ("DG", self.flux.spaces.degree + 2))
        return function_at(space, cell_dofs(space), self.in_nodes(space.element.interpolation_points), "u")


@dataclass(frozen=True)
class CubicPotential(Potential):
    """The cubic ũ on each owned cell with the mean of u_h for which ‖κ_h^½(∇ũ − κ⁻¹σ_h)‖ is least: for RT1.

    Attributes:
        coefficients: Its Bernstein coefficients, shape (cells, nodes).
    """

    coefficients: Array

    @classmethod
    def of(cls, data: Data, flux: CellFlux, u: fem.Function) -> Self:
        """The potential of a flux of RT1 and of a linear u_h (collective)."""
        mesh, means = flux.spaces.mesh, means_in_cells(u)
        cell, dim = mesh.basix_cell(), mesh.topology.dim
        kappa_h = np.broadcast_to(data.matrices(flux.spaces), (len(means), dim, dim))
        points, weights = positive_quadrature(cell, 2 * DEGREE - 2)
        slopes = basis(cell, DEGREE, points, slopes=True)
        products, size = np.einsum("q,iqb,jqc->ijbc", weights, slopes, slopes), slopes.shape[2]
        coefficients = np.empty((len(means), size))
        for at in in_cells(mesh, owned_cells(mesh), points, weights):
            kappa, mapped = kappa_h[at.rows], at.slopes[:, 1:]  # from reference coordinates
            y = scaled(kappa[:, None], scaled(inverted(data.kappa.values(at)), flux.at(at)))
            matrix = np.einsum("nij,ijbc->nbc", mapped @ kappa @ mapped.transpose(0, 2, 1), products, optimize=True)
            right = np.einsum("q,iqb,nij,nqj->nb", weights, slopes, mapped, y, optimize=True)
            fixed = matrix[:, :1, :1]  # times the sum of the coefficients, which is so many times the mean
            right += size * fixed[:, 0] * means[at.rows, None]
            coefficients[at.rows] = np.linalg.solve(matrix + fixed, right[..., None])[..., 0]
        centroid = jet(coefficients, np.full((1, 1, dim + 1), 1 / (dim + 1)))[:, 0, 0]
        return cls(centroid, flux, inverses(kappa_h), coefficients)

    def at(self, points: Points) -> Array:
        """ũ in points, shape (n, points)."""
        return jet(self.coefficients[points.rows], points.barycentric)[:, :, 0]
