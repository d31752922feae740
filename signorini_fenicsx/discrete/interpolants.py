"""Quadratics near an expression on simplices, with nodes as Basix numbers them: vertices, then midpoints of edges."""

import basix
import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.discrete.bernstein import exponents
from signorini_fenicsx.expressions import Tree, values
from signorini_fenicsx.expressions.simplices import Quadratic, bernstein, edges, quadratic


def edge_order(corners: int) -> list[int]:
    """The positions in Basix's order of the edges of a simplex that `edges` lists."""
    order = [tuple(sorted(edge)) for edge in basix.topology(SIMPLEX[corners - 1])[1]]
    return [corners + order.index(edge) for edge in edges(corners)]


def quadratic_of(vertices: Array, nodes: Array) -> Quadratic:
    """The quadratics with these values in the nodes of P2 as Basix numbers them."""
    corners = vertices.shape[1]
    return quadratic(vertices, nodes[:, :corners], nodes[:, edge_order(corners)])


def in_nodes(tree: Tree, vertices: Array, degree: int = 2) -> Array:
    """Values in the nodes of polynomials of a degree, as Basix numbers them, shape (n, nodes)."""
    shares = exponents(SIMPLEX[vertices.shape[1] - 1], degree) / degree
    return values(tree, shares @ vertices)


def as_basix(p: Quadratic, vertices: Array) -> Array:
    """The Bernstein coefficients of quadratics, in the order of Basix, shape (n, nodes)."""
    corners = vertices.shape[1]
    coefficients = bernstein(p, vertices)
    in_order = np.empty_like(coefficients)
    in_order[:, [*range(corners), *edge_order(corners)]] = coefficients
    return in_order
