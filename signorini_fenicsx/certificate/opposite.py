"""Functions on slave facets that have to follow what is opposite to them: their nodes do, and what they lack between.

On a slave facet e let v₁ interpolate w = v₂∘χ in the points of the coefficients, and let r = w − v₁, a polynomial on
each piece. On the simplex S between e and the centroid c of the cell let s be the sum of the hats λ_i of the vertices
of e, and

    d = s r(τ),   τ_i = λ_i/s,

the value at the point of e that c sees behind x; elsewhere d = 0. In the plane r is 0 at the ends of e, so that d is
continuous if w is, and [v + d] = 0: v + d is admissible for surfaces that are tied, and if the nodes of v₁ have a jump
besides, [v + d] is this polynomial. Its gradient

    ∇d = r ⊗ ∇s + Σ ∂_i r ⊗ (∇λ_i − τ_i ∇s)

depends on τ alone, all of which have the same share of S as of e. So ‖∇d‖²_S, or ‖ε(d)‖²_S of a displacement, is |S|
times a mean over e, a sum over its pieces that is exact; so is ‖d‖²_S, as the mean of s² is dim/(dim + 2).

In space r is not 0 on an edge E of e. So on all other simplices S with the ends a, b of E

    d = Σ_E ρ r_E(τ),   ρ = λ_a + λ_b,   τ = λ_b/ρ,

over the slave edges E of S: a term is 0 on faces without E, and s r(τ) on that between E and c. Again

    ∇d = r ⊗ ∇ρ + r' ⊗ ((1 − τ)∇λ_b − τ∇λ_a)

depends on τ alone, all of which have the same share of S, so that a matrix for each edge gives all norms; the mean of
ρ² is 3/10. Where facets on which v is given or has a law, masters or slaves of another pair meet E, r has to be 0 in
what is given.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import basix
import numpy as np

from signorini_fenicsx.base.arrays import AnyIndices, Array, Indices
from signorini_fenicsx.base.owned import cell_nodes
from signorini_fenicsx.discrete.facet_coefficients import NOTHING, FacetCoefficients
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, LinearTraces, opposite
from signorini_fenicsx.discrete.overlay import Pieces
from signorini_fenicsx.discrete.pairing import MeshPair
from signorini_fenicsx.discrete.points import facet_type
from signorini_fenicsx.expressions.simplices import barycentric_gradients

SAME = 1e-7
"""Corners of pieces whose places on a facet differ by less are one."""


@dataclass(frozen=True)
class Opposite:
    """The two sides of a pair by the nodes of a continuous function.

    Attributes:
        slaves: The slave facets.
        masters: The master facets.
        pieces: The overlay, by rows of these.
        turns: Whether χ may jump at edges of slave facets, as these turn and are apart.
    """

    slaves: FacetCoefficients
    masters: FacetCoefficients
    pieces: Pieces
    turns: bool

    @classmethod
    def of(
        cls, pair: MeshPair, spaces: LinearTraces, slaves: FacetCoefficients, masters: FacetCoefficients
    ) -> "Opposite":
        """The two sides of a pair on all facets of both sides, or some; each piece is on one rank, and there or not."""
        pieces = pair.pieces.take(np.isin(pair.pieces.slave, slaves.rows))
        of = (slaves.rows, pieces.slave), (masters.rows, pieces.master - pair.first)
        rows = [np.searchsorted(some, each) for some, each in of]
        turned = np.ptp(pair.directions, axis=0).max(initial=0.0) > SAME if len(pair.slaves) else False
        apart = np.abs(pair.pieces.gap).max(initial=0.0) > SAME * spaces.length
        return cls(slaves, masters, replace(pieces, slave=rows[0], master=rows[1]), bool(turned and apart))

    def across(self, hats: Array) -> tuple[Indices, Array]:
        """The piece in which each of some points of slave facets is, and χ of it on its master facet.

        Args:
            hats: Barycentric coordinates of points on each slave facet, shape (facets, points, d).

        Returns:
            Of shape (facets, points), and barycentric coordinates of the shape of `hats`.
        """
        pieces, piece = self.pieces, np.zeros(hats.shape[:2], dtype=np.int64)
        local = hats[pieces.slave] @ np.linalg.inv(pieces.on_slave)
        for point, inside in enumerate(local.min(axis=2).T):
            order = np.argsort(inside, kind="stable")
            piece[pieces.slave[order], point] = order
        return piece, np.einsum(
            "fpc,fpca->fpa", local[piece, np.arange(hats.shape[1])], pieces.on_master[piece], optimize=True
        )

    def conditions(self, *, of_values: bool = False) -> tuple[Indices, Array]:
        """Nodes of each condition, its slave's first, and their weights, whose sum has to be 0, shape (n, nodes).

        They are for coefficients, or for values in the points of these.
        """
        slaves, pieces, hats = self.slaves, self.pieces, self.slaves.hats
        number = len(hats)
        piece, opposite = self.across(np.broadcast_to(hats, (len(slaves.rows), *hats.shape)))
        values = self.masters.basis(opposite[..., 1:].reshape(-1, hats.shape[1] - 1)).reshape(*piece.shape, number)
        to_coefficients, same = np.linalg.inv(slaves.basis(hats[:, 1:])), np.eye(number)
        own, other = (same, to_coefficients) if of_values else (to_coefficients, same)
        weights = np.einsum("jp,fpl->fjpl", own, values @ other)
        named, first = np.unique(slaves.nodes, return_index=True)
        facet, place = np.divmod(first, number)
        weights = weights[facet, place].reshape(len(named), number**2)
        nodes = self.masters.nodes[pieces.master[piece[facet]]].reshape(weights.shape)
        weights[np.abs(weights) < NOTHING] = 0.0
        most = max(1, (weights != 0).sum(axis=1).max(initial=0))
        order = np.argsort(weights == 0, axis=1, kind="stable")[:, :most]
        nodes, weights = np.take_along_axis(nodes, order, axis=1), np.take_along_axis(weights, order, axis=1)
        return np.column_stack([named, nodes]), np.column_stack([np.ones(len(named)), -weights])

    def following(self, values: Array) -> Array:
        """V at the nodes, with slaves as they follow their masters, shape (nodes, components)."""
        (nodes, weights), followed = self.conditions(), values.copy()
        followed[nodes[:, 0]] = -np.einsum("kn,kni->ki", weights[:, 1:], values[nodes[:, 1:]])
        return followed

    def jumps(self, values: Array) -> Array:
        """The coefficients of r on each piece, from v at the nodes, shape (pieces, coefficients, …)."""
        slaves, masters, pieces = self.slaves, self.masters, self.pieces
        of_w = np.einsum("pkl,pli->pki", masters.restricted(pieces.on_master), values[masters.nodes[pieces.master]])
        of_v = np.einsum("pkl,pli->pki", slaves.restricted(pieces.on_slave), values[slaves.nodes[pieces.slave]])
        return np.asarray(of_w - of_v)

    def on_edges(self, values: Array) -> Array:
        """∫ f⊗f over τ on the edges of slave facets in space, f = (r, r', r'τ), shape (facets, 3 edges, n, n).

        Edge t is opposite to vertex t of the facet, from its first vertex to its last one.
        """
        slaves, pieces, jumps = self.slaves, self.pieces, self.jumps(values)
        x, weights = basix.make_quadrature(basix.CellType.interval, 2 * slaves.degree)
        size = 3 * values.shape[1]
        products = np.zeros((len(slaves.rows), 3, size, size))
        for (i, j), t in product(combinations(range(3), 2), range(3)):
            rows = np.flatnonzero((pieces.on_slave[:, [i, j], t] < SAME).all(axis=1))
            last = max(set(range(3)) - {t})
            begin, end = pieces.on_slave[rows, i, last], pieces.on_slave[rows, j, last]
            points = np.eye(3)[i, 1:] + x * (np.eye(3)[j] - np.eye(3)[i])[1:]
            tau = begin[:, None] + x[:, 0] * (end - begin)[:, None]
            r = np.einsum("qk,pki->pqi", slaves.basis(points), jumps[rows])
            way = (np.eye(3)[j] - np.eye(3)[i])[1:]
            slope = np.einsum("m,mqk,pki->pqi", way, slaves.slopes(points), jumps[rows]) / (end - begin)[:, None, None]
            f = np.concatenate([r, slope, slope * tau[..., None]], axis=2)
            of_sides = np.einsum("p,q,pqa,pqb->pab", np.abs(end - begin), weights, f, f)
            np.add.at(products[:, t], pieces.slave[rows], of_sides)
        return products

    def lacking(self, values: Array, middles: Array) -> tuple[Array, float]:
        """‖∇d‖² or ‖ε(d)‖², and ‖d‖², behind each slave facet over the measure of S, and the largest jump of r.

        Args:
            values: v at the nodes, shape (nodes, components).
            middles: The centroids of the cells behind the facets, shape (facets, d).
        """
        slaves, pieces, dim, jumps = self.slaves, self.pieces, middles.shape[1], self.jumps(values)
        points, weights = basix.make_quadrature(facet_type(dim), 2 * slaves.degree)
        hats = np.column_stack([1 - points.sum(axis=1), points])
        tau = hats @ pieces.on_slave
        r = np.einsum("qk,pki->pqi", slaves.basis(points), jumps)
        along = np.einsum("jqk,pki->pqji", slaves.slopes(points), jumps)
        sides = pieces.on_slave[:, 1:, 1:] - pieces.on_slave[:, :1, 1:]
        along = np.einsum("pij,pqjk->pqik", np.linalg.inv(sides), along)  # by τ_1, …
        simplices = np.concatenate([slaves.facets.vertices, middles[:, None]], axis=1)
        gradients = barycentric_gradients(simplices)[pieces.slave, :dim]
        of_s = gradients.sum(axis=1)
        ways = gradients[:, None, 1:] - tau[:, :, 1:, None] * of_s[:, None, None]
        slopes = np.einsum("pqi,pj->pqij", r, of_s) + np.einsum("pqki,pqkj->pqij", along, ways)
        strains = slopes if values.shape[1] == 1 else (slopes + slopes.swapaxes(2, 3)) / 2
        sizes = np.einsum("q,pqij->p", weights / weights.sum(), strains**2)
        of_d = dim / (dim + 2) * np.einsum("q,pqi->p", weights / weights.sum(), r**2)
        at_corners = np.einsum("ck,pki->pci", slaves.basis(np.eye(dim)[:, 1:]), jumps)
        past = np.abs(np.where((pieces.on_slave.max(axis=2) > 1 - NOTHING)[:, :, None], at_corners, 0.0)).max(initial=0)
        places = np.column_stack([np.repeat(pieces.slave, dim), np.rint(pieces.on_slave.reshape(-1, dim) / SAME)])
        _, place = np.unique(places, axis=0, return_inverse=True)  # pieces meet there
        most, least = np.full((2, len(places), values.shape[1]), [[[-np.inf]], [[np.inf]]])
        np.maximum.at(most, place.ravel(), at_corners.reshape(len(places), values.shape[1]))
        np.minimum.at(least, place.ravel(), at_corners.reshape(len(places), values.shape[1]))
        past = max(past, np.where(np.isfinite(most), most - least, 0.0).max(initial=0.0), np.inf if self.turns else 0.0)
        squares = [np.bincount(pieces.slave, pieces.share * each, len(slaves.rows)) for each in (sizes, of_d)]
        return np.column_stack(squares), float(past)


def lacking(
    pairs: Sequence[tuple[Opposite, Array]], spaces: LinearTraces, given: Iterable[tuple[BoundaryFacets, Array]]
) -> tuple[Array, float]:
    """‖∇d‖² or ‖ε(d)‖², and ‖d‖², on the owned cells, and the largest jump of r on this rank (collective).

    The jump is one between pieces or facets, or on an edge beside a facet in a direction in which v is given there.

    Args:
        pairs: The pairs, each with v at the nodes, shape (nodes, components).
        spaces: The spaces.
        given: Facets, and a direction on each, shape (facets, components).
    """
    dim, components, largest = spaces.dim, pairs[0][1].shape[1] if pairs else 1, 0.0
    size = 3 * components
    squares = np.zeros((len(spaces.order), dim + 1, 2))
    edges = [(np.empty(0, dtype=np.int64), np.empty((0, size, size)))]
    for pair, values in pairs:
        facets = pair.slaves.facets
        of_facets, past = pair.lacking(values, spaces.vertices[facets.cells].mean(axis=1))
        squares[facets.cells, facets.local] = of_facets
        largest = max(largest, past)
        if dim == 3:
            keys, first = np.unique(_edges(spaces, facets.cells, facets.local).ravel(), return_index=True)
            edges.append((keys, pair.on_edges(values).reshape(-1, size, size)[first]))
    if dim == 3:
        gathered = spaces.mesh.comm.allgather([np.concatenate(each) for each in zip(*edges, strict=True)])
        keys, products = (np.concatenate(each) for each in zip(*gathered, strict=True))
        order = np.argsort(keys, kind="stable")
        keys, products = keys[order], products[order]
        squares_of_r = range(components)
        twice = products[1:, squares_of_r, squares_of_r][keys[1:] == keys[:-1]]  # edges of two pairs
        largest = max(largest, float(np.sqrt(np.maximum(twice, 0.0)).max(initial=0.0)))
        around = _around_edges(spaces, keys, products)
        for pair, _ in pairs:
            around[pair.slaves.facets.cells, pair.slaves.facets.local] = 0.0
        squares += around
        largest = max(largest, _on_what_is_given(spaces, given, keys, products))
    return squares.sum(axis=1) * spaces.cell_measures[:, None] / (dim + 1), largest


def _edges(spaces: LinearTraces, cells: AnyIndices, local: AnyIndices) -> Indices:
    """The keys of the edges of facets of cells, that opposite to each vertex of the facet, shape (facets, 3)."""
    nodes, of_mesh = np.take_along_axis(cell_nodes(spaces.mesh), spaces.order, axis=1), spaces.mesh.geometry.index_map()
    numbers = of_mesh.local_to_global(nodes[cells].ravel().astype(np.int32))
    at = np.take_along_axis(np.asarray(numbers).reshape(-1, 4), opposite(3)[local], axis=1)
    ends = np.sort(at[:, [[1, 2], [0, 2], [0, 1]]], axis=2)
    return np.asarray(ends[..., 0] * of_mesh.size_global + ends[..., 1])


def _found(keys: Indices, wanted: Indices) -> tuple[Indices, ...]:
    """Where wanted keys are that are among the keys, and for each its place among these."""
    place = np.minimum(np.searchsorted(keys, wanted), max(len(keys) - 1, 0))
    where = np.nonzero(keys[place] == wanted) if len(keys) else tuple(np.empty((wanted.ndim, 0), dtype=np.int64))
    return (*where, place[where])


def _around_edges(spaces: LinearTraces, keys: Indices, products: Array) -> Array:
    """‖∇d‖² or ‖ε(d)‖², and ‖d‖², over the measure of each simplex, of the edges in it, shape (cells, 4, 2)."""
    cells, roots, components = np.arange(len(spaces.order)), np.zeros((len(spaces.order), 4, 2)), products.shape[1] // 3
    for k in range(4):
        rows, t, place = _found(keys, _edges(spaces, cells, np.full(len(cells), k)))
        facet = spaces.vertices[rows][:, opposite(3)[k]]
        gradients = barycentric_gradients(np.concatenate([facet, spaces.vertices[rows].mean(axis=1)[:, None]], axis=1))
        a, b = (gradients[np.arange(len(rows)), np.array(ends)[t]] for ends in ((1, 0, 0), (2, 2, 1)))
        ways = np.stack([a + b, b, -a - b], axis=1)  # of r, r' and r'τ
        G = products[place].reshape(-1, 3, components, 3, components)
        sizes = np.einsum("zaibi,zak,zbk->z", G, ways, ways)
        if components > 1:
            sizes = (sizes + np.einsum("zaibj,zbi,zaj->z", G, ways, ways)) / 2
        both = np.column_stack([sizes, 0.3 * np.einsum("zii->z", G[:, 0, :, 0])])
        np.add.at(roots[:, k], rows, np.sqrt(np.maximum(both, 0.0)))
    return roots**2


def _on_what_is_given(
    spaces: LinearTraces, given: Iterable[tuple[BoundaryFacets, Array]], keys: Indices, products: Array
) -> float:
    """The largest root mean square of what r is on edges along what is given on facets there."""
    largest, components = 0.0, products.shape[1] // 3
    for facets, axes in given:
        rows, _, place = _found(keys, _edges(spaces, facets.cells, facets.local))
        sizes = np.einsum("zi,zij,zj->z", axes[rows], products[place, :components, :components], axes[rows])
        largest = max(largest, float(np.sqrt(np.maximum(sizes, 0.0)).max(initial=0.0)))
    return largest
