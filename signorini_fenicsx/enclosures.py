"""What is certain of data on simplices: enclosures of an expression less a quadratic, by intervals and bisection.

A simplex is bisected, longest edge first, until enough is known. On each part, with its vertices x_v, its centroid c,
enclosures of e, ∇e and ∇²e over its bounding box and of e and ∇e in c, and d = e − p:

    ∇d(x) ∈ ∇d(c) + [∇²d](x − c) =: G         and         d(x) ∈ d(c) + G·(x − c)

by the mean value theorem, both as hulls over the vertices, and what the box itself says is used where it says more. With
G = G_m ± δ and V = Σ_v (x_v − c)(x_v − c)ᵀ/((k + 1)(k + 2)), the covariance of x on a simplex of dimension k, the mean
of d is in d(c) ± Σ δ_i √V_ii, since that of G_m·(x − c) is 0, and its root mean square at most √(d(c)² + G_m·V G_m) +
Σ δ_i √V_ii. Where a condition is undecided, ∇e is unknown, and d is in the hull of both branches.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from signorini_fenicsx.expressions.differentiation import Differentiated, Dual
from signorini_fenicsx.expressions.evaluation import Intervals, values
from signorini_fenicsx.expressions.intervals import (
    WHOLE,
    Array,
    Elementary,
    FromNumPy,
    Interval,
    Mask,
    Truth,
    enclosing,
)
from signorini_fenicsx.expressions.tree import Tree, evaluate

CAP = 1000
"""Parts that one simplex is bisected into at most."""
CLOSE = 0.2
"""An upper bound of ‖d‖² that is at most so much too large, relative to itself, is good enough."""
NEAR = 1e-12
"""Distance, relative to the size of the domain, at which a mesh fits a discontinuity of the data."""
ROUNDING = 1e-13
"""Relative size of what the arithmetic outside of the intervals leaves."""
CHUNK = 20000
"""Boxes evaluated at once."""


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


def quadratic(vertices: Array, at_vertices: Array, at_midpoints: Array) -> Quadratic:
    """The quadratic with given values.

    Args:
        vertices: Of n simplices of dimension k, shape (n, k + 1, d).
        at_vertices: Shape (n, k + 1).
        at_midpoints: Of edges, in the order of `edges`, shape (n, (k + 1)k/2).
    """
    corners = vertices.shape[1]
    slopes = barycentric_gradients(vertices)
    # p = Σ a_v λ_v + 4 Σ_{v<w} b_vw λ_v λ_w, b_vw what the midpoint has above the mean of its ends
    bend = np.zeros((len(vertices), corners, corners))
    for column, (v, w) in enumerate(edges(corners)):
        bend[:, v, w] = bend[:, w, v] = 4 * (at_midpoints[:, column] - (at_vertices[:, v] + at_vertices[:, w]) / 2)
    value = at_vertices.mean(axis=1) + bend.sum(axis=(1, 2)) / (2 * corners**2)
    gradient = np.einsum("nv,nvi->ni", at_vertices + bend.sum(axis=2) / corners, slopes)
    return Quadratic(value, gradient, np.einsum("nvi,nvw,nwj->nij", slopes, bend, slopes))


def interpolated(tree: Tree, vertices: Array) -> Quadratic:
    """The quadratic that has the values of a tree in vertices and midpoints of edges; NaN where the tree has none."""
    ends = np.array(edges(vertices.shape[1])).T
    midpoints = (vertices[:, ends[0]] + vertices[:, ends[1]]) / 2
    in_nodes = [values(tree, dict(zip("xyz", np.moveaxis(x, -1, 0), strict=False))) for x in (vertices, midpoints)]
    return quadratic(vertices, *in_nodes)


def constant(means: Array, dim: int) -> Quadratic:
    """The constants."""
    return Quadratic(means, np.zeros((len(means), dim)), np.zeros((len(means), dim, dim)))


def edges(corners: int) -> list[tuple[int, int]]:
    """Pairs of vertices of a simplex."""
    return [(v, w) for v in range(corners) for w in range(v + 1, corners)]


def barycentric_gradients(vertices: Array) -> Array:
    """Gradients of the barycentric coordinates along each simplex, shape (n, k + 1, d)."""
    inverse = np.linalg.pinv((vertices[:, 1:] - vertices[:, :1]).transpose(0, 2, 1))
    return np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)


@dataclass(frozen=True)
class Enclosure:
    """What is certain of d = e − p on each of n simplices. Arrays of shape (n,), infinite where nothing is.

    Attributes:
        mean: The mean of d lies in it.
        norm: Upper bound of the root mean square of d, which is ‖d‖/|T|^½ in L².
        sup: Upper bound of |d|.
        slope: Upper bound of |∇d|, along T and across it.
        range: All values of e lie in it.
        resolved: Where the bisection came to an end before its cap.
        place: Centroid of the part of a simplex that adds most to the upper bound of ‖d‖, shape (n, d).
        boxes: Parts that were looked at.
    """

    mean: Interval
    norm: Array
    sup: Array
    slope: Array
    range: Interval
    resolved: Mask
    place: Array
    boxes: int


def enclose(
    tree: Tree,
    vertices: Array,
    p: Quadratic,
    tolerance: Array,
    *,
    scale: float,
    by_slope: bool = False,
    cap: int = CAP,
    elementary: Elementary | None = None,
) -> Enclosure:
    """Enclose an expression less a quadratic on simplices, each by itself, so whatever the partition.

    A simplex is resolved where the upper bound of the root mean square of d (or of |∇d|) is below the tolerance, or
    not much above the lower bound. What was reached is valid anyway.

    Args:
        tree: The expression, in x, y and, in 3D, z.
        vertices: Of n simplices of any dimension k ≥ 1 in d dimensions, shape (n, k + 1, d).
        p: What is to be taken off.
        tolerance: For each simplex, shape (n,).
        scale: Size of the whole domain: decides what is rounding in the place of a discontinuity; 0: nothing is.
        by_slope: Whether the tolerance is for |∇d|.
        cap: Parts of one simplex that are looked at.
        elementary: Bounds of sin, exp, …; by default those of NumPy.
    """
    work = _Bisection(vertices, tolerance, by_slope=by_slope)
    algebra = elementary or FromNumPy()
    parts = _Parts(vertices, np.arange(len(vertices)), np.ones(len(vertices)))
    while len(parts.own):
        chunks = [parts.take(slice(start, start + CHUNK)) for start in range(0, len(parts.own), CHUNK)]
        with np.errstate(all="ignore"):
            known = _Known.joined([_known(tree, chunk, vertices, p, scale, algebra) for chunk in chunks])
        parts = parts.halves(work.unfinished(parts, known, cap))
    return work.result()


@dataclass(frozen=True)
class _Parts:
    """Parts of simplices: vertices, the simplex they are of, and their share of its measure."""

    vertices: Array
    own: np.ndarray[tuple[int], np.dtype[np.int64]]
    share: Array

    def centred(self) -> tuple[Array, Array]:
        """Centroids, and the vertices as seen from there."""
        centre = self.vertices.mean(axis=1)
        return centre, self.vertices - centre[:, None]

    def take(self, which: slice | Mask) -> _Parts:
        return _Parts(self.vertices[which], self.own[which], self.share[which])

    def halves(self, which: Mask) -> _Parts:
        """Both halves of some of them, cut through the middle of their longest edge."""
        chosen = self.take(which)
        pairs = np.array(edges(self.vertices.shape[1]))
        lengths = [((chosen.vertices[:, v] - chosen.vertices[:, w]) ** 2).sum(axis=1) for v, w in pairs]
        v, w = pairs[np.stack(lengths, axis=1).argmax(axis=1)].T
        rows = np.arange(len(chosen.own))
        middle = (chosen.vertices[rows, v] + chosen.vertices[rows, w]) / 2
        first, second = chosen.vertices.copy(), chosen.vertices.copy()
        first[rows, v] = middle
        second[rows, w] = middle
        own, share = np.tile(chosen.own, 2), np.tile(chosen.share / 2, 2)
        return _Parts(np.concatenate([first, second]), own, share)


@dataclass(frozen=True)
class _Known:
    """As `Enclosure`, for parts; `least` is a lower bound of the root mean square."""

    mean: Interval
    norm: Array
    least: Array
    sup: Array
    slope: Array
    range: Interval

    @staticmethod
    def joined(pieces: Sequence[_Known]) -> _Known:
        def intervals(name: str) -> Interval:
            ends = [[getattr(getattr(piece, name), end) for piece in pieces] for end in ("lo", "hi")]
            return Interval(np.concatenate(ends[0]), np.concatenate(ends[1]))

        def arrays(name: str) -> Array:
            return np.concatenate([getattr(piece, name) for piece in pieces])

        names = ("norm", "least", "sup", "slope")
        return _Known(**{n: arrays(n) for n in names}, mean=intervals("mean"), range=intervals("range"))


class _Bisection:
    """Sums over finished parts, and the decision which parts are finished."""

    def __init__(self, vertices: Array, tolerance: Array, *, by_slope: bool):
        n = len(vertices)
        self._tolerance = tolerance
        self._by_slope = by_slope
        self._lo, self._hi, self._square, self._least, self._sup, self._slope = (np.zeros(n) for _ in range(6))
        self._lowest, self._highest = np.full(n, np.inf), np.full(n, -np.inf)
        self._count = np.zeros(n, dtype=np.int64)
        self._resolved = np.ones(n, dtype=bool)
        self._worst = np.full(n, -1.0)
        self._place = vertices.mean(axis=1)

    def unfinished(self, parts: _Parts, known: _Known, cap: int) -> Mask:
        """Which of these parts have to be halved; the others are summed up."""
        own, n = parts.own, len(self._count)
        limit = self._tolerance[own]
        self._count += np.bincount(own, minlength=n)
        if self._by_slope:
            wide = ~(known.slope <= limit)
        else:
            square = parts.share * known.norm**2
            upper = self._square + np.bincount(own, square, n)
            lower = self._least + np.bincount(own, parts.share * known.least**2, n)
            enough = (upper <= self._tolerance**2) | (upper - lower <= CLOSE * upper)
            small = known.norm**2 - known.least**2 <= np.maximum(limit**2, CLOSE * known.norm**2) / 2
            wide = ~enough[own] & ~small
        capped = self._count + 2 * np.bincount(own, wide, n) > cap
        self._resolved[own[wide & capped[own]]] = False
        wide &= ~capped[own]
        self._add(parts.take(~wide), known, ~wide)
        return wide

    def _add(self, parts: _Parts, known: _Known, done: Mask) -> None:
        own, share, n = parts.own, parts.share, len(self._count)
        square = share * known.norm[done] ** 2
        self._square += np.bincount(own, square, n)
        self._least += np.bincount(own, share * known.least[done] ** 2, n)
        self._lo += np.bincount(own, share * known.mean.lo[done], n)
        self._hi += np.bincount(own, share * known.mean.hi[done], n)
        np.maximum.at(self._sup, own, known.sup[done])
        np.maximum.at(self._slope, own, known.slope[done])
        np.minimum.at(self._lowest, own, known.range.lo[done])
        np.maximum.at(self._highest, own, known.range.hi[done])
        order = np.argsort(square, kind="stable")  # the last of each simplex is its largest
        largest = np.full(n, -1.0)
        largest[own[order]] = square[order]
        place = self._place.copy()
        place[own[order]] = parts.vertices[order].mean(axis=1)
        better = largest > self._worst
        self._worst[better] = largest[better]
        self._place[better] = place[better]

    def result(self) -> Enclosure:
        """The sums, inflated by their rounding."""
        with np.errstate(all="ignore"):
            norm = np.sqrt(self._square) * (1 + ROUNDING)
            mean = Interval(self._lo - ROUNDING * norm, self._hi + ROUNDING * norm)
        whole = Interval(self._lowest, self._highest)
        resolved = self._resolved & np.isfinite(norm)
        return Enclosure(mean, norm, self._sup, self._slope, whole, resolved, self._place, int(self._count.sum()))


class _OnSimplices(Differentiated):
    """Values, gradients and Hessians over boxes, values and gradients in centres; conditions by the mean value form."""

    def __init__(self, inner: Differentiated, names: Mapping[str, Dual], arms: Array, near: Array):
        super().__init__(inner, names)
        self._arms = arms
        self._near = near

    def compare(self, sign: str, left: Dual, right: Dual) -> tuple[Any, ...]:
        """Almost everywhere: where one side changes along T for sure, equality is a set of measure 0."""
        over_box, at_centre = super().compare(sign, left, right)
        difference = left - right
        if not difference.gradient:
            return over_box, at_centre
        shape = (len(self._arms),)
        box, centre = (value.values[0].on(shape) for value in difference.values)
        slopes = [difference.gradient[name].values[0].on(shape) for name in difference.gradient]
        axes = [list(self._names).index(name) for name in difference.gradient]
        changes = _changes(stacked(slopes), self._arms[:, :, axes])
        all_values = box.meet(centre + _hull(changes))
        change = np.fmax.reduce(np.maximum(changes.lo, -changes.hi), axis=1)
        varies = change > 0
        slack = np.where(varies, self._near * change, 0.0)
        below, above = varies & (all_values.hi <= slack), varies & (all_values.lo >= -slack)
        truth: Truth = over_box[0]
        match sign:
            case "==":
                known = Truth(~varies & truth.surely, ~varies & truth.possibly)
            case "!=":
                known = Truth(varies | truth.surely, varies | truth.possibly)
            case _:
                holds, fails = (below, above) if sign[0] == "<" else (above, below)
                known = Truth(truth.surely | (holds & ~fails), truth.possibly & ~(fails & ~holds))
        return (known,), at_centre


def stacked(columns: Sequence[Interval]) -> Interval:
    """Intervals side by side."""
    return Interval(np.stack([a.lo for a in columns], axis=1), np.stack([a.hi for a in columns], axis=1))


def _changes(slope: Interval, arms: Array) -> Interval:
    """slope·arm for each arm, shape (n, arms)."""
    ends = [end[:, None, :] * arms for end in (slope.lo, slope.hi)]
    lo, hi = np.minimum(*ends), np.maximum(*ends)
    rounding = ROUNDING * np.maximum(np.abs(lo), np.abs(hi)).sum(axis=2)
    return Interval(lo.sum(axis=2) - rounding, hi.sum(axis=2) + rounding)


def _hull(changes: Interval) -> Interval:
    return Interval(changes.lo.min(axis=1), changes.hi.max(axis=1))


def _product(slope: Interval, arms: Array) -> Interval:
    """All values of slope·(x − c) on the simplices."""
    return _hull(_changes(slope, arms))


def _evaluated(tree: Tree, parts: _Parts, scale: float, elementary: Elementary) -> Dual:
    """A tree over boxes with first and second derivatives, and in centres with first ones."""
    centre, arms = parts.centred()
    pad = 4 * np.spacing(np.abs(parts.vertices).max(axis=(1, 2)))[:, None]  # midpoints are rounded
    lo, hi = parts.vertices.min(axis=1) - pad, parts.vertices.max(axis=1) + pad
    names = "xyz"[: centre.shape[1]]
    near = NEAR * scale / np.maximum((hi - lo).max(axis=1), 1e-300)
    one = enclosing(1.0)
    places = {name: (Interval(lo[:, i], hi[:, i]), enclosing(centre[:, i])) for i, name in enumerate(names)}
    inner = Differentiated(Intervals({}, elementary), {name: Dual((box,), {}) for name, (box, _) in places.items()})
    variables = {
        name: Dual(tuple(Dual((a,), {name: one}) for a in both), {name: Dual((one,), {})})
        for name, both in places.items()
    }
    found: Dual = evaluate(tree, _OnSimplices(inner, variables, arms, near))
    return found


@dataclass(frozen=True)
class _Local:
    """Enclosures of e over parts and in their centres, as arrays."""

    value: Interval
    gradient: Interval
    hessian: list[Interval]
    middle: Interval
    middle_gradient: Interval

    @staticmethod
    def of(found: Dual, n: int, names: str) -> _Local:
        def row(gradient: Mapping[str, Interval]) -> Interval:
            return stacked([gradient.get(name, enclosing(0.0)).on((n,)) for name in names])

        derivatives = [found.gradient.get(name, Dual((enclosing(0.0),), {})) for name in names]
        over_box, middle = found.values
        return _Local(
            over_box.values[0].on((n,)),
            stacked([derivative.values[0].on((n,)) for derivative in derivatives]),
            [row(derivative.gradient) for derivative in derivatives],
            middle.values[0].on((n,)),
            row(middle.gradient),
        )


def _known(tree: Tree, parts: _Parts, simplices: Array, p: Quadratic, scale: float, elementary: Elementary) -> _Known:
    """What one box each says of the parts of simplices."""
    centre, arms = parts.centred()
    dim = centre.shape[1]
    e = _Local.of(_evaluated(tree, parts, scale, elementary), len(centre), "xyz"[:dim])

    # p in the centres, and how it changes from there
    offset = centre - simplices[parts.own].mean(axis=1)
    hessian = p.hessian[parts.own]
    bend = np.einsum("nij,nj->ni", hessian, offset)
    slope = p.gradient[parts.own] + bend
    rise = ((p.gradient[parts.own] + bend / 2) * offset).sum(axis=1)
    value = p.value[parts.own] + rise
    noise = ROUNDING * (np.abs(p.value[parts.own]) + np.abs(rise))
    turn = np.einsum("nij,nvj->nvi", hessian, arms)
    reach = np.abs(arms).max(axis=1)
    arch = np.einsum("ni,nij,nj->n", reach, np.abs(hessian), reach) / 2

    # ∇d, d(c) and d
    curved = stacked([_product(h - enclosing(hessian[:, i]), arms) for i, h in enumerate(e.hessian)])
    over_box = Interval(e.gradient.lo - slope - turn.max(axis=1), e.gradient.hi - slope - turn.min(axis=1))
    G = over_box.meet(e.middle_gradient - enclosing(slope) + curved)
    at_centre = e.middle - enclosing(value) + Interval(-noise, noise)
    change_of_p = _product(enclosing(slope), arms) + Interval(-arch, arch)
    d = (e.value - enclosing(value) - change_of_p + Interval(-noise, noise)).meet(at_centre + _product(G, arms))
    return _summary(d, at_centre, G, arms, e.value.meet(e.middle + _product(e.gradient, arms)))


def _summary(d: Interval, at_centre: Interval, G: Interval, arms: Array, every: Interval) -> _Known:
    corners = arms.shape[1]
    covariance = np.einsum("nvi,nvj->nij", arms, arms) / (corners * (corners + 1))
    deviation = np.sqrt(np.einsum("nii->ni", covariance))
    half = (G.hi + G.lo) / 2
    radius = np.maximum(G.hi - half, half - G.lo)
    rest = (radius * deviation).sum(axis=1) * (1 + ROUNDING)
    tilt = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", half, covariance, half), 0.0))
    mean = d.meet(at_centre + Interval(-rest, rest))
    norm = np.fmin(d.largest, np.hypot(at_centre.largest, tilt) + rest) * (1 + ROUNDING)
    least = np.fmax(mean.smallest, np.hypot(at_centre.smallest, tilt) - rest)
    return _Known(
        mean=mean.where(~np.isnan(mean.lo + mean.hi), WHOLE),
        norm=np.nan_to_num(norm, nan=np.inf, posinf=np.inf),
        least=np.nan_to_num(np.maximum(least, 0.0), nan=0.0, posinf=0.0),
        sup=d.largest,
        slope=np.nan_to_num(np.sqrt((G.largest**2).sum(axis=1)), nan=np.inf, posinf=np.inf),
        range=every.where(~np.isnan(every.lo + every.hi), WHOLE),
    )
