"""Taylor series with enclosed coefficients, on many regions at once.

A region is a convex set in a box with centre c and half widths H. With ξ = (x − c)/H a series of degree K has the value
in c, an interval with all values on the region, and for each multi-index 1 ≤ |α| ≤ K an interval mid ± rad that
contains H^α ∂^α e/α! in all points of the box. By Taylor's formula e is on the region within

    Σ rad_α |ξ|^α over |α| = j

of a polynomial of degree j, for each j ≤ K, and its gradient is within the derivative of this sum of the gradient of
the same polynomial.

Where e has a kink or a jump, the coefficients may be those of a smooth function s near e instead: |e − s| ≤ `rough` on
the region. Then e itself is within `rough` more of the polynomial, and nothing is known of its gradient.

Floating-point arithmetic counts as exact here. For proofs, rounding included, there is `simplices`.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.expressions import intervals
from signorini_fenicsx.expressions.intervals import UNKNOWN, WHOLE, FromNumPy, Interval, enclosing

DEGREE = 4
"""K."""
NUMPY = FromNumPy()
SMOOTH = np.asarray(0.0)

type Layer = tuple[Array, Array] | None
"""mid and rad of the coefficients of one order, shape (coefficients, n); None for 0."""


@dataclass(frozen=True)
class Series:
    """A series, see the module.

    Attributes:
        at: The value in c, shape (n,).
        value: All values on the region.
        layers: The coefficients of orders 1, …, K.
        corners: Those of `Regions`; None for a constant, whose arrays are broadcast.
        whole: Of a positive part max(a, 0) this is a, else None.
        rough: Bound of |e − s|; 0 where the coefficients are those of e.
        gradient: ∂e/∂ξ in c, shape (dim, n), NaN where unknown; None for 0.
    """

    at: Array
    value: Interval
    layers: tuple[Layer, ...] = (None,) * DEGREE
    corners: Array | None = None
    whole: Series | None = None
    rough: Array = field(default_factory=lambda: SMOOTH)
    gradient: Array | None = None

    @property
    def values(self) -> Interval:
        """All values of e and of s on the region."""
        return Interval(self.value.lo - self.rough, self.value.hi + self.rough)

    @property
    def is_zero(self) -> bool:
        """Whether the expression is the constant 0."""
        return self.corners is None and bool(np.all(self.value.is_zero))

    def __neg__(self) -> Series:
        layers = tuple(layer and (-layer[0], layer[1]) for layer in self.layers)
        gradient = None if self.gradient is None else -self.gradient
        return Series(-self.at, -self.value, layers, self.corners, rough=self.rough, gradient=gradient)

    def __add__(self, other: Series) -> Series:
        layers = tuple(map(plus, self.layers, other.layers))
        at, gradient = self.at + other.at, _sum((1.0, self), (1.0, other))
        return self._with(other, at, self.value + other.value, layers, self.rough + other.rough, gradient)

    def __sub__(self, other: Series) -> Series:
        return self + -other

    def __mul__(self, other: Series) -> Series:
        value = self.value * (self.value if other is self else other.value)
        layers = product([centred(self.values), *self.layers], [centred(other.values), *other.layers])
        rough = times(self.value.largest, other.rough) + times(other.values.largest, self.rough)
        gradient = _sum((other.at, self), (self.at, other))
        return self._with(other, self.at * other.at, value, layers[1:], rough, gradient)

    def __truediv__(self, other: Series) -> Series:
        quotient = self * other.power(-1.0)
        at, value = self.at / other.at, self.value / other.value
        return self._with(other, at, value, quotient.layers, quotient.rough, quotient.gradient)

    def of(self, derivatives: Sequence[Interval | None], at: Array, first: Array) -> Series:
        """φ(e), from enclosures of φ(e) and of φ^(k)/k! on `values` for 1 ≤ k ≤ K, None for 0.

        Args:
            derivatives: These enclosures.
            at: φ(e) in c.
            first: φ'(e) in c.
        """
        change: list[Layer] = [None, *self.layers]
        layers: list[Layer] = [None] * (DEGREE + 1)
        power, value = change, derivatives[0]
        assert value is not None
        unknown = np.isnan(value.lo + value.hi)
        for derivative in derivatives[1:]:
            if derivative is not None:
                derivative = UNKNOWN.where(unknown, derivative)
                layers = list(map(plus, layers, product([centred(derivative)], power)))
            power = product(power, change)
        rough = SMOOTH if derivatives[1] is None else times(derivatives[1].largest, self.rough)
        return self._with(self, at, value, layers[1:], rough, _sum((first, self)))

    def power(self, exponent: float) -> Series:
        """The expression to the power of a number."""
        binomials = itertools.accumulate(range(DEGREE), lambda b, k: b * (exponent - k) / (k + 1), initial=1.0)
        everywhere = [self.value, *[self.values] * DEGREE]
        powers = [intervals.power(NUMPY, value, enclosing(exponent - k)) for k, value in enumerate(everywhere)]
        derivatives = [None if b == 0 else power * b for power, b in zip(powers, binomials, strict=True)]
        first = exponent * np.power(self.at, exponent - 1)
        derivatives[0] = powers[0]  # without rounding, so that squares are not negative
        if self.whole is not None and exponent > 1 and not self.whole.rough.any():
            return self.whole.of(self.whole._smoother(derivatives, exponent), np.power(self.at, exponent), first)
        return self.of(derivatives, np.power(self.at, exponent), first)

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

    def _with(
        self,
        other: Series,
        at: Array,
        value: Interval,
        layers: Sequence[Layer],
        rough: Array = SMOOTH,
        gradient: Array | None = None,
    ) -> Series:
        """A series on the same regions; the mean value theorem may narrow its values."""
        corners = self.corners if other.corners is None else other.corners
        if corners is None or layers[0] is None:
            return Series(at, value, tuple(layers), corners, rough=rough, gradient=gradient)
        lo, hi = along(at, layers[0], corners)
        near = Interval(lo.min(axis=0) - 2 * rough, hi.max(axis=0) + 2 * rough)
        return Series(at, value.meet(near), tuple(layers), corners, rough=rough, gradient=gradient)

    def beyond_gradient(self) -> Interval:
        """What e has on the region beside the affine function with its value and gradient in c; NaN where unknown."""
        if self.gradient is None or self.layers[1] is None:
            return enclosing(np.where(self.rough == 0, 0.0, np.nan))
        mid, rad = self.layers[1]
        is_square = (indices(len(self.gradient), 2) == 2).any(axis=1)[:, None]
        lo = np.where(is_square, np.minimum(mid - rad, 0.0), -np.abs(mid) - rad).sum(axis=0)
        hi = np.where(is_square, np.maximum(mid + rad, 0.0), np.abs(mid) + rad).sum(axis=0)
        return Interval(lo, hi).where(self.rough == 0, UNKNOWN)

    def range(self) -> Interval:
        """All values on the region, by the second order too."""
        if self.corners is None or self.gradient is None:
            return self.value
        affine, rest = self.at + np.einsum("in,icn->cn", self.gradient, self.corners), self.beyond_gradient()
        return self.value.meet(Interval(affine.min(axis=0) + rest.lo, affine.max(axis=0) + rest.hi))


def along(at: Array, slope: tuple[Array, Array], corners: Array) -> tuple[Array, Array]:
    """Bounds of at + slope·ξ in the corners, shape (corners, n)."""
    mid, rad = (np.einsum("in,icn->cn", part, xi) for part, xi in zip(slope, (corners, np.abs(corners)), strict=True))
    return at + mid - rad, at + mid + rad


def constant(value: float) -> Series:
    """The series of a number."""
    return Series(np.asarray(value), enclosing(value))


def centred(value: Interval) -> tuple[Array, Array]:
    """An interval as a layer of order 0; where nothing is known rad is infinite."""
    middle = (value.lo + value.hi) / 2
    is_finite = np.isfinite(middle)
    return np.where(is_finite, middle, 0.0)[None], np.where(is_finite, (value.hi - value.lo) / 2, np.inf)[None]


def _sum(*terms: tuple[Array | float, Series]) -> Array | None:
    """The sum of factors times gradients."""
    gradients = [factor * series.gradient for factor, series in terms if series.gradient is not None]
    return sum(gradients[1:], gradients[0]) if gradients else None


def times(size: Array, rough: Array) -> Array:
    """A size times a distance; 0 where the distance is 0, whatever the size."""
    return np.where(rough == 0, 0.0, size * rough)


def plus(a: Layer, b: Layer) -> Layer:
    """The sum of two layers."""
    if a is None or b is None:
        return a or b
    return a[0] + b[0], a[1] + b[1]


def product(a: Sequence[Layer], b: Sequence[Layer]) -> list[Layer]:
    """The product of two series of layers from order 0 on, up to order K."""
    layers: list[Layer] = [None] * (DEGREE + 1)
    for i, left in enumerate(a):
        for j, right in enumerate(b[: DEGREE + 1 - i]):
            if left is not None and right is not None:
                layers[i + j] = plus(layers[i + j], _homogeneous(left, right, i, j))
    return layers


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
    exponents = itertools.product(range(order + 1), repeat=dim)
    return np.array([index for index in exponents if sum(index) == order][::-1], dtype=np.int64)


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
        rough: That of the series, shape (n,).
    """

    value: Interval
    layers: tuple[Layer, ...]
    half: Array
    reach: Array
    rough: Array

    @classmethod
    def of(cls, series: Series, half: Array, rows: Indices | slice, reach: Array) -> Remainder:
        """The remainder on simplices in these rows of regions with these half widths."""

        def taken(values: Array) -> Array:
            return np.broadcast_to(values, (*values.shape[:-1], half.shape[1]))[..., rows]

        lo, hi, rough = (taken(np.atleast_1d(each)) for each in (series.value.lo, series.value.hi, series.rough))
        layers = tuple(layer and (taken(layer[0]), taken(layer[1])) for layer in series.layers)
        return cls(Interval(lo, hi), layers, half[:, rows], reach, rough)

    @np.errstate(over="ignore", invalid="ignore")  # far from the region nothing is known, which the result says
    def distance(self, degree: int = DEGREE) -> Array:
        """Bound of the distance to a polynomial of this degree ≤ K; infinite if none is known."""
        half_width = (self.value.hi - self.value.lo) / 2
        for order, layer in enumerate(self.layers[: degree + 1], 1):
            if layer is None:
                return np.where(np.isfinite(half_width), np.fmin(half_width, self.rough), np.inf)
            size = layer[1] if order <= degree else np.abs(layer[0]) + layer[1]
            beyond = (size * self._monomials(indices(len(self.reach), order))).sum(axis=0)
            half_width = np.fmin(half_width, beyond + self.rough)
        return np.nan_to_num(half_width, nan=np.inf, posinf=np.inf)

    @np.errstate(over="ignore", invalid="ignore")
    def slope(self) -> tuple[Array, Array]:
        """Bounds of the distances of value and gradient to those of one polynomial of degree K."""
        dim, number = self.reach.shape
        best = np.full((2, number), np.inf)
        is_finite = np.isfinite(self.value.hi - self.value.lo) & (self.rough == 0)
        for order, layer in enumerate(self.layers, 1):
            if layer is None:
                none = np.where(is_finite, 0.0, np.inf)
                return none, none
            squares, of_order = np.zeros(number), indices(dim, order)
            for axis, one in enumerate(np.eye(dim, dtype=np.int64)):
                terms = layer[1] * of_order[:, axis, None] * self._monomials(np.maximum(of_order - one, 0))
                squares += (terms.sum(axis=0) / np.where(self.half[axis] > 0, self.half[axis], np.inf)) ** 2
            slopes = np.stack([(layer[1] * self._monomials(of_order)).sum(axis=0), np.sqrt(squares)])
            best = np.where(slopes[1] < best[1], slopes, best)
        best[:, self.rough != 0] = np.inf
        return best[0], best[1]

    def _monomials(self, powers: Indices) -> Array:
        return np.asarray(np.prod(self.reach[None] ** powers[:, :, None], axis=1))


def scaled(layer: Layer, factor: float) -> Layer:
    """A layer times a number."""
    return layer and (factor * layer[0], factor * layer[1])


def hull(a: tuple[Array, Array], b: tuple[Array, Array]) -> tuple[Array, Array]:
    """The hull of two layers."""
    lo, hi = np.minimum(a[0] - a[1], b[0] - b[1]), np.maximum(a[0] + a[1], b[0] + b[1])
    is_finite = np.isfinite(hi - lo)
    return np.where(is_finite, (lo + hi) / 2, 0.0), np.where(is_finite, (hi - lo) / 2, np.inf)
