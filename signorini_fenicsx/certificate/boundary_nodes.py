"""Nodes of a conforming displacement on the boundary: where it is given, and where it must not pass the foundation.

On each facet of Γ_D, Γ_C and of parts that are fixed in some components, a displacement has coefficients in Bernstein's
basis. As a polynomial is a mean of its coefficients, v_n ≤ g on a facet if the coefficients are in that relation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import basix
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from dolfinx import fem, la

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.points import from_within, in_facets
from signorini_fenicsx.physics.diffusion.nodes import extreme_around
from signorini_fenicsx.physics.elasticity.data import ElasticData
from signorini_fenicsx.physics.elasticity.johnson_mercier import SIMPLEX
from signorini_fenicsx.physics.elasticity.problem import NORMAL
from signorini_fenicsx.physics.elasticity.spaces import BoundaryFacets, ElasticSpaces
from signorini_fenicsx.physics.elasticity.split_mesh import SplitMesh
from signorini_fenicsx.physics.elasticity.vector_datum import VectorDatum

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
    """Facets on the split mesh or a part of it, and the nodes of a displacement on each.

    Attributes:
        facets: The facets.
        rows: Where they are among those asked for.
        cells: The cell of the split mesh behind each, which is opposite to its last vertex.
        nodes: Shape (facets, coefficients).
        degree: Of the displacement.
    """

    facets: BoundaryFacets
    rows: Indices
    cells: Indices
    nodes: npt.NDArray[np.int32]
    degree: int

    @cached_property
    def _element(self) -> basix.finite_element.FiniteElement:
        facet = SIMPLEX[self.facets.vertices.shape[2] - 1]
        return basix.create_element(basix.ElementFamily.P, facet, self.degree, basix.LagrangeVariant.bernstein)

    def basis(self, points: Array) -> Array:
        """Bernstein's basis in points of the reference facet, shape (points, coefficients)."""
        found: Array = self._element.tabulate(0, points)[0, :, :, 0]
        return found

    def of(self, mesh: dolfinx.mesh.Mesh, datum: Datum | VectorDatum) -> Array:
        """Coefficients of the polynomials that interpolate at equidistant points (collective).

        What is not a polynomial may jump where a punch ends, so the values are limits from inside the facets.
        """
        points = basix.create_lattice(self._element.cell_type, self.degree, basix.LatticeType.equispaced, True)
        at = in_facets(mesh, self.facets.facets, points)
        values = from_within(datum.values, at) if datum.polynomial is None else datum.values(at)
        steps = np.rint(self.degree * np.column_stack([1 - points.sum(axis=1), points])).astype(np.int64)
        weights = (self.degree + 1) ** np.arange(steps.shape[1])
        number_of = np.zeros(weights[-1] * (self.degree + 1), dtype=np.int64)
        number_of[steps @ weights] = np.arange(len(points))
        where = number_of[weights[self.facets.ranking] @ steps.T]  # the points in the order of the facet's vertices
        found = np.take_along_axis(values, where.reshape(*where.shape, *[1] * (values.ndim - 2)), axis=1)
        return np.einsum("kp,np...->nk...", np.linalg.inv(self.basis(points)), found)


def facet_coefficients(split: SplitMesh, space: fem.FunctionSpace, facets: BoundaryFacets) -> FacetCoefficients:
    """The nodes in a space on the split mesh or a part of it, on those of the facets that it has."""
    behind = split.cells[facets.cells, facets.local]
    rows = np.flatnonzero(behind >= 0)
    element = space.element.basix_element
    nodes = space.dofmap.list[behind[rows]][:, element.entity_closure_dofs[-2][-1]]
    return FacetCoefficients(facets.take(rows), rows, behind[rows], nodes, element.degree)


def boundary_nodes(
    spaces: ElasticSpaces, data: ElasticData, split: SplitMesh, space: fem.FunctionSpace, v: fem.Function | None = None
) -> BoundaryNodes:
    """Collect what is given at the nodes from the facets of all ranks (collective).

    Args:
        spaces: The spaces.
        data: The data.
        split: The split mesh, or a part of it.
        space: Displacements on that.
        v: A displacement in this space; it is given in the place of u_D, and where the part ends inside the domain.
    """
    dim, index_map = spaces.dim, space.dofmap.index_map
    # sums over facets: of d dᵀ and (d·u_D)d for given directions d; of n on Γ_C
    products, pulls, normals = la.vector(index_map, dim**2), la.vector(index_map, dim), la.vector(index_map, dim)
    for facets, k, letter in spaces.fixed:
        there = facet_coefficients(split, space, facets)
        axis = np.broadcast_to(np.eye(dim)[k], there.facets.normals.shape)
        directions = (there.facets.normals if letter == NORMAL else axis)[:, None]
        given = there.of(spaces.mesh, data.u_D) if v is None else v.x.array.reshape(-1, dim)[there.nodes]
        along = np.einsum("nai,nbi->na", given, directions)
        _add(products, there.nodes, np.einsum("nbi,nbj->nbij", directions, directions))
        _add(pulls, there.nodes, along[:, :, None] * directions)
    if v is not None:
        ends = _ends(spaces, split, space)
        products.array.reshape(-1, dim, dim)[ends] += np.eye(dim)
        pulls.array.reshape(-1, dim)[ends] += v.x.array.reshape(-1, dim)[ends]
    contact = facet_coefficients(split, space, spaces.contact)
    _add(normals, contact.nodes, contact.facets.normals[:, None])
    gap = extreme_around(space, contact.nodes * dim, contact.of(spaces.mesh, data.gap), largest=False)[::dim]
    for sums in (products, pulls, normals):
        sums.scatter_reverse(la.InsertMode.add)
        sums.scatter_forward()
    on_contact = np.isfinite(gap)
    normal = normals.array.reshape(-1, dim).copy()
    normal[on_contact] /= np.linalg.norm(normal[on_contact], axis=1, keepdims=True)
    return _framed(products.array.reshape(-1, dim, dim), pulls.array.reshape(-1, dim), normal, gap, on_contact)


def _ends(spaces: ElasticSpaces, split: SplitMesh, space: fem.FunctionSpace) -> npt.NDArray[np.int32]:
    """Nodes where a part of the split mesh ends inside the domain (collective)."""
    dim, topology = spaces.dim, split.mesh.topology
    topology.create_connectivity(dim - 1, dim)
    topology.create_connectivity(dim, dim - 1)
    boundary = [spaces.contact, spaces.neumann, spaces.dirichlet]
    behind = np.concatenate([facet_coefficients(split, space, facets).cells for facets in boundary])
    of_domain = topology.connectivity(dim, dim - 1).array.reshape(-1, dim + 1)[behind, dim]
    ends = np.setdiff1d(dolfinx.mesh.exterior_facet_indices(topology), of_domain)
    return fem.locate_dofs_topological(space, dim - 1, ends.astype(np.int32), remote=False)


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
