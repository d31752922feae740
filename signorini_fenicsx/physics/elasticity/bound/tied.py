"""Tied surfaces of bodies: conditions at their nodes, and what v lacks between these, see `certificate.opposite`."""

from collections.abc import Iterator, Sequence

import basix
import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.certificate import opposite
from signorini_fenicsx.certificate.opposite import Opposite
from signorini_fenicsx.discrete.points import facet_type
from signorini_fenicsx.physics.elasticity.discrete.boundary_nodes import facet_coefficients
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces, SplitMesh


def tied_pairs(spaces: ElasticSpaces, split: SplitMesh, space: fem.FunctionSpace) -> Iterator[Opposite]:
    """The tied pairs on the split mesh or a part of it."""
    for pair in spaces.pairs:
        if pair.parts.tied:
            slaves, masters = (
                facet_coefficients(split, space, spaces.boundary_facets(each)) for each in (pair.slaves, pair.masters)
            )
            yield Opposite.of(pair, spaces, slaves, masters)


def lacking(
    pairs: Sequence[Opposite], spaces: ElasticSpaces, data: ElasticData, v: fem.Function
) -> tuple[Array, float]:
    """‖ε(d)‖² and ‖d‖² on each owned cell, and the largest jump of r on this rank (collective)."""
    masters = [spaces.boundary_facets(pair.masters) for pair in spaces.pairs]
    everything = [spaces.contact, spaces.across, data.supports.facets, *masters]
    given = [(facets, np.tile(np.eye(3)[k], (len(facets.cells), 1))) for facets in everything for k in range(3)]
    given += [(each.facets, each.axes) for each in spaces.fixed]
    values = v.x.array.reshape(-1, spaces.dim)
    return opposite.lacking([(pair, values) for pair in pairs], spaces, given)


def pulled_open(pairs: Sequence[Opposite], spaces: ElasticSpaces, stresses: Array, v: fem.Function) -> float:
    """∫ yn·d over the slaves, where d = r, on this rank.

    Args:
        pairs: The pairs.
        spaces: The spaces.
        stresses: y, as in `SplitMesh.values`.
        v: v.
    """
    total = 0.0
    for pair in pairs:
        pieces, facets = pair.pieces, pair.slaves.facets
        at_corners = pieces.on_slave @ spaces.tractions(facets, stresses)[pieces.slave]
        points, weights = basix.make_quadrature(facet_type(spaces.dim), pair.slaves.degree + 1)
        r = np.einsum("qk,pki->pqi", pair.slaves.basis(points), pair.jumps(v.x.array.reshape(-1, spaces.dim)))
        at_points = np.column_stack([1 - points.sum(axis=1), points]) @ at_corners
        measure = pieces.share * facets.measure[pieces.slave]
        total += float(np.einsum("p,q,pqi,pqi->", measure, weights / weights.sum(), at_points, r))
    return total


def with_tied(pairs: Sequence[Opposite], nodes: Indices, signs: Array) -> tuple[Indices, Array, Array]:
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
