"""What a pair of surfaces passes on between the vertices of master facets, which the stresses there do not balance.

Let t = χ_*(−σ_h n) be the traction that slave facets pass on to a master facet e: on the image of each piece it is
linear, and elsewhere 0. σ_h has the tractions Π₁t there, so that r = t − Π₁t is orthogonal to linear fields on e.

The cell T behind e is cut into cells K that are small at e. On each facet k ⊂ e of these r = Π_k r + s, with the
projection Π_k to linear fields on k. Let z be the stress of Johnson and Mercier of least norm on these cells with ∇·z =
0, zn = Π_k r on each k and zn = 0 on the other facets of T. As s is orthogonal to linear fields on each k,

    ⟨r, w⟩_e = (z, ε(w))_T + Σ_k ⟨s, w⟩_k ≤ (‖z‖_T + (Σ_k a t_K² ‖s‖_k²)^½) |w|_T

with t_K of `korn` and the largest eigenvalue a of 𝔸. All integrals are exact: pieces are cut at the facets k.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.fenicsx import bisected
from signorini_fenicsx.base.owned import cell_nodes
from signorini_fenicsx.discrete.linear_traces import linear_values
from signorini_fenicsx.discrete.overlay import Pieces, common_parts
from signorini_fenicsx.discrete.simplices import facet_normals, opposite
from signorini_fenicsx.meshes.domain import distribute
from signorini_fenicsx.meshes.refinement import OBLIQUE
from signorini_fenicsx.physics.elasticity.bound.korn import trace_constants
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import Cells, compliance_product, reference
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces

ROUNDS = {2: 4, 3: 2}
"""How often the edges of the facet are halved, by dimension."""
HIDDEN = 1e-14
"""‖s‖² is at least this share of the square of t, as rounding may hide so much; the bound is the same on all ranks."""
AT_ONCE = {2: 100, 3: 10}
"""Cells whose systems are in memory at the same time."""


@dataclass(frozen=True)
class FineCells:
    """The reference simplex cut into cells that are small at the facet opposite to its last vertex.

    Attributes:
        hats: The hats of its vertices at the vertices of the cells, shape (cells, d + 1, d + 1).
        blocks: The facets of the cells by their numbers, shape (cells, d + 1).
        on: Those on that facet, by cell and number in it, shape (facets, 2).
    """

    hats: Array
    blocks: Indices
    on: Indices


@lru_cache
def fine_cells(dim: int) -> FineCells:
    """The cells in this dimension."""
    points = np.vstack([np.zeros(dim), np.eye(dim)])
    mesh = distribute(MPI.COMM_SELF, points, np.arange(dim + 1)[None], dim)
    for _ in range(ROUNDS[dim]):
        mesh.topology.create_entities(1)
        near = dolfinx.mesh.locate_entities(mesh, dim - 1, lambda x: np.abs(x[dim - 1]) < 1e-9)
        mesh.topology.create_connectivity(dim - 1, 1)
        edges = dolfinx.mesh.compute_incident_entities(mesh.topology, near, dim - 1, 1)
        mesh, _, _ = bisected(mesh, edges)
    numbers = np.sort(cell_nodes(mesh), axis=1)
    x = mesh.geometry.x[numbers, :dim]
    facets = numbers[:, opposite(dim)]
    _, blocks = np.unique(facets.reshape(-1, dim), axis=0, return_inverse=True)
    on = np.argwhere((np.abs(x[:, opposite(dim), dim - 1]) < 1e-9).all(axis=2))
    hats = np.concatenate([1 - x.sum(axis=2, keepdims=True), x], axis=2)
    return FineCells(hats, blocks.reshape(len(numbers), dim + 1), on)


def passed_on(spaces: ElasticSpaces, data: ElasticData, stresses: Array, compliance: Array) -> Array:
    """How large ⟨r, w⟩ may be beside |w|_T for each owned cell; both sides of a piece are on one rank (collective).

    Args:
        spaces: The spaces.
        data: The data.
        stresses: Values of σ_h, as in `SplitMesh.values`.
        compliance: On each owned cell a matrix that is at least 𝔸 there, shape (cells, entries, entries).
    """
    of_cells = np.zeros(len(spaces.order))
    if not spaces.joints:
        return of_cells
    tractions = data.pulled - spaces.tractions(spaces.contact, stresses)
    for joint in spaces.joints:
        masters, rows = spaces.boundary_facets(joint.masters), joint.pieces.master - joint.first
        order = np.argsort(masters.vertices @ OBLIQUE[: spaces.dim], axis=1)  # the same on any number of ranks
        on_master = np.take_along_axis(joint.pieces.on_master, order[rows][:, None], axis=2)
        pieces = replace(joint.pieces, master=rows, on_master=on_master)
        behind = spaces.vertices[masters.cells]
        apex = behind[np.arange(len(behind)), masters.local]
        facets = np.take_along_axis(masters.vertices, order[:, :, None], axis=1)
        vertices = np.concatenate([facets, apex[:, None]], axis=1)
        of_facets = _oscillation(pieces, tractions[spaces.rows_of(joint)], vertices, compliance[masters.cells])
        np.add.at(of_cells, masters.cells, of_facets)
    return of_cells


def _oscillation(pieces: Pieces, tractions: Array, vertices: Array, compliance: Array) -> Array:
    """What ⟨r, w⟩ on each master facet is at most beside |w| in the cell behind it, shape (masters,).

    Args:
        pieces: Of the slave facets, with rows of these master facets.
        tractions: −σ_h n at the vertices of slave facets, shape (slaves, d, d).
        vertices: Of the cells behind the master facets, those of the facet first, shape (masters, d + 1, d).
        compliance: A matrix that is at least 𝔸 in each of these, shape (masters, entries, entries).
    """
    count, dim, fine = len(vertices), vertices.shape[2], fine_cells(vertices.shape[2])
    at_corners = np.einsum("pca,pai->pci", pieces.on_slave, tractions[pieces.slave]) / pieces.stretch[:, None, None]
    projected = _fitted(_moments(pieces.on_master, at_corners, pieces.master, count))
    corners = fine.hats[fine.on[:, 0, None], opposite(dim)[fine.on[:, 1]]][:, :, :dim]
    number, share = len(corners), np.abs(np.linalg.det(corners))
    which, small = (each.ravel() for each in np.indices((len(pieces), number)))
    rows, inside = common_parts(pieces.on_master[which], corners[small])
    which, small = which[rows], small[rows]
    values = inside @ np.linalg.inv(pieces.on_master[which]) @ at_corners[which]
    place, local = pieces.master[which] * number + small, inside @ np.linalg.inv(corners[small])
    moments = _moments(local, values, place, count * number)
    squares = _squares(local, values, place, count * number)
    rest = squares - np.einsum("nai,nai->n", _fitted(moments), moments)
    rest = np.maximum(rest, HIDDEN * squares).reshape(count, number)
    mass = (1 + np.eye(dim)) / (dim * (dim + 1))
    moments = moments.reshape(count, number, dim, dim) - mass @ np.einsum("kca,nai->nkci", corners, projected)
    sizes = np.linalg.norm(facet_normals(vertices)[:, -1], axis=1)[:, None] * share
    norms = np.zeros(count)
    for start in range(0, count, AT_ONCE[dim]):
        some = slice(start, start + AT_ONCE[dim])
        loads = sizes[some, :, None, None] * moments[some]
        norms[some] = _norms(fine, vertices[some], compliance[some], loads, sizes[some] * rest[some])
    return norms


def _fitted(moments: Array) -> Array:
    """The values at the vertices of linear functions on facets of measure 1 from ∫ φ_a w."""
    return linear_values(moments, np.ones(len(moments)))


def _moments(corners: Array, values: Array, place: Indices, size: int) -> Array:
    """∫ φ_a w over facets of measure 1 for linear w on simplices with these corners, shape (size, d, …)."""
    dim = corners.shape[1]
    mass = np.abs(np.linalg.det(corners))[:, None, None] * (1 + np.eye(dim)) / (dim * (dim + 1))
    sums = np.zeros((size, dim, values.shape[2]))
    np.add.at(sums, place, np.einsum("nca,ncd,ndi->nai", corners, mass, values))
    return sums


def _squares(corners: Array, values: Array, place: Indices, size: int) -> Array:
    """∫ |Σ w|² over facets of measure 1 for linear w on simplices, which may overlap."""
    dim = corners.shape[1]
    order = np.argsort(place, kind="stable")
    starts = np.searchsorted(place[order], np.arange(size + 1))
    squares = np.zeros(size)
    longest = int(np.diff(starts).max(initial=0))
    for ahead in range(longest):
        one = np.arange(len(order) - ahead)
        one = one[place[order[one]] == place[order[one + ahead]]]
        i, j = order[one], order[one + ahead]
        rows, inside = common_parts(corners[i], corners[j])
        i, j = i[rows], j[rows]
        first, second = (np.einsum("nca,nai->nci", inside @ np.linalg.inv(corners[k]), values[k]) for k in (i, j))
        mass = np.abs(np.linalg.det(inside))[:, None, None] * (1 + np.eye(dim)) / (dim * (dim + 1))
        np.add.at(squares, place[i], (1 if ahead == 0 else 2) * np.einsum("nci,ncd,ndi->n", first, mass, second))
    return squares


def _norms(fine: FineCells, vertices: Array, compliance: Array, moments: Array, rest: Array) -> Array:
    """‖z‖ and what the rest adds, of some cells.

    Args:
        fine: How they are cut.
        vertices: Theirs.
        compliance: Theirs.
        moments: ∫ φ_a r over the small facets, shape (cells, facets, d, d).
        rest: ‖s‖² on these.
    """
    dim, number, count = vertices.shape[2], len(fine.hats), len(vertices)
    cells = Cells(np.einsum("mva,nai->nmvi", fine.hats, vertices).reshape(-1, dim + 1, dim))
    element = reference(dim)
    free = slice(None, element.free)
    hats = (1 + np.eye(dim + 1)) / ((dim + 1) * (dim + 2))
    masses = np.einsum("ab,nij->naibj", hats, compliance).reshape(count, *[(dim + 1) * compliance.shape[1]] * 2)
    masses = (cells.measure / (dim + 1))[:, None, None, None] * np.repeat(masses, number, axis=0)[:, None]
    masses = np.broadcast_to(masses, (len(masses), dim + 1, *masses.shape[2:]))
    stresses = cells.stresses(element.stresses[:, :, free])
    through = cells.tractions(element.tractions)[:, :, free]
    matrices = through @ np.linalg.solve(compliance_product(stresses, masses), through.swapaxes(1, 2))
    matrices = matrices.reshape(count, number, *matrices.shape[1:])
    size = dim**2
    unknowns = (fine.blocks[:, :, None] * size + np.arange(size)).reshape(number, -1)
    total = size * (fine.blocks.max() + 1)
    system, load = np.zeros((count, total, total)), np.zeros((count, total))
    for cell, own in enumerate(unknowns):
        system[:, own[:, None], own] += matrices[:, cell]
    first = np.arange(size)
    system[:, first, first] += matrices.diagonal(axis1=2, axis2=3).mean(axis=(1, 2))[:, None]  # holds it; no force
    blocks = fine.blocks[fine.on[:, 0], fine.on[:, 1]]
    load.reshape(count, -1, dim, dim)[:, blocks] = moments
    x = np.linalg.solve(system, load[:, :, None])[:, :, 0]
    squares = np.maximum(np.einsum("ni,ni->n", load, x), 0.0)
    behind = cells.derivative.reshape(count, number, dim, dim)[:, fine.on[:, 0]].reshape(-1, dim, dim)
    normals = facet_normals(cells.vertices).reshape(count, number, dim + 1, dim)[:, fine.on[:, 0], fine.on[:, 1]]
    constants = trace_constants(behind, np.linalg.norm(normals, axis=2).ravel()).reshape(rest.shape)
    softest = np.linalg.eigvalsh(compliance)[:, -1]
    return np.asarray(np.sqrt(squares) + np.sqrt(softest * (constants**2 * rest).sum(axis=1)))
