"""Uniform refinement: each triangle is cut into four and each tetrahedron into eight, on the rank that owns it.

A triangle is cut along the lines between the midpoints of its edges, so its children are similar to it. Four corners
are cut off a tetrahedron, and the octahedron that is left is cut along its shortest diagonal (J. Bey, Tetrahedral grid
refinement, Computing 55, 1995). The children of all generations belong to a few classes of similar tetrahedra.
"""

import itertools
from collections.abc import Sequence

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from dolfinx.common import IndexMap
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.owned import cell_nodes, cells_of_facets, number_of_cells
from signorini_fenicsx.base.reference_cells import EDGES
from signorini_fenicsx.meshes.checks import diameters
from signorini_fenicsx.meshes.domain import Domain, distribute, marked, membership
from signorini_fenicsx.meshes.refinement import descendant

AROUND = {(0, 5): (1, 2, 4, 3), (1, 4): (0, 2, 5, 3), (2, 3): (0, 1, 5, 4)}
"""For each diagonal of the octahedron, between midpoints of opposite edges, the other four edges in a circle."""
TIE = 1e-6
"""Diagonals that differ relatively by less than this count as equal, so that rounding does not choose."""


def _children(dim: int, corners: Sequence[int]) -> Indices:
    """Corners of the children of a cell, or of the facet with these corners, but for those in an octahedron.

    Numbers 0 … dim are vertices, dim + 1 + edge are midpoints.
    """
    midpoint = {edge: dim + 1 + number for number, edge in enumerate(EDGES[dim])}
    rows = [[a if a == b else midpoint[min(a, b), max(a, b)] for b in corners] for a in corners]
    middle = [midpoint[pair] for pair in itertools.combinations(corners, 2)]
    return np.array([*rows, middle] if len(corners) == 3 else rows)


OCTAHEDRON = 4 + np.array(
    [[[*diagonal, around[i], around[(i + 1) % 4]] for i in range(4)] for diagonal, around in AROUND.items()]
)
"""For each diagonal the four tetrahedra around it."""


def refined_uniformly(domain: Domain) -> Domain:
    """Refine all cells of a domain once (collective).

    The children stay on the rank of their parent. New vertices on curved parts of the boundary move there; a mesh from
    a file keeps its polygon or polyhedron. Parts and regions are inherited.

    Raises:
        NumericalFailure: If moving vertices to a curved boundary would flatten or invert a cell.
    """
    mesh, comm = domain.mesh, domain.mesh.comm
    dim = mesh.topology.dim
    size = number_of_cells(mesh)
    mesh.topology.create_entities(1)
    mesh.topology.create_connectivity(dim, 1)
    mesh.topology.create_connectivity(1, dim)
    nodes, edges = mesh.geometry.index_map(), mesh.topology.index_map(1)
    of_vertex, of_edge = _numbers(comm, nodes, edges)
    edges_of_cell = mesh.topology.connectivity(dim, 1).array.reshape(-1, len(EDGES[dim]))[:size]
    numbers = np.hstack([of_vertex[cell_nodes(mesh)], of_edge[edges_of_cell]])

    ends = dolfinx.mesh.entities_to_geometry(mesh, 1, np.arange(edges.size_local, dtype=np.int32))
    points = np.concatenate([mesh.geometry.x[: nodes.size_local], mesh.geometry.x[ends].mean(axis=1)])[:, :dim]
    children = numbers[:, _children(dim, range(dim + 1))]
    if dim == 3:
        corners = mesh.geometry.x[cell_nodes(mesh)]
        octahedron = numbers[np.arange(size)[:, None, None], OCTAHEDRON[_shortest_diagonal(corners)[0]]]
        children = np.concatenate([children, octahedron], axis=1)
    cells = children.reshape(-1, dim + 1)
    facets = {name: _children_of_facets(mesh, facets, numbers) for name, facets in domain.facets.items()}
    fine = distribute(comm, points, cells, dim, stay=True)
    there = marked(fine, facets, np.repeat(membership(domain), 2**dim, axis=0), domain.regions)
    return descendant(domain, there, made=domain.made, coarser=domain)


def _numbers(comm: MPI.Comm, *maps: IndexMap) -> list[Indices]:
    """New numbers of entities of several kinds on this rank; a rank has consecutive ones, kind by kind (collective)."""
    sizes = np.array(comm.allgather([index_map.size_local for index_map in maps]), dtype=np.int64)
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]]).reshape(sizes.shape)  # the new numbers, by rank and kind
    before = np.cumsum(sizes, axis=0) - sizes  # the old ones
    numbers = []
    for kind, index_map in enumerate(maps):
        own = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
        owner = np.concatenate([np.full(index_map.size_local, comm.rank, dtype=np.int32), index_map.owners])
        numbers.append(index_map.local_to_global(own) + (first - before)[owner, kind])
    return numbers


def parents(fine: Domain) -> Indices:
    """The nodes of the coarser mesh between which the nodes on this rank were put, shape (nodes, 2) (collective).

    Twice the same one if it was there before. Both are on this rank, because children stay where their parents are.
    """
    assert fine.coarser is not None
    coarse = fine.coarser.mesh
    nodes, edges = coarse.geometry.index_map(), coarse.topology.index_map(1)
    of_node = np.arange(nodes.size_local + nodes.num_ghosts)
    of_edge = np.arange(edges.size_local + edges.num_ghosts, dtype=np.int32)
    between = np.concatenate(
        [np.stack([of_node, of_node], axis=1), dolfinx.mesh.entities_to_geometry(coarse, 1, of_edge)]
    )
    numbers = np.concatenate(_numbers(coarse.comm, nodes, edges))
    order = np.argsort(numbers)
    return between[order[np.searchsorted(numbers, fine.mesh.geometry.input_global_indices, sorter=order)]]


def refined_diameter(points: Array, cells: Indices) -> float:
    """Largest diameter of the children of these cells (not collective)."""
    half = float(diameters(points, cells).max()) / 2
    return half if points.shape[1] == 2 else max(half, float(_shortest_diagonal(points[cells])[1].max()))


def _shortest_diagonal(corners: Array) -> tuple[Indices, Array]:
    """For each cell the number and the length of the shortest diagonal between midpoints of opposite edges."""
    middle = {edge: corners[:, list(ends)].mean(axis=1) for edge, ends in enumerate(EDGES[3])}
    lengths = np.stack([np.linalg.norm(middle[a] - middle[b], axis=1) for a, b in AROUND], axis=1)
    number = np.argmax(lengths <= lengths.min(axis=1, keepdims=True) * (1 + TIE), axis=1)
    return number, lengths[np.arange(len(number)), number]


def _children_of_facets(mesh: dolfinx.mesh.Mesh, facets: npt.NDArray[np.int32], numbers: Indices) -> Indices:
    """The vertices of the children of boundary facets, ascending, shape (children, dim)."""
    dim = mesh.topology.dim
    cells, place = cells_of_facets(mesh, facets)
    tables = np.stack([_children(dim, [*range(facet), *range(facet + 1, dim + 1)]) for facet in range(dim + 1)])
    rows = numbers[cells[:, None, None], tables[place]]
    return np.sort(rows.reshape(-1, dim), axis=1)
