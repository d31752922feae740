"""Enclosures of data on simplices: of d = e − p, an expression e minus a quadratic p, by intervals and bisection.

A simplex is bisected, longest edge first, until the enclosures are narrow enough. Each part has vertices x_v and a
centroid c. Intervals enclose e, ∇e and ∇²e over its bounding box, and e and ∇e in c. By the mean value theorem

    ∇d(x) ∈ ∇d(c) + [∇²d](x − c) =: G        and        d(x) ∈ d(c) + G·(x − c),

both as hulls over the vertices; they are intersected with the enclosures over the box. Let G = G_m ± δ, and let V =
Σ_v (x_v − c)(x_v − c)ᵀ/((k + 1)(k + 2)) be the covariance of x on a simplex of dimension k. The mean of G_m·(x − c) is
0, so the mean of d is in d(c) ± Σ δ_i √V_ii, and the root mean square of d is at most √(d(c)² + G_m·V G_m) + Σ δ_i
√V_ii. Where a condition is undecided, ∇e is unknown and d is in the hull of both branches.

With proven bounds of elementary functions all this is proven, rounding included. Intervals are rounded outward; other
sums of products have a slack relative to the sum of absolute values. `Places` gives the distance of the stored c and
x_v from the exact ones. A distance e of c from the centroid adds G·e, and using V of the stored vertices adds less than
3 |G|·pad.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.reference_cells import EDGES
from signorini_fenicsx.expressions import Tree
from signorini_fenicsx.expressions.intervals import WHOLE, Elementary, Interval, enclosing, stacked
from signorini_fenicsx.expressions.simplices import (
    ROUNDING,
    TINY,
    Parts,
    Places,
    Quadratic,
    changes,
    evaluated,
    slack,
)

CAP = 1000
"""Largest number of boxes for one simplex."""
BUDGET, BUDGET_EACH = 50_000, 10
"""Largest number of boxes for all simplices together: the first number plus the second per simplex; some seconds."""
WORST = 0.25
"""A part is cut if its share of the uncertainty is at least this much of the largest share in its simplex."""
CLOSE = 0.5
"""An upper bound of ‖d‖² is good enough if it is too large by at most this share of itself."""
CHUNK = 20000
"""Boxes evaluated at once."""


@dataclass(frozen=True)
class Enclosure:
    """Enclosures of d = e − p on each of n simplices. Arrays have shape (n,), and are infinite where nothing is known.

    Attributes:
        mean: Interval with the mean of d.
        norm: Upper bound of the root mean square of d, which is ‖d‖/|T|^½ in L².
        largest: Upper bound of |d|.
        slope: Upper bound of |∇d|, of its components along T and normal to T.
        tilt: Upper bound of the root mean square of |∇d|.
        rise: Upper bound of |∇d·e| for all edges e of T.
        range: Interval with all values of e.
        place: Centroid of the part of a simplex that adds most to the upper bound of ‖d‖, shape (n, d).
    """

    mean: Interval
    norm: Array
    largest: Array
    slope: Array
    tilt: Array
    rise: Array
    range: Interval
    place: Array


def enclose(
    tree: Tree,
    vertices: Array,
    p: Quadratic,
    tolerance: Array,
    elementary: Elementary,
    by: Literal["norm", "mean", "tilt"] = "norm",
) -> Enclosure:
    """Enclose an expression minus a quadratic on simplices, each by itself.

    With "norm" or "tilt" a simplex is done if the upper bound is below the tolerance, or not much above a lower bound;
    with "mean" if the width of the mean is below the tolerance. The enclosures of simplices that are given up before
    are valid too.

    Args:
        tree: The expression, in x, y and, in 3D, z.
        vertices: Vertices of n simplices of any dimension k ≥ 1 in d dimensions, shape (n, k + 1, d).
        p: The quadratics that are subtracted.
        tolerance: Tolerance of each simplex, shape (n,).
        elementary: Bounds of sin, exp, ….
        by: The quantity with the tolerance: `Enclosure.norm`, `tilt` or the width of `mean`.
    """

    def look(parts: Parts) -> Array:
        starts = range(0, max(len(parts.own), 1), CHUNK)
        return np.concatenate([_known(tree, parts.take(slice(a, a + CHUNK)), vertices, p, elementary) for a in starts])

    with np.errstate(all="ignore"):
        work = _Bisection(vertices, tolerance, by)
        parts = Parts(vertices, np.arange(len(vertices)), np.ones(len(vertices)))
        values = look(parts)
        left = (BUDGET_EACH - 1) * len(vertices) + BUDGET
        while True:
            active, cut = work.decide(parts, values)
            wanted = 2 * int(np.count_nonzero(cut))
            if not 0 < wanted <= left:
                work.add(parts, values)
                return work.result()
            left -= wanted
            work.add(parts.take(~active), values[~active])
            halves = parts.take(cut).halves()
            kept = active & ~cut
            parts, values = parts.take(kept).and_(halves), np.concatenate([values[kept], look(halves)])


MEAN_LO, MEAN_HI, MEAN, SQUARE, LEAST, STEEP, FLAT, SUP, SLOPE, RISE, LO, HI = range(12)
"""Columns of the enclosures of a part: the mean of d and its absolute value; bounds from above and below of the mean
square of d and of |∇d|; |d|, |∇d|, |∇d·e|; the range of e."""


class _Bisection:
    """What decides which parts are cut, and sums over the parts of simplices that are done."""

    def __init__(self, vertices: Array, tolerance: Array, by: str):
        n = len(vertices)
        self._tolerance = tolerance
        self._above, self._below = {"mean": (MEAN_HI, MEAN_LO), "tilt": (STEEP, FLAT)}.get(by, (SQUARE, LEAST))
        self._cost = np.ones(n, dtype=np.int64)
        self._sums = np.zeros((n, 5))
        self._most = np.zeros((n, 3))
        self._range = np.tile([np.inf, -np.inf], (n, 1))
        self._place = vertices.mean(axis=1)

    def decide(self, parts: Parts, values: Array) -> tuple[Mask, Mask]:
        """Masks of the parts of simplices that are not done, and of the worst of them, which are to be cut."""
        own, n = parts.own, len(self._cost)
        gap = parts.share * (values[:, self._above] - values[:, self._below])
        left = np.bincount(own, gap, n)
        if self._above == MEAN_HI:
            needy = ~(left <= self._tolerance)
        else:
            upper = np.bincount(own, parts.share * values[:, self._above], n)
            needy = ~((np.isfinite(upper) & (left <= CLOSE * upper)) | (upper <= self._tolerance**2))
        largest = np.zeros(n)
        np.maximum.at(largest, own, gap)
        cut = needy[own] & (gap >= WORST * largest[own])
        cost = self._cost + 2 * np.bincount(own, cut, n).astype(np.int64)
        needy &= cost <= CAP
        self._cost = np.where(needy, cost, self._cost)
        return needy[own], cut & needy[own]

    def add(self, parts: Parts, values: Array) -> None:
        """Sum up all parts of simplices that are done."""
        own, n = parts.own, len(self._cost)
        for column, name in enumerate((MEAN_LO, MEAN_HI, MEAN, SQUARE, STEEP)):
            self._sums[:, column] += np.bincount(own, parts.share * values[:, name], n)
        for column, name in enumerate((SUP, SLOPE, RISE)):
            np.maximum.at(self._most[:, column], own, values[:, name])
        np.minimum.at(self._range[:, 0], own, values[:, LO])
        np.maximum.at(self._range[:, 1], own, values[:, HI])
        order = np.argsort(parts.share * values[:, SQUARE], kind="stable")  # the worst part of each simplex comes last
        self._place[own[order]] = parts.vertices[order].mean(axis=1)

    def result(self) -> Enclosure:
        """The sums, enlarged by their rounding; there are at most as many additions as boxes."""
        rounding = self._cost * 2.0**-52
        mean_lo, mean_hi, mean, *squares = self._sums.T
        norm, tilt = (np.sqrt(square) * (1 + rounding) for square in squares)
        return Enclosure(
            mean=Interval(mean_lo - rounding * mean, mean_hi + rounding * mean),
            norm=norm,
            largest=self._most[:, 0],
            slope=self._most[:, 1],
            tilt=tilt,
            rise=self._most[:, 2],
            range=Interval(self._range[:, 0], self._range[:, 1]),
            place=self._place,
        )


def _known(tree: Tree, parts: Parts, simplices: Array, p: Quadratic, elementary: Elementary) -> Array:
    """The columns of parts of simplices, from one box for each part."""
    places = parts.within(simplices)
    e = evaluated(tree, places, elementary)

    # p in the centres, and its changes from there
    gradient, hessian = p.gradient[parts.own], p.hessian[parts.own]
    steepness, curvature = np.abs(gradient), np.abs(hessian)
    offset = places.centre - simplices[parts.own].mean(axis=1)
    bend = np.einsum("nij,nj->ni", hessian, offset)
    value = p.value[parts.own] + ((gradient + bend / 2) * offset).sum(axis=1)
    distance = np.abs(offset)
    bent = np.einsum("nij,nj->ni", curvature, distance)
    size = np.abs(p.value[parts.own]) + ((steepness + bent) * distance).sum(axis=1)
    p_here = _around(value, slack(size, size > 0))
    reach = np.abs(places.arms).max(axis=1)
    turned = np.einsum("nij,nj->ni", curvature, reach)
    slope = _around(gradient + bend, slack(steepness + bent, steepness + curvature.sum(axis=2) > 0))
    turns = np.einsum("nij,nvj->nvi", hessian, places.arms)
    blur = slack(turned, turned > 0) + (1 + ROUNDING) * curvature.sum(axis=2) * places.pad
    turn = Interval(turns.min(axis=1) - blur, turns.max(axis=1) + blur)
    arch = (turned + 3 * curvature.sum(axis=2) * places.pad) * (reach + 3 * places.pad)
    arch = (1 + ROUNDING) * arch.sum(axis=1) / 2

    # ∇d, d(c) and d
    curved = stacked([places.all_changes(h - enclosing(hessian[:, i])) for i, h in enumerate(e.hessian)], axis=1)
    G = (e.gradient - slope - turn).meet(e.middle_gradient - slope + curved)
    at_centre = e.middle - p_here
    d = (e.value - p_here - places.all_changes(slope) - Interval(-arch, arch)).meet(at_centre + places.all_changes(G))
    ends = np.array(EDGES[simplices.shape[1] - 1]).T
    rise = changes(G, simplices[:, ends[0]][parts.own] - simplices[:, ends[1]][parts.own], np.zeros_like(places.pad))
    return _summary(d, at_centre, G, rise, places, e.value.meet(e.middle + places.all_changes(e.gradient)))


def _around(value: Array, radius: Array) -> Interval:
    return Interval(value - radius, value + radius)


def _summary(d: Interval, at_centre: Interval, G: Interval, rise: Interval, places: Places, every: Interval) -> Array:
    """The columns, from d and d(c), ∇d, ∇d·e and e."""
    arms, reach = places.arms, np.abs(places.arms).max(axis=1)
    corners = arms.shape[1]
    count = corners * (corners + 1)
    deviation = np.sqrt((arms**2).sum(axis=1) / count)
    half = (G.hi + G.lo) / 2
    radius = np.maximum(G.hi - half, half - G.lo)
    rest = (radius * deviation + G.largest * (4 * places.pad + ROUNDING * reach)).sum(axis=1) * (1 + ROUNDING)
    rest += np.where((G.largest > 0).any(axis=1), TINY, 0.0)
    tilt = np.sqrt((np.einsum("nvi,ni->nv", arms, half) ** 2).sum(axis=1) / count)
    mean = d.meet(at_centre + Interval(-rest, rest))
    norm = np.fmin(d.largest, np.hypot(at_centre.largest, tilt) + rest) * (1 + ROUNDING)
    least = np.fmax(mean.smallest, np.hypot(at_centre.smallest, tilt) - rest)
    mean = mean.where(~np.isnan(mean.lo + mean.hi), WHOLE)
    every = every.where(~np.isnan(every.lo + every.hi), WHOLE)
    steep = _square(G.largest).sum(axis=1) * (1 + ROUNDING)
    columns = [
        mean.lo,
        mean.hi,
        mean.largest,
        _square(norm),
        np.minimum(np.fmax(least, 0.0), norm) ** 2,
        steep,
        (G.smallest**2).sum(axis=1),
        d.largest,
        np.sqrt(steep) * (1 + ROUNDING),
        rise.largest.max(axis=1),
        every.lo,
        every.hi,
    ]
    return np.stack(columns, axis=1)


def _square(a: Array) -> Array:
    """Upper bound of a², positive where a is."""
    return np.maximum(a * a * (1 + ROUNDING), np.where(a > 0, TINY, 0.0))
