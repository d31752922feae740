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
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.discrete.overlay import Pieces
from signorini_fenicsx.expressions.quadratics import barycentric_gradients
from signorini_fenicsx.physics.elasticity.discrete.boundary_nodes import NOTHING, FacetCoefficients, facet_coefficients
from signorini_fenicsx.physics.elasticity.discrete.on_facets import facet_rule
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.discrete.split_mesh import SplitMesh

SAME = 1e-7
"""Corners of pieces whose places on a facet differ by less are one."""


@dataclass(frozen=True)
class Tied:
    """A tied pair on the split mesh or a part of it.

    Attributes:
        slaves: The slave facets.
        masters: The master facets.
        pieces: The overlay, by rows of these.
    """

    slaves: FacetCoefficients
    masters: FacetCoefficients
    pieces: Pieces

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

    def lacking(self, values: Array, middles: Array) -> tuple[Array, float]:
        """‖ε(d)‖² behind each slave facet as a share of its subcell, and the largest jump of r.

        Args:
            values: v at the nodes, shape (nodes, d).
            middles: The centroids of the cells behind the facets, shape (facets, d).
        """
        slaves, masters, pieces, dim = self.slaves, self.masters, self.pieces, values.shape[1]
        of_w = np.einsum("pkl,pli->pki", masters.restricted(pieces.on_master), values[masters.nodes[pieces.master]])
        of_v = np.einsum("pkl,pli->pki", slaves.restricted(pieces.on_slave), values[slaves.nodes[pieces.slave]])
        points, weights = facet_rule(dim, 2 * slaves.degree)
        hats = np.column_stack([1 - points.sum(axis=1), points])
        tau = hats @ pieces.on_slave
        r = np.einsum("qk,pki->pqi", slaves.basis(points), of_w - of_v)
        along = np.einsum("jqk,pki->pqji", slaves.slopes(points), of_w - of_v)
        sides = pieces.on_slave[:, 1:, 1:] - pieces.on_slave[:, :1, 1:]
        along = np.einsum("pij,pqjk->pqik", np.linalg.inv(sides), along)  # by τ_1, …
        simplices = np.concatenate([slaves.facets.vertices, middles[:, None]], axis=1)
        gradients = barycentric_gradients(simplices)[pieces.slave, :dim]
        of_s = gradients.sum(axis=1)
        ways = gradients[:, None, 1:] - tau[:, :, 1:, None] * of_s[:, None, None]
        slopes = np.einsum("pqi,pj->pqij", r, of_s) + np.einsum("pqki,pqkj->pqij", along, ways)
        strains = (slopes + slopes.swapaxes(2, 3)) / 2
        sizes = pieces.share * np.einsum("q,pqij->p", weights / weights.sum(), strains**2)
        at_corners = np.einsum("ck,pki->pci", slaves.basis(np.eye(dim)[:, 1:]), of_w - of_v)
        past = np.abs(np.where((pieces.on_slave.max(axis=2) > 1 - NOTHING)[:, :, None], at_corners, 0.0)).max(initial=0)
        places = np.column_stack([np.repeat(pieces.slave, dim), np.rint(pieces.on_slave.reshape(-1, dim) / SAME)])
        _, place = np.unique(places, axis=0, return_inverse=True)  # pieces meet there
        most, least = np.full((2, len(places), dim), [[[-np.inf]], [[np.inf]]])
        np.maximum.at(most, place.ravel(), at_corners.reshape(-1, dim))
        np.minimum.at(least, place.ravel(), at_corners.reshape(-1, dim))
        past = max(past, np.where(np.isfinite(most), most - least, 0.0).max(initial=0.0))
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
            yield Tied(slaves, masters, replace(pieces, slave=rows[0], master=rows[1]))


def lacking(pairs: Sequence[Tied], spaces: ElasticSpaces, v: fem.Function) -> tuple[Array, float]:
    """‖ε(d)‖² on each owned cell, and the largest jump of r on this rank, between pieces or facets."""
    squares, largest, dim = np.zeros(len(spaces.order)), 0.0, spaces.dim
    for pair in pairs:
        cells = pair.slaves.facets.cells
        of_facets, past = pair.lacking(v.x.array.reshape(-1, dim), spaces.vertices[cells].mean(axis=1))
        np.add.at(squares, cells, of_facets * spaces.cell_measures[cells] / (dim + 1))
        largest = max(largest, past)
    return squares, largest


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
