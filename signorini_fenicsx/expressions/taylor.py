"""The Taylor series of trees on many regions at once, see `series`.

Where a condition is undecided, e is in the hull of both branches. With d ∈ [l, h] the difference of the branches,

- max(d, 0) is within −lh/(2(h − l)) of the affine function of d that is 0 in l and h in h, less this. So max(b + d, b)
  is as near to a mean of both branches with a constant; and a jump within sup|d|/2 of half of each;
- or, for gradients, those of min, max and abs are in the hull of those of both branches (Clarke's gradient); all other
  derivatives are unknown.

Such a region can be cut along the *switch* a = 0 that is undecided: a is within `Switch.blur` of an affine function.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.expressions import intervals
from signorini_fenicsx.expressions.evaluation import COMPARISONS, Intervals, Logic
from signorini_fenicsx.expressions.functions import FUNCTIONS
from signorini_fenicsx.expressions.intervals import Interval, Truth, almost_everywhere, enclosing
from signorini_fenicsx.expressions.series import (
    DEGREE,
    NUMPY,
    Layer,
    Series,
    along,
    centred,
    constant,
    hull,
    indices,
    plus,
    product,
    scaled,
    times,
)
from signorini_fenicsx.expressions.tree import Number, Tree, evaluate

NEAR = 1e-12
"""A mesh fits a discontinuity of the data up to this distance, relative to the size of the domain."""
ROUNDING = 8 * 2.0**-52
"""Distance from a discontinuity that is rounding, relative to the coordinates."""


@dataclass(frozen=True)
class Regions:
    """Convex sets in boxes.

    Attributes:
        centre: c, shape (dim, n).
        half: H, shape (dim, n).
        corners: ξ of points whose convex hull is the region, shape (dim, corners, n or 1).
        near: A discontinuity that is that near to the boundary, relative to the largest H, does not cut the region.
    """

    centre: Array
    half: Array
    corners: Array
    near: Array

    @classmethod
    def of_simplices(cls, vertices: Array, scale: float) -> Regions:
        """Simplices by their vertices, shape (n, vertices, dim), in a domain of this size."""
        x = np.moveaxis(vertices, 0, -1).swapaxes(0, 1)
        lo, hi = x.min(axis=1), x.max(axis=1)
        centre, half = (lo + hi) / 2, (hi - lo) / 2
        corners = (x - centre[:, None]) / np.where(half > 0, half, 1.0)[:, None]
        near = NEAR * scale + ROUNDING * np.abs(x).max(axis=(0, 1))
        return cls(centre, half, corners, near / np.maximum(half.max(axis=0), 1e-300))

    @classmethod
    def of_boxes(cls, lo: Array, hi: Array) -> Regions:
        """Boxes by two corners, shape (dim, n)."""
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=len(lo)))).T[:, :, None]
        return cls((lo + hi) / 2, (hi - lo) / 2, signs, np.zeros(lo.shape[1]))


@dataclass
class Switch:
    """For each region a comparison of an a with 0 that is undecided on it, if there is one.

    Attributes:
        undecided: Mask of the regions with one.
        at: a in c, shape (n,).
        slope: ∂a/∂ξ, shape (dim, n).
        blur: Bound of |a − at − slope·ξ|.
    """

    undecided: Mask
    at: Array
    slope: Array
    blur: Array


@dataclass(frozen=True)
class _Condition(Truth):
    """Whether a condition holds on whole regions, and in their centres."""

    here: Mask

    def __and__(self, other: _Condition) -> _Condition:  # type: ignore[override]
        return _Condition(self.surely & other.surely, self.possibly & other.possibly, self.here & other.here)

    def __or__(self, other: _Condition) -> _Condition:  # type: ignore[override]
        return _Condition(self.surely | other.surely, self.possibly | other.possibly, self.here | other.here)

    def __invert__(self) -> _Condition:
        return _Condition(~self.possibly, ~self.surely, ~self.here)


def expanded(trees: Sequence[Tree], regions: Regions, *, rough: bool) -> tuple[list[Series], Switch]:
    """The series of trees on regions, rough ones or with gradients, and a switch for each region that has one."""
    algebra = _Taylor(regions, rough=rough)
    known: dict[Tree, Series] = {}
    with np.errstate(all="ignore"):
        return [evaluate(tree, algebra, known) for tree in trees], algebra.switch


class _Taylor(Logic):
    """The algebra of series on some regions."""

    def __init__(self, regions: Regions, *, rough: bool):
        self._regions, self._rough = regions, rough
        dim, number = regions.centre.shape
        self.switch = Switch(np.zeros(number, dtype=bool), np.zeros(number), np.zeros((dim, number)), np.zeros(number))

    def number(self, number: Number) -> Series:
        return constant(number.value)

    def coordinate(self, name: str) -> Series:
        axis = "xyz".index(name)
        centre, half = self._regions.centre[axis], self._regions.half[axis]
        slope = np.zeros_like(self._regions.half)
        slope[axis] = half
        layers = (slope, np.zeros_like(slope)), *[None] * (DEGREE - 1)
        return Series(centre, Interval(centre - half, centre + half), layers, self._regions.corners, gradient=slope)

    def power(self, base: Series, exponent: Series) -> Series:
        if exponent.at.ndim == 0:
            return base.power(float(exponent.at))
        return self.call("exp", [exponent * self.call("log", [base])])

    def call(self, name: str, arguments: Sequence[Series]) -> Series:
        function = FUNCTIONS[name]
        at = np.asarray(function.numeric(*(a.at for a in arguments)))
        if name in _DERIVATIVES:
            (a,) = arguments
            value, everywhere = (function.enclosure(NUMPY, values) for values in (a.value, a.values))
            steep = next(iter(_DERIVATIVES[name](enclosing(a.at), enclosing(at))))
            return a.of([value, *_DERIVATIVES[name](a.values, everywhere)], at, (steep.lo + steep.hi) / 2)
        if name == "sqrt":
            return arguments[0].power(0.5)
        value = function.enclosure(NUMPY, *(a.value for a in arguments))
        if name == "atan2":
            return self._angle(arguments[0], arguments[1], at, value)
        left, right = arguments if len(arguments) == 2 else (arguments[0], -arguments[0])
        first = self.compare("<=" if name == "min" else ">=", left, right)
        beyond = (right - left if name == "min" else left - right).range()
        choice = self._chosen(first, left, right, at, value, beyond)
        whole = left if right.is_zero else right if left.is_zero else None
        return replace(choice, whole=whole) if name == "max" else choice

    def compare(self, sign: str, left: Series, right: Series) -> _Condition:
        """Compare almost everywhere: where left − right has one sign and varies, both are equal on the border alone.

        Inside of regions, where there are points of quadratures, they are then equal nowhere.
        """
        a = left - right
        whole = a.range()
        lo, hi = whole.lo, whole.hi
        below, above = np.asarray(False), np.asarray(False)
        if a.corners is not None and a.layers[0] is not None:
            least, most = along(np.zeros(1), a.layers[0], a.corners)
            change = np.where(a.rough == 0, np.maximum(np.fmax(least, -most).max(axis=0), 0.0), 0.0)
            varies, slack = change > 0, self._regions.near * change
            below, above = varies & (hi <= slack), varies & (lo >= -slack)
        everywhere = Intervals({}, NUMPY).compare(sign, whole, enclosing(0.0))
        truth = almost_everywhere(sign, everywhere, below | above, below, above)
        here = (COMPARISONS[sign](a.at, 0.0) | truth.surely) & truth.possibly  # a centre may be on the border
        condition = _Condition(truth.surely, truth.possibly, np.asarray(here))
        self._record(a, condition.possibly & ~condition.surely)
        return condition

    def _record(self, a: Series, undecided: Mask) -> None:
        """Keep a for the regions where a comparison of it with 0 is the first that is undecided."""
        if a.layers[0] is None:
            return
        switch = self.switch
        new = undecided & ~switch.undecided
        slope, rad = a.layers[0]
        switch.undecided |= new
        blur, rest = rad.sum(axis=0) + a.rough, a.beyond_gradient()
        closer = rest.hi - rest.lo < 2 * blur
        found = (
            np.where(closer, a.at + (rest.lo + rest.hi) / 2, a.at),
            slope if a.gradient is None else np.where(closer, a.gradient, slope),
            np.where(closer, (rest.hi - rest.lo) / 2, blur),
        )
        for kept, now in zip((switch.at, switch.slope, switch.blur), found, strict=True):
            kept[..., new] = np.broadcast_to(now, kept.shape)[..., new]

    def choose(self, condition: _Condition, then: Series, otherwise: Series) -> Series:
        undecided = then.value.hull(otherwise.value)
        value = then.value.where(condition.surely, undecided.where(condition.possibly, otherwise.value))
        at = np.where(condition.here, then.at, otherwise.at)
        return self._chosen(condition, then, otherwise, at, value, None)

    def _chosen(
        self,
        condition: _Condition,
        then: Series,
        otherwise: Series,
        at: Array,
        value: Interval,
        beyond: Interval | None,
    ) -> Series:
        """The series of a choice of these values.

        Of max, min and abs the first branch is chosen where `beyond`, a difference of the branches, is ≥ 0.
        """
        undecided = condition.possibly & ~condition.surely
        share, rough = np.asarray(0.5), np.asarray(0.0)
        if self._rough and undecided.any():
            share, rough = _mean(then, otherwise, beyond)
        layers: list[Layer] = []
        for order, (a, b) in enumerate(zip(then.layers, otherwise.layers, strict=True), 1):
            if a is None and b is None and not undecided.any():
                layers.append(None)
                continue
            zero = np.zeros((len(indices(len(self._regions.centre), order)), 1))
            one, other = a or (zero, zero), b or (zero, zero)
            if self._rough:
                mixed = tuple(share * x + (1 - share) * y for x, y in zip(one, other, strict=True))
            else:
                mixed = hull(one, other) if order == 1 and beyond is not None else (zero, zero + np.inf)
            mid, rad = (
                np.where(condition.surely, x, np.where(condition.possibly, both, y))
                for x, y, both in zip(one, other, mixed, strict=True)
            )
            layers.append((mid, rad))
        rough = np.where(condition.surely, then.rough, np.where(condition.possibly, rough, otherwise.rough))
        series = then._with(otherwise, at, value, layers, rough)
        if then.gradient is not None or otherwise.gradient is not None:
            first, second = (np.zeros(1) if each.gradient is None else each.gradient for each in (then, otherwise))
            series = replace(series, gradient=np.where(condition.here, first, second))
        return replace(series, corners=self._regions.corners) if undecided.any() else series

    def _angle(self, y: Series, x: Series, at: Array, value: Interval) -> Series:
        """The series of atan2(y, x): Σ|α| g_α ξ^α = (x Σ|α| y_α ξ^α − y Σ|α| x_α ξ^α)/(x² + y²)."""
        zero = constant(0.0)
        apart = self.compare(">=", x, zero) | self.compare(">=", y, zero) | self.compare("<=", y, zero)
        angles = [[centred(a.values), *a.layers] for a in (x, -y)]
        slopes = [[None, *(scaled(layer, order) for order, layer in enumerate(a.layers, 1))] for a in (y, x)]
        turned = map(plus, *(product(angle, slope) for angle, slope in zip(angles, slopes, strict=True)))
        inverse = (x * x + y * y).power(-1.0)
        quotient = product(list(turned), [centred(inverse.values), *inverse.layers])
        layers = [scaled(layer, 1 / order) for order, layer in enumerate(quotient[1:], 1)]
        unknown = np.asarray(np.inf)
        smooth = x._with(y, at, value, layers, times(unknown, x.rough + y.rough))
        return self._chosen(apart, smooth, replace(smooth, rough=unknown), at, smooth.value, None)


def _mean(then: Series, otherwise: Series, beyond: Interval | None) -> tuple[Array, Array]:
    """The share of the first branch in a mean of both that is near a choice, and how near, see the module."""
    if beyond is None:
        share, near = np.asarray(0.5), (then - otherwise).value.largest / 2
    else:
        width = beyond.hi - beyond.lo
        share, near = beyond.hi / width, -beyond.lo * beyond.hi / (2 * width)
    return share, share * then.rough + (1 - share) * otherwise.rough + near


def _wave(quarter: int) -> Callable[[Interval, Interval], Iterator[Interval]]:
    """The derivatives of sin (quarter 0) and cos (1)."""

    def derivatives(a: Interval, _: Interval) -> Iterator[Interval]:
        sine, cosine = intervals.sin(NUMPY, a), intervals.cos(NUMPY, a)
        turns = [sine, cosine, -sine, -cosine]
        for k in range(1, DEGREE + 1):
            yield turns[(quarter + k) % 4] * (1 / math.factorial(k))

    return derivatives


def _tangent(sign: float) -> Callable[[Interval, Interval], Iterator[Interval]]:
    """The derivatives of tan (1) and tanh (−1), by φ' = 1 ± φ²."""

    def derivatives(_: Interval, value: Interval) -> Iterator[Interval]:
        coefficients = [value]
        for k in range(DEGREE):
            square = sum(
                (coefficients[i] * coefficients[k - i] for i in range(1, k + 1)), coefficients[0] * coefficients[k]
            )
            coefficients.append((square * sign + (1.0 if k == 0 else 0.0)) * (1 / (k + 1)))
            yield coefficients[-1]

    return derivatives


def _error_function(a: Interval, _: Interval) -> Iterator[Interval]:
    """The derivatives of erf, by φ'' = −2aφ'."""
    bell = intervals.exp(NUMPY, -intervals.power(NUMPY, a, enclosing(2.0)))
    scale = enclosing(2.0) / intervals.sqrt(NUMPY, enclosing(math.pi).hull(enclosing(np.nextafter(math.pi, 4.0))))
    coefficients = [bell * scale]
    yield coefficients[0]
    for k in range(1, DEGREE):
        following = a * coefficients[-1] * (-2.0 / (k + 1))
        if k > 1:
            following += coefficients[-2] * (-2.0 * (k - 1) / (k * (k + 1)))
        coefficients.append(following)
        yield following


_DERIVATIVES: Mapping[str, Callable[[Interval, Interval], Iterator[Interval]]] = {
    "exp": lambda _, value: (value * (1 / math.factorial(k)) for k in range(1, DEGREE + 1)),
    "log": lambda a, _: (
        intervals.power(NUMPY, a, enclosing(-float(k))) * (-((-1) ** k) / k) for k in range(1, DEGREE + 1)
    ),
    "sin": _wave(0),
    "cos": _wave(1),
    "tan": _tangent(1.0),
    "tanh": _tangent(-1.0),
    "erf": _error_function,
}
"""Enclosures of φ^(k)(a)/k! for 1 ≤ k ≤ K, from those of a and φ(a)."""
