"""What a bound of u asks of the Bernstein coefficients of v, on each cell or facet.

Let b be a lower bound; of an upper one all is the other way round. As a rule v is at least I_hb, by the coefficients of
both, and what b is beyond I_hb cuts v off. Two sorts of simplices ask for one number instead.

- *Clear* ones: v is not on the bound there, and b is proved to be below a number c that is less than all coefficients
  of v. So b, which may be steep or far away, changes nothing.
- *Rough* ones, in which or in whose nodes b jumps: v is at least sup b there. So b does not cut v off, and v stays
  continuous where b is not.

A node has the largest number that its simplices ask for. So where b jumps along lines of the mesh its larger side holds
v, as it holds u.
"""

from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import AnyIndices, Array, Mask
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.discrete.bernstein import coefficients_of, degree_of
from signorini_fenicsx.discrete.continuity import jumps_inside
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.interpolants import in_nodes
from signorini_fenicsx.discrete.mesh_spaces import extreme_around
from signorini_fenicsx.expressions import Tree, is_polynomial
from signorini_fenicsx.expressions.cutting import Frame
from signorini_fenicsx.expressions.enclosures import ranges, slopes, surely_above
from signorini_fenicsx.expressions.tree import Negative

BESIDE = 1e-4, 1e-8
"""A datum jumps if it is as far from its value in a node at the second share of the way to the centroid as at the
first; r^α would be 10^-4α times as far."""
ROUNDING = 1e-12
"""Relative size of what is no jump."""
BLUR = 16 * np.finfo(np.float64).eps
"""Rounding of coordinates, as a share of their size."""
SHARP = 0.1
"""sup b is known up to this share of what b varies by between nodes."""


def jumps_in_nodes(tree: Tree, vertices: Array, degree: int, nodes: Array | None = None) -> Mask:
    """Where the values of a tree in the nodes of simplices are not the limits from inside, shape (n, nodes).

    Args:
        tree: The tree.
        vertices: Of the simplices.
        degree: The degree of v.
        nodes: Values that are looked at in the place of those of the tree, NaN where any will do.
    """
    inside = vertices.mean(axis=1, keepdims=True) - vertices
    at, near, nearer = (in_nodes(tree, vertices + share * inside, degree) for share in (0.0, *BESIDE))
    if nodes is not None:
        at = np.where(np.isnan(nodes), nearer, nodes)
    far, close = np.abs(near - at), np.abs(nearer - at)
    return np.asarray((close > far / 2) & (close > _rounding(vertices, at)[:, None]))


def _rounding(vertices: Array, at: Array) -> Array:
    """What rounding of values and of coordinates makes of values in the nodes of each simplex, at most."""
    blur = BLUR * np.abs(vertices).max(axis=(1, 2), initial=0.0) / np.ptp(vertices, axis=1).max(axis=1, initial=0.0)
    return np.asarray(ROUNDING * np.abs(at).max(initial=0.0) + blur * np.ptp(at, axis=1))


@dataclass(frozen=True)
class Simplices:
    """Owned cells or facets, as v has them.

    Attributes:
        vertices: Shape (n, vertices, dim).
        cells: The owned cell of each.
        nodes: Their nodes in the space of v, as Basix orders them, shape (n, nodes).
        v: The coefficients of v there.
        touched: Mask of those where v is on the bound.
    """

    vertices: Array
    cells: AnyIndices
    nodes: AnyIndices
    v: Array
    touched: Mask

    def asked(self, datum: Datum, sign: float, space: fem.FunctionSpace, frame: Frame) -> tuple[Array, Mask, Mask]:
        """The least coefficients (sign 1), or the largest ones (−1), and masks of rough and clear ones (collective).

        Args:
            datum: The bound, by texts.
            sign: Whether it is a lower or an upper one.
            space: That of v.
            frame: The domain.
        """
        number, cell, degree = len(self.vertices), SIMPLEX[self.vertices.shape[1] - 1], degree_of(space)
        wanted, in_node = np.empty(self.nodes.shape), np.zeros(self.nodes.shape, dtype=bool)
        torn, pieces = np.zeros(number, dtype=bool), []
        for tree, rows in datum.trees_in(self.cells):
            pieces.append((Negative(tree) if sign > 0 else tree, rows))
            x = self.vertices[rows]
            wanted[rows] = sign * coefficients_of(in_nodes(tree, x, degree), cell)
            if not is_polynomial(tree, degree):
                in_node[rows] = jumps_in_nodes(tree, x, degree)
                some = rows[~np.isfinite(sum(slopes(tree, x, frame, np.full(len(rows), np.inf))))]
                sizes = jumps_inside(tree, self.vertices[some])[0].max(axis=1, initial=0.0)
                torn[some] = sizes > _rounding(self.vertices[some], wanted[some])
        around = extreme_around(space, self.nodes, 1.0 * in_node, largest=True)
        rough, clear = torn | (around[self.nodes] > 0).any(axis=1), np.zeros(number, dtype=bool)
        for below, rows in pieces:
            number_on = self._numbers(below, rows, sign, frame)
            far = np.isfinite(number_on)
            wanted[rows[far]], clear[rows[far]] = number_on[far, None], True
            some = rows[rough[rows] & ~far]
            high, low = wanted[some].max(axis=1, initial=-np.inf), wanted[some].min(axis=1, initial=np.inf)
            slack = SHARP * (high - low) + ROUNDING * np.abs(high)
            most = -ranges(below, self.vertices[some], None, frame, -high - slack, np.inf).lo
            rough[some[~np.isfinite(most)]] = False
            wanted[some] = np.where(np.isfinite(most), most + ROUNDING * np.abs(most), wanted[some].T).T
        return sign * wanted, rough & ~clear, clear

    def _numbers(self, below: Tree, rows: AnyIndices, sign: float, frame: Frame) -> Array:
        """The number that clear ones of some rows ask for, −∞ on others; `below` is −b, or b of an upper bound."""
        least = (sign * self.v[rows]).min(axis=1, initial=np.inf)
        number = (least + in_nodes(Negative(below), self.vertices[rows]).max(axis=1, initial=-np.inf)) / 2
        far = np.flatnonzero(~self.touched[rows] & (number < least))
        sure = far[surely_above(below, self.vertices[rows[far]], frame, -number[far])]
        return np.where(np.isin(np.arange(len(rows)), sure), number, -np.inf)
