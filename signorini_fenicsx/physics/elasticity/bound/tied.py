"""Tied surfaces: what makes v the same on both at the nodes, and what v lacks between these.

On a slave facet e let v₁ interpolate w = v₂∘χ in the points of the coefficients, and let r = w − v₁, a polynomial on
each piece. On the subcell S between e and the centroid c let s be the sum of the hats λ_i of the vertices of e, and

    d = s r(τ),   τ_i = λ_i/s,

the value at the point of e that c sees behind x; elsewhere d = 0. In the plane r is 0 at the ends of e, so that d is
continuous if w is, and [v + d] = 0: v + d is admissible. Its gradient

    ∇d = r ⊗ ∇s + Σ ∂_i r ⊗ (∇λ_i − τ_i ∇s)

depends on τ alone, all of which have the same share of S as of e. So ‖ε(d)‖²_S is |S| times the mean of |sym ∇d|² over
e, a sum over its pieces that is exact, and ‖ℂ(ε(v + d) − ε₀) − y‖ is larger by at most the root of the largest
eigenvalue of ℂ times ‖ε(d)‖.

In space r is not 0 on an edge E of e. So on all other subcells with the ends a, b of E

    d = Σ_E ρ r_E(τ),   ρ = λ_a + λ_b,   τ = λ_b/ρ,

over the slave edges E of the subcell: a term is 0 on faces without E, and s r(τ) on that between E and c. Again

    ∇d = r ⊗ ∇ρ + r' ⊗ ((1 − τ)∇λ_b − τ∇λ_a)

depends on τ alone, all of which have the same share of the subcell, so that a matrix for each edge gives all norms.
Where facets with given u, contact or springs, masters or slaves of another pair meet E, r has to be 0 in what is given.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import basix
import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import AnyIndices, Array, Indices
from signorini_fenicsx.discrete.linear_traces import opposite
from signorini_fenicsx.discrete.overlay import Pieces
from signorini_fenicsx.expressions.simplices import barycentric_gradients
from signorini_fenicsx.physics.elasticity.discrete.boundary_nodes import NOTHING, FacetCoefficients, facet_coefficients
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.on_facets import facet_rule
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces, SplitMesh

SAME = 1e-7
"""Corners of pieces whose places on a facet differ by less are one."""


@dataclass(frozen=True)
class Tied:
    """A tied pair on the split mesh or a part of it.

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

    def conditions(self) -> tuple[Indices, Array]:
        """Nodes of each condition, its slave's first, and their weights, whose sum has to be 0, shape (n, nodes)."""
        slaves, pieces, hats = self.slaves, self.pieces, self.slaves.hats
        number, local = len(hats), hats @ np.linalg.inv(pieces.on_slave)
        piece = np.zeros((len(slaves.rows), number), dtype=np.int64)  # in which each point is
        for point, inside in enumerate(local.min(axis=2).T):
            order = np.argsort(inside, kind="stable")
            piece[pieces.slave[order], point] = order
        opposite = np.einsum("fpc,fpca->fpa", local[piece, np.arange(number)], pieces.on_master[piece])
        values = self.masters.basis(opposite[..., 1:].reshape(-1, hats.shape[1] - 1)).reshape(*piece.shape, number)
        weights = np.einsum("jp,fpl->fjpl", np.linalg.inv(slaves.basis(hats[:, 1:])), values)
        named, first = np.unique(slaves.nodes, return_index=True)
        facet, own = np.divmod(first, number)
        weights = weights[facet, own].reshape(len(named), number**2)
        nodes = self.masters.nodes[pieces.master[piece[facet]]].reshape(weights.shape)
        weights[np.abs(weights) < NOTHING] = 0.0
        most = max(1, (weights != 0).sum(axis=1).max(initial=0))
        order = np.argsort(weights == 0, axis=1, kind="stable")[:, :most]
        nodes, weights = np.take_along_axis(nodes, order, axis=1), np.take_along_axis(weights, order, axis=1)
        return np.column_stack([named, nodes]), np.column_stack([np.ones(len(named)), -weights])

    def jumps(self, values: Array) -> Array:
        """The coefficients of r on each piece, from v at the nodes, shape (pieces, coefficients, d)."""
        slaves, masters, pieces = self.slaves, self.masters, self.pieces
        of_w = np.einsum("pkl,pli->pki", masters.restricted(pieces.on_master), values[masters.nodes[pieces.master]])
        of_v = np.einsum("pkl,pli->pki", slaves.restricted(pieces.on_slave), values[slaves.nodes[pieces.slave]])
        return np.asarray(of_w - of_v)

    def on_edges(self, values: Array) -> Array:
        """∫ f⊗f over τ on the edges of slave facets in space, f = (r, r', r'τ), shape (facets, 3 edges, 9, 9).

        Edge t is opposite to vertex t of the facet, from its first vertex to its last one.
        """
        slaves, pieces, jumps = self.slaves, self.pieces, self.jumps(values)
        x, weights = basix.make_quadrature(basix.CellType.interval, 2 * slaves.degree)
        products = np.zeros((len(slaves.rows), 3, 9, 9))
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
        """‖ε(d)‖² behind each slave facet as a share of its subcell, and the largest jump of r.

        Args:
            values: v at the nodes, shape (nodes, d).
            middles: The centroids of the cells behind the facets, shape (facets, d).
        """
        slaves, pieces, dim, jumps = self.slaves, self.pieces, values.shape[1], self.jumps(values)
        points, weights = facet_rule(dim, 2 * slaves.degree)
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
        strains = (slopes + slopes.swapaxes(2, 3)) / 2
        sizes = pieces.share * np.einsum("q,pqij->p", weights / weights.sum(), strains**2)
        at_corners = np.einsum("ck,pki->pci", slaves.basis(np.eye(dim)[:, 1:]), jumps)
        past = np.abs(np.where((pieces.on_slave.max(axis=2) > 1 - NOTHING)[:, :, None], at_corners, 0.0)).max(initial=0)
        places = np.column_stack([np.repeat(pieces.slave, dim), np.rint(pieces.on_slave.reshape(-1, dim) / SAME)])
        _, place = np.unique(places, axis=0, return_inverse=True)  # pieces meet there
        most, least = np.full((2, len(places), dim), [[[-np.inf]], [[np.inf]]])
        np.maximum.at(most, place.ravel(), at_corners.reshape(-1, dim))
        np.minimum.at(least, place.ravel(), at_corners.reshape(-1, dim))
        past = max(past, np.where(np.isfinite(most), most - least, 0.0).max(initial=0.0), np.inf if self.turns else 0.0)
        return np.bincount(pieces.slave, sizes, len(slaves.rows)), float(past)


def tied_pairs(spaces: ElasticSpaces, split: SplitMesh, space: fem.FunctionSpace) -> Iterator[Tied]:
    """The tied pairs; both sides of a piece are on one rank, and on `split` or not."""
    for joint in spaces.joints:
        if joint.pair.tied:
            slaves, masters = (
                facet_coefficients(split, space, spaces.boundary_facets(each)) for each in (joint.slaves, joint.masters)
            )
            pieces = joint.pieces.take(np.isin(joint.pieces.slave, slaves.rows))
            of = (slaves.rows, pieces.slave), (masters.rows, pieces.master - joint.first)
            rows = [np.searchsorted(some, each) for some, each in of]
            turned = np.ptp(joint.directions, axis=0).max(initial=0.0) > SAME if len(joint.slaves) else False
            apart = np.abs(joint.pieces.gap).max(initial=0.0) > SAME * spaces.length
            yield Tied(slaves, masters, replace(pieces, slave=rows[0], master=rows[1]), bool(turned and apart))


def lacking(pairs: Sequence[Tied], spaces: ElasticSpaces, data: ElasticData, v: fem.Function) -> tuple[Array, float]:
    """‖ε(d)‖² on each owned cell, and the largest jump of r, between pieces or facets, on this rank (collective)."""
    dim, largest = spaces.dim, 0.0
    squares = np.zeros((len(spaces.order), dim + 1))
    values, edges = v.x.array.reshape(-1, dim), [(np.empty(0, dtype=np.int64), np.empty((0, 9, 9)))]
    for pair in pairs:
        facets = pair.slaves.facets
        of_facets, past = pair.lacking(values, spaces.vertices[facets.cells].mean(axis=1))
        squares[facets.cells, facets.local] = of_facets
        largest = max(largest, past)
        if dim == 3:
            keys, first = np.unique(_edges(spaces, facets.cells, facets.local).ravel(), return_index=True)
            edges.append((keys, pair.on_edges(values).reshape(-1, 9, 9)[first]))
    if dim == 3:
        gathered = spaces.mesh.comm.allgather([np.concatenate(each) for each in zip(*edges, strict=True)])
        keys, products = (np.concatenate(each) for each in zip(*gathered, strict=True))
        order = np.argsort(keys, kind="stable")
        keys, products = keys[order], products[order]
        twice = products[1:, range(3), range(3)][keys[1:] == keys[:-1]]  # edges of two pairs
        largest = max(largest, float(np.sqrt(np.maximum(twice, 0.0)).max(initial=0.0)))
        over = np.zeros(squares.shape, dtype=bool)
        for pair in pairs:
            over[pair.slaves.facets.cells, pair.slaves.facets.local] = True
        squares += np.where(over, 0.0, _around_edges(spaces, keys, products))
        largest = max(largest, _on_what_is_given(spaces, data, keys, products))
    return (squares.sum(axis=1) * spaces.cell_measures / (dim + 1)), largest


def _edges(spaces: ElasticSpaces, cells: AnyIndices, local: AnyIndices) -> Indices:
    """The keys of the edges of facets of cells, that opposite to each vertex of the facet, shape (facets, 3)."""
    numbers = spaces.mesh.geometry.index_map().local_to_global(spaces.nodes[cells].ravel().astype(np.int32))
    at = np.take_along_axis(np.asarray(numbers).reshape(-1, 4), opposite(3)[local], axis=1)
    ends = np.sort(at[:, [[1, 2], [0, 2], [0, 1]]], axis=2)
    return np.asarray(ends[..., 0] * spaces.mesh.geometry.index_map().size_global + ends[..., 1])


def _found(keys: Indices, wanted: Indices) -> tuple[Indices, ...]:
    """Where wanted keys are that are among the keys, and for each its place among these."""
    place = np.minimum(np.searchsorted(keys, wanted), max(len(keys) - 1, 0))
    where = np.nonzero(keys[place] == wanted) if len(keys) else tuple(np.empty((wanted.ndim, 0), dtype=np.int64))
    return (*where, place[where])


def _around_edges(spaces: ElasticSpaces, keys: Indices, products: Array) -> Array:
    """‖ε(d)‖² over the measure of each subcell, of the edges in it, shape (cells, 4)."""
    cells, roots = np.arange(len(spaces.order)), np.zeros((len(spaces.order), 4))
    for k in range(4):
        rows, t, place = _found(keys, _edges(spaces, cells, np.full(len(cells), k)))
        facet = spaces.vertices[rows][:, opposite(3)[k]]
        gradients = barycentric_gradients(np.concatenate([facet, spaces.vertices[rows].mean(axis=1)[:, None]], axis=1))
        a, b = (gradients[np.arange(len(rows)), np.array(ends)[t]] for ends in ((1, 0, 0), (2, 2, 1)))
        ways = np.stack([a + b, b, -a - b], axis=1)  # of r, r' and r'τ
        G = products[place].reshape(-1, 3, 3, 3, 3)
        sizes = np.einsum("zaibi,zak,zbk->z", G, ways, ways)
        sizes += np.einsum("zaibj,zbi,zaj->z", G, ways, ways)
        np.add.at(roots[:, k], rows, np.sqrt(np.maximum(sizes / 2, 0.0)))
    return roots**2


def _on_what_is_given(spaces: ElasticSpaces, data: ElasticData, keys: Indices, products: Array) -> float:
    """The largest root mean square of what r is on edges along what is given on facets there."""
    masters = [spaces.boundary_facets(joint.masters) for joint in spaces.joints]
    everything = [spaces.contact, spaces.across, data.supports.facets, *masters]
    given = [(facets, np.tile(np.eye(3)[k], (len(facets.cells), 1))) for facets in everything for k in range(3)]
    largest = 0.0
    for facets, axes in [*given, *((each.facets, each.axes) for each in spaces.fixed)]:
        rows, _, place = _found(keys, _edges(spaces, facets.cells, facets.local))
        sizes = np.einsum("zi,zij,zj->z", axes[rows], products[place, :3, :3], axes[rows])
        largest = max(largest, float(np.sqrt(np.maximum(sizes, 0.0)).max(initial=0.0)))
    return largest


def with_tied(pairs: Sequence[Tied], nodes: Indices, signs: Array) -> tuple[Indices, Array, Array]:
    """The nodes of conditions and their weights, and at the end those of tied pairs, d for each node of a slave.

    Returns:
        Both, shape (conditions, nodes), and the directions of those at the end.
    """
    conditions = [pair.conditions() for pair in pairs]
    dim = pairs[0].slaves.facets.vertices.shape[2] if pairs else 1
    named = [(np.repeat(some, dim, axis=0), np.repeat(weights, dim, axis=0)) for some, weights in conditions]
    most = max([nodes.shape[1], *(some.shape[1] for some, _ in named)])
    rows = [(nodes, signs), *named]
    numbers = [np.pad(some, ((0, 0), (0, most - some.shape[1])), mode="edge") for some, _ in rows]
    weights = [np.pad(each, ((0, 0), (0, most - each.shape[1]))) for _, each in rows]
    ways = np.tile(np.eye(dim), (sum(len(some) for some, _ in conditions), 1))
    return np.concatenate(numbers), np.concatenate(weights), ways
