"""Trees over simplices: values, gradients and Hessians over bounding boxes, values and gradients in centroids."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from signorini_fenicsx.expressions.differentiation import Differentiated, Dual
from signorini_fenicsx.expressions.evaluation import Intervals
from signorini_fenicsx.expressions.intervals import Array, Elementary, Interval, Mask, Truth, enclosing
from signorini_fenicsx.expressions.quadratics import edges
from signorini_fenicsx.expressions.tree import Tree, evaluate

NEAR = 1e-12
"""Distance, relative to the size of the domain, at which a mesh fits a discontinuity of the data."""
ROUNDING = 1e-13
"""Relative size of what the arithmetic outside of the intervals leaves."""


@dataclass(frozen=True)
class Parts:
    """Parts of simplices: vertices, the simplex they are of, and their share of its measure."""

    vertices: Array
    own: np.ndarray[tuple[int], np.dtype[np.int64]]
    share: Array

    def centred(self) -> tuple[Array, Array]:
        """Centroids, and the vertices as seen from there."""
        centre = self.vertices.mean(axis=1)
        return centre, self.vertices - centre[:, None]

    def take(self, which: slice | Mask) -> Parts:
        """Some of them."""
        return Parts(self.vertices[which], self.own[which], self.share[which])

    def and_(self, other: Parts) -> Parts:
        """These and others."""
        pairs = [(getattr(self, name), getattr(other, name)) for name in ("vertices", "own", "share")]
        return Parts(*(np.concatenate(pair) for pair in pairs))

    def halves(self, which: Mask) -> Parts:
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
        return Parts(np.concatenate([first, second]), own, share)


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


def all_changes(slope: Interval, arms: Array) -> Interval:
    """All values of slope·(x − c) on the simplices."""
    return _hull(_changes(slope, arms))


@dataclass(frozen=True)
class Local:
    """Enclosures of e over parts and in their centres, as arrays."""

    value: Interval
    gradient: Interval
    hessian: list[Interval]
    middle: Interval
    middle_gradient: Interval

    @staticmethod
    def of(found: Dual, n: int, names: str) -> Local:
        def row(gradient: Mapping[str, Interval]) -> Interval:
            return stacked([gradient.get(name, enclosing(0.0)).on((n,)) for name in names])

        derivatives = [found.gradient.get(name, Dual((enclosing(0.0),), {})) for name in names]
        over_box, middle = found.values
        return Local(
            over_box.values[0].on((n,)),
            stacked([derivative.values[0].on((n,)) for derivative in derivatives]),
            [row(derivative.gradient) for derivative in derivatives],
            middle.values[0].on((n,)),
            row(middle.gradient),
        )


def evaluated(tree: Tree, parts: Parts, scale: float, elementary: Elementary) -> Local:
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
    return Local.of(found, len(centre), names)
