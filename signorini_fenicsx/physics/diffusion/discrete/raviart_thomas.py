"""RT1 on a reference simplex, and its cells in batches.

Vertices of a cell are in the order of `LinearTraces.order`; facet i is opposite to vertex i, so that no facet needs an
orientation. τ = Fτ̂/|det F|. A flux is quadratic on a cell: it is kept by its values at the vertices and at the
midpoints of the edges.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations, permutations

import basix
import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.discrete.linear_traces import SomeCells, facet_normals, null_space


@dataclass(frozen=True)
class Reference:
    """RT1 on the reference simplex: linear fields and x times linear ones.

    Attributes:
        dim: d.
        basis: Coefficients of the basis in `_spanning`, those of divergence 0 first, then one for each moment of the
            divergence against the hat of a vertex, shape (fields, basis).
        free: Number of those of divergence 0.
        tractions: ⟨φ_a, τ̂n̂⟩ over each facet, φ_a the hat of its vertex a, shape ((d + 1) d, basis).
        mass: (τ̂_i, τ̂'_j) of the components, shape (d, d, basis, basis).
        to_basis: Coefficients of a flux from its values at the nodes, shape (basis, nodes, d).
    """

    dim: int
    basis: Array
    free: int
    tractions: Array

    def values(self, points: Array) -> Array:
        """The basis in points, shape (points, d, basis)."""
        return _spanning(points)[0] @ self.basis

    @cached_property
    def at_nodes(self) -> Array:
        """The basis in the vertices and the midpoints of the edges, shape (nodes, d, basis)."""
        return self.values(nodes(self.dim) @ np.vstack([np.zeros(self.dim), np.eye(self.dim)]))

    @cached_property
    def nodal(self) -> Array:
        """The basis dual to the `tractions`, then fluxes that go through no facet, shape (basis, basis)."""
        inside = np.linalg.svd(self.tractions)[2][len(self.tractions) :]
        return np.linalg.inv(np.vstack([self.tractions, inside]))

    @cached_property
    def to_basis(self) -> Array:
        """See the attributes."""
        number = self.at_nodes.shape[0]
        return np.linalg.pinv(self.at_nodes.reshape(number * self.dim, -1)).reshape(-1, number, self.dim)

    @cached_property
    def mass(self) -> Array:
        """See the attributes."""
        points, weights = basix.make_quadrature(SIMPLEX[self.dim], 4)
        values = self.values(points)
        return np.einsum("q,qib,qjc->ijbc", weights, values, values)

    def permuted(self, points: Array) -> Array:
        """The basis in points whose barycentric coordinates are in each order, see `order_number`.

        Shape (orders, points, d, basis).
        """
        hats = np.column_stack([1 - points.sum(axis=1), points])
        return np.stack([self.values(hats[:, list(order)[1:]]) for order in permutations(range(self.dim + 1))])


@lru_cache
def reference(dim: int) -> Reference:
    """The element in this dimension."""
    points, weights = basix.make_quadrature(SIMPLEX[dim], 4)
    hats = np.column_stack([1 - points.sum(axis=1), points])
    moments = np.einsum("q,qv,qb->vb", weights, hats, _spanning(points)[1])
    balanced = null_space(moments)
    basis = np.hstack([balanced, np.linalg.pinv(moments)])
    basis[np.abs(basis) < 1e-15] = 0.0

    vertices = np.vstack([np.zeros(dim), np.eye(dim)])
    areas = facet_normals(vertices[None])[0]
    on_facet, weights = basix.make_quadrature(SIMPLEX[dim - 1], 4)
    hats = np.column_stack([1 - on_facet.sum(axis=1), on_facet])
    tractions = []
    for facet, area in enumerate(areas):
        values = _spanning(hats @ np.delete(vertices, facet, axis=0))[0] @ basis
        tractions.append(np.einsum("q,qa,qib,i->ab", weights / weights.sum(), hats, values, area))
    return Reference(dim, basis, balanced.shape[1], np.concatenate(tractions))


def _spanning(points: Array) -> tuple[Array, Array]:
    """Fields that span RT1, shape (points, d, fields), and their divergence: e_i, x_j e_i, and x x_j."""
    number, dim = points.shape
    linear = np.column_stack([np.ones(number), points])
    fields = np.zeros((number, dim, dim * (dim + 1) + dim))
    divergence = np.zeros((number, fields.shape[2]))
    for i in range(dim):
        fields[:, i, i * (dim + 1) : (i + 1) * (dim + 1)] = linear
        divergence[:, i * (dim + 1) + 1 + i] = 1.0
    fields[:, :, dim * (dim + 1) :] = points[:, :, None] * points[:, None]
    divergence[:, dim * (dim + 1) :] = (dim + 1) * points
    return fields, divergence


@lru_cache
def nodes(dim: int) -> Array:
    """Barycentric coordinates of the vertices and then of the midpoints of the edges, shape (nodes, d + 1)."""
    unit = np.eye(dim + 1)
    return np.vstack([unit, *((unit[i] + unit[j]) / 2 for i, j in combinations(range(dim + 1), 2))])


def order_number(order: Indices) -> Indices:
    """The number of each order of the vertices, shape (cells, d + 1), among all orders."""
    size = order.shape[1]
    digits = (size ** np.arange(size))[::-1]
    all_orders = np.array(list(permutations(range(size)))) @ digits  # ascending
    return np.searchsorted(all_orders, order @ digits)


@dataclass(frozen=True)
class Cells(SomeCells):
    """Some cells by their vertices, see `SomeCells`."""

    @cached_property
    def map(self) -> Array:
        """F/|det F|, shape (cells, d, d)."""
        return self.derivative / self.determinant[:, None, None]

    def product(self, inverse: Array) -> Array:
        """(κ⁻¹τ, τ') for all pairs of the basis, shape (cells, basis, basis).

        Args:
            inverse: κ⁻¹ of each cell, shape (cells, d, d).
        """
        pulled = self.determinant[:, None, None] * self.map.transpose(0, 2, 1) @ inverse @ self.map
        mass = reference(self.dim).mass
        return np.tensordot(pulled, mass, ((1, 2), (0, 1)))

    def product_in_points(self, inverse: Array, values: Array, weights: Array) -> Array:
        """(κ⁻¹τ, τ') by quadrature, as `product`.

        Args:
            inverse: κ⁻¹ in points, shape (cells, points, d, d).
            values: The basis on the reference cell in these points, shape (cells, points, d, basis).
            weights: Of the points on the reference cell.
        """
        scale = self.determinant[:, None] * weights
        pulled = self.map.transpose(0, 2, 1)[:, None] @ (scale[:, :, None, None] * inverse) @ self.map[:, None]
        rows = len(values), values.shape[1] * self.dim, values.shape[3]
        return values.reshape(rows).transpose(0, 2, 1) @ (pulled @ values).reshape(rows)

    def at_nodes(self, coefficients: Array) -> Array:
        """The values at the nodes of fluxes by their coefficients, shape (cells, nodes, d)."""
        on_reference = np.tensordot(coefficients, reference(self.dim).at_nodes, (1, 2))
        return on_reference @ self.map.transpose(0, 2, 1)

    def coefficients(self, values: Array) -> Array:
        """The coefficients of fluxes by their values at the nodes, shape (cells, basis)."""
        pulled = values @ np.linalg.inv(self.map).transpose(0, 2, 1)
        return np.tensordot(pulled, reference(self.dim).to_basis, ((1, 2), (1, 2)))

    def hat_masses(self, weight: Array | float = 1.0) -> Array:
        """∫ φ_v φ_w of the hats times a weight per cell, shape (cells, d + 1, d + 1)."""
        size = self.dim + 1
        mass: Array = (np.eye(size) + 1) / (size * (size + 1))
        return (self.measure * weight)[:, None, None] * mass
