"""The spaces of the hybrid elastic problem: traces linear on each facet, in frames that suit the conditions.

*The mesh of the subcells into which the Johnson-Mercier element splits cells*.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import cell_nodes, function_at, original_cells
from signorini_fenicsx.contact.sites import SiteKind, Sites
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, LinearTraces, linear_traces, opposite
from signorini_fenicsx.discrete.mesh_spaces import build_mesh_spaces
from signorini_fenicsx.discrete.pairing import MeshPair, pairs_on
from signorini_fenicsx.meshes.domain import AXES, Domain, distribute
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import Cells
from signorini_fenicsx.physics.elasticity.problem import NORMAL, TANGENTIAL, ElasticBoundary


@dataclass(frozen=True)
class SplitMesh:
    """The mesh of the subcells of all cells or of some, on the ranks of their cells.

    Attributes:
        size: Number of all cells of the domain on this rank.
        mesh: The mesh.
        subcells: For each of its cells the number of the subcell: the cell's, times d + 1, plus the subcell's.
    """

    size: int
    mesh: dolfinx.mesh.Mesh
    subcells: Indices

    @cached_property
    def stresses(self) -> fem.FunctionSpace:
        """The space of the stresses (collective)."""
        dim = self.mesh.geometry.dim
        return fenicsx.function_space(self.mesh, ("DG", 1, (dim, dim)))

    @cached_property
    def cells(self) -> Indices:
        """The cell of this mesh for each subcell of the domain, shape (cells, d + 1); −1 where it has none."""
        numbers = np.full((self.size, self.mesh.geometry.dim + 1), -1)
        numbers.ravel()[self.subcells] = np.arange(len(self.subcells))
        return numbers

    def part(self, cells: Indices) -> "SplitMesh":
        """The subcells of some owned cells of the domain (collective)."""
        subcells = np.sort(self.cells[cells].ravel()).astype(np.int32)
        mesh, entities = fenicsx.submesh(self.mesh, self.mesh.topology.dim, subcells)
        owned = np.arange(len(subcells), dtype=np.int32)
        return SplitMesh(self.size, mesh, self.subcells[entities.sub_topology_to_topology(owned, inverse=False)])

    def stress(self, values: Array) -> fem.Function:
        """The stress with these values at the vertices of the subcells, shape (cells, d + 1, d + 1, d, d)."""
        return self.function(self.stresses, values, "sigma")

    def function(self, space: fem.FunctionSpace, values: Array, name: str) -> fem.Function:
        """The linear function with these values at the vertices of the subcells, shape (cells, d + 1, d + 1, …)."""
        function = fem.Function(space, name=name)
        self.set_values(function, values)
        return function

    def set_values(self, function: fem.Function, values: Array) -> None:
        """Set a discontinuous linear function by its values at the vertices, shape (cells, d + 1, d + 1, …)."""
        space = function.function_space
        by_node = function.x.array.reshape(-1, *space.value_shape)
        by_node[space.dofmap.list] = values.reshape(-1, *values.shape[2:])[self.subcells]

    def values(self, function: fem.Function) -> Array:
        """Values at the vertices, shape (cells, d + 1, d + 1, …), of a discontinuous linear function on it."""
        shape = function.function_space.value_shape
        by_node = function.x.array.reshape(-1, *shape)[function.function_space.dofmap.list]
        in_order = np.empty_like(by_node)
        in_order[self.subcells] = by_node
        size = self.mesh.geometry.dim + 1
        return in_order.reshape(-1, size, size, *shape)


def split_mesh(mesh: dolfinx.mesh.Mesh, order: Indices, vertices: Array) -> SplitMesh:
    """Split all cells at their centroids (collective).

    Args:
        mesh: The mesh.
        order: Vertices of the owned cells in the order that the subcells have.
        vertices: Their coordinates, shape (cells, d + 1, d).
    """
    comm, dim = mesh.comm, mesh.topology.dim
    nodes, size = mesh.geometry.index_map(), len(order)
    begins = np.array(comm.allgather((nodes.local_range[0], size)))
    centroids_before = np.concatenate([[0], np.cumsum(begins[:, 1])])
    local = np.take_along_axis(cell_nodes(mesh), order, axis=1)
    numbers = nodes.local_to_global(local.ravel().astype(np.int32)).reshape(local.shape)
    numbers += centroids_before[np.searchsorted(begins[:, 0], numbers, side="right") - 1]
    first = nodes.local_range[1] + centroids_before[comm.rank]
    centroid = np.broadcast_to((first + np.arange(size))[:, None, None], (size, dim + 1, 1))
    cells = np.concatenate([numbers[:, opposite(dim)], centroid], axis=2).reshape(-1, dim + 1)
    points = np.concatenate([mesh.geometry.x[: nodes.size_local, :dim], vertices.mean(axis=1)])
    split = distribute(comm, points, cells, dim, stay=True)
    begin = split.topology.index_map(dim).local_range[0]
    return SplitMesh(size, split, original_cells(split) - begin)


class Fixed(NamedTuple):
    """Facets on which a component of u is given.

    Attributes:
        facets: The facets.
        k: Its number among the unknowns of a vertex.
        axes: Its direction on each facet, shape (facets, d).
        of: Which components of u_D it is made of.
    """

    facets: BoundaryFacets
    k: int
    axes: Array
    of: range


@dataclass(frozen=True, kw_only=True)
class ElasticSpaces(LinearTraces):
    """Spaces on one domain, with the cells' vertices in an order that is the same on any rank, see `LinearTraces`.

    Unknown (a, k) of a facet is at its vertex a. On Γ_C and on parts that are fixed in the normal or in the tangential
    components k = 0 is that along n, in other places k is a coordinate. On Γ_C the normal part is in the basis dual to
    the hats φ_a, so that its coefficient is the φ_a-weighted mean of u_n, and the residual that belongs to it |e|/d
    times σ_nn at the vertex a. Where a law is from the other side, n on Γ_C is the inner normal.

    On a part inside the domain the unknowns of the named side are the jump, û of this side less û of the other one;
    those of the other side are in the same frame. The unknowns of a slave of a pair in the directions in which a law
    holds are jumps, too: û less the mean of û opposite to it.

    Attributes:
        boundary: The parts.
        displacements: Linear on each cell.
        rough_rows: Which of them have friction; there the tangential part has the dual basis, too.
    """

    boundary: ElasticBoundary
    displacements: fem.FunctionSpace
    rough_rows: Indices
    cell_type = Cells

    @cached_property
    def distances(self) -> dict[tuple[str, str], Array]:
        """How far the vertices of parts are from surfaces in files, each of which is read once."""
        return {}

    def as_dolfinx(self, cells: npt.NDArray[np.int32]) -> tuple[Indices, Indices, Indices]:
        """Indices of subcell vertices in this order for DOLFINx's order of the cell's vertices.

        With `found = values_of_dolfinx[spaces.as_dolfinx(cells)]` values at (cell, subcell, vertex) change their order.
        """
        order, dim = self.order[cells], self.dim
        of_subcell = order[:, opposite(dim)]
        place = np.empty((*of_subcell.shape[:2], dim + 1), dtype=np.int64)
        place[:, :, :dim] = of_subcell - (of_subcell > order[:, :, None])
        place[:, :, dim] = dim  # the centroid
        return np.arange(len(cells))[:, None, None], order[:, :, None], place

    @cached_property
    def frames(self) -> list[tuple[BoundaryFacets, Array]]:
        """Facets whose unknowns are no coordinates, and the values at the vertices that the unknowns stand for.

        These are matrices from unknowns (a, k) to values (vertex, component), shape (facets, d², d²).
        """
        dual = (self.dim + 1) * np.eye(self.dim) - 1
        frames = [(self.contact, _frame_matrices(self.contact.normals, dual))]
        frames[0][1][self.rough_rows] = _frame_matrices(self.rough.normals, dual, dual)
        frames.append((self.across, frames[0][1][self.inner.rows]))
        for name, components in self.boundary.fixed.items():
            if components in (NORMAL, TANGENTIAL) and name not in self.boundary.contact:
                part = self.part(name)
                frames.append((part, _frame_matrices(part.normals, np.eye(self.dim))))
        if self.tied.size:
            everything = np.kron(dual, np.eye(self.dim))
            frames.append((self.boundary_facets(self.tied), np.tile(everything, (self.tied.size, 1, 1))))
        return frames

    def frames_of(self, pair: MeshPair) -> Array:
        """See `LinearTraces.frames_of`: the normal and, with friction, tangents; all components where it is tied."""
        if pair.parts.tied:
            return np.tile(np.eye(self.dim), (len(pair.slaves), 1, 1))
        frames = _frames(self.boundary_facets(pair.slaves).normals)  # as in `frames`, to the last digit
        frames[~np.isin(pair.slaves, self.rough.facets), 1:] = 0.0
        return frames

    def unknowns(self, facets: BoundaryFacets, k: int) -> npt.NDArray[np.int32]:
        """The unknowns (a, k) of facets, shape (facets, d)."""
        dim = self.dim
        return facets.blocks[:, None] * dim**2 + np.arange(dim, dtype=np.int32) * dim + k

    @cached_property
    def fixed(self) -> list[Fixed]:
        """Where components of u are given: those of Γ_D first, one after the other."""
        dim, everything = self.dim, range(self.dim)

        def along(facets: BoundaryFacets, k: int) -> Fixed:
            return Fixed(facets, k, np.broadcast_to(np.eye(dim)[k], facets.normals.shape), everything[k : k + 1])

        given = [along(self.dirichlet, k) for k in everything]
        for name, components in self.boundary.fixed.items():
            on_contact = name in self.boundary.contact
            part = self.contact.take(self.rows_on(name)) if on_contact else self.part(name)
            if components in (NORMAL, TANGENTIAL):
                frames = _frames(part.normals)
                numbers = everything[:1] if components == NORMAL else everything[1:]
                given += [Fixed(part, k, frames[:, k], everything) for k in numbers]
            else:
                given += [along(part, AXES.index(letter)) for letter in components]
        return given

    @cached_property
    def displacement_rounding(self) -> float:
        """A displacement that is rounding of the coordinates of nodes, on any body (collective when first used)."""
        return 8 * float(np.finfo(float).eps) * self.length

    @cached_property
    def rough(self) -> BoundaryFacets:
        """The facets of Γ_C with friction."""
        return self.contact.take(self.rough_rows)

    @cached_property
    def tangents(self) -> Array:
        """Tangents of the facets with friction, n turned to the left or two in space, shape (facets, d − 1, d)."""
        return _frames(self.rough.normals)[:, 1:]

    @cached_property
    def site_kinds(self) -> Sites:
        """The facet vertices of Γ_C in the normal direction, and those with friction once more for each tangent."""
        number, dim, rows = len(self.facets), self.dim, self.rough_rows
        normal, slip = self.unknowns(self.contact, 0), [self.unknowns(self.rough, k) for k in range(1, dim)]
        share, rough = np.repeat(self.contact.measure / dim, dim), np.repeat(self.rough.measure / dim, dim * (dim - 1))
        pressing = dim * rows[:, None] + np.arange(dim)
        return Sites(
            SiteKind("normal", number, np.arange(number), share, (dim,), normal.ravel(), sign=-1.0),
            SiteKind("slip", number, rows, rough, (dim, dim - 1), np.stack(slip, axis=2).ravel(), pressing=pressing),
        )

    @property
    def places(self) -> Array:
        """The place of each site, see `LinearTraces.places`; with friction its last number is the tangent's."""
        dim, rows = self.dim, super().places
        rough = np.repeat(rows.reshape(-1, dim, 1, rows.shape[1])[self.rough_rows], dim - 1, axis=2)
        rough[..., -1] = np.arange(1, dim)
        return np.concatenate([rows, rough.reshape(-1, rows.shape[1])])

    def pressure_of(self, flux: Array) -> Array:
        """The pressure at the vertices of the facets with friction, of values at all sites, shape (facets, d)."""
        return flux[self.site_kinds["slip"].pressing]

    def along(self, values: Array) -> Array:
        """Tangential vectors from values at the sites with friction, shape (facets, d, d)."""
        return np.einsum("nak,nki->nai", values.reshape(-1, self.dim, self.dim - 1), self.tangents)

    def in_frames(self, vectors: Array) -> Array:
        """The values at the sites with friction of tangential vectors, the inverse of `along`."""
        return np.einsum("nai,nki->nak", vectors, self.tangents).ravel()

    def displacement(self, values: Array) -> fem.Function:
        """The function with these values at the vertices of the owned cells, shape (cells, d + 1, d) (collective)."""
        return function_at(self.displacements, self.at_vertices(self.displacements), values, "u")

    def displacement_values(self, function: fem.Function) -> Array:
        """Values of a displacement at the vertices of the owned cells."""
        return function.x.array.reshape(-1, self.dim)[self.at_vertices(self.displacements)]

    def tractions(self, facets: BoundaryFacets, stresses: Array) -> Array:
        """σn at the vertices of boundary facets, shape (facets, d, d), of values as in `SplitMesh.values`."""
        at_vertices = stresses[facets.cells, facets.local, : self.dim]
        return np.einsum("naij,nj->nai", at_vertices, facets.outward[:, None] * facets.normals)

    def shear(self, stresses: Array) -> Array:
        """σ_t at the sites with friction."""
        return np.einsum("nai,nki->nak", self.tractions(self.rough, stresses), self.tangents).ravel()

    @cached_property
    def split(self) -> SplitMesh:
        """The mesh of the subcells (collective)."""
        return split_mesh(self.mesh, self.order, self.vertices)


def build_elastic_spaces(domain: Domain, boundary: ElasticBoundary, rough: Sequence[str] = ()) -> ElasticSpaces:
    """Create the spaces, with friction on some parts of Γ_C (collective).

    Raises:
        InputError: If a part does not exist, or is fixed in z in the plane.
    """
    flat = [part for part, components in boundary.fixed.items() if "z" in components]
    if domain.mesh.geometry.dim == 2 and flat:
        raise InputError(f"[boundary] fixed: part '{flat[0]}' is fixed in z, which there is only in space")
    pairs = pairs_on(domain, boundary.pairs, cut=bool(boundary.inner))
    loaded = [*boundary.neumann, *(part for part in boundary.fixed if part not in boundary.contact)]
    on_mesh = build_mesh_spaces(
        domain, boundary.contact, loaded, boundary.inner, pairs, [each.left_out for each in pairs]
    )
    dim = domain.mesh.topology.dim
    displacements = fenicsx.function_space(domain.mesh, ("DG", 1, (dim,)))
    spaces = ElasticSpaces(
        **linear_traces(on_mesh, (dim, dim)),
        boundary=boundary,
        displacements=displacements,
        rough_rows=on_mesh.rows_on(*rough),
    )
    turned = spaces.rows_on(*boundary.turned)
    return replace(spaces, contact=spaces.contact.turned(turned)) if boundary.turned else spaces


def _frame_matrices(normals: Array, dual: Array, beside: Array | None = None) -> Array:
    """The matrices from unknowns (a, k) to values (vertex, component): n times the functions of `dual` for k = 0.

    For other k it is a tangent times the functions of `beside`, by default the hats.
    """
    number, dim = normals.shape
    frames = _frames(normals)
    matrices = np.zeros((number, dim, dim, dim, dim))
    matrices[:, :, :, :, 0] = np.einsum("ba,ni->nbia", dual, normals)
    for k in range(1, dim):
        matrices[:, :, :, :, k] = np.einsum("ba,ni->nbia", np.eye(dim) if beside is None else beside, frames[:, k])
    return matrices.reshape(number, dim**2, dim**2)


def _frames(normals: Array) -> Array:
    """Orthonormal bases whose first vector is n, shape (n, d, d)."""
    if normals.shape[1] == 2:
        return np.stack([normals, np.stack([-normals[:, 1], normals[:, 0]], axis=1)], axis=1)
    least = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = np.cross(normals, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([normals, first, np.cross(normals, first)], axis=1)
