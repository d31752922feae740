"""Taylor series of trees with enclosed coefficients, on many regions at once.

A region is a convex set in a box with centre c and half widths H. With ξ = (x − c)/H a series of degree K has the value
in c, an interval with all values on the region, and for each multi-index 1 ≤ |α| ≤ K an interval mid ± rad that
contains H^α ∂^α e/α! in all points of the box. By Taylor's formula e is on the region within

    Σ rad_α |ξ|^α over |α| = j

of a polynomial of degree j, for each j ≤ K, and its gradient is within the derivative of this sum of the gradient of
the same polynomial.

Where a condition is undecided, e is in the hull of both branches. Gradients of min, max and abs are in the hull of
those of both branches (Clarke's gradient); all other derivatives are unknown. Such a region can be cut along the
*switch* a = 0 that is undecided: a is within `Switch.blur` of an affine function.

Floating-point arithmetic counts as exact here. For proofs, rounding included, there is `simplices`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.expressions import intervals
from signorini_fenicsx.expressions.evaluation import COMPARISONS
from signorini_fenicsx.expressions.functions import FUNCTIONS
from signorini_fenicsx.expressions.intervals import UNKNOWN, WHOLE, FromNumPy, Interval, Truth, enclosing
from signorini_fenicsx.expressions.tree import Number, Tree, evaluate

DEGREE = 4
"""K."""
NEAR = 1e-12
"""A mesh fits a discontinuity of the data up to this distance, relative to the size of the domain."""
ROUNDING = 8 * 2.0**-52
"""The same relative to the coordinates."""
NUMPY = FromNumPy()

type Layer = tuple[Array, Array] | None
"""mid and rad of the coefficients of one order, shape (coefficients, n); None for 0."""


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
class Series:
    """A series, see the module.

    Attributes:
        at: The value in c, shape (n,).
        value: All values on the region.
        layers: The coefficients of orders 1, …, K.
        corners: Those of `Regions`; None for a constant, whose arrays are broadcast.
        whole: Of a positive part max(a, 0) this is a, else None.
    """

    at: Array
    value: Interval
    layers: tuple[Layer, ...] = (None,) * DEGREE
    corners: Array | None = None
    whole: Series | None = None

    @property
    def is_zero(self) -> bool:
        """Whether it is the constant 0."""
        return self.corners is None and bool(np.all(self.value.is_zero))

    def __neg__(self) -> Series:
        layers = tuple(layer and (-layer[0], layer[1]) for layer in self.layers)
        return Series(-self.at, -self.value, layers, self.corners)

    def __add__(self, other: Series) -> Series:
        layers = tuple(map(_sum, self.layers, other.layers))
        return self._with(other, self.at + other.at, self.value + other.value, layers)

    def __sub__(self, other: Series) -> Series:
        return self + -other

    def __mul__(self, other: Series) -> Series:
        value = self.value * (self.value if other is self else other.value)
        layers = _product([_centred(self.value), *self.layers], [_centred(other.value), *other.layers])
        return self._with(other, self.at * other.at, value, layers[1:])

    def __truediv__(self, other: Series) -> Series:
        found = self * other.power(-1.0)
        return self._with(other, self.at / other.at, self.value / other.value, found.layers)

    def of(self, derivatives: Sequence[Interval | None], at: Array) -> Series:
        """φ(e), from enclosures of φ^(k)(e)/k! for 0 ≤ k ≤ K, None for 0, and its value in c."""
        change: list[Layer] = [None, *self.layers]
        layers: list[Layer] = [None] * (DEGREE + 1)
        power, value = change, derivatives[0]
        assert value is not None
        unknown = np.isnan(value.lo + value.hi)
        for derivative in derivatives[1:]:
            if derivative is not None:
                derivative = UNKNOWN.where(unknown, derivative)
                layers = list(map(_sum, layers, _product([_centred(derivative)], power)))
            power = _product(power, change)
        return self._with(self, at, value, layers[1:])

    def power(self, exponent: float) -> Series:
        """E to the power of a number."""
        binomials = itertools.accumulate(range(DEGREE), lambda b, k: b * (exponent - k) / (k + 1), initial=1.0)
        powers = [intervals.power(NUMPY, self.value, enclosing(exponent - k)) for k in range(DEGREE + 1)]
        derivatives = [None if b == 0 else power * b for power, b in zip(powers, binomials, strict=True)]
        derivatives[0] = powers[0]  # without rounding, so that squares are not negative
        if self.whole is not None and exponent > 1:
            return self.whole.of(self.whole._smoother(derivatives, exponent), np.power(self.at, exponent))
        return self.of(derivatives, np.power(self.at, exponent))

    def _smoother(self, derivatives: list[Interval | None], exponent: float) -> list[Interval | None]:
        """The derivatives of max(a, 0)^p for this a: of orders < p they are continuous, that of order p is bounded."""
        positive, undecided = self.value.lo > 0, (self.value.lo <= 0) & (self.value.hi > 0)
        nothing = enclosing(np.zeros_like(self.value.lo))
        for k in range(1, DEGREE + 1):
            derivative = derivatives[k] or nothing
            if k > exponent:
                derivatives[k] = WHOLE.where(undecided, derivative.where(positive, nothing))
            elif k == exponent:
                derivatives[k] = derivative.hull(nothing).where(undecided, derivative.where(positive, nothing))
        return derivatives

    def _with(self, other: Series, at: Array, value: Interval, layers: Sequence[Layer]) -> Series:
        """A series on the same regions; the mean value theorem may narrow its values."""
        corners = self.corners if other.corners is None else other.corners
        if corners is None or layers[0] is None:
            return Series(at, value, tuple(layers), corners)
        lo, hi = _along(at, layers[0], corners)
        return Series(at, value.meet(Interval(lo.min(axis=0), hi.max(axis=0))), tuple(layers), corners)


def _along(at: Array, slope: tuple[Array, Array], corners: Array) -> tuple[Array, Array]:
    """Bounds of at + slope·ξ in the corners, shape (corners, n)."""
    mid, rad = (np.einsum("in,icn->cn", part, xi) for part, xi in zip(slope, (corners, np.abs(corners)), strict=True))
    return at + mid - rad, at + mid + rad


def constant(value: float) -> Series:
    """The series of a number."""
    return Series(np.asarray(value), enclosing(value))


def _centred(value: Interval) -> tuple[Array, Array]:
    """An interval as a layer of order 0; where nothing is known rad is infinite."""
    middle = (value.lo + value.hi) / 2
    known = np.isfinite(middle)
    return np.where(known, middle, 0.0)[None], np.where(known, (value.hi - value.lo) / 2, np.inf)[None]


def _sum(a: Layer, b: Layer) -> Layer:
    if a is None or b is None:
        return a or b
    return a[0] + b[0], a[1] + b[1]


def _product(a: Sequence[Layer], b: Sequence[Layer]) -> list[Layer]:
    """The product of two series of layers from order 0 on, up to order K."""
    found: list[Layer] = [None] * (DEGREE + 1)
    for i, left in enumerate(a):
        for j, right in enumerate(b[: DEGREE + 1 - i]):
            if left is not None and right is not None:
                found[i + j] = _sum(found[i + j], _homogeneous(left, right, i, j))
    return found


def _homogeneous(a: tuple[Array, Array], b: tuple[Array, Array], i: int, j: int) -> tuple[Array, Array]:
    """The product of two layers of orders i and j."""
    if 0 not in (i, j):
        first, second, begin = _pairs(_dimension(len(a[0]), i), i, j)
        a, b = (a[0][first], a[1][first]), (b[0][second], b[1][second])
    mid, rad = a[0] * b[0], np.abs(a[0]) * b[1] + a[1] * (np.abs(b[0]) + b[1])
    if 0 not in (i, j):
        mid, rad = np.add.reduceat(mid, begin), np.add.reduceat(rad, begin)
    return mid, rad  # NaN where it is 0 times what is unknown


@cache
def indices(dim: int, order: int) -> Indices:
    """The multi-indices of an order, shape (coefficients, dim)."""
    found = itertools.product(range(order + 1), repeat=dim)
    return np.array([index for index in found if sum(index) == order][::-1], dtype=np.int64)


@cache
def _dimension(coefficients: int, order: int) -> int:
    return next(dim for dim in (1, 2, 3) if len(indices(dim, order)) == coefficients)


@cache
def _pairs(dim: int, i: int, j: int) -> tuple[Indices, Indices, Indices]:
    """Pairs of coefficients of two layers, in the order of those of the product, and where each of these begins."""
    place = {tuple(index): n for n, index in enumerate(indices(dim, i + j).tolist())}
    pairs = sorted(
        (place[tuple(a + b)], n, m) for n, a in enumerate(indices(dim, i)) for m, b in enumerate(indices(dim, j))
    )
    to, first, second = np.array(pairs, dtype=np.int64).T
    return first, second, np.searchsorted(to, np.arange(len(place)))


@dataclass(frozen=True)
class Remainder:
    """How far an expression is from polynomials on simplices, each of which lies in a region.

    Attributes:
        value: All values on the region of each simplex, shape (n,).
        layers: The coefficients there of orders 1, …, K.
        half: H there, shape (dim, n).
        reach: On each simplex |ξ| is at most this, shape (dim, n).
    """

    value: Interval
    layers: tuple[Layer, ...]
    half: Array
    reach: Array

    @classmethod
    def of(cls, series: Series, half: Array, rows: Indices | slice, reach: Array) -> Remainder:
        """That on simplices in these rows of regions with these half widths."""

        def taken(values: Array) -> Array:
            return np.broadcast_to(values, (*values.shape[:-1], half.shape[1]))[..., rows]

        value = Interval(*(taken(np.atleast_1d(end)) for end in (series.value.lo, series.value.hi)))
        return cls(
            value, tuple(layer and (taken(layer[0]), taken(layer[1])) for layer in series.layers), half[:, rows], reach
        )

    def distance(self, degree: int = DEGREE) -> Array:
        """Bound of the distance to a polynomial of this degree ≤ K; infinite if none is known."""
        found = (self.value.hi - self.value.lo) / 2
        for order, layer in enumerate(self.layers[: degree + 1], 1):
            if layer is None:
                return np.where(np.isfinite(found), 0.0, np.inf)
            size = layer[1] if order <= degree else np.abs(layer[0]) + layer[1]
            found = np.fmin(found, (size * self._monomials(indices(len(self.reach), order))).sum(axis=0))
        return np.nan_to_num(found, nan=np.inf, posinf=np.inf)

    def slope(self) -> tuple[Array, Array]:
        """Bounds of the distances of value and gradient to those of one polynomial of degree K."""
        dim, number = self.reach.shape
        found = np.full((2, number), np.inf)
        known = np.isfinite(self.value.hi - self.value.lo)
        for order, layer in enumerate(self.layers, 1):
            if layer is None:
                none = np.where(known, 0.0, np.inf)
                return none, none
            squares, of_order = np.zeros(number), indices(dim, order)
            for axis, one in enumerate(np.eye(dim, dtype=np.int64)):
                terms = layer[1] * of_order[:, axis, None] * self._monomials(np.maximum(of_order - one, 0))
                squares += (terms.sum(axis=0) / np.where(self.half[axis] > 0, self.half[axis], np.inf)) ** 2
            here = np.stack([(layer[1] * self._monomials(of_order)).sum(axis=0), np.sqrt(squares)])
            found = np.where(here[1] < found[1], here, found)
        return found[0], found[1]

    def _monomials(self, powers: Indices) -> Array:
        return np.asarray(np.prod(self.reach[None] ** powers[:, :, None], axis=1))


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


def expanded(tree: Tree, regions: Regions) -> tuple[Series, Switch]:
    """The series of a tree on regions, and a switch for each that has one."""
    algebra = _Taylor(regions)
    with np.errstate(all="ignore"):
        return evaluate(tree, algebra, {}), algebra.switch


class _Taylor:
    """The algebra of series on some regions."""

    def __init__(self, regions: Regions):
        self._regions = regions
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
        return Series(centre, Interval(centre - half, centre + half), layers, self._regions.corners)

    def power(self, base: Series, exponent: Series) -> Series:
        if exponent.at.ndim == 0:
            return base.power(float(exponent.at))
        return self.call("exp", [exponent * self.call("log", [base])])

    def call(self, name: str, arguments: Sequence[Series]) -> Series:
        function = FUNCTIONS[name]
        at = np.asarray(function.numeric(*(a.at for a in arguments)))
        if name in _DERIVATIVES:
            (a,) = arguments
            value = function.enclosure(NUMPY, a.value)
            return a.of([value, *_DERIVATIVES[name](a.value, value)], at)
        if name == "sqrt":
            return arguments[0].power(0.5)
        value = function.enclosure(NUMPY, *(a.value for a in arguments))
        if name == "atan2":
            return self._angle(arguments[0], arguments[1], at, value)
        left, right = arguments if len(arguments) == 2 else (arguments[0], -arguments[0])
        first = self.compare("<=" if name == "min" else ">=", left, right)
        found = self._chosen(first, left, right, at, value, continuous=True)
        whole = left if right.is_zero else right if left.is_zero else None
        return replace(found, whole=whole) if name == "max" else found

    def compare(self, sign: str, left: Series, right: Series) -> _Condition:
        """Compare almost everywhere: if left − right certainly varies, both are equal on a set of measure 0."""
        a = left - right
        lo, hi, varies, below, above = a.value.lo, a.value.hi, np.asarray(False), np.asarray(False), np.asarray(False)
        if a.corners is not None and a.layers[0] is not None:
            least, most = _along(np.zeros(1), a.layers[0], a.corners)
            change = np.maximum(np.fmax(least, -most).max(axis=0), 0.0)
            varies, slack = change > 0, self._regions.near * change
            below, above = varies & (hi <= slack), varies & (lo >= -slack)
        here = np.asarray(COMPARISONS[sign](a.at, 0.0))
        match sign:
            case "==":
                found = _Condition(~varies & (lo == 0) & (hi == 0), ~varies & ~((lo > 0) | (hi < 0)), here)
            case "!=":
                return ~self.compare("==", left, right)
            case _:
                holds, fails = (below, above) if sign[0] == "<" else (above, below)
                surely, never = {
                    "<": (hi < 0, lo >= 0),
                    "<=": (hi <= 0, lo > 0),
                    ">": (lo > 0, hi <= 0),
                    ">=": (lo >= 0, hi < 0),
                }[sign]
                found = _Condition(surely | (holds & ~fails), ~never & ~(fails & ~holds), here)
        self._record(a, found.possibly & ~found.surely)
        return found

    def _record(self, a: Series, undecided: Mask) -> None:
        """Keep a for the regions where a comparison of it with 0 is the first that is undecided."""
        if a.layers[0] is None:
            return
        switch = self.switch
        new = undecided & ~switch.undecided
        slope, rad = a.layers[0]
        switch.undecided |= new
        for kept, found in ((switch.at, a.at), (switch.slope, slope), (switch.blur, rad.sum(axis=0))):
            kept[..., new] = np.broadcast_to(found, kept.shape)[..., new]

    def both(self, left: _Condition, right: _Condition) -> _Condition:
        return left & right

    def either(self, left: _Condition, right: _Condition) -> _Condition:
        return left | right

    def opposite(self, condition: _Condition) -> _Condition:
        return ~condition

    def choose(self, condition: _Condition, then: Series, otherwise: Series) -> Series:
        undecided = then.value.hull(otherwise.value)
        value = then.value.where(condition.surely, undecided.where(condition.possibly, otherwise.value))
        at = np.where(condition.here, then.at, otherwise.at)
        return self._chosen(condition, then, otherwise, at, value, continuous=False)

    def _chosen(
        self, condition: _Condition, then: Series, otherwise: Series, at: Array, value: Interval, *, continuous: bool
    ) -> Series:
        """The series of a choice of these values; if the branches meet, gradients are in the hull of both."""
        undecided = condition.possibly & ~condition.surely
        layers: list[Layer] = []
        for order, (a, b) in enumerate(zip(then.layers, otherwise.layers, strict=True), 1):
            if a is None and b is None and not undecided.any():
                layers.append(None)
                continue
            zero = np.zeros((len(indices(len(self._regions.centre), order)), 1))
            one, other = a or (zero, zero), b or (zero, zero)
            mixed = _hull(one, other) if order == 1 and continuous else (zero, zero + np.inf)
            mid, rad = (
                np.where(condition.surely, x, np.where(condition.possibly, both, y))
                for x, y, both in zip(one, other, mixed, strict=True)
            )
            layers.append((mid, rad))
        found = then._with(otherwise, at, value, layers)
        return replace(found, corners=self._regions.corners) if undecided.any() else found

    def _angle(self, y: Series, x: Series, at: Array, value: Interval) -> Series:
        """The series of atan2(y, x): Σ|α| g_α ξ^α = (x Σ|α| y_α ξ^α − y Σ|α| x_α ξ^α)/(x² + y²)."""
        zero = constant(0.0)
        apart = self.compare(">=", x, zero) | self.compare(">=", y, zero) | self.compare("<=", y, zero)
        angles = [[_centred(a.value), *a.layers] for a in (x, -y)]
        slopes = [[None, *(_scaled(layer, order) for order, layer in enumerate(a.layers, 1))] for a in (y, x)]
        turned = map(_sum, *(_product(angle, slope) for angle, slope in zip(angles, slopes, strict=True)))
        inverse = (x * x + y * y).power(-1.0)
        found = _product(list(turned), [_centred(inverse.value), *inverse.layers])
        layers = [_scaled(layer, 1 / order) for order, layer in enumerate(found[1:], 1)]
        smooth = x._with(y, at, value, layers)
        return self._chosen(apart, smooth, smooth, at, smooth.value, continuous=False)


def _scaled(layer: Layer, factor: float) -> Layer:
    return layer and (factor * layer[0], factor * layer[1])


def _hull(a: tuple[Array, Array], b: tuple[Array, Array]) -> tuple[Array, Array]:
    """The hull of two layers."""
    lo, hi = np.minimum(a[0] - a[1], b[0] - b[1]), np.maximum(a[0] + a[1], b[0] + b[1])
    known = np.isfinite(hi - lo)
    return np.where(known, (lo + hi) / 2, 0.0), np.where(known, (hi - lo) / 2, np.inf)


def _exponential(_: Interval, value: Interval) -> Iterator[Interval]:
    for k in range(1, DEGREE + 1):
        yield value * (1 / math.factorial(k))


def _logarithm(a: Interval, _: Interval) -> Iterator[Interval]:
    for k in range(1, DEGREE + 1):
        yield intervals.power(NUMPY, a, enclosing(-float(k))) * (-((-1) ** k) / k)


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
        known = [value]
        for k in range(DEGREE):
            square = sum((known[i] * known[k - i] for i in range(1, k + 1)), known[0] * known[k])
            known.append((square * sign + (1.0 if k == 0 else 0.0)) * (1 / (k + 1)))
            yield known[-1]

    return derivatives


_DERIVATIVES: Mapping[str, Callable[[Interval, Interval], Iterator[Interval]]] = {
    "exp": _exponential,
    "log": _logarithm,
    "sin": _wave(0),
    "cos": _wave(1),
    "tan": _tangent(1.0),
    "tanh": _tangent(-1.0),
}
"""Enclosures of φ^(k)(a)/k! for 1 ≤ k ≤ K, from those of a and φ(a)."""
