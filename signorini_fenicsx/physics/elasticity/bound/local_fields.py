"""Stresses on single cells that balance what σ_h leaves of the loads there, and act on nothing outside of the cell.

On each cell T let z be symmetric, cubic on each subcell, with zn continuous in T, −∇·z = l in T and zn = r on ∂T. There
is one for all l that are quadratic on each subcell and all cubic r whose forces and moments balance. Then (l, w)_T +
⟨r, w⟩_∂T = (z, ε(w))_T ≤ ‖z‖_T |w|_T for all displacements w, where ‖·‖ and |·| are the norms of the energy. The z of
least norm is the sharpest such bound that one can compute on T alone; in flat cells it is far below one by constants.

The map from the reference simplex is that of σ_h, see `forms/elasticity.py`: z = Fẑ Fᵀ/|det F| has ∇·z = F ∇·ẑ/|det F|
and zn |e| = F ẑn̂ |ê|.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import basix
import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.discrete.lattices import lagrange, lagrange_slopes, lattice
from signorini_fenicsx.discrete.linear_traces import facet_normals, null_space
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import (
    Cells,
    entries,
    normal_of,
    split_vertices,
    symmetric,
    to_entries,
)
from signorini_fenicsx.physics.elasticity.discrete.material import regular

INSIDE, ON_FACETS = 2, 3
"""Degrees of l and of r; z has the degree of r."""
SINGULAR = 1e-14
"""Share of its diagonal that is added to the matrix of the z without loads; any z bounds, this one is near the best."""


@dataclass(frozen=True)
class LocalStresses:
    """The stresses on the split reference simplex, by their values in quadrature points of the subcells.

    Attributes:
        balancing: For each value of a load one stress, shape (subcells, points, d, d, values): l in the points of the
            lattice of each subcell, then r in those of each facet, both with d entries.
        free: A basis of those without loads, shape (subcells, points, d, d, basis).
        weights: Of the points in a subcell, their sum is 1.
    """

    balancing: Array
    free: Array
    weights: Array

    def least_norms(self, cells: Cells, inside: Array, on_facets: Array, compliance: Array) -> Array:
        """The least ‖z‖_T of cells, or a bit more, shape (cells,).

        Args:
            cells: The cells.
            inside: l in the lattices of the subcells, shape (cells, d + 1, points, d).
            on_facets: r in the lattices of the facets, shape (cells, d + 1, points, d).
            compliance: 𝔸 of each cell, at least that in all of its points, shape (cells, entries, entries).
        """
        F, normals = cells.derivative[:, None, None], _reference_normals(cells.dim)
        scale = np.linalg.norm(facet_normals(cells.vertices), axis=2) / np.linalg.norm(normals, axis=1)
        pulled = scale[:, :, None, None] * np.linalg.solve(F, on_facets[..., None])[..., 0]
        loads = -cells.determinant[:, None, None, None] * np.linalg.solve(F, inside[..., None])[..., 0]
        values = np.concatenate([loads.reshape(len(F), -1), pulled.reshape(len(F), -1)], axis=1)
        balancing = np.einsum("sqijb,nb->nsqij", self.balancing, values, optimize=True)[..., None]
        z = self._weighted(cells, balancing, compliance)[:, :, 0]
        free = self._weighted(cells, np.broadcast_to(self.free, (len(F), *self.free.shape)), compliance)
        products = free.swapaxes(1, 2) @ free
        products += SINGULAR * np.einsum("nbb->n", products)[:, None, None] * np.eye(free.shape[2])
        shares = np.linalg.solve(products, free.swapaxes(1, 2) @ z[:, :, None])
        return np.linalg.norm(z - (free @ shares)[:, :, 0], axis=1)

    def _weighted(self, cells: Cells, stresses: Array, compliance: Array) -> Array:
        """𝔸^½ times stresses times the square root of the weights, one row per number: (cells, rows, basis)."""
        dim, F = cells.dim, cells.derivative / np.sqrt(cells.determinant)[:, None, None]
        mapped = np.einsum("nik,nsqklb,njl->nsqijb", F, stresses, F, optimize=True)
        size = np.sqrt(cells.measure[:, None] / (dim + 1) * self.weights)
        root = np.linalg.cholesky(regular(compliance)).swapaxes(1, 2)
        values = to_entries(np.moveaxis(mapped, -1, -3)).swapaxes(-1, -2)
        weighted: Array = root[:, None, None] @ values * size[:, None, :, None, None]
        return weighted.reshape(len(F), -1, stresses.shape[-1])


@lru_cache
def local_stresses(dim: int) -> LocalStresses:
    """The stresses in this dimension."""
    size, places = dim + 1, lattice(dim + 1, ON_FACETS)
    vertices, normals = np.vstack([np.zeros(dim), np.eye(dim)]), _reference_normals(dim)
    split = split_vertices(vertices[None])[0]
    points = np.einsum("na,sai->sni", places / ON_FACETS, split)
    number = size * len(places) * len(entries(dim))
    unit = symmetric(np.eye(number).reshape(size, len(places), -1, number), dim)  # subcell, point, row, column, basis

    jumps = []
    for i, j in combinations(range(size), 2):
        normal = normal_of(np.vstack([vertices[[k for k in range(size) if k not in (i, j)]], split[0, -1]]))
        same = np.square(points[i][:, None] - points[j]).sum(axis=2) < 1e-20
        for m, n in zip(*np.nonzero(same), strict=True):
            jumps.append(np.einsum("rcb,c->rb", unit[i, m] - unit[j, n], normal))
    continuous = null_space(np.concatenate(jumps))

    slopes = lagrange_slopes(lattice(size, INSIDE) / INSIDE, ON_FACETS)
    hats = np.linalg.inv(np.concatenate([split, np.ones((size, size, 1))], axis=2)).swapaxes(1, 2)[:, :, :dim]
    loads = [np.einsum("vna,ai,nrib->vrb", slopes, hats[s], unit[s]).reshape(-1, number) for s in range(size)]
    outer = places[:, -1] == 0
    for s, n in enumerate(normals / np.linalg.norm(normals, axis=1)[:, None]):
        loads.append(np.einsum("nrcb,c->nrb", unit[s][outer], n).reshape(-1, number))
    acting = np.concatenate(loads) @ continuous

    inner, weights = basix.make_quadrature(SIMPLEX[dim], 2 * ON_FACETS)
    tabulated = lagrange(np.column_stack([1 - inner.sum(axis=1), inner]), ON_FACETS)
    balancing, free = (
        np.einsum("qn,snijb,bk->sqijk", tabulated, unit, continuous @ chosen, optimize=True)
        for chosen in (np.linalg.pinv(acting, rcond=1e-10), null_space(acting))
    )
    return LocalStresses(balancing, free, weights / weights.sum())


def _reference_normals(dim: int) -> Array:
    """|ê| n̂ of the facets of the reference simplex."""
    return facet_normals(np.vstack([np.zeros(dim), np.eye(dim)])[None])[0]
