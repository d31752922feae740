"""Nodes of a conforming displacement on the boundary: where it is given, and where it must not pass the foundation.

On each facet of Γ_D, Γ_C and of parts that are fixed in some components, a quadratic displacement has coefficients in
Bernstein's basis, for the vertices and the edges of the facet. As a quadratic is a mean of its coefficients, v_n ≤ g on
a facet if the coefficients are in that relation.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import basix
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from dolfinx import fem, la

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.elastic_data import ElasticData
from signorini_fenicsx.discrete.elastic_problem import NORMAL
from signorini_fenicsx.discrete.elastic_spaces import BoundaryFacets, ElasticSpaces
from signorini_fenicsx.discrete.johnson_mercier import SIMPLEX
from signorini_fenicsx.discrete.nodes import extreme_around
from signorini_fenicsx.discrete.points import from_within, in_facets
from signorini_fenicsx.discrete.vector_datum import VectorDatum

ALONG = 1e-8
"""A direction is given at a node if it is within this angle of those that are."""


@dataclass(frozen=True)
class BoundaryNodes:
    """The nodes of this rank, ghosts too, each with an orthonormal frame; inner nodes have that of the coordinates.

    Attributes:
        frames: Directions, a column each, shape (nodes, d, d): those in which v is given, then the free part of n.
        given: How many directions are given.
        values: v in these, and 0 in the others, shape (nodes, d).
        touching: Whether the node is on Γ_C with n not given.
        bound: On these the bound for the coefficient in the direction behind the given ones.
    """

    frames: Array
    given: Indices
    values: Array
    touching: Mask
    bound: Array


@dataclass(frozen=True)
class FacetCoefficients:
    """Facets and the nodes of a quadratic displacement on each.

    Attributes:
        facets: The facets.
        nodes: Shape (facets, coefficients).
    """

    facets: BoundaryFacets
    nodes: npt.NDArray[np.int32]

    def of(self, mesh: dolfinx.mesh.Mesh, datum: Datum | VectorDatum) -> Array:
        """Bernstein coefficients of the quadratics that interpolate at vertices and midpoints (collective).

        What is not a polynomial may jump where a punch ends, so the values are limits from inside the facets.
        """
        dim = self.facets.vertices.shape[2]
        pairs = list(combinations(range(dim), 2))
        corners = np.vstack([np.zeros(dim - 1), np.eye(dim - 1)])
        points = np.vstack([corners, [(corners[i] + corners[j]) / 2 for i, j in pairs]])
        at = in_facets(mesh, self.facets.facets, points)
        values = from_within(datum.values, at) if datum.polynomial is None else datum.values(at)
        middle = np.zeros((dim, dim), dtype=np.int64)
        for index, (i, j) in enumerate(pairs):
            middle[i, j] = middle[j, i] = dim + index
        order = self.facets.ranking
        where = np.column_stack([order, *[middle[order[:, i], order[:, j]] for i, j in pairs]])
        found = np.take_along_axis(values, where.reshape(*where.shape, *[1] * (values.ndim - 2)), axis=1)
        for index, (i, j) in enumerate(pairs):
            found[:, dim + index] = 2 * found[:, dim + index] - (found[:, i] + found[:, j]) / 2
        return found


def facet_coefficients(spaces: ElasticSpaces, space: fem.FunctionSpace, facets: BoundaryFacets) -> FacetCoefficients:
    """The nodes on facets, at vertices and then edges, in a space of quadratics on the split mesh."""
    dim = spaces.dim
    edges = [tuple(sorted(edge)) for edge in basix.topology(SIMPLEX[dim])[1]]
    local = [*range(dim), *(dim + 1 + edges.index(pair) for pair in combinations(range(dim), 2))]
    return FacetCoefficients(facets, space.dofmap.list[spaces.split_cells(facets)][:, local])


def boundary_nodes(spaces: ElasticSpaces, data: ElasticData, space: fem.FunctionSpace) -> BoundaryNodes:
    """Collect what is given at the nodes from the facets of all ranks (collective)."""
    dim, index_map = spaces.dim, space.dofmap.index_map
    # sums over facets: of d dᵀ and (d·u_D)d for given directions d; of n on Γ_C
    products, pulls, normals = la.vector(index_map, dim**2), la.vector(index_map, dim), la.vector(index_map, dim)
    for facets, k, letter in spaces.fixed:
        there = facet_coefficients(spaces, space, facets)
        axis = np.broadcast_to(np.eye(dim)[k], facets.normals.shape)
        directions = (facets.normals if letter == NORMAL else axis)[:, None]
        along = np.einsum("nai,nbi->na", there.of(spaces.mesh, data.u_D), directions)
        _add(products, there.nodes, np.einsum("nbi,nbj->nbij", directions, directions))
        _add(pulls, there.nodes, along[:, :, None] * directions)
    contact = facet_coefficients(spaces, space, spaces.contact)
    _add(normals, contact.nodes, spaces.contact.normals[:, None])
    gap = extreme_around(space, contact.nodes * dim, contact.of(spaces.mesh, data.gap), largest=False)[::dim]
    for sums in (products, pulls, normals):
        sums.scatter_reverse(la.InsertMode.add)
        sums.scatter_forward()
    on_contact = np.isfinite(gap)
    normal = normals.array.reshape(-1, dim).copy()
    normal[on_contact] /= np.linalg.norm(normal[on_contact], axis=1, keepdims=True)
    return _framed(products.array.reshape(-1, dim, dim), pulls.array.reshape(-1, dim), normal, gap, on_contact)


def _framed(products: Array, pulls: Array, normal: Array, gap: Array, on_contact: Mask) -> BoundaryNodes:
    number, dim = normal.shape
    sizes, vectors = np.linalg.eigh(products)
    fixed = sizes > ALONG
    inverse = np.where(fixed, 1 / np.where(fixed, sizes, 1.0), 0.0)
    at = np.einsum("nik,nk,njk,nj->ni", vectors, inverse, vectors, pulls)  # v as far as it is given
    given = fixed.sum(axis=1)
    free = normal - np.einsum("nik,nk,njk,nj->ni", vectors, fixed, vectors, normal)
    length = np.linalg.norm(free, axis=1)
    touching = on_contact & (length > ALONG)
    frames = np.broadcast_to(np.eye(dim), (number, dim, dim)).copy()
    special = np.flatnonzero((given > 0) | touching)
    for count in range(dim + 1):
        chosen = special[given[special] == count]
        if len(chosen) == 0:
            continue
        columns = [vectors[chosen][:, :, dim - count :], free[chosen][:, :, None], frames[chosen]]
        q, r = np.linalg.qr(np.concatenate(columns, axis=2))
        signs = np.sign(np.einsum("nkk->nk", r[:, :, :dim]))
        frames[chosen] = q * np.where(signs == 0, 1, signs)[:, None]
    values = np.einsum("nij,ni->nj", frames, at) * (np.arange(dim) < given[:, None])
    bound = np.where(touching, gap - np.einsum("ni,ni->n", normal, at), 0.0) / np.where(touching, length, 1.0)
    return BoundaryNodes(frames, given, values, touching, bound)


def _add(sums: la.Vector, nodes: npt.NDArray[np.int32], values: Array) -> None:
    """Add values of facets to their nodes."""
    rows = sums.array.reshape(-1, sums.block_size)
    np.add.at(
        rows, nodes, np.broadcast_to(values.reshape(*values.shape[:2], rows.shape[1]), (*nodes.shape, rows.shape[1]))
    )


def excess(
    spaces: ElasticSpaces, data: ElasticData, nodes: BoundaryNodes, contact: FacetCoefficients, v: fem.Function
) -> tuple[Array, bool]:
    """How far nodes have to go back along their direction so that v_n ≤ g on all facets, and whether that helps.

    Collective.
    """
    dim = spaces.dim
    coefficients = v.x.array.reshape(-1, dim)
    too_far = np.einsum("nai,ni->na", coefficients[contact.nodes], contact.facets.normals) - contact.of(
        spaces.mesh, data.gap
    )
    direction = direction_of_contact(nodes)[contact.nodes]
    share = np.einsum("nai,ni->na", direction, contact.facets.normals)
    can = nodes.touching[contact.nodes] & (share > 0.1)
    scale = max(float(np.abs(coefficients).max(initial=0.0)), 1e-300)
    stuck = bool(np.any(~can & (too_far > 1e-12 * scale)))
    back = la.vector(v.function_space.dofmap.index_map)
    _add(back, contact.nodes, np.where(can, np.maximum(too_far, 0) / np.where(can, share, 1.0), 0.0)[:, :, None])
    back.scatter_reverse(la.InsertMode.add)
    back.scatter_forward()
    return back.array, not max(spaces.mesh.comm.allgather(stuck))


def direction_of_contact(nodes: BoundaryNodes) -> Array:
    """The direction behind the given ones, 0 off Γ_C, shape (nodes, d)."""
    number, dim = nodes.values.shape
    column = np.minimum(nodes.given, dim - 1)
    found: Array = nodes.frames[np.arange(number), :, column] * nodes.touching[:, None]
    return found
