"""Trees on simplices: values, gradients and Hessians over bounding boxes, values and gradients in centroids.

*Quadratic functions on single simplices of any dimension, without a mesh*.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import AnyIndices, Array, Indices, Mask, inverses
from signorini_fenicsx.base.reference_cells import EDGES, SIMPLEX, orthonormal
from signorini_fenicsx.expressions.differentiation import Differentiated, Dual
from signorini_fenicsx.expressions.evaluation import Intervals, values
from signorini_fenicsx.expressions.intervals import Elementary, Interval, Truth, almost_everywhere, enclosing, stacked
from signorini_fenicsx.expressions.tree import Tree, evaluate

INSIDE = 0.75
"""Distance of the nodes of an interpolant from the centroid, relative to that of the nodes of P2."""
DIGITS = 12
"""Points of reference simplices are the same in so many digits."""


@dataclass(frozen=True)
class Polynomial:
    """Polynomials of any degree on n simplices of dimension k.

    Attributes:
        coefficients: In an orthonormal basis on the reference simplex, shape (n, basis).
        slopes: Gradients of barycentric coordinates, shape (n, k + 1, d).
        degree: Their degree.
    """

    coefficients: Array
    slopes: Array
    degree: int

    def of(self, rows: AnyIndices | Mask) -> Polynomial:
        """The polynomials on a selection of the simplices."""
        return Polynomial(self.coefficients[rows], self.slopes[rows], self.degree)

    def at(self, arms: Array) -> Array:
        """Values, and gradients as the last columns, in points x with x − x_T given, shape (n, points, 1 + d).

        Points that lie alike in their simplices share what the basis is there, which takes most of the time.
        """
        (number, points, dim), corners = arms.shape, self.slopes.shape[1]
        reference = 1 / corners + np.einsum("nqi,nvi->nqv", arms, self.slopes[:, 1:])
        rounded = np.round(reference, DIGITS).reshape(number, points * (corners - 1))
        _, first, alike = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
        basis = orthonormal(SIMPLEX[corners - 1], self.degree)
        tables = basis.tabulate(1, reference[first].reshape(-1, corners - 1))[:, :, :, 0]
        tables = tables.reshape(corners, len(first), points, basis.dim).transpose(1, 0, 3, 2)
        groups = np.split(np.argsort(alike), np.cumsum(np.bincount(alike))[:-1])
        jets = np.empty((corners, number, points))
        for table, rows in zip(tables, groups, strict=False):  # without simplices there is an empty group and no table
            jets[:, rows] = self.coefficients[rows] @ table
        at = np.empty((number, points, 1 + dim))
        at[:, :, 0], at[:, :, 1:] = jets[0], np.einsum("vnq,nvi->nqi", jets[1:], self.slopes[:, 1:])
        return at


def through(vertices: Array, nodes: Array, at_nodes: Array, degree: int) -> Polynomial:
    """The polynomials of a degree with these values in nodes of the reference simplex, shape (n, nodes)."""
    table = orthonormal(SIMPLEX[vertices.shape[1] - 1], degree).tabulate(0, nodes)[0][:, :, 0]
    return Polynomial(at_nodes @ np.linalg.inv(table).T, barycentric_gradients(vertices), degree)


@dataclass(frozen=True)
class Quadratic:
    """p(x) = value + gradient·(x − x_T) + ½(x − x_T)·hessian (x − x_T) on each simplex T with centroid x_T.

    Attributes:
        value: Shape (n,).
        gradient: Shape (n, d), along T.
        hessian: Shape (n, d, d), symmetric, along T.
    """

    value: Array
    gradient: Array
    hessian: Array

    def of(self, rows: AnyIndices | Mask) -> Quadratic:
        """The quadratic functions on some of the simplices."""
        return Quadratic(self.value[rows], self.gradient[rows], self.hessian[rows])

    def at(self, arms: Array) -> Array:
        """Values, and gradients as the last columns, in points x with x − x_T given, shape (n, points, 1 + d)."""
        at = np.empty((*arms.shape[:2], 1 + arms.shape[2]), order="F")
        at[:, :, 0] = self.value[:, None]
        for i, arm in enumerate(np.moveaxis(arms, 2, 0)):
            bend = sum(self.hessian[:, i, j, None] * other for j, other in enumerate(np.moveaxis(arms, 2, 0)))
            at[:, :, 1 + i] = self.gradient[:, i, None] + bend
            at[:, :, 0] += (self.gradient[:, i, None] + bend / 2) * arm
        return at


def quadratic(vertices: Array, nodes: Array) -> Quadratic:
    """The quadratics with given values in the nodes of P2: vertices, then the midpoints of `EDGES`, shape (n, nodes).

    The vertices are those of n simplices of dimension k, shape (n, k + 1, d).
    """
    corners = vertices.shape[1]
    at_vertices, at_midpoints = np.split(nodes, [corners], axis=1)
    slopes = barycentric_gradients(vertices)
    # p = Σ a_v λ_v + 4 Σ_{v<w} b_vw λ_v λ_w, where b_vw is the value in the midpoint minus the mean of the ends
    bend = np.zeros((len(vertices), corners, corners), order="F")
    for column, (v, w) in enumerate(EDGES[corners - 1]):
        bend[:, v, w] = bend[:, w, v] = 4 * (at_midpoints[:, column] - (at_vertices[:, v] + at_vertices[:, w]) / 2)
    value = at_vertices.mean(axis=1) + bend.sum(axis=(1, 2)) / (2 * corners**2)
    gradient = np.einsum("nv,nvi->ni", at_vertices + bend.sum(axis=2) / corners, slopes)
    return Quadratic(value, gradient, np.einsum("nvi,nvj->nij", slopes, np.einsum("nvw,nwj->nvj", bend, slopes)))


def interpolated(tree: Tree, vertices: Array) -> Quadratic:
    """The quadratic with the values of a tree in six points inside each simplex, ten in 3D (three on an edge).

    The points are nodes of P2 moved inside. So data that jump between simplices are taken from the right side.
    """
    centre = vertices.mean(axis=1, keepdims=True)
    first, second = np.array(EDGES[vertices.shape[1] - 1]).T
    corners = centre + INSIDE * (vertices - centre)
    midpoints = (corners[:, first] + corners[:, second]) / 2
    return quadratic(corners, values(tree, np.concatenate([corners, midpoints], axis=1)))


def constant(means: Array, dim: int) -> Quadratic:
    """Constant functions with these values, as quadratics."""
    return Quadratic(means, np.zeros((len(means), dim)), np.zeros((len(means), dim, dim)))


def bernstein(p: Quadratic, vertices: Array) -> Array:
    """Bernstein coefficients of quadratics, in the order of nodes of P2; every value is a weighted mean of them."""
    first, second = np.array(EDGES[vertices.shape[1] - 1]).T
    arms = vertices - vertices.mean(axis=1, keepdims=True)
    slope = np.einsum("nvi,ni->nv", arms, p.gradient)
    bend = np.einsum("nvi,niw->nvw", arms, np.einsum("nij,nwj->niw", p.hessian, arms)) / 2
    of_vertices = p.value[:, None] + slope + np.einsum("nvv->nv", bend)
    of_edges = p.value[:, None] + (slope[:, first] + slope[:, second]) / 2 + bend[:, first, second]
    return np.concatenate([of_vertices, of_edges], axis=1)


def barycentric_gradients(vertices: Array) -> Array:
    """Gradients of the barycentric coordinates along each simplex, shape (n, k + 1, d)."""
    edges_from_first = (vertices[:, 1:] - vertices[:, :1]).transpose(0, 2, 1)
    full = vertices.shape[1] == vertices.shape[2] + 1 > 2
    inverse = inverses(edges_from_first) if full else np.linalg.pinv(edges_from_first)
    return np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)


def barycentric(vertices: Array, x: Array) -> Array:
    """The barycentric coordinates of points along each simplex, shape (n, points, k + 1)."""
    arms = x - vertices.mean(axis=1, keepdims=True)
    return np.asarray(1 / vertices.shape[1] + arms @ barycentric_gradients(vertices).transpose(0, 2, 1))


ROUNDING = 1e-13
"""Bound of the rounding in sums of up to 100 products, relative to the sum of absolute values: 450 times 2⁻⁵²."""
TINY = 1e-300
"""Bound of the error by underflow in such a sum."""


@dataclass(frozen=True)
class Parts:
    """Parts of simplices.

    Attributes:
        vertices: Those of the parts, shape (parts, k + 1, d).
        simplex: The number of the simplex of which each is a part.
        share: Its share of the measure of that simplex.
    """

    vertices: Array
    simplex: Indices
    share: Array

    def within(self, simplices: Array) -> Places:
        """The places of the parts; `simplices` has the vertices of all simplices."""
        whole = simplices[self.simplex]
        generations = -np.log2(self.share)
        pad = ((generations + 4) * np.spacing(np.abs(whole).max(axis=(1, 2))))[:, None]
        lo = np.maximum(self.vertices.min(axis=1) - pad, whole.min(axis=1))
        hi = np.minimum(self.vertices.max(axis=1) + pad, whole.max(axis=1))
        centre = np.clip(self.vertices.mean(axis=1), lo, hi)
        return Places(centre, self.vertices - centre[:, None], pad, Interval(lo, hi))

    def take(self, which: slice | Mask) -> Parts:
        """A selection of the parts."""
        return Parts(self.vertices[which], self.simplex[which], self.share[which])

    def and_(self, other: Parts) -> Parts:
        """The parts of both."""
        pairs = [(getattr(self, name), getattr(other, name)) for name in ("vertices", "simplex", "share")]
        return Parts(*(np.concatenate(pair) for pair in pairs))

    def sums(self, columns: Array, number: int) -> Array:
        """Sums of columns times shares over the parts of so many simplices, shape (columns, number); ∞ for NaN."""
        shares = self.share[:, None] * columns
        shares[np.isnan(shares)] = np.inf
        return np.stack([np.bincount(self.simplex, column, number) for column in shares.T])

    def longest(self) -> tuple[Indices, Indices]:
        """The longest edge of each part, by the numbers of its vertices."""
        pairs = np.column_stack(np.triu_indices(self.vertices.shape[1], 1))
        lengths = [((self.vertices[:, v] - self.vertices[:, w]) ** 2).sum(axis=1) for v, w in pairs]
        first, second = pairs[np.stack(lengths, axis=1).argmax(axis=1)].T
        return first, second

    def cut(self, first: Indices, second: Indices, place: Array) -> Parts:
        """Both pieces of each part; the edge from its first to its second vertex is cut at that share of its length."""
        rows, beyond = np.arange(len(first)), 1 - place[:, None]
        middle = beyond * self.vertices[rows, first] + (1 - beyond) * self.vertices[rows, second]
        pieces = self.vertices.copy(), self.vertices.copy()
        pieces[0][rows, second] = middle
        pieces[1][rows, first] = middle
        share = np.concatenate([self.share * place, self.share * (1 - place)])
        return Parts(np.concatenate(pieces), np.tile(self.simplex, 2), share)

    def halves(self) -> Parts:
        """Both halves of each part."""
        return self.cut(*self.longest(), np.full(len(self.simplex), 0.5))


@dataclass(frozen=True)
class Places:
    """The places of parts of simplices.

    The exact vertices of a part come from exact bisection of the simplex with its stored floats. Rounding of a
    midpoint is at most one unit in the last place of the simplex's largest coordinate, so stored vertices differ
    from the exact ones by at most one unit per generation. The pad has four units more for rounding of the
    centroid. The box of the stored vertices, enlarged by the pad and cut to the box of the simplex, contains the
    exact part.

    Attributes:
        centre: Floats in the box, at most the pad from the exact centroid, shape (n, d).
        arms: Vertices minus centre; their error is at most the pad and a relative rounding, shape (n, k + 1, d).
        pad: Shape (n, 1).
        box: Shape (n, d).
    """

    centre: Array
    arms: Array
    pad: Array
    box: Interval

    def all_changes(self, slope: Interval) -> Interval:
        """All values of slope·(x − c) on the exact parts."""
        return _hull(changes(slope, self.arms, self.pad))


class _OnSimplices(Differentiated):
    """Values, gradients and Hessians over boxes, values and gradients in centres; conditions in mean value form."""

    def __init__(self, inner: Differentiated, names: Mapping[str, Dual], places: Places):
        super().__init__(inner, names)
        self._where = places

    def compare(self, sign: str, left: Dual, right: Dual) -> tuple[Any, ...]:
        """Compare almost everywhere: if left − right certainly varies along T, both are equal on a set of measure 0.

        Should the centre be in this set, it is taken for one of the points beside it.
        """
        over_box, at_centre = super().compare(sign, left, right)
        difference = left - right
        if not difference.gradient:
            return over_box, at_centre
        shape = (len(self._where.pad),)
        box, centre = (value.values[0].on(shape) for value in difference.values)
        slopes = [difference.gradient[name].values[0].on(shape) for name in difference.gradient]
        axes = [list(self._names).index(name) for name in difference.gradient]
        along = changes(stacked(slopes, axis=1), self._where.arms[:, :, axes], self._where.pad)
        all_values = box.meet(centre + _hull(along))
        change = np.fmax.reduce(np.maximum(along.lo, -along.hi), axis=1)
        varies = change > 0
        below, above = varies & (all_values.hi <= 0), varies & (all_values.lo >= 0)
        everywhere, (here,) = almost_everywhere(sign, over_box[0], varies, below, above), at_centre
        beside = Truth(*(everywhere.surely | (known & everywhere.possibly) for known in (here.surely, here.possibly)))
        return (everywhere,), (beside,)


def changes(slope: Interval, arms: Array, pad: Array) -> Interval:
    """slope·arm for each exact arm, shape (n, arms); stored arms differ by at most the pad and a relative rounding."""
    ends = [end[:, None, :] * arms for end in (slope.lo, slope.hi)]
    lo, hi = np.minimum(*ends), np.maximum(*ends)
    steepness = np.maximum(np.abs(slope.lo), np.abs(slope.hi))[:, None, :]
    left = slack((steepness * np.abs(arms)).sum(axis=2), steepness.sum(axis=2) > 0)
    left = left + (1 + ROUNDING) * (steepness * pad[:, None]).sum(axis=2)
    return Interval(lo.sum(axis=2) - left, hi.sum(axis=2) + left)


def slack(size: Array, some: Mask) -> Array:
    """Bound of rounding and underflow in sums of products.

    `size` is the sum of the absolute values; `some` is False only where all products are exactly 0.
    """
    return np.asarray(ROUNDING * size + np.where(some, TINY, 0.0))


def _hull(columns: Interval) -> Interval:
    return Interval(columns.lo.min(axis=1), columns.hi.max(axis=1))


@dataclass(frozen=True)
class Local:
    """Enclosures of e over parts and in their centres, as arrays."""

    value: Interval
    gradient: Interval
    hessian: list[Interval]
    middle: Interval
    middle_gradient: Interval

    @staticmethod
    def of(dual: Dual, n: int, names: str) -> Local:
        def row(gradient: Mapping[str, Interval]) -> Interval:
            return stacked([gradient.get(name, enclosing(0.0)).on((n,)) for name in names], axis=1)

        derivatives = [dual.gradient.get(name, Dual((enclosing(0.0),), {})) for name in names]
        over_box, middle = dual.values
        return Local(
            over_box.values[0].on((n,)),
            stacked([derivative.values[0].on((n,)) for derivative in derivatives], axis=1),
            [row(derivative.gradient) for derivative in derivatives],
            middle.values[0].on((n,)),
            row(middle.gradient),
        )


def evaluated(tree: Tree, places: Places, elementary: Elementary) -> Local:
    """Evaluate a tree over boxes with first and second derivatives, and in centres with first derivatives."""
    centre, lo, hi = places.centre, places.box.lo, places.box.hi
    names = "xyz"[: centre.shape[1]]
    one = enclosing(1.0)
    both_of = {name: (Interval(lo[:, i], hi[:, i]), enclosing(centre[:, i])) for i, name in enumerate(names)}
    inner = Differentiated(Intervals({}, elementary), {name: Dual((box,), {}) for name, (box, _) in both_of.items()})
    variables = {
        name: Dual(tuple(Dual((a,), {name: one}) for a in both), {name: Dual((one,), {})})
        for name, both in both_of.items()
    }
    dual: Dual = evaluate(tree, _OnSimplices(inner, variables, places))
    return Local.of(dual, len(centre), names)
