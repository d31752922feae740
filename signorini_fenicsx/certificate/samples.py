"""Values of data in points of cells and boundary facets, and the geometry of these, as NumPy arrays."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import basix
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from dolfinx import fem
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.data import Data, is_constant

AT_ONCE = 20_000
"""Number of cells whose values are in memory at the same time."""


def corners(mesh: dolfinx.mesh.Mesh) -> Array:
    """Vertices of the cells of this rank, shape (cells, dim + 1, dim)."""
    return mesh.geometry.x[mesh.geometry.dofmaps[0], : mesh.topology.dim]


def quadratic_nodes(cell: basix.CellType) -> Array:
    """The vertices of the reference cell or facet, then the midpoints of its edges."""
    return basix.create_element(basix.ElementFamily.P, cell, 2, basix.LagrangeVariant.gll_warped).points


def cell_values(mesh: dolfinx.mesh.Mesh, value: Expr, points: Array) -> Iterator[tuple[slice, Array]]:
    """Values in reference points of the cells of this rank, some cells at a time (collective).

    Yields:
        A slice of cells, and their values, shape (cells, points, *shape of the value).
    """
    number = mesh.topology.index_map(mesh.topology.dim).size_local
    expression = fem.Expression(_on_mesh(mesh, value), points)
    for first in range(0, number, AT_ONCE):
        cells = np.arange(first, min(first + AT_ONCE, number), dtype=np.int32)
        values = np.asarray(expression.eval(mesh, cells), dtype=np.float64)
        yield slice(first, first + len(cells)), values.reshape(len(cells), len(points), *value.ufl_shape)


def _on_mesh(mesh: dolfinx.mesh.Mesh, value: Expr) -> Expr:
    """The same value; a plain number, which has no mesh, becomes an expression on this mesh."""
    return fem.Constant(mesh, 1.0) * value


@dataclass(frozen=True)
class FacetPoints:
    """The same points in some boundary facets of this rank, which lie in owned cells.

    Attributes:
        mesh: The mesh.
        facets: Mesh facets.
        cells: The cell behind each facet.
        local: Index of each facet in this cell.
        points: Points in the reference facet, shape (points, dim − 1).
        weights: Weights of the quadrature on the reference facet; empty for other points.
    """

    mesh: dolfinx.mesh.Mesh
    facets: npt.NDArray[np.int32]
    cells: npt.NDArray[np.int32]
    local: npt.NDArray[np.int32]
    points: Array
    weights: Array

    def values(self, value: Expr) -> Array:
        """Values in the points, shape (facets, points) (collective).

        They are evaluated as points of cells, because DOLFINx's own points of a facet depend on its vertex numbers.
        """
        shape = (len(self.facets), len(self.points))
        if is_constant(value):
            return np.full(shape, float(value))
        cell = self.mesh.basix_cell()
        reference = [basix.geometry(cell)[vertices] for vertices in basix.topology(cell)[-2]]
        in_cell = np.stack([x[0] + self.points @ (x[1:] - x[0]) for x in reference])
        expression = fem.Expression(_on_mesh(self.mesh, value), in_cell.reshape(-1, in_cell.shape[2]))
        if len(self.facets) == 0:
            return np.empty(shape)
        values = np.asarray(expression.eval(self.mesh, self.cells), dtype=np.float64)
        return values.reshape(len(self.facets), len(reference), -1)[np.arange(len(self.facets)), self.local]

    def among(self, cells: npt.NDArray[np.bool_]) -> FacetPoints:
        """The facets of some of the cells; `cells` is a mask."""
        chosen = cells[self.cells]
        return replace(self, facets=self.facets[chosen], cells=self.cells[chosen], local=self.local[chosen])

    @cached_property
    def vertices(self) -> Array:
        """Vertices of each facet, in the order of the reference facet, shape (facets, dim, dim)."""
        local = np.array(basix.topology(self.mesh.basix_cell())[-2])[self.local]
        return np.take_along_axis(corners(self.mesh)[self.cells], local[:, :, None], axis=1)

    @cached_property
    def scale(self) -> Array:
        """|e| divided by the measure of the reference facet, per facet."""
        edges = self.vertices[:, 1:] - self.vertices[:, :1]
        return np.sqrt(np.linalg.det(edges @ edges.transpose(0, 2, 1)))

    def integrals(self, values: Array) -> Array:
        """Integrals per facet of values of shape (facets, points)."""
        return self.scale * (values @ self.weights)

    def per_cell(self, values: Array, number: int) -> Array:
        """Sums of values per facet over the facets of each owned cell; `number` is that of the cells."""
        return np.bincount(self.cells, values, number)[:number]


def facet_type(dim: int) -> basix.CellType:
    """The reference facet of a simplex."""
    return basix.CellType.interval if dim == 2 else basix.CellType.triangle


def facet_quadrature(mesh: dolfinx.mesh.Mesh, facets: npt.NDArray[np.int32], degree: int) -> FacetPoints:
    """The points of a quadrature in these facets (collective)."""
    return _facet_points(mesh, facets, *basix.make_quadrature(facet_type(mesh.topology.dim), degree))


def facet_lattice(mesh: dolfinx.mesh.Mesh, facets: npt.NDArray[np.int32], parts: int) -> FacetPoints:
    """A grid in these facets whose edges are cut into equal parts (collective)."""
    points = basix.create_lattice(facet_type(mesh.topology.dim), parts, basix.LatticeType.equispaced, True)
    return _facet_points(mesh, facets, points, np.empty(0))


def _facet_points(mesh: dolfinx.mesh.Mesh, facets: npt.NDArray[np.int32], points: Array, weights: Array) -> FacetPoints:
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    mesh.topology.create_connectivity(dim, dim - 1)
    facet_cells = mesh.topology.connectivity(dim - 1, dim)
    cells = facet_cells.array[facet_cells.offsets[facets]]
    cell_facets = mesh.topology.connectivity(dim, dim - 1).array.reshape(-1, dim + 1)[cells]
    local = np.argmax(cell_facets == facets[:, None], axis=1).astype(np.int32)
    return FacetPoints(mesh, facets, cells, local, points, weights)


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


def cell_metric(mesh: dolfinx.mesh.Mesh, data: Data) -> CellMetric:
    """Measure the owned cells (collective)."""
    dim = mesh.topology.dim
    number = mesh.topology.index_map(dim).size_local
    x = corners(mesh)[:number]
    jacobian = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
    kappa_h = _matrices(data.kappa_h, number, dim)
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


def _matrices(kappa_h: Expr, number: int, dim: int) -> Array:
    """κ_h as matrices, shape (cells, dim, dim), or (1, dim, dim) if it is a number."""
    if is_constant(kappa_h):
        return float(kappa_h) * np.eye(dim)[None]
    entries = kappa_h.x.array.reshape(-1, *(kappa_h.ufl_shape or (1, 1)))[:number]
    return entries if kappa_h.ufl_shape else entries * np.eye(dim)


def _lowest_ratio(mesh: dolfinx.mesh.Mesh, kappa: Expr, inverse: Array) -> Array:
    """The smallest eigenvalue of κ_h^-½ κ κ_h^-½ in the nodes of P2 on each cell, at most 1 (collective)."""
    low = np.ones(len(inverse))
    if is_constant(kappa):
        return low
    dim = inverse.shape[1]
    for cells, values in cell_values(mesh, kappa, quadratic_nodes(mesh.basix_cell())):
        matrices = values if kappa.ufl_shape else values[:, :, None, None] * np.eye(dim)
        root = np.linalg.cholesky(inverse[cells])[:, None]
        ratios = np.linalg.eigvalsh(root.transpose(0, 1, 3, 2) @ matrices @ root)
        low[cells] = np.minimum(low[cells], ratios[:, :, 0].min(axis=1))
    return low
