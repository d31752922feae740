"""Traces that are linear on each facet: the facets with their vertices in one order, their unknowns, the two sides.

Both elements of order two have them: that of Johnson and Mercier for stresses, and RT1 for fluxes.

*Simplices by their vertices, in batches*: their maps from the reference cell, normals, measures.

Facet i of a cell is opposite to its vertex i, and its vertices are in the order of those of the cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from math import factorial
from typing import TYPE_CHECKING, Any, ClassVar, Self

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.owned import cell_dofs, cell_nodes, number_of_cells, sums_at
from signorini_fenicsx.discrete.hybrid_system import Sides, copies
from signorini_fenicsx.discrete.mesh_spaces import Facets, MeshSpaces, cells_and_dofs

if TYPE_CHECKING:  # it needs the ranks of nodes
    from signorini_fenicsx.discrete.pairing import MeshPair

BLOCK = {2: 4096, 3: 512}
"""Cells, by dimension, whose values are held at a time: some tens of megabytes."""


def opposite(dim: int) -> Indices:
    """Vertices of each facet of a simplex, ascending: shape (d + 1, d)."""
    return np.array([[k for k in range(dim + 1) if k != i] for i in range(dim + 1)])


def facet_normals(vertices: Array) -> Array:
    """|e| n for the facet opposite to each vertex, n pointing outwards, shape (cells, d + 1, d)."""
    dim = vertices.shape[2]
    edges = vertices[:, 1:] - vertices[:, :1]
    gradients = np.linalg.inv(edges).transpose(0, 2, 1)
    gradients = np.concatenate([-gradients.sum(axis=1, keepdims=True), gradients], axis=1)
    measures = np.abs(np.linalg.det(edges)) / factorial(dim)
    return -dim * measures[:, None, None] * gradients


def null_space(matrix: Array) -> Array:
    """An orthonormal basis of the vectors that a matrix maps to 0, as columns; as SciPy's, which is slow to load."""
    _, sizes, vectors = np.linalg.svd(matrix)
    rank = int(np.count_nonzero(sizes > 1e-10 * sizes.max(initial=0.0)))
    return vectors[rank:].T


@dataclass(frozen=True)
class SomeCells:
    """Some cells by their vertices.

    Attributes:
        vertices: Shape (cells, d + 1, d).
        numbers: Their numbers on this rank, if they are those of a mesh.
    """

    vertices: Array
    numbers: npt.NDArray[np.int32] = field(default_factory=lambda: np.empty(0, dtype=np.int32))

    @property
    def dim(self) -> int:
        """The dimension d."""
        return int(self.vertices.shape[2])

    @cached_property
    def derivative(self) -> Array:
        """F, shape (cells, d, d)."""
        return (self.vertices[:, 1:] - self.vertices[:, :1]).transpose(0, 2, 1)

    @cached_property
    def determinant(self) -> Array:
        """|det F|."""
        return np.abs(np.linalg.det(self.derivative))

    @cached_property
    def measure(self) -> Array:
        """|T|."""
        return self.determinant / factorial(self.dim)


def blocks_of_cells(mesh: dolfinx.mesh.Mesh) -> Iterator[npt.NDArray[np.int32]]:
    """The owned cells, so many at a time and equally often on all ranks (collective)."""
    size = number_of_cells(mesh)
    parts = max(mesh.comm.allreduce(-(-size // BLOCK[mesh.topology.dim]), MPI.MAX), 1)
    yield from np.array_split(np.arange(size, dtype=np.int32), parts)


@dataclass(frozen=True)
class Hats:
    """The hats of the vertices of some facets or cells, in the order of `LinearTraces.order`.

    Attributes:
        ranking: Where the vertices are among those that DOLFINx gives the facet or cell, shape (n, its vertices).
        measure: |e| or |T|.
    """

    ranking: Indices
    measure: Array

    def take(self, rows: Indices) -> Self:
        """A selection of the facets or cells."""
        return type(self)(*(getattr(self, each.name)[rows] for each in fields(self)))

    def of_linear(self, values: Array) -> Array:
        """∫ f φ_a over each of them, of functions that are linear by their values at the vertices, shape as these."""
        shares = self.measure / self.ranking.shape[1]
        return np.asarray(np.einsum("n,na...->na...", shares, means_of_linear(values)))

    def moments(self, values: Array, points: Array, weights: Array) -> Array:
        """∫ value φ_a over each of them, shape (n, its vertices, …), from values in points of the reference one."""
        hats = np.column_stack([1 - points.sum(axis=1), points])
        by_dolfinx = np.einsum("q,qa,nq...->na...", weights / weights.sum(), hats, values)
        order = self.ranking.reshape(*self.ranking.shape, *[1] * (values.ndim - 2))
        scale = self.measure.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(scale * np.take_along_axis(by_dolfinx, order, axis=1))


@dataclass(frozen=True)
class BoundaryFacets(Hats):
    """Some boundary facets of this rank, all owned. Their vertices are in the order of `LinearTraces.order`.

    Attributes:
        facets: Their numbers.
        cells: The cell behind each.
        local: Which vertex of that cell is opposite, in the order of `LinearTraces.order`.
        blocks: Block of unknowns of each.
        vertices: Shape (facets, d, d).
        normals: Outer unit normals; inner ones where a law is from the other side, see `turned`.
        outward: 1 where they are outer ones, −1 elsewhere.
    """

    facets: npt.NDArray[np.int32]
    cells: npt.NDArray[np.int32]
    local: Indices
    blocks: npt.NDArray[np.int32]
    vertices: Array
    normals: Array
    outward: Array

    def turned(self, rows: Indices) -> BoundaryFacets:
        """The facets with inner normals on these rows, along which a law then counts."""
        outward = np.where(np.isin(np.arange(len(self.facets)), rows), -1.0, 1.0)
        return replace(self, normals=outward[:, None] * self.normals, outward=outward)


def linear_values(moments: Array, measure: Array) -> Array:
    """Values at the vertices of the linear functions with these moments ∫ φ_a, the vertices being axis 1."""
    size = moments.shape[1]
    dual = (size + 1) * np.eye(size) - 1
    scale = (size / measure).reshape(-1, *[1] * (moments.ndim - 1))
    return scale * np.einsum("ab,nb...->na...", dual, moments)


def linear_from_means(means: Array) -> Array:
    """Values at the vertices of linear functions with these means weighted by the hats, shape (facets, d, …)."""
    return (means.shape[1] + 1) * means - means.sum(axis=1, keepdims=True)


def means_of_linear(values: Array) -> Array:
    """The means weighted by the hats of linear functions with these values, the inverse of `linear_from_means`."""
    return (values + values.sum(axis=1, keepdims=True)) / (values.shape[1] + 1)


def squares_of(measure: Array, values: Array) -> float:
    """∫v² of a v that is constant on each simplex, or linear by its values at the vertices, shape (simplices, …)."""
    rows = values if values.ndim > 1 else values[:, None]
    size = rows.shape[1]
    return float(measure @ ((rows**2).sum(axis=1) + rows.sum(axis=1) ** 2) / (size * (size + 1)))


@dataclass(frozen=True, kw_only=True)
class LinearTraces(MeshSpaces):
    """Spaces with traces that are linear on each facet.

    The vertices of cells and facets are in an order that is the same on any rank, see `node_ranks`.

    Attributes:
        traces: A block of unknowns per facet: one for each of its vertices and components.
        order: Vertices of the owned cells in this order.
        dofs: Blocks of the facets opposite to them, shape (cells, d + 1).
        contact: The facets of Γ_S or Γ_C, in the order of `facets`.
    """

    traces: fem.FunctionSpace
    order: Indices
    dofs: npt.NDArray[np.int32]
    contact: BoundaryFacets
    cell_type: ClassVar[type[SomeCells]]
    """Cells as the element has them."""

    @property
    def dim(self) -> int:
        """The dimension d."""
        return self.mesh.topology.dim

    def blocks(self) -> Iterator[Any]:
        """The owned cells as the element has them, some at a time, see `blocks_of_cells` (collective)."""
        return (self.cell_type(self.vertices[numbers], numbers) for numbers in blocks_of_cells(self.mesh))

    @property
    def nodes(self) -> npt.NDArray[np.integer]:
        """The nodes at the vertices of the owned cells in this order, shape (cells, d + 1)."""
        return np.take_along_axis(super().nodes, self.order, axis=1)

    def at_vertices(self, space: fem.FunctionSpace) -> npt.NDArray[np.int32]:
        """The degrees of freedom of linear functions on cells at the vertices of the owned cells in this order."""
        return np.take_along_axis(cell_dofs(space), self.order, axis=1)

    @property
    def corners(self) -> Array:
        """The vertices of the facets of Γ_C in this order."""
        return self.contact.vertices

    @property
    def frames(self) -> list[tuple[BoundaryFacets, Array]]:
        """Facets whose unknowns are no values at vertices, and the values there that the unknowns stand for.

        These are matrices from the unknowns of a facet to values, shape (facets, block, block).
        """
        raise NotImplementedError

    def to_unknowns(self, of_facets: Array, numbers: npt.NDArray[np.int32]) -> None:
        """Let what belongs to values on the facets of cells belong to the unknowns of `frames`, in place.

        Args:
            of_facets: The rows of each cell are facet by facet, shape (cells, n, …).
            numbers: The numbers of the cells, which follow one another.
        """
        for facets, matrices in self.frames:
            chosen, size = np.flatnonzero(np.isin(facets.cells, numbers)), matrices.shape[1]
            rows = facets.local[chosen, None] * size + np.arange(size)
            places = (facets.cells[chosen] - numbers[:1])[:, None], rows
            of_facets[places] = matrices[chosen].transpose(0, 2, 1) @ of_facets[places]

    def forces(self, through: Array) -> Array:
        """⟨σn, q⟩ summed over the cells for each owned unknown q (collective).

        Args:
            through: |e| σn at the vertices of the facets of the owned cells, shape (cells, d + 1, d, components).
        """
        numbers, mass = self.traces.dofmap.index_map, (1 + np.eye(self.dim)) / (self.dim * (self.dim + 1))
        size = self.dim * through.shape[3]
        by_block = sums_at(numbers, self.dofs, mass @ through).reshape(-1, size)
        for facets, matrices in self.frames:
            by_block[facets.blocks] = np.einsum("nij,ni->nj", matrices, by_block[facets.blocks])
        return self.sides.forces(by_block.ravel()[: size * numbers.size_local])

    @property
    def places(self) -> Array:
        """For each vertex of the facets of Γ_S the vertex, the sum of those of its facet, and a zero."""
        vertices = self.contact.vertices
        of_facet = np.broadcast_to(np.sort(vertices, axis=1).sum(axis=1, keepdims=True), vertices.shape)
        rows = np.concatenate([vertices, of_facet, np.zeros((*vertices.shape[:2], 1))], axis=2)
        return np.asarray(rows.reshape(-1, rows.shape[2]))

    @cached_property
    def vertices(self) -> Array:
        """Vertices of the owned cells, shape (cells, d + 1, d)."""
        nodes = np.take_along_axis(cell_nodes(self.mesh), self.order, axis=1)
        return self.mesh.geometry.x[nodes, : self.dim]

    def boundary_facets(self, numbers: npt.NDArray[np.int32]) -> BoundaryFacets:
        """Boundary facets by their numbers."""
        return _boundary_facets(self.traces, self.order, numbers)

    def part(self, name: str) -> BoundaryFacets:
        """The facets of a part."""
        if name not in self._parts:
            self._parts[name] = self.boundary_facets(self.domain.facets[name])
        return self._parts[name]

    @cached_property
    def _parts(self) -> dict[str, BoundaryFacets]:
        """The parts that were asked for."""
        return {}

    @cached_property
    def neumann(self) -> BoundaryFacets:
        """All facets on which some component of σn is given."""
        return self.boundary_facets(self.neumann_facets)

    @cached_property
    def dirichlet(self) -> BoundaryFacets:
        """The facets of Γ_D."""
        return self.boundary_facets(self.dirichlet_facets)

    @cached_property
    def across(self) -> BoundaryFacets:
        """The other sides of the facets inside the domain, in the order of `inner.rows`."""
        return self.boundary_facets(self.inner.facets)

    @cached_property
    def sides(self) -> Sides:
        """The facets whose unknowns are jumps (collective when first used)."""
        entries = [self.jumps, *map(self._means_opposite, self.pairs)]
        rows, columns, values = (np.concatenate(each) for each in zip(*entries, strict=True))
        return Sides(self.traces, (rows, columns, values), present=self.several)

    @cached_property
    def tied(self) -> Facets:
        """The slave facets that are tied; they have the dual basis in all components."""
        return np.concatenate([np.empty(0, dtype=np.int32), *(each.slaves for each in self.pairs if each.parts.tied)])

    def frames_of(self, pair: MeshPair) -> Array:
        """The directions of the jumps on the slave facets, 0 where there is none, shape (slaves, k, component)."""
        return np.ones((len(pair.slaves), 1, 1))

    def _means_opposite(self, pair: MeshPair) -> tuple[Indices, Indices, Array]:
        """The entries of P of a pair, see `Sides` (collective)."""
        dim, numbers, pieces, frames = self.dim, self.traces.dofmap.index_map, pair.pieces, self.frames_of(pair)
        masters = numbers.local_to_global(self.boundary_facets(pair.masters).blocks).astype(np.int64)
        columns = pair.of_masters(self.mesh.comm, masters)[pieces.master]
        blocks, parts = self.boundary_facets(pair.slaves).blocks.astype(np.int64), frames.shape[1]
        a, k, b, i = np.meshgrid(*map(np.arange, (dim, parts, dim, parts)), indexing="ij")
        rows = blocks[pieces.slave, None] * dim * parts + (a * parts + k).ravel()
        values = np.einsum("nab,nki->nakbi", pieces.weights, frames[pieces.slave]).reshape(rows.shape)
        places = columns[:, None] * dim * parts + (b * parts + i).ravel()
        used = values != 0
        return rows[used], places[used], values[used]

    @property
    def jumps(self) -> tuple[Indices, Indices, Array]:
        """The entries of P on parts inside the domain, see `Sides`."""
        blocks, size = (self.contact.blocks[self.inner.rows], self.across.blocks), self.traces.dofmap.index_map_bs
        named, across = ((each[:, None].astype(np.int64) * size + np.arange(size)).ravel() for each in blocks)
        return copies(self.traces, named, across)


def linear_traces(spaces: MeshSpaces, shape: tuple[int, ...]) -> dict[str, Any]:
    """The fields of `LinearTraces` with a block of this shape per facet (collective)."""
    mesh = spaces.mesh
    traces = fenicsx.function_space(mesh, ("CR", 1, shape))
    order = np.argsort(node_ranks(mesh, cut=spaces.inner.present)[cell_nodes(mesh)], axis=1)
    dofs = np.take_along_axis(cell_dofs(traces), order, axis=1)
    contact = _boundary_facets(traces, order, spaces.facets)
    on_mesh = {each.name: getattr(spaces, each.name) for each in fields(spaces)}
    return {**on_mesh, "traces": traces, "order": order, "dofs": dofs, "contact": contact}


def node_ranks(mesh: dolfinx.mesh.Mesh, *, cut: bool) -> Indices:
    """The numbers by which the nodes of this rank are ordered: their global ones.

    Of a mesh that is cut inside the domain they are the places among the nodes sorted by x, then y, then z. So vertices
    that lie on each other have the same order in the cells of both sides.
    """
    if not cut:
        return mesh.geometry.input_global_indices
    places = np.empty(len(mesh.geometry.x), dtype=np.int64)
    places[np.lexsort(mesh.geometry.x.T[::-1])] = np.arange(len(places))
    return places


def _boundary_facets(traces: fem.FunctionSpace, order: Indices, facets: npt.NDArray[np.int32]) -> BoundaryFacets:
    mesh = traces.mesh
    dim = mesh.topology.dim
    cells, blocks = cells_and_dofs(traces, facets)
    place = np.argmax(traces.dofmap.list[cells] == blocks[:, None], axis=1)  # the facet in DOLFINx's order of the cell
    local = np.argmax(order[cells] == place[:, None], axis=1)
    among = np.take_along_axis(order[cells], opposite(dim)[local], axis=1)  # DOLFINx's numbers of the facet's vertices
    ranking = among - (among > place[:, None])
    nodes = np.take_along_axis(cell_nodes(mesh)[cells], order[cells], axis=1)
    vertices = mesh.geometry.x[nodes, :dim]
    areas = facet_normals(vertices)[np.arange(len(cells)), local]
    measure = np.linalg.norm(areas, axis=1)
    return BoundaryFacets(
        facets=facets,
        cells=cells,
        local=local,
        ranking=ranking,
        blocks=blocks,
        vertices=np.take_along_axis(vertices, opposite(dim)[local][:, :, None], axis=1),
        normals=areas / measure[:, None],
        measure=measure,
        outward=np.ones(len(facets)),
    )
