"""The gap of a site under any monotone law, for which the program measures areas beside a graph.

A law is a monotone graph, −σ·n ∈ ∂φ(u) with φ convex. The gap identities of all physics have φ(v) + φ*(−y·n) + (y·n)v ≥
0, see `forms/certificate.py`. If s(t) is σ·n on the graph at u = t, then −s is the slope of φ, and the gap is an area
between the graph and the line σ·n = η, with η for y·n:

    φ(v) + φ*(−η) + ηv = ∫ [η − s(t)]_+ for t < v  +  ∫ [s(t) − η]_+ for t > v,

infinite where v or η is outside of what the graph allows. On a segment of the graph both integrands are linear.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.discrete.points import Points


def gap(law: Chains, v: Array, eta: Array) -> Array:
    """φ(v) + φ*(−η) + ηv at sites whose v and η are in what their law allows, but for rounding."""
    low_p, high_p, low, high = law.extent()
    v, eta = np.clip(v, low_p, high_p), np.clip(eta, low, high)
    total, (ends, _) = np.zeros(len(v)), law.ends
    with np.errstate(invalid="ignore", over="ignore"):
        for segment in range(law.corners + 1):
            slope, begin, end = law.slope[:, segment], ends[:, segment], ends[:, segment + 1]
            inside = np.isfinite(slope) & (segment <= law.count)
            ahead = eta - law.value[:, segment]
            for sign, first, last in ((1.0, begin, np.minimum(end, v)), (-1.0, np.maximum(begin, v), end)):
                # ∫ [±(η − s(t))]_+ over first < t < last, where η − s(t) = ahead + slope·t
                at = [np.maximum(sign * (ahead + np.where(slope > 0, slope * t, 0.0)), 0.0) for t in (first, last)]
                flat = np.where(at[0] > 0, at[0] * (last - first), 0.0)
                sloped = np.abs(at[1] - at[0]) * (at[1] + at[0]) / np.where(slope > 0, 2 * slope, 1.0)
                area = np.where(slope > 0, sloped, flat)
                total += np.where(inside & (last > first), area, 0.0)
    return total


type Area = Callable[[Chains, Array, Array], Array]
"""What laws add for v and η at sites: `gap`, or for quantities `half_gap`."""


def half_gap(law: Chains, v: Array, eta: Array) -> Array:
    """The largest (η − σ·n)(v − u) over the graph, for v and η as in `gap`: Fitzpatrick's function less the product.

    It is at most `gap`: half of it where v and η are on either side of a sloped segment, equal on others.
    """
    low_p, high_p, low, high = law.extent()
    v, eta = np.clip(v, low_p, high_p), np.clip(eta, low, high)
    most, (ends, _) = np.zeros(len(v)), law.ends
    with np.errstate(invalid="ignore", over="ignore"):
        for corner in range(law.corners):
            product = (eta - law.flux[:, corner]) * (v - law.p[:, corner])
            most = np.where(np.isfinite(law.p[:, corner]), np.maximum(most, product), most)
        for segment in range(law.corners + 1):
            slope, value = law.slope[:, segment], law.value[:, segment]
            sloped = np.isfinite(slope) & (slope > 0) & (segment <= law.count)
            beta = np.where(sloped, slope, 1.0)
            u = np.clip((beta * v - eta + value) / (2 * beta), ends[:, segment], ends[:, segment + 1])
            most = np.where(sloped, np.maximum(most, (eta - value + beta * u) * (v - u)), most)
    return most


@dataclass(frozen=True)
class LawPoints[P: Points]:
    """Points in all facets of Γ_S, or in some cells, and the law in each, measured from u = 0 and σ·n = 0.

    Attributes:
        points: The points.
        law: The law of each, facet after facet or cell after cell.
    """

    points: P
    law: Chains

    def extent(self) -> list[Array]:
        """The smallest and largest u and σ·n of the law, in arrays of shape (facets, points)."""
        return [end.reshape(self.points.shape) for end in self.law.extent()]

    def on(self, segment: Indices) -> tuple[Array, Array]:
        """β and value of a segment of each facet, shape (facets, points)."""
        return self._at(self.law.slope, segment), self._at(self.law.value, segment)

    def traces(self, segment: Indices) -> list[Array]:
        """The least and the largest u of a segment of each facet, shape (facets, points)."""
        return [self._at(self.law.ends[0], segment + end) for end in (0, 1)]

    def flux_at(self, corner: Indices) -> Array:
        """σ·n at one corner of the law of each facet, in points."""
        return self._at(self.law.flux, corner)

    def areas(self, area: Area, v: Array, eta: Array) -> Array:
        """What the laws add for v and η in the points, shape (facets, points) each."""
        return area(self.law, v.ravel(), eta.ravel()).reshape(self.points.shape)

    def _at(self, values: Array, corner: Indices) -> Array:
        column = np.minimum(np.repeat(corner, self.points.shape[1]), values.shape[1] - 1)[:, None]
        return np.take_along_axis(values, column, axis=1).reshape(self.points.shape)


def with_mean(base: Array, low: Array, high: Array, mean: Array, weights: Array) -> Array:
    """max(low, min(high, base + c)) with c such that it has this mean, in the points of a quadrature.

    Args:
        base: Shape (facets, points).
        low: At most `high`; infinite in all points of a facet, or in none.
        high: Likewise.
        mean: Of each facet, between those of `low` and `high`.
        weights: Of the quadrature.
    """
    weights = weights / weights.sum()
    if len(base) == 0:
        return base
    free = mean - base @ weights
    ends = np.concatenate([np.where(np.isfinite(each), each - base, free[:, None]) for each in (low, high)], axis=1)
    ends = np.sort(ends, axis=1)  # the mean grows with c, and is linear in c between these
    lowest, highest = np.zeros(len(base), dtype=np.int64), np.full(len(base), ends.shape[1] - 1)

    def mean_with(c: Array) -> Array:
        return np.clip(base + c[:, None], low, high) @ weights

    rows = np.arange(len(base))
    while np.any(highest - lowest > 1):
        middle = (lowest + highest) // 2
        small = mean_with(ends[rows, middle]) <= mean
        lowest, highest = np.where(small, middle, lowest), np.where(small, highest, middle)
    a, b = ends[rows, lowest], ends[rows, highest]
    at_a, at_b = mean_with(a), mean_with(b)
    # beyond all ends the mean still grows if an end is infinite; there it grows like c
    share = np.divide(mean - at_a, at_b - at_a, out=np.zeros_like(mean), where=at_b > at_a)
    c = np.where(mean > at_b, b + mean - at_b, np.where(mean < at_a, a + mean - at_a, a + share * (b - a)))
    return np.clip(base + c[:, None], low, high)
