"""The Johnson-Mercier element on a reference simplex, and its cells in batches; see `forms/elasticity.py`.

Vertices of a cell are in the order of their global numbers, on any rank; facet i is opposite to vertex i and its
vertices are in the same order, so that no facet needs an orientation. Subcell i has the vertices of facet i and, as its
last one, the centroid. A stress has values at the vertices of each subcell: shape (cells, subcells, vertices,
entries), d + 1 subcells with d + 1 vertices each. Entries of a symmetric matrix are weighted by √2 off the diagonal, so
that inner products of matrices are those of their entries.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations
from math import factorial

import basix
import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.discrete.linear_traces import SomeCells, facet_normals, null_space, opposite
from signorini_fenicsx.forms.elasticity import pairs as entries


@dataclass(frozen=True)
class Reference:
    """Functions on the reference cell, which all cells share.

    Attributes:
        stresses: Values of the basis, those of divergence zero first, then one for each moment of the divergence
            against a hat function of a vertex and a component: shape ((d + 1)², entries, basis).
        free: Number of stresses of divergence zero.
        tractions: ⟨φ_a e_r, τ̂n̂⟩ over each facet, φ_a the hat of its vertex a: shape ((d + 1) d², basis).
    """

    stresses: Array
    free: int
    tractions: Array


@lru_cache
def reference(dim: int) -> Reference:
    """The element in this dimension."""
    vertices = np.vstack([np.zeros(dim), np.eye(dim)])
    normals = facet_normals(vertices[None])[0]
    split = split_vertices(vertices[None])[0]
    size, pairs = dim + 1, entries(dim)
    unit = np.eye(size * size * len(pairs)).reshape(size, size, len(pairs), -1)
    matrices = symmetric(unit, dim)  # subcell, vertex, row, column, basis

    jumps = []
    for i, j in combinations(range(size), 2):
        edge = [k for k in range(size) if k not in (i, j)]
        normal = normal_of(np.vstack([vertices[edge], split[0, -1]]))
        for k in edge:
            jumps.append(np.einsum("rcb,c->rb", matrices[i, _of(i, k)] - matrices[j, _of(j, k)], normal))
        jumps.append(np.einsum("rcb,c->rb", matrices[i, -1] - matrices[j, -1], normal))
    continuous = null_space(np.concatenate(jumps))

    volume = 1 / factorial(dim) / size
    gradients = -facet_normals(split) / (dim * volume)  # of the hats of each subcell; barycentric
    divergence = np.einsum("svrcb,svc->srb", matrices, gradients)
    moments = np.einsum("vs,srb->vrb", volume * hats_in_subcells(dim), divergence).reshape(size * dim, -1) @ continuous
    balanced = null_space(moments)
    basis = continuous @ np.hstack([balanced, np.linalg.pinv(moments)])
    basis[np.abs(basis) < 1e-15] = 0.0

    mass = (1 + np.eye(dim)) / (dim * (dim + 1))
    pulls = np.einsum("svrcb,sc->svrb", matrices[:, :dim], normals)  # outer vertices are the first ones of a subcell
    tractions = np.einsum("av,svrb->sarb", mass, pulls).reshape(size * dim * dim, -1) @ basis
    return Reference(basis.reshape(size * size, len(pairs), -1), balanced.shape[1], tractions)


def to_matrices(values: Array) -> Array:
    """Symmetric matrices, shape (…, d, d), from their entries, shape (…, entries)."""
    dim = {3: 2, 6: 3}[values.shape[-1]]
    return np.moveaxis(symmetric(values[..., None], dim)[..., 0], (-2, -1), (-2, -1))


def to_entries(matrices: Array) -> Array:
    """What the inner product with matrices is for the entries of symmetric ones, shape (…, entries)."""
    sums = (matrices + matrices.swapaxes(-1, -2)) / 2
    weights = [1 if i == j else np.sqrt(2) for i, j in entries(matrices.shape[-1])]
    rows, columns = zip(*entries(matrices.shape[-1]), strict=True)
    return np.array(weights) * sums[..., list(rows), list(columns)]


def symmetric(values: Array, dim: int) -> Array:
    """Symmetric matrices, shape (…, d, d, basis), from their entries, shape (…, entries, basis)."""
    matrices = np.zeros((*values.shape[:-2], dim, dim, values.shape[-1]))
    for index, (i, j) in enumerate(entries(dim)):
        value = values[..., index, :] / (1 if i == j else np.sqrt(2))
        matrices[..., i, j, :] = matrices[..., j, i, :] = value
    return matrices


def hats_in_subcells(dim: int) -> Array:
    """Means over the subcells of the hat functions of the vertices of a cell, shape (d + 1, d + 1)."""
    size = dim + 1
    return np.full((size, size), 1 / size) + 1 / size**2 - np.eye(size) / size


def split_vertices(vertices: Array) -> Array:
    """Vertices of the subcells, shape (cells, d + 1, d + 1, d), of cells with these vertices."""
    size = vertices.shape[1]
    centroid = np.broadcast_to(vertices.mean(axis=1)[:, None, None], (len(vertices), size, 1, vertices.shape[2]))
    return np.concatenate([vertices[:, opposite(size - 1)], centroid], axis=2)


def normal_of(simplex: Array) -> Array:
    """A normal of d points in R^d."""
    return null_space(simplex[1:] - simplex[:1])[:, 0]


def _of(subcell: int, vertex: int) -> int:
    """The place of a vertex of the cell among those of a subcell."""
    return vertex - (vertex > subcell)


@dataclass(frozen=True)
class SplitQuadrature:
    """Points in the subcells of the reference simplex.

    Attributes:
        points: Shape ((d + 1) q, d), by subcell.
        hats: The hats of the cell's vertices in the points of each subcell, shape (d + 1, q, d + 1).
        local: The hats of a subcell's own vertices in its points, shape (q, d + 1).
        weights: Of the q points of a subcell, their sum is 1.
        degree: Up to which it is exact on each subcell.
    """

    points: Array
    hats: Array
    local: Array
    weights: Array
    degree: int

    @classmethod
    def of_degree(cls, dim: int, degree: int) -> "SplitQuadrature":
        """Exact for polynomials of this degree on each subcell."""
        points, weights = basix.make_quadrature(SIMPLEX[dim], degree)
        local = np.column_stack([1 - points.sum(axis=1), points])
        vertices = np.vstack([np.zeros(dim), np.eye(dim)])
        inside = np.einsum("qv,svx->sqx", local, split_vertices(vertices[None])[0])
        hats = np.concatenate([1 - inside.sum(axis=2, keepdims=True), inside], axis=2)
        return cls(inside.reshape(-1, dim), hats, local, weights / weights.sum(), degree)


@dataclass(frozen=True)
class Cells(SomeCells):
    """Some cells by their vertices, see `SomeCells`."""

    @property
    def hat_gradients(self) -> Array:
        """Gradients of the hats of each subcell, times its measure, shape (cells, d + 1, d + 1, d)."""
        shapes = self.vertices - self.vertices[:, :1]  # the means of coordinates far from 0 would be rounded
        normals = facet_normals(split_vertices(shapes).reshape(-1, self.dim + 1, self.dim))
        return -normals.reshape(len(shapes), self.dim + 1, self.dim + 1, self.dim) / self.dim

    @cached_property
    def mapped(self) -> Array:
        """The entries of Fτ̂Fᵀ/|det F| from those of τ̂, shape (cells, entries, entries)."""
        dim, pairs = self.dim, entries(self.dim)
        scaled = self.derivative / np.sqrt(self.determinant)[:, None, None]
        matrices = np.einsum("nij,jkb,nlk->nilb", scaled, symmetric(np.eye(len(pairs)), dim), scaled, optimize=True)
        weights = [1 if i == j else np.sqrt(2) for i, j in pairs]
        return np.stack([w * matrices[:, i, j] for w, (i, j) in zip(weights, pairs, strict=True)], axis=1)

    def stresses(self, basis: Array) -> Array:
        """τ = Fτ̂Fᵀ/|det F| of stresses on the reference simplex, shape (cells, (d + 1)², entries, basis)."""
        return self.mapped[:, None] @ basis

    def tractions(self, basis: Array) -> Array:
        """⟨φ_a e_r, τn⟩ = F ⟨φ_a, τ̂n̂⟩, shape (cells, (d + 1) d², basis), from those on the reference simplex."""
        dim = self.dim
        rows = basis.reshape(-1, dim, basis.shape[-1])
        mapped = np.einsum("nij,fjb->nfib", self.derivative, rows, optimize=True)
        return mapped.reshape(len(self.vertices), *basis.shape)


def compliance_product(stresses: Array, masses: Array) -> Array:
    """(𝔸τ, τ') for all pairs of stresses of each cell, shape (cells, basis, basis).

    Args:
        stresses: Shape (cells, (d + 1)², entries, basis).
        masses: 𝔸 times φ_a φ_b over each subcell, shape (cells, d + 1, (d + 1) entries, (d + 1) entries).
    """
    number, size, basis = *masses.shape[:2], stresses.shape[-1]
    weighted = masses @ stresses.reshape(number, size, -1, basis)
    return stresses.reshape(number, -1, basis).transpose(0, 2, 1) @ weighted.reshape(number, -1, basis)
