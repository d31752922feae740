"""Geometry of the cells in the metric of κ."""

from __future__ import annotations

import math
from dataclasses import dataclass

import dolfinx.mesh
import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.data import Data
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.points import corners, in_cells, in_vertices, owned_cells, quadratic_nodes
from signorini_fenicsx.discrete.spaces import Spaces


@dataclass(frozen=True)
class CellMetric:
    """Geometry of the owned cells in the metric of κ. Arrays have one entry per cell.

    Attributes:
        jacobian: Jacobian of the map from the reference cell, shape (cells, dim, dim).
        volume: |T|.
        inverse: κ_h⁻¹, shape (cells, dim, dim).
        diameter: Square root of max (x − y)·κ_h⁻¹(x − y) over T: the diameter of T measured in κ_h⁻¹.
        low: The largest number ≤ 1 with κ ≥ low κ_h in the nodes of P2 on T.
        kappa_min: low times the smallest eigenvalue of κ_h.
    """

    jacobian: Array
    volume: Array
    inverse: Array
    diameter: Array
    low: Array
    kappa_min: Array

    def squares(self, sigma: fem.Function, weight: Array | None = None) -> Array:
        """∫_T σ·κ_h⁻¹σ of a flux of RT0, or ∫_T σ·Wσ for one matrix W.

        The integral of the product of two linear functions is |T|/((d + 1)(d + 2)) times the sum of its values in the
        vertices and of the product of their sums.
        """
        values = in_vertices(sigma)[: len(self.volume)]
        both = np.concatenate([values, values.sum(axis=1, keepdims=True)], axis=1)
        weighted = both @ (self.inverse if weight is None else weight)
        corners = values.shape[1]
        found: Array = self.volume / (corners * (corners + 1)) * (weighted * both).sum(axis=(1, 2))
        return found


def cell_metric(spaces: Spaces, data: Data) -> CellMetric:
    """Measure the owned cells (collective)."""
    mesh = spaces.mesh
    dim = mesh.topology.dim
    number = mesh.topology.index_map(dim).size_local
    x = corners(mesh, slice(number))
    jacobian = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
    kappa_h = data.matrices(spaces)
    inverse = np.broadcast_to(np.linalg.inv(kappa_h), (number, dim, dim))
    first, second = np.triu_indices(dim + 1, 1)
    edges = x[:, first] - x[:, second]
    squares = ((edges @ inverse) * edges).sum(axis=2)
    low = _lowest_ratio(mesh, data.kappa, inverse)
    return CellMetric(
        jacobian=jacobian,
        volume=np.abs(np.linalg.det(jacobian)) / math.factorial(dim),
        inverse=inverse,
        diameter=np.sqrt(squares.max(axis=1, initial=0.0)),
        low=low,
        kappa_min=low * np.linalg.eigvalsh(kappa_h)[:, 0],
    )


def _lowest_ratio(mesh: dolfinx.mesh.Mesh, kappa: Datum, inverse: Array) -> Array:
    """The smallest eigenvalue of κ_h^-½ κ κ_h^-½ in the nodes of P2 on each cell, at most 1 (collective)."""
    low = np.ones(len(inverse))
    if kappa.number is not None:
        return low
    dim = inverse.shape[1]
    for points in in_cells(mesh, owned_cells(mesh), quadratic_nodes(mesh.basix_cell())):
        values, cells = kappa.values(points), points.cells
        matrices = values if kappa.shape else values[:, :, None, None] * np.eye(dim)
        root = np.linalg.cholesky(inverse[cells])[:, None]
        ratios = np.linalg.eigvalsh(root.transpose(0, 1, 3, 2) @ matrices @ root)
        low[cells] = np.minimum(low[cells], ratios[:, :, 0].min(axis=1))
    return low
