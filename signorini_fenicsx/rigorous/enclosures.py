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
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.reference_cells import EDGES
from signorini_fenicsx.expressions import Tree
from signorini_fenicsx.expressions.cutting import cut_as_needed, halving
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
    number, is_mean = len(vertices), by == "mean"
    above, below = {"mean": (MEAN_HI, MEAN_LO), "tilt": (STEEP, FLAT)}.get(by, (SQUARE, LEAST))

    def looked(parts: Parts) -> tuple[Array, Array]:
        return _known(tree, parts, vertices, p, elementary), halving(parts)

    def need(parts: Parts, known: Array) -> Array:
        """All of the worst parts of simplices that are not done, nothing of the others."""
        own, gap = parts.simplex, parts.share * (known[:, above] - known[:, below])
        left, upper = (np.bincount(own, each, number) for each in (gap, parts.share * known[:, above]))
        if is_mean:
            needy = ~(left <= tolerance)
        else:
            needy = ~((np.isfinite(upper) & (left <= CLOSE * upper)) | (upper <= tolerance**2))
        largest = np.zeros(number)
        np.maximum.at(largest, own, gap)
        cut = needy[own] & (gap >= WORST * largest[own])
        needy &= _boxes(parts, number) + 2 * np.bincount(own, cut, number) <= CAP
        return np.where(cut & needy[own], 2.0, 0.0)

    with np.errstate(all="ignore"):
        room = BUDGET + BUDGET_EACH * number
        parts, known = cut_as_needed(vertices, looked, need, room, MPI.COMM_SELF)
        return _summed(parts, known, vertices)


MEAN_LO, MEAN_HI, MEAN, SQUARE, LEAST, STEEP, FLAT, SUP, SLOPE, RISE, LO, HI = range(12)
"""Columns of the enclosures of a part: the mean of d and its absolute value; bounds from above and below of the mean
square of d and of |∇d|; |d|, |∇d|, |∇d·e|; the range of e."""


def _boxes(parts: Parts, number: int) -> Indices:
    """How many boxes have been looked at for each of so many simplices."""
    return np.asarray(2 * np.bincount(parts.simplex, minlength=number) - 1)


def _summed(parts: Parts, known: Array, vertices: Array) -> Enclosure:
    """The sums over parts, enlarged by their rounding; there are at most as many additions as boxes."""
    own, number = parts.simplex, len(vertices)
    rounding = _boxes(parts, number) * 2.0**-52
    names = (MEAN_LO, MEAN_HI, MEAN, SQUARE, STEEP)
    mean_lo, mean_hi, mean, *squares = (np.bincount(own, parts.share * known[:, name], number) for name in names)
    norm, tilt = (np.sqrt(square) * (1 + rounding) for square in squares)
    most, (lo, hi), place = np.zeros((3, number)), np.full((2, number), [[np.inf], [-np.inf]]), vertices.mean(axis=1)
    for largest, name in zip((*most, hi), (SUP, SLOPE, RISE, HI), strict=True):
        np.maximum.at(largest, own, known[:, name])
    np.minimum.at(lo, own, known[:, LO])
    order = np.argsort(parts.share * known[:, SQUARE], kind="stable")  # the worst part of each simplex comes last
    place[own[order]] = parts.vertices[order].mean(axis=1)
    return Enclosure(
        mean=Interval(mean_lo - rounding * mean, mean_hi + rounding * mean),
        norm=norm,
        largest=most[0],
        slope=most[1],
        tilt=tilt,
        rise=most[2],
        range=Interval(lo, hi),
        place=place,
    )


def _known(tree: Tree, parts: Parts, simplices: Array, p: Quadratic, elementary: Elementary) -> Array:
    """The columns of parts of simplices, from one box for each part."""
    places = parts.within(simplices)
    e = evaluated(tree, places, elementary)

    # p in the centres, and its changes from there
    gradient, hessian = p.gradient[parts.simplex], p.hessian[parts.simplex]
    steepness, curvature = np.abs(gradient), np.abs(hessian)
    offset = places.centre - simplices[parts.simplex].mean(axis=1)
    bend = np.einsum("nij,nj->ni", hessian, offset)
    value = p.value[parts.simplex] + ((gradient + bend / 2) * offset).sum(axis=1)
    distance = np.abs(offset)
    bent = np.einsum("nij,nj->ni", curvature, distance)
    size = np.abs(p.value[parts.simplex]) + ((steepness + bent) * distance).sum(axis=1)
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
    along = (simplices[:, ends[0]] - simplices[:, ends[1]])[parts.simplex]
    rise = changes(G, along, np.zeros_like(places.pad))
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
