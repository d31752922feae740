"""A flux of RT1 cell by cell, by its values at the vertices and the midpoints of the edges."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations
from math import factorial

import basix
import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.discrete.points import Points
from signorini_fenicsx.discrete.simplices import Simplices, facet_normals, opposite
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import Weight
from signorini_fenicsx.physics.diffusion.discrete.linear_spaces import LinearSpaces


def quadratic_functions(hats: Array) -> Array:
    """The P2 functions of the vertices and then of the edges from barycentric coordinates, shape (…, d + 1)."""
    edges = [4 * hats[..., i] * hats[..., j] for i, j in combinations(range(hats.shape[-1]), 2)]
    return np.concatenate([hats * (2 * hats - 1), np.stack(edges, axis=-1)], axis=-1)


@lru_cache
def _mass(dim: int) -> Array:
    """Means of products of these functions over a simplex."""
    points, weights = basix.make_quadrature(SIMPLEX[dim], 4)
    functions = quadratic_functions(np.column_stack([1 - points.sum(axis=1), points]))
    return np.asarray(np.einsum("q,qa,qb->ab", weights, functions, functions) * factorial(dim))


@dataclass(frozen=True)
class QuadraticFlux:
    """A flux of RT1 on the owned cells.

    Attributes:
        spaces: The spaces.
        values: σ at the nodes, see `raviart_thomas.nodes`, shape (cells, nodes, d).
    """

    spaces: LinearSpaces
    values: Array

    @property
    def centroid(self) -> Array:
        """σ at the centroids, shape (cells, d)."""
        middle = np.full(self.spaces.dim + 1, 1 / (self.spaces.dim + 1))
        return np.asarray(np.einsum("v,nvi->ni", quadratic_functions(middle), self.values))

    @cached_property
    def divergences(self) -> Array:
        """∇·σ at the vertices, shape (cells, d + 1), of a linear function."""
        size = self.spaces.dim + 1
        slopes = np.zeros((size, self.values.shape[1], size))  # of the functions at vertices by λ
        for v in range(size):
            slopes[v, :size] = np.diag(4 * np.eye(size)[v] - 1)
            for edge, (i, j) in enumerate(combinations(range(size), 2)):
                slopes[v, size + edge, i], slopes[v, size + edge, j] = 4.0 * (v == j), 4.0 * (v == i)
        return np.einsum("nai,nki,vak->nv", self.values, self._hat_gradients, slopes, optimize=True)

    @cached_property
    def _hat_gradients(self) -> Array:
        """Gradients of the hats of the vertices, shape (cells, d + 1, d)."""
        inverse = np.linalg.inv(Simplices(self.spaces.vertices).derivative)
        return np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)

    @property
    def divergence(self) -> Array:
        """The mean of ∇·σ on each cell."""
        return np.asarray(self.divergences.mean(axis=1))

    def in_vertices(self) -> Array:
        """σ in the vertices of the cells, in the order of `LinearTraces.order`, shape (cells, d + 1, d)."""
        return self.values[:, : self.spaces.dim + 1]

    def at(self, points: Points) -> Array:
        """σ in points, shape (n, points, d)."""
        hats = np.take_along_axis(points.barycentric, self.spaces.order[points.cells][:, None], axis=2)
        return np.asarray(quadratic_functions(hats) @ self.values[points.cells])

    def divergence_at(self, points: Points) -> Array:
        """∇·σ in points, shape (n, points)."""
        hats = np.take_along_axis(points.barycentric, self.spaces.order[points.cells][:, None], axis=2)
        return np.asarray(np.einsum("nqv,nv->nq", hats, self.divergences[points.cells]))

    @property
    def leaving(self) -> Array:
        """∫ σ·n over each facet of each cell, n pointing outwards, in DOLFINx's order, shape (cells, d + 1)."""
        spaces, leaving = self.spaces, np.empty(self.spaces.order.shape)
        means = self.values[:, opposite(spaces.dim)].mean(axis=2)
        through = np.einsum("nsj,nsj->ns", means, facet_normals(spaces.vertices))
        np.put_along_axis(leaving, spaces.order, through, axis=1)
        return leaving

    def squares(self, weight: Weight) -> Array:
        """(Bσ, σ)_T of each cell."""
        image = weight * self.values if isinstance(weight, float) else self.values @ np.swapaxes(weight, -1, -2)
        products = np.einsum("nai,nbi,ab->n", image, self.values, _mass(self.spaces.dim), optimize=True)
        return np.asarray(self.spaces.cell_measures * products)
