"""Local refinement: marking of cells, and the refined mesh. Neither depends on the number of ranks."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Indices, determinants
from signorini_fenicsx.base.errors import NumericalFailure
from signorini_fenicsx.base.owned import cell_nodes, sums_at
from signorini_fenicsx.meshes.domain import (
    Domain,
    bounding_box,
    brought_together,
    distribute,
    facet_pairs,
    largest_diameter,
    marked,
    membership,
    other_side,
)

SAME = 1e-6
"""Cells whose indicators differ relatively by less than this are refined together, so that rounding does not choose."""
NEGLIGIBLE = 1e-20
NONE = np.empty(0, dtype=np.int32)
FLAT = 0.1
"""A cell must keep at least this share of its volume when vertices move to a curved boundary."""
SKEW = np.eye(3) + 1e-6 * np.array(
    [[0, 0, 0], [1 / np.sqrt(2), 1 / np.sqrt(3), 0], [1 / np.pi, 1 / np.e, 1 / np.sqrt(7)]]
)
"""A small change of lengths, so that of two equally long edges the direction decides, not the numbers, which depend on
the ranks."""
OBLIQUE, ROUNDING = np.array([1.0, np.sqrt(2), np.sqrt(3)]), 1e-12
"""A direction along which the centroids of the parts of a facet tell how it was cut, and what is rounding in that."""


def dorfler(indicator: Array, theta: float, comm: MPI.Comm) -> npt.NDArray[np.int32]:
    """A small set of cells with the share θ of Σ η_T² (collective).

    Args:
        indicator: η_T of the owned cells.
        theta: Between 0 and 1; 1 takes all cells.
        comm: Communicator of the mesh.

    Returns:
        Owned cells with η_T above a threshold that is the same on all ranks; all if a square of η_T is no float.
    """
    squares = indicator**2
    wanted = theta * comm.allreduce(squares.sum())
    high = comm.allreduce(squares.max(initial=0.0), MPI.MAX)
    if theta >= 1 or high == 0 or not np.isfinite(high):
        return np.arange(len(squares), dtype=np.int32)
    low = NEGLIGIBLE * high
    while high > (1 + SAME) * low:
        middle = np.sqrt(low * high)
        if comm.allreduce(squares[squares >= middle].sum()) >= wanted:
            low = middle
        else:
            high = middle
    return np.flatnonzero(squares >= low).astype(np.int32)


def refine(domain: Domain, cells: npt.NDArray[np.int32]) -> Domain:
    """Halve all edges of some cells, and other edges as needed for conformity, by longest-edge bisection (collective).

    New vertices on curved boundary parts of named shapes move to the curve; a mesh from a file keeps its polygon or
    polyhedron. Parts and regions are inherited. Both sides of an inner part are refined alike. The refined mesh is
    distributed anew.

    Args:
        domain: The domain to refine.
        cells: Owned cells to refine.

    Raises:
        NumericalFailure: If moving the vertices to a curved boundary would flatten or invert a cell.
    """
    mesh = domain.mesh
    dim = mesh.topology.dim
    pairs = [facet_pairs(domain, name) for name in domain.parts if other_side(name) in domain.parts]
    named, across = (np.concatenate([NONE, *some]) for some in ([pair[side] for pair in pairs] for side in (0, 1)))
    mesh.topology.create_entities(1)
    mesh.topology.create_connectivity(dim, 1)
    edges = dolfinx.mesh.compute_incident_entities(mesh.topology, cells, dim, 1)
    fine, parent_cell, parent_facet = _bisected(mesh, edges)
    boundary, children, behind = _boundary_facets(mesh, fine, parent_cell, parent_facet)
    while mesh.comm.allreduce(bool(len(uneven := _uneven(fine, boundary, children, named, across))), MPI.LOR):
        more = uneven if dim == 2 else dolfinx.mesh.compute_incident_entities(mesh.topology, uneven, 2, 1)
        edges = np.union1d(edges, more).astype(np.int32)
        fine, parent_cell, parent_facet = _bisected(mesh, edges)
        boundary, children, behind = _boundary_facets(mesh, fine, parent_cell, parent_facet)
    nodes = fine.geometry.index_map()

    def vertices(local: npt.NDArray[np.int32], columns: int) -> Indices:
        return nodes.local_to_global(local.ravel()).reshape(-1, columns)

    of_parts = {
        name: np.sort(vertices(children[np.isin(boundary, f)], dim), axis=1) for name, f in domain.facets.items()
    }
    points, children_of_cells = fine.geometry.x[: nodes.size_local, :dim], vertices(cell_nodes(fine), dim + 1)
    together = None
    if pairs or domain.together:
        places = np.sort(fine.geometry.x[children], axis=1).sum(axis=1)
        sides = [np.flatnonzero(np.isin(boundary, facets)) for facets in (named, across)]
        together = np.stack([behind[rows[np.lexsort(places[rows].T)]] for rows in sides], axis=1).astype(np.int64)
        at_pairs = [np.concatenate([domain.facets[part] for part in names]) for names in domain.together]
        groups = [behind[np.isin(boundary, facets)] for facets in at_pairs]
        first = fine.topology.index_map(dim).local_range[0]
        together = np.concatenate([together + first, brought_together(mesh.comm, [first + cells for cells in groups])])
    refined = distribute(mesh.comm, points, children_of_cells, dim, together=together)
    there = marked(refined, of_parts, membership(domain)[parent_cell], domain.regions)
    return descendant(domain, there, "refined where the error is")


def _uneven(
    fine: dolfinx.mesh.Mesh,
    boundary: npt.NDArray[np.int32],
    children: npt.NDArray[np.int32],
    named: npt.NDArray[np.int32],
    across: npt.NDArray[np.int32],
) -> npt.NDArray[np.int32]:
    """The inner facets that are not cut alike on both sides, by their sides.

    Args:
        fine: The refined mesh.
        boundary: The parent of each refined facet.
        children: The nodes of each refined facet.
        named: The facets of the named sides.
        across: Those that lie on them.
    """
    number = max(named.max(initial=0), across.max(initial=0), boundary.max(initial=0)) + 1
    places = (fine.geometry.x[children].sum(axis=1) @ OBLIQUE) ** 2
    count, size = (np.bincount(boundary, some, number) for some in (np.ones_like(places), places))
    apart = np.abs(size[named] - size[across]) > ROUNDING * size[named]
    uneven = apart | (count[named] != count[across])
    return np.concatenate([named[uneven], across[uneven]])


def descendant(domain: Domain, there: Mapping[str, Any], made: str, coarser: Domain | None = None) -> Domain:
    """A domain on a refined mesh; the vertices of curved boundary parts move there (collective).

    Args:
        domain: What was refined.
        there: The refined mesh with its parts and regions, see `marked`.
        made: How it was made, in words.
        coarser: The domain again if it was refined uniformly.

    Raises:
        NumericalFailure: If moving the vertices would flatten or invert a cell.
    """
    refined = replace(domain, made=made, coarser=coarser, changed="", **there)
    mesh = refined.mesh
    nearest = {name: part.nearest for name, part in domain.parts.items() if part.nearest is not None}
    if not nearest:
        return refined
    before, dim = _volumes(mesh), mesh.topology.dim
    for name, moved in nearest.items():
        nodes = dolfinx.mesh.entities_to_geometry(mesh, dim - 1, refined.facets[name])
        listed = sums_at(mesh.geometry.index_map(), nodes) > 0  # by any rank
        mesh.geometry.x[listed] = moved(mesh.geometry.x[listed].T).T
    if not mesh.comm.allreduce(bool(np.all(_volumes(mesh) / before > FLAT)), MPI.LAND):
        raise NumericalFailure("new vertices on a curved boundary would flatten a cell; start from a finer mesh")
    return replace(refined, h=largest_diameter(mesh))


def _bisected(
    mesh: dolfinx.mesh.Mesh, edges: npt.NDArray[np.int32]
) -> tuple[dolfinx.mesh.Mesh, npt.NDArray[np.int32], npt.NDArray[np.int8]]:
    """Halve these edges, and others as needed, without moving vertices (collective).

    Returns:
        The refined mesh, with cells on the ranks of their parents; the parent of each cell; and for each facet of each
        cell the facet of the parent that contains it, or −1. Facet i is opposite to vertex i.
    """
    dim = mesh.topology.dim
    x, origin = mesh.geometry.x.copy(), bounding_box(mesh.geometry.x, mesh.comm)[0]
    try:
        mesh.geometry.x[:] = (x - origin) @ SKEW
        fine, parent_cell, parent_facet = fenicsx.bisected(mesh, edges)
        corners = _corners(mesh)
    finally:
        mesh.geometry.x[:] = x
    parents, children = _affine(corners[parent_cell]), _affine(_corners(fine))
    barycentric = np.round(2 * np.linalg.solve(parents, children).transpose(0, 2, 1)) / 2
    fine.geometry.x[cell_nodes(fine), :dim] = barycentric @ _corners(mesh)[parent_cell]
    return fine, parent_cell, parent_facet


def _corners(mesh: dolfinx.mesh.Mesh) -> Array:
    """Vertices of the owned cells, shape (cells, dim + 1, dim)."""
    return mesh.geometry.x[cell_nodes(mesh), : mesh.topology.dim]


def _affine(corners: Array) -> Array:
    """Per cell the matrix with a column (x, 1) for each vertex x."""
    return np.concatenate([corners, np.ones_like(corners[:, :, :1])], axis=2).transpose(0, 2, 1)


def _volumes(mesh: dolfinx.mesh.Mesh) -> Array:
    """Signed volumes of the cells, up to a factor."""
    x = _corners(mesh)
    return determinants(x[:, 1:] - x[:, :1])


def _boundary_facets(
    mesh: dolfinx.mesh.Mesh,
    fine: dolfinx.mesh.Mesh,
    parent_cell: npt.NDArray[np.int32],
    parent_facet: npt.NDArray[np.int8],
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32], npt.NDArray[np.intp]]:
    """Refined facets on the boundary: the parent facet of each, its nodes, shape (facets, dim), and its cell."""
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim, dim - 1)
    facets = mesh.topology.connectivity(dim, dim - 1).array.reshape(-1, dim + 1)
    cells, opposite = np.nonzero(parent_facet >= 0)
    parents = facets[parent_cell[cells], parent_facet[cells, opposite]]
    outside = np.isin(parents, dolfinx.mesh.exterior_facet_indices(mesh.topology))
    nodes = cell_nodes(fine)[cells[outside]]
    others = nodes[np.arange(dim + 1) != opposite[outside, None]]
    return parents[outside], others.reshape(-1, dim), cells[outside]
