"""Geometry of the cells in the metric of κ."""

import math
from dataclasses import dataclass

import dolfinx.mesh
import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import number_of_cells, owned_cells
from signorini_fenicsx.base.small_matrices import determinants, inverses, squares_of
from signorini_fenicsx.discrete.cell_shapes import corners, mean_moments, some_at_a_time, squared_arms
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.points import in_cells, quadratic_nodes
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces


@dataclass(frozen=True)
class CellMetric:
    """Geometry of the owned cells in the metric of κ. Arrays have one entry per cell.

    Attributes:
        jacobian: Jacobian of the map from the reference cell, shape (cells, dim, dim).
        volume: |T|.
        inverse: κ_h⁻¹, shape (cells, dim, dim).
        diameter: Square root of max (x − y)·κ_h⁻¹(x − y) over T: the diameter of T measured in κ_h⁻¹.
        moment: Mean of (x − x_T)·κ_h⁻¹(x − x_T) over T, x_T the centroid.
        low: The largest number ≤ 1 with κ ≥ low κ_h in the nodes of P2 on T.
        high: The smallest number ≥ 1 with κ ≤ high κ_h there.
        kappa_min: low times the smallest eigenvalue of κ_h.
        rho: On T, κ is within ρ of a polynomial of degree K, infinite if nothing is known; 0 before it is enclosed.
    """

    jacobian: Array
    volume: Array
    inverse: Array
    diameter: Array
    moment: Array
    low: Array
    high: Array
    kappa_min: Array
    rho: Array

    def squares(self, flux: CellFlux) -> Array:
        """∫_T σ·κ_h⁻¹σ of a flux."""
        return flux.squares(self.inverse, self.moment)


def cell_metric(spaces: Spaces, data: Data) -> CellMetric:
    """Measure the owned cells (collective)."""
    mesh = spaces.mesh
    dim = mesh.topology.dim
    number = number_of_cells(mesh)
    jacobian, longest = np.empty((number, dim, dim), order="F"), np.empty(number)
    first, second = np.triu_indices(dim + 1, 1)
    kappa_h = data.matrices(spaces)
    inverse = np.broadcast_to(inverses(kappa_h), (number, dim, dim))
    for some in some_at_a_time(mesh):
        x = corners(mesh, some)
        jacobian[some] = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
        longest[some] = squares_of(x[:, first] - x[:, second], inverse[some]).max(axis=1)
    low, high = _ratios(mesh, data.kappa, inverse)
    return CellMetric(
        jacobian=jacobian,
        volume=np.abs(determinants(jacobian)) / math.factorial(dim),
        inverse=inverse,
        diameter=np.sqrt(longest),
        moment=mean_moments(squared_arms(mesh, inverse)),
        low=low,
        high=high,
        kappa_min=low * np.linalg.eigvalsh(kappa_h)[:, 0],
        rho=np.zeros(number),
    )


def _ratios(mesh: dolfinx.mesh.Mesh, kappa: Datum, inverse: Array) -> tuple[Array, Array]:
    """The extreme eigenvalues of κ_h^-½ κ κ_h^-½ in the nodes of P2 on each cell, and 1 (collective)."""
    low, high = np.ones(len(inverse)), np.ones(len(inverse))
    if kappa.number is not None:
        return low, high
    dim = inverse.shape[1]
    for points in in_cells(mesh, owned_cells(mesh), quadratic_nodes(mesh.basix_cell())):
        values, cells = kappa.values(points), points.cells
        matrices = values if kappa.shape else values[:, :, None, None] * np.eye(dim)
        root = np.linalg.cholesky(inverse[cells])[:, None]
        ratios = np.linalg.eigvalsh(root.transpose(0, 1, 3, 2) @ matrices @ root)
        low[cells] = np.minimum(low[cells], ratios[:, :, 0].min(axis=1))
        high[cells] = np.maximum(high[cells], ratios[:, :, -1].max(axis=1))
    return low, high
