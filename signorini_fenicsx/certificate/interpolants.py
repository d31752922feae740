"""Quadratics near an expression on simplices, with nodes as Basix numbers them: vertices, then midpoints of edges."""

from __future__ import annotations

from collections.abc import Callable

import basix
import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.expressions import Tree, values, values_and_gradient
from signorini_fenicsx.expressions.quadratics import Quadratic, edges, quadratic

POINTS = 8
"""Smallest degree of the quadratures for data."""
BLOCK = 4096
"""Number of simplices whose quadrature points are in memory at a time: some tens of megabytes."""


def edge_order(corners: int) -> list[int]:
    """The positions in Basix's order of the edges of a simplex that `edges` lists."""
    cell = {2: basix.CellType.interval, 3: basix.CellType.triangle, 4: basix.CellType.tetrahedron}[corners]
    order = [tuple(sorted(edge)) for edge in basix.topology(cell)[1]]
    return [corners + order.index(edge) for edge in edges(corners)]


def quadratic_of(vertices: Array, nodes: Array) -> Quadratic:
    """The quadratics with these values in the nodes of P2 as Basix numbers them."""
    corners = vertices.shape[1]
    return quadratic(vertices, nodes[:, :corners], nodes[:, edge_order(corners)])


def in_nodes(tree: Tree, vertices: Array) -> Array:
    """Values in the vertices and then the midpoints of edges, as Basix numbers them, shape (n, nodes)."""
    corners = vertices.shape[1]
    ends = np.empty((corners * (corners - 1) // 2, 2), dtype=np.int64)
    ends[np.array(edge_order(corners)) - corners] = edges(corners)
    x = np.concatenate([vertices, (vertices[:, ends[:, 0]] + vertices[:, ends[:, 1]]) / 2], axis=1)
    return values(tree, dict(zip("xyz", np.moveaxis(x, -1, 0), strict=False)))


def _points(vertices: Array, degree: int) -> tuple[Array, Array, Array]:
    """Points of a quadrature in each simplex, the same minus its centroid, and weights with sum 1."""
    cells = {2: basix.CellType.interval, 3: basix.CellType.triangle, 4: basix.CellType.tetrahedron}
    points, weights = basix.make_quadrature(cells[vertices.shape[1]], degree)
    x = vertices[:, :1] + points @ (vertices[:, 1:] - vertices[:, :1])
    return x, x - vertices.mean(axis=1, keepdims=True), weights / weights.sum()


def mean_above(tree: Tree, vertices: Array, p: Quadratic, degree: int) -> Array:
    """Mean of e − p by a quadrature of this degree."""

    def mean(vertices: Array, p: Quadratic) -> Array:
        x, arms, weights = _points(vertices, degree)
        found = values(tree, dict(zip("xyz", np.moveaxis(x, -1, 0), strict=False)))
        of_p = p.value[:, None] + np.einsum("nqi,ni->nq", arms, p.gradient)
        above: Array = (found - of_p - np.einsum("nqi,nij,nqj->nq", arms, p.hessian, arms) / 2) @ weights
        return above

    return _in_blocks(mean, vertices, p)


def seen_slope(tree: Tree, vertices: Array, p: Quadratic) -> Array:
    """Root mean square of |∇(e − p)| over the points of a quadrature."""

    def slope(vertices: Array, p: Quadratic) -> Array:
        x, arms, weights = _points(vertices, POINTS)
        _, found = values_and_gradient(tree, dict(zip("xyz", np.moveaxis(x, -1, 0), strict=False)))
        found = found - p.gradient[:, None] - np.einsum("nij,nqj->nqi", p.hessian, arms)
        return np.sqrt(np.maximum((found**2).sum(axis=2) @ weights, 0.0))

    return _in_blocks(slope, vertices, p)


def _in_blocks(compute: Callable[[Array, Quadratic], Array], vertices: Array, p: Quadratic) -> Array:
    """A value per simplex, computed for BLOCK simplices at once, because each has hundreds of points."""
    blocks = [slice(begin, begin + BLOCK) for begin in range(0, max(len(vertices), 1), BLOCK)]
    parts = [compute(vertices[b], Quadratic(p.value[b], p.gradient[b], p.hessian[b])) for b in blocks]
    return np.concatenate(parts)
