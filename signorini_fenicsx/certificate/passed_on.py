"""What a pair of surfaces passes on between the vertices of master facets, which the fields there do not balance.

The fields are stresses or fluxes, of order two; |w| is ‖ε(w)‖ or ‖∇w‖ of displacements or of a scalar w, and the norm
of fields ‖z‖² = (𝔸z, z), with κ⁻¹ for 𝔸.

Let t = χ_*(−σ_h n) be what slave facets pass on to a master facet e: on the image of each piece it is linear, and
elsewhere 0. σ_h n is Π₁t there, so that r = t − Π₁t is orthogonal to linear fields on e.

The cell T behind e is cut like a lattice, an edge into n parts, and so is e. On each small facet k let r = Π_k r + s,
with the projection Π_k to linear fields on k. There is a field z of the element on the lattice with ∇·z = 0, zn = Π_k r
on each k and zn = 0 on the other facets of T, as Π_k r has neither force nor moment on e. Over each k stands one cell K
of the lattice, and s is orthogonal to linear fields on k. So it has again such a z_k on the lattice of K, which is 0
outside of K, and so on. Where the cutting ends, at any k, a constant t_K bounds what is left. So

    ⟨r, w⟩_e = (z + Σ z_k + …, w)_T + Σ ⟨s, w⟩_k ≤ (‖z‖ + (Σ ‖z_k‖²)^½ + … + (Σ t_K² ‖s‖_k²)^½) |w|_T,

where (z, w) is (z, ε(w)) or (z, ∇w). All integrals of r are exact: pieces are cut at the facets k.

*The lattice.* Let v₀, …, v_d be the vertices of T, those of e first, and E the matrix of the edges v_k − v_{k−1}. Then
T = v₀ + E T̂ with Kuhn's simplex T̂ = {1 ≥ x₁ ≥ … ≥ x_d ≥ 0}. The planes where nx_i or n(x_i − x_j) are whole numbers
cut it into n^d simplices, whose edges from one vertex to the next are those of a cube, in any order. That along x_d is
the last one over e, where x_d = 0. So K is again v + E_K T̂ with the columns of E/n for E_K, the first d − 1 in another
order: one ẑ for each load on T̂ serves all cells and levels. z = Eẑ Eᵀ/|det E|, or Eẑ/|det E| of a flux, has the norm
of ẑ with a matrix that E and 𝔸 give, so that quadratic forms of ẑ, made once, give ‖z‖ for all loads. ẑ is least for
𝔸 = I on T̂; any ẑ bounds.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Self

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, LinearTraces, linear_values, opposite
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.overlay import common_parts
from signorini_fenicsx.discrete.pairing import MeshPair
from signorini_fenicsx.meshes.refinement import OBLIQUE

PARTS = {2: 8, 3: 4}
"""n, by dimension."""
LEVELS = 3
"""How often facets are cut,"""
SHARE = 1e-5
"""if t_K² ‖s‖² is more than this share of the largest of all master facets."""
HIDDEN = 1e-14
"""‖s‖² is at least this share of the square of t, as rounding may hide so much; the bound is the same on all ranks."""
SHORTER = 1e-9
"""Of paths whose squares differ by this share the first one is taken, which does not depend on the ranks."""


@dataclass(frozen=True)
class LatticeFields:
    """The basis of divergence 0 of an element on the cells of the lattice, in any order of its entries.

    Attributes:
        values: In some nodes of each cell, shape (cells, nodes, entries, basis).
        masses: ∫ of the products of two functions of the nodes, shape (nodes, nodes); it is the same for all cells.
        through: ⟨φ_a, zn⟩ over the facets for the hats of their vertices, shape (cells, facets d components, basis).
    """

    values: Array
    masses: Array
    through: Array


@dataclass(frozen=True)
class LatticeResponse(ABC):
    """Fields on the lattice of Kuhn's simplex for loads on its facet x_d = 0.

    Attributes:
        corners: Of the small facets, by barycentric coordinates, shape (facets, d, d).
        turned: The edges of the path in the cell over each, as columns, shape (facets, d, d).
        products: ∫ ẑ_a ẑ'_b of their entries a, b, for the moments of loads with the hats of the vertices of the small
            facets, shape (entries, entries, loads, loads).
    """

    corners: Array
    turned: Array
    products: Array

    @classmethod
    def of(cls, dim: int, fields: LatticeFields) -> Self:
        """The response by the fields of an element on `kuhn_lattice` with `PARTS` (collective of nothing)."""
        parts, places = PARTS[dim], kuhn_lattice(dim, PARTS[dim])
        products = np.einsum("cmeb,mn,cned->cbd", fields.values, fields.masses, fields.values, optimize=True)
        of_traces = np.linalg.solve(products, fields.through.swapaxes(1, 2))
        nodes = places @ (parts + 1) ** np.arange(dim)
        _, blocks = np.unique(nodes[:, opposite(dim)].reshape(-1, dim), axis=0, return_inverse=True)
        size = fields.through.shape[1] // (dim + 1)
        unknowns = (blocks.reshape(len(places), dim + 1, 1) * size + np.arange(size)).reshape(len(places), -1)
        system = np.zeros((size * (blocks.max() + 1),) * 2)
        for own, matrix in zip(unknowns, fields.through @ of_traces, strict=True):
            system[own[:, None], own] += matrix
        system[:size, :size] += np.trace(system) / len(system) * np.eye(size)  # holds it; no force
        on = np.flatnonzero((places[:, :dim, -1] == 0).all(axis=1))
        loaded = unknowns[on][:, -size:].ravel()
        traces = np.linalg.solve(system, np.eye(len(system))[:, loaded])
        z = np.einsum("cmeb,cbl->ecml", fields.values, of_traces @ traces[unknowns], optimize=True)
        weighted = np.einsum("mn,ecnl->ecml", fields.masses, z)
        of_entries = (len(z), -1, len(loaded))
        between = z.reshape(of_entries).swapaxes(1, 2)[:, None] @ weighted.reshape(of_entries)
        turned = np.diff(places[on], axis=1).swapaxes(1, 2) / parts
        return cls(hats_on_facet(places[on, :dim] / parts), turned, between)

    @abstractmethod
    def weights(self, edges: Array, compliance: Array) -> Array:
        """What the entries of ẑ have for 𝔸 in cells with these E, shape (cells, entries, entries)."""

    @abstractmethod
    def pulled(self, edges: Array, moments: Array) -> Array:
        """The moments of loads on T̂ from those on cells, shape (cells, facets, d, components)."""

    @abstractmethod
    def constants(self, edges: Array, compliance: Array, sizes: Array) -> Array:
        """t_K² of cells with these E and facets of these measures."""

    def squares(self, edges: Array, compliance: Array, moments: Array) -> Array:
        """‖z‖² in some cells, shape (cells,).

        Args:
            edges: E of each, shape (cells, d, d).
            compliance: A matrix that is at least 𝔸 in each of these, shape (cells, entries, entries).
            moments: ∫ φ_a r over the small facets, shape (cells, facets, d, components).
        """
        weights = self.weights(edges, compliance)
        loads = self.pulled(edges, moments).reshape(len(edges), self.products.shape[2])
        squares = np.zeros(len(edges))
        for a, b in zip(*np.triu_indices(weights.shape[1]), strict=True):
            squares += (1 + (a < b)) * weights[:, a, b] * np.einsum("ni,ni->n", loads @ self.products[a, b], loads)
        return np.maximum(squares, 0.0)


def kuhn_lattice(dim: int, parts: int) -> Indices:
    """The vertices of the cells of Kuhn's simplex times a number of parts, shape (cells, d + 1, d)."""
    starts = np.array(list(product(range(parts), repeat=dim)))
    steps = np.array([np.eye(dim, dtype=np.int64)[list(order)] for order in permutations(range(dim))])
    walks = np.concatenate([np.zeros_like(steps[:, :1]), steps.cumsum(axis=1)], axis=1)
    places = (starts[:, None, None] + walks).reshape(-1, dim + 1, dim)
    return np.asarray(places[(np.diff(places, axis=2) <= 0).all(axis=(1, 2))])


def hats_on_facet(x: Array) -> Array:
    """The hats of the first d vertices of Kuhn's simplex in points where x_d = 0."""
    return np.concatenate([1 - x[..., :1], x[..., :-1] - x[..., 1:]], axis=-1)


def passed_on(
    spaces: LinearTraces, flows: Iterator[tuple[MeshPair, Array]], compliance: Array, response: LatticeResponse
) -> Array:
    """How large ⟨r, w⟩ may be beside |w|_T for each owned cell; both sides of a piece are on one rank (collective).

    Args:
        spaces: The spaces.
        flows: For each pair −σ_h n at the vertices of its slave facets, shape (slaves, d, components).
        compliance: On each owned cell a matrix that is at least 𝔸 there, shape (cells, entries, entries).
        response: Of the element.
    """
    of_cells = np.zeros(len(spaces.order))
    for pair, flow in flows:
        masters, pieces = spaces.boundary_facets(pair.masters), pair.pieces
        order, edges = _paths(spaces, masters)
        rows = pieces.master - pair.first
        on_master = np.take_along_axis(pieces.on_master, order[rows][:, None], axis=2)
        values = pieces.on_slave @ flow[pieces.slave] / pieces.stretch[:, None, None]
        passed = Passed(rows, on_master, values).checked(len(edges))
        of_facets = oscillation(spaces.mesh.comm, passed, edges, compliance[masters.cells], response)
        np.add.at(of_cells, masters.cells, of_facets)
    return of_cells


def pairs_without_bound(spaces: MeshSpaces) -> str:
    """Why there is no bound for the pairs of surfaces, in words; empty if there is one (collective)."""
    for pair in spaces.pairs:
        rows = pair.pieces.master - pair.first
        elsewhere = bool(((rows < 0) | (rows >= len(pair.masters))).any())
        if spaces.mesh.comm.allreduce(elsewhere, MPI.LOR):
            return (
                f"both sides of the pair {pair.parts.words} have to be on one process for it; give these parts as "
                "`pairs` where the domain is made, or run on one process"
            )
    return ""


def _paths(spaces: LinearTraces, masters: BoundaryFacets) -> tuple[Indices, Array]:
    """The vertices of master facets in the order of the shortest path over them to the vertex behind, and E."""
    rows, behind = np.arange(len(masters.cells)), spaces.vertices[masters.cells]
    by_place = np.argsort(masters.vertices @ OBLIQUE[: spaces.dim], axis=1)  # the same on any number of ranks
    orders = by_place[:, list(permutations(range(spaces.dim)))]
    facets = masters.vertices[rows[:, None, None], orders]
    apex = np.broadcast_to(behind[rows, masters.local][:, None, None], (*facets.shape[:2], 1, spaces.dim))
    edges = np.diff(np.concatenate([facets, apex], axis=2), axis=2)
    squares = (edges**2).sum(axis=(2, 3))
    best = (squares <= (1 + SHORTER) * squares.min(axis=1, keepdims=True)).argmax(axis=1)
    return orders[rows, best], edges[rows, best].swapaxes(1, 2)


@dataclass(frozen=True)
class Passed:
    """Tractions on facets, linear on simplices, which may overlap.

    Attributes:
        place: The facet of each simplex.
        corners: Of each, by barycentric coordinates on its facet, shape (simplices, d, d).
        values: In these, shape (simplices, d, components).
        overlaps: Whether some overlap.
    """

    place: Indices
    corners: Array
    values: Array
    overlaps: bool = True

    def on_parts(self, corners: Array) -> "Passed":
        """The same on the parts of facets, each with so many and these corners; those of a facet one after another."""
        number = len(corners)
        which, part = (each.ravel() for each in np.indices((len(self.place), number)))
        rows, inside = common_parts(self.corners[which], corners[part])
        which, part = which[rows], part[rows]
        values = inside @ np.linalg.inv(self.corners[which]) @ self.values[which]
        place, inside = self.place[which] * number + part, inside @ np.linalg.inv(corners[part])
        return Passed(place, inside, values, self.overlaps)

    def moments(self, facets: int) -> Array:
        """∫ φ_a t over facets of measure 1, shape (facets, d, components)."""
        dim = self.corners.shape[1]
        mass = np.abs(np.linalg.det(self.corners))[:, None, None] * (1 + np.eye(dim)) / (dim * (dim + 1))
        sums = np.zeros((facets, dim, self.values.shape[2]))
        np.add.at(sums, self.place, np.einsum("nca,ncd,ndi->nai", self.corners, mass, self.values))
        return sums

    def squares(self, facets: int) -> Array:
        """∫ |t|² over facets of measure 1."""
        return sum((squares for squares, _ in self._products(facets)), np.zeros(facets))

    def checked(self, facets: int) -> "Passed":
        """The same, that knows whether some overlap."""
        return replace(self, overlaps=any(number > 0 for _, number in list(self._products(facets))[1:]))

    def _products(self, facets: int) -> Iterator[tuple[Array, int]]:
        """∫ t·t' of each with itself, then twice with the next one on its facet, and so on; and of how many it is."""
        dim, corners, values = self.corners.shape[1], self.corners, self.values
        order = np.argsort(self.place, kind="stable")
        for ahead in range(int(np.bincount(self.place, minlength=1).max()) if self.overlaps else 1):
            one = np.arange(len(order) - ahead)
            one = one[self.place[order[one]] == self.place[order[one + ahead]]]
            i, j = order[one], order[one + ahead]
            rows, inside = common_parts(corners[i], corners[j])
            i, j = i[rows], j[rows]
            first, second = (np.einsum("nca,nai->nci", inside @ np.linalg.inv(corners[k]), values[k]) for k in (i, j))
            mass = np.abs(np.linalg.det(inside))[:, None, None] * (1 + np.eye(dim)) / (dim * (dim + 1))
            squares = (1 if ahead == 0 else 2) * np.einsum("nci,ncd,ndi->n", first, mass, second)
            yield np.bincount(self.place[i], squares, facets), len(i)


def oscillation(comm: MPI.Comm, passed: Passed, edges: Array, compliance: Array, response: LatticeResponse) -> Array:
    """What ⟨r, w⟩ on each master facet is at most beside |w| in the cell behind it, shape (masters,) (collective).

    Args:
        comm: Communicator.
        passed: t.
        edges: E of the cells behind the master facets, shape (masters, d, d).
        compliance: A matrix that is at least 𝔸 in each of these, shape (masters, entries, entries).
        response: Of the element.
    """
    count, dim, components = len(edges), edges.shape[1], passed.values.shape[2]
    mass, number, largest = (1 + np.eye(dim)) / (dim * (dim + 1)), len(response.corners), np.inf
    norms, rest, of = np.zeros(count), np.zeros(count), np.arange(count)  # the master facet of each facet
    for level in range(LEVELS + 1):
        moments, squares = passed.moments(len(of)), passed.squares(len(of))
        linear = linear_values(moments, np.ones(len(of)))
        left = np.maximum(squares - np.einsum("nai,nai->n", linear, moments), HIDDEN * squares)
        along = edges[:, :, : dim - 1]
        sizes = np.sqrt(np.linalg.det(along.swapaxes(1, 2) @ along)) / (dim - 1)
        bounds = response.constants(edges, compliance[of], sizes) * sizes * left
        if level == 0:
            largest = comm.allreduce(float(bounds.max(initial=0.0)), MPI.MAX)
        cut = (bounds > SHARE * largest) & (level < LEVELS)
        rest += np.bincount(of[~cut], bounds[~cut], count)
        there, rows = cut[passed.place], np.flatnonzero(cut)
        place = np.searchsorted(rows, passed.place[there])
        passed = Passed(place, passed.corners[there], passed.values[there], passed.overlaps).on_parts(response.corners)
        share = passed.moments(len(rows) * number).reshape(len(rows), number, dim, components)
        share = share - mass @ np.einsum("kca,nai->nkci", response.corners, linear[rows])
        loads = (sizes[rows] / number)[:, None, None, None] * share
        norms += np.sqrt(np.bincount(of[rows], response.squares(edges[rows], compliance[of[rows]], loads), count))
        edges = (edges[rows, None] @ response.turned).reshape(-1, dim, dim)
        of = np.repeat(of[rows], number)
    return norms + np.sqrt(rest)
