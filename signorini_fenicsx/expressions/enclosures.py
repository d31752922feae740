"""Enclosures of data on simplices: of d = e − p, an expression e minus a quadratic p.

Let e be within ρ of a polynomial on a simplex, and Q a quadrature with positive weights that is exact for the
polynomial and its square. Then the mean of d is in Q(d) ± 2ρ, and its root mean square at most Q(d²)^½ + 2ρ; likewise
for ∇d. `taylor` gives ρ, on boxes and parts that `cutting` makes until the enclosures together are narrow enough.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.reference_cells import SIMPLEX, orthonormal, positive_quadrature
from signorini_fenicsx.expressions.cutting import CHUNK, Frame, in_parts, look_everywhere
from signorini_fenicsx.expressions.evaluation import values, values_and_gradient
from signorini_fenicsx.expressions.intervals import Interval
from signorini_fenicsx.expressions.series import DEGREE, Remainder
from signorini_fenicsx.expressions.simplices import (
    INSIDE,
    Parts,
    Polynomial,
    Quadratic,
    barycentric,
    barycentric_gradients,
    bernstein,
    interpolated,
)
from signorini_fenicsx.expressions.tree import Tree

CLOSE = 0.3
"""An upper bound of ‖∇d‖² is good enough if it is too large by at most this share of itself."""
BESIDE = 4.5
"""If e is within ρ of a quadratic, it is within so many times ρ of `interpolated`, whose Lebesgue constant is 3.5."""


def distances(tree: Tree, vertices: Array, frame: Frame, enough: Array, degree: int = DEGREE) -> Array:
    """Bounds of the distance to polynomials of a degree ≤ K on simplices, only as small as is enough, see `taylor`.

    Args:
        tree: The expression.
        vertices: Vertices of n simplices of this rank, of any dimension ≥ 1, shape (n, vertices, dim).
        frame: The domain.
        enough: Of each simplex.
        degree: The degree.
    """
    bounds_of_parts = np.full(len(vertices), np.inf)

    def look(remainder: Remainder, rows: Indices) -> Mask:
        bounds_of_parts[rows] = np.minimum(bounds_of_parts[rows], remainder.distance(degree))
        return np.asarray(bounds_of_parts[rows] <= enough[rows])

    look_everywhere(tree, vertices, frame, look)
    return bounds_of_parts


def surely_above(tree: Tree, vertices: Array, frame: Frame, low: Array) -> Mask:
    """The simplices on which all values are proved to be above a bound; quick where that is true in large boxes."""
    above = np.zeros(len(vertices), dtype=bool)

    def look(remainder: Remainder, rows: Indices) -> Mask:
        above[rows] |= remainder.value.lo > low[rows]
        return above[rows]

    look_everywhere(tree, vertices, frame, look)
    return above


def slopes(tree: Tree, vertices: Array, frame: Frame, enough: Array) -> tuple[Array, Array]:
    """Bounds of value and gradient, see `Remainder.slope`; the gradient is only as small as is enough."""
    best = np.full((2, len(vertices)), np.inf)

    def look(remainder: Remainder, rows: Indices) -> Mask:
        own = np.stack(remainder.slope())
        best[:, rows] = np.where(own[1] < best[1, rows], own, best[:, rows])
        return np.asarray(best[1, rows] <= enough[rows])

    look_everywhere(tree, vertices, frame, look, rough=False)
    return best[0], best[1]


@dataclass(frozen=True)
class Means:
    """Enclosures of d = e − p on each of n simplices S; infinite where nothing is known.

    Attributes:
        mean: Interval with the mean of d.
        norm: Upper bound of the root mean square of d.
        linear: Upper bound of ‖Π₁d‖/|S|^½, with the projection Π₁ to the linear functions on S, if it was asked for.
        place: Centroid of the part that adds most to the uncertainty, shape (n, dim).
        parts: Number of parts that were looked at.
    """

    mean: Interval
    norm: Array
    linear: Array
    place: Array
    parts: int


def means(
    tree: Tree, vertices: Array, p: Quadratic | Polynomial, frame: Frame, weight: Array, *, linear: bool = False
) -> Means:
    """Enclose means (collective): Σ weight·(half width)² ≤ 1 is aimed at, in the sum over all simplices.

    On a part P of S the quadrature is exact for linear functions l times what is within ρ of e, so it has (d, l)_P but
    for 2ρ|P|^½‖l‖_P.

    Args:
        tree: The expression.
        vertices: Vertices of n simplices of this rank, of any dimension ≥ 1, shape (n, vertices, dim).
        p: The polynomials, of a degree ≤ K.
        frame: The domain.
        weight: Of each simplex.
        linear: Whether `Means.linear` is wanted; then what is unsure of it is aimed at, in the place of the half width.
    """
    number, corners = vertices.shape[:2]

    def look(parts: Parts, remainder: Remainder) -> Array:
        return 2 * remainder.distance()[:, None]

    def need(parts: Parts, rho: Array) -> Array:
        if linear:
            return np.asarray(weight[parts.simplex] * parts.share * rho[:, 0] ** 2)
        width = parts.share * rho[:, 0]
        of_simplex = np.bincount(parts.simplex, np.where(np.isfinite(width), width, 0.0), number)[parts.simplex]
        return np.asarray(weight[parts.simplex] * width * of_simplex)

    parts, of_parts = in_parts([tree], vertices, frame, look, need)
    rho, chunks = of_parts[:, 0], range(0, max(len(of_parts), 1), CHUNK)
    of_chunks = [_moments(tree, p, vertices, parts.take(slice(at, at + CHUNK)), linear=linear) for at in chunks]
    of_d, of_square, *of_hats = np.concatenate(of_chunks).T
    columns = np.column_stack([rho, rho**2, of_d, (np.sqrt(of_square) + rho) ** 2, *of_hats])
    radius, unsure, middle, square, *of_hats = parts.sums(columns, number)
    of_linear = np.full(number, np.inf)
    if linear:
        with np.errstate(invalid="ignore"):
            squares = np.sum(np.square(of_hats), axis=0) - np.sum(of_hats, axis=0) ** 2 / (corners + 1)
            of_linear = np.sqrt(np.maximum(corners * (corners + 1) * squares, 0.0)) + np.sqrt(unsure)
        of_linear[np.isnan(of_linear)] = np.inf
    middle[~np.isfinite(middle)] = 0.0
    place = _place(parts, parts.share * rho, vertices)
    return Means(Interval(middle - radius, middle + radius), np.sqrt(square), of_linear, place, len(rho))


def _moments(tree: Tree, p: Quadratic | Polynomial, vertices: Array, parts: Parts, *, linear: bool) -> Array:
    """Means of d and d² over parts by quadrature, and if `linear` those with the hats of simplices, (parts, means)."""
    x, rule = in_points(parts.vertices)
    d = values(tree, x) - _of_simplices(p, vertices, parts, x)[:, :, 0]
    found = [d @ rule, d**2 @ rule]
    if linear:
        found.append(np.einsum("nq,q,nqv->nv", d, rule, barycentric(vertices[parts.simplex], x)))
    return np.column_stack(found)


@dataclass(frozen=True)
class Tilts:
    """Enclosures of d = e − p and ∇d on each of n simplices; infinite where nothing is known.

    Attributes:
        norm: Upper bound of the root mean square of d.
        tilt: Upper bound of that of |∇d|, along the simplex.
        place: Centroid of the part that adds most to the uncertainty, shape (n, dim).
    """

    norm: Array
    tilt: Array
    place: Array


def tilts(
    tree: Tree, vertices: Array, p: Quadratic | Polynomial, frame: Frame, weight: Array, close: float = CLOSE
) -> Tilts:
    """Enclose gradients (collective).

    Σ weight·(by how much the bound of |∇d|² may be too large) ≤ 1 is aimed at; a share `close` of the bound is allowed.

    Args:
        tree: The expression.
        vertices: Vertices of n simplices of this rank, of any dimension ≥ 1, shape (n, vertices, dim).
        p: The polynomials, of a degree ≤ K.
        frame: The domain.
        weight: Of each simplex.
        close: The share.
    """
    number = len(vertices)

    def look(parts: Parts, remainder: Remainder) -> Array:
        x, rule = in_points(parts.vertices)
        seen, (rho, slope) = np.sqrt(_squares(tree, p, vertices, parts, x) @ rule), remainder.slope()
        norm, steep = (seen[0] + 2 * rho) ** 2, (seen[1] + 2 * slope) ** 2
        return np.stack([norm, steep, steep - seen[1] ** 2], axis=1)

    def need(parts: Parts, of_parts: Array) -> Array:
        steep, excess = (np.bincount(parts.simplex, parts.share * column, number) for column in of_parts[:, 1:].T)
        shares = weight[parts.simplex] * parts.share
        return np.where((excess <= close * steep)[parts.simplex], 0.0, shares * of_parts[:, 2])

    parts, of_parts = in_parts([tree], vertices, frame, look, need, rough=False)
    norm, tilt, _ = np.sqrt(parts.sums(of_parts, number))
    return Tilts(norm, tilt, _place(parts, parts.share * of_parts[:, 2], vertices))


def projected(tree: Tree, vertices: Array) -> Polynomial:
    """The L² projections of an expression to polynomials of degree K, by quadrature."""
    corners = vertices.shape[1]
    points, weights = _rule(corners, 2 * DEGREE)
    basis = orthonormal(SIMPLEX[corners - 1], DEGREE).tabulate(0, points)[0][:, :, 0]
    coefficients = np.empty((len(vertices), basis.shape[1]))
    for begin in range(0, len(vertices), CHUNK):
        some = slice(begin, begin + CHUNK)
        coefficients[some] = values(tree, in_points(vertices[some])[0]) @ (weights[:, None] * basis)
    measure = 1 / math.factorial(corners - 1)
    return Polynomial(coefficients * measure, barycentric_gradients(vertices), DEGREE)


def shown(tree: Tree, vertices: Array, p: Quadratic | Polynomial, degree: int) -> Array:
    """Root mean squares of d = e − p and of |∇d| over the points of a quadrature of this degree, shape (2, n)."""
    everything = Parts(vertices, np.arange(len(vertices)), np.ones(len(vertices)))
    squares = np.empty((2, len(vertices)))
    for begin in range(0, len(vertices), CHUNK):
        parts = everything.take(slice(begin, begin + CHUNK))
        x, weights = in_points(parts.vertices, degree)
        squares[:, parts.simplex] = _squares(tree, p, vertices, parts, x) @ weights
    return np.sqrt(squares)


def _squares(tree: Tree, p: Quadratic | Polynomial, vertices: Array, parts: Parts, x: Array) -> Array:
    """The squares of d and of |∇d| along simplices in points of parts of them, shape (2, parts, points)."""
    value, gradient = values_and_gradient(tree, x)
    if vertices.shape[1] <= vertices.shape[2]:
        edges = (vertices[:, 1:] - vertices[:, :1])[parts.simplex]
        gradient = gradient @ np.linalg.pinv(edges) @ edges
    jets = _of_simplices(p, vertices, parts, x)
    return np.stack([(value - jets[:, :, 0]) ** 2, ((gradient - jets[:, :, 1:]) ** 2).sum(axis=2)])


@dataclass(frozen=True)
class Ranges:
    """Enclosures of d = e − p on each of n simplices; infinite where nothing is known.

    Attributes:
        lo: Lower bound of d.
        hi: Upper bound of d.
        least: Smallest value of d in the points that were looked at.
        at: Where that is, shape (n, dim).
    """

    lo: Array
    hi: Array
    least: Array
    at: Array

    @property
    def sup(self) -> Array:
        """Bound of |d|."""
        return np.maximum(-self.lo, self.hi)


def ranges(
    tree: Tree, vertices: Array, p: Quadratic | None, frame: Frame, low: Array | float, high: Array | float
) -> Ranges:
    """Enclose values, as narrowly as is needed to see whether low ≤ d ≤ high; beyond, up to a factor of 2 (collective).

    Args:
        tree: The expression.
        vertices: Vertices of n simplices of this rank, of any dimension ≥ 1, shape (n, vertices, dim).
        p: The quadratics; None for 0.
        frame: The domain.
        low: Of each simplex; −∞ for none.
        high: Of each simplex; ∞ for none.
    """
    number = len(vertices)
    low, high = (np.broadcast_to(end, number) for end in (low, high))

    def lacking(own: Indices, bounds: Array) -> Array:
        lo, hi, least, most = bounds[:, :4].T
        below = low[own] - lo - 2 * np.maximum(low[own] - least, 0.0)
        above = hi - high[own] - 2 * np.maximum(most - high[own], 0.0)
        return np.asarray(np.maximum(below, above))

    everything = Parts(vertices, np.arange(number), np.ones(number))
    enclosed = _bounds(tree, p, vertices, everything, np.zeros(number))
    rho = distances(tree, vertices, frame, np.maximum(-lacking(everything.simplex, enclosed), 0.0) / BESIDE, 2)
    enclosed[:, 0] -= BESIDE * rho
    enclosed[:, 1] += BESIDE * rho
    unclear = ~(lacking(everything.simplex, enclosed) <= 0)

    def look(parts: Parts, remainder: Remainder) -> Array:
        of_all = Parts(parts.vertices, rows[parts.simplex], parts.share)
        bounds = _bounds(tree, p, vertices, of_all, remainder.distance(2))
        if p is None:
            bounds[:, 0] = np.fmax(bounds[:, 0], remainder.value.lo)
            bounds[:, 1] = np.fmin(bounds[:, 1], remainder.value.hi)
        return bounds

    def need(parts: Parts, bounds: Array) -> Array:
        size = lacking(rows[parts.simplex], bounds)
        return np.where(size <= 0, 0.0, 1 + size)

    rows = np.flatnonzero(unclear)
    parts, of_parts = in_parts([tree], vertices[unclear], frame, look, need)
    of_parts[:, :2] = np.where(np.isnan(of_parts[:, :2]), [-np.inf, np.inf], of_parts[:, :2])
    own, least = rows[parts.simplex], of_parts[:, 2]
    enclosed[rows, 0], enclosed[rows, 1] = np.inf, -np.inf
    np.minimum.at(enclosed[:, 0], own, of_parts[:, 0])
    np.maximum.at(enclosed[:, 1], own, of_parts[:, 1])
    order = np.argsort(-least, kind="stable")  # the least value of each simplex comes last
    enclosed[own[order], 2], enclosed[own[order], 4:] = least[order], of_parts[order, 4:]
    return Ranges(enclosed[:, 0], enclosed[:, 1], enclosed[:, 2], enclosed[:, 4:])


def _bounds(tree: Tree, p: Quadratic | None, vertices: Array, parts: Parts, rho: Array) -> Array:
    """What is known of d on parts where e is within ρ of a quadratic.

    Returns:
        Lower and upper bound, the least and the largest value in some points, and where the least is, shape
        (parts, 4 + dim).
    """
    near = interpolated(tree, parts.vertices)
    x = np.concatenate([parts.vertices, parts.vertices.mean(axis=1, keepdims=True)], axis=1)
    x = x.mean(axis=1, keepdims=True) + INSIDE * (x - x.mean(axis=1, keepdims=True))
    seen, coefficients = values(tree, x), bernstein(near, parts.vertices)
    if p is not None:
        seen = seen - _of_simplices(p, vertices, parts, x)[:, :, 0]
        coefficients = bernstein(_less(near, p, vertices, parts), parts.vertices)
    place = np.nan_to_num(seen, nan=np.inf).argmin(axis=1)
    rows = np.arange(len(place))
    lo, hi = coefficients.min(axis=1) - BESIDE * rho, coefficients.max(axis=1) + BESIDE * rho
    return np.column_stack([lo, hi, seen[rows, place], seen.max(axis=1), x[rows, place]])


def _less(near: Quadratic, p: Quadratic, vertices: Array, parts: Parts) -> Quadratic:
    """The difference of quadratics of parts and those of their simplices."""
    middle = parts.vertices.mean(axis=1, keepdims=True)
    jet, hessian = _of_simplices(p, vertices, parts, middle)[:, 0], p.hessian[parts.simplex]
    return Quadratic(near.value - jet[:, 0], near.gradient - jet[:, 1:], near.hessian - hessian)


def in_points(vertices: Array, degree: int = 2 * DEGREE) -> tuple[Array, Array]:
    """Points of a quadrature in each simplex, shape (n, points, dim), and its weights > 0 with sum 1."""
    points, weights = _rule(vertices.shape[1], degree)
    return vertices[:, :1] + points @ (vertices[:, 1:] - vertices[:, :1]), weights


@cache
def _rule(corners: int, degree: int) -> tuple[Array, Array]:
    points, weights = positive_quadrature(SIMPLEX[corners - 1], degree)
    return points, weights / weights.sum()


def _of_simplices(p: Quadratic | Polynomial, vertices: Array, parts: Parts, x: Array) -> Array:
    """Values and gradients in points x of parts of the quadratics of their simplices."""
    return p.of(parts.simplex).at(x - vertices.mean(axis=1)[parts.simplex, None])


def _place(parts: Parts, uncertainty: Array, vertices: Array) -> Array:
    """The centroid of the part of each simplex that adds most to the uncertainty."""
    place, order = vertices.mean(axis=1), np.argsort(uncertainty, kind="stable")
    place[parts.simplex[order]] = parts.vertices[order].mean(axis=1)
    return place
