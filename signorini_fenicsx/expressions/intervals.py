"""Interval arithmetic over many boxes at once, rounded outward.

+ − * / and √ of IEEE arithmetic are correctly rounded, so the true result is between the next floats on both sides.
exp, sin, … are not correctly rounded: `Elementary` gives floats below and above their values. Its default takes NumPy's
values and adds ULPS units in the last place; this is measured by NumPy's authors, not proven. A library with proven
bounds can be used instead.

NaN as an end means that nothing is known: the expression may be undefined there. It spreads like any NaN.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from signorini_fenicsx.base.arrays import Array, Mask

ULPS = 8
"""NumPy's vectorised functions are right up to 4 units in the last place."""
LARGE = 1e6
"""For larger arguments of sin, cos and tan only the range of the function is returned."""
LARGEST_POWER = 2**20
"""Integer powers up to this are computed as products."""


def _down(value: Array) -> Array:
    return np.nextafter(value, -np.inf)


def _up(value: Array) -> Array:
    return np.nextafter(value, np.inf)


def _two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """fl(a + b) and a + b − fl(a + b), both exact (Knuth), the latter NaN where the sum is not finite."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def _extremes(candidates: list[Array]) -> tuple[Array, Array]:
    return functools.reduce(np.minimum, candidates), functools.reduce(np.maximum, candidates)


@dataclass(frozen=True, slots=True)
class Interval:
    """All numbers from lo to hi, arrays of one shape; ±inf where unbounded, NaN where nothing is known."""

    lo: Array
    hi: Array

    __array_ufunc__ = None  # array + Interval is Interval.__radd__

    def __getitem__(self, index: Any) -> Interval:
        return Interval(self.lo[index], self.hi[index])

    def __setitem__(self, index: Any, other: Interval) -> None:
        self.lo[index], self.hi[index] = other.lo, other.hi

    def put(self, index: Any, other: Interval) -> Interval:
        """A copy with other entries at an index."""
        copy = Interval(self.lo.copy(), self.hi.copy())
        copy[index] = other
        return copy

    def __neg__(self) -> Interval:
        return Interval(-self.hi, -self.lo)

    def __add__(self, other: Interval | float | Array) -> Interval:
        other = enclosing(other)
        lo, error = _two_sum(self.lo, other.lo)
        hi, error_above = _two_sum(self.hi, other.hi)
        return Interval(np.where(error >= 0, lo, _down(lo)), np.where(error_above <= 0, hi, _up(hi)))

    def __sub__(self, other: Interval | float | Array) -> Interval:
        return self + -enclosing(other)

    def __mul__(self, other: Interval | float | Array) -> Interval:
        if other is self:
            return _size_power(absolute(self), 2)
        other = enclosing(other)
        lowest, highest = _extremes([a * b for a in self._ends for b in other._ends])
        exact = self.is_zero | other.is_zero
        return Interval(np.where(exact, lowest, _down(lowest)), np.where(exact, highest, _up(highest)))

    def __truediv__(self, other: Interval | float | Array) -> Interval:
        other = enclosing(other)
        lowest, highest = _extremes([a / b for a in self._ends for b in other._ends])
        unknown = np.where(~((other.lo > 0) | (other.hi < 0)), np.nan, 0.0)
        exact = self.is_zero
        return Interval(
            np.where(exact, lowest, _down(lowest)) + unknown, np.where(exact, highest, _up(highest)) + unknown
        )

    def __radd__(self, other: float | Array) -> Interval:
        return self + other

    def __rsub__(self, other: float | Array) -> Interval:
        return -self + other

    def __rmul__(self, other: float | Array) -> Interval:
        return self * other

    def __rtruediv__(self, other: float | Array) -> Interval:
        return enclosing(other) / self

    @property
    def _ends(self) -> tuple[Array, ...]:
        return (self.lo,) if self.lo is self.hi else (self.lo, self.hi)

    @property
    def is_zero(self) -> Mask:
        """Mask: where both ends are 0."""
        return (self.lo == 0) & (self.hi == 0)

    @property
    def largest(self) -> Array:
        """Bound of the absolute value, infinite where nothing is known."""
        return np.nan_to_num(np.maximum(-self.lo, self.hi), nan=np.inf, posinf=np.inf)

    @property
    def smallest(self) -> Array:
        """Lower bound of the absolute value, 0 where nothing is known."""
        return np.fmax(np.fmax(self.lo, -self.hi), 0.0) * ~np.isnan(self.lo + self.hi)

    def hull(self, other: Interval) -> Interval:
        """The smallest interval that contains both."""
        return Interval(np.minimum(self.lo, other.lo), np.maximum(self.hi, other.hi))

    def meet(self, other: Interval) -> Interval:
        """The intersection of two enclosures of the same number; where one knows nothing, the other."""
        return Interval(np.fmax(self.lo, other.lo), np.fmin(self.hi, other.hi))

    def on(self, shape: tuple[int, ...]) -> Interval:
        """The interval with ends broadcast to this shape."""
        return Interval(np.array(np.broadcast_to(self.lo, shape)), np.array(np.broadcast_to(self.hi, shape)))

    def reshape(self, *shape: int) -> Interval:
        """The interval with ends of another shape."""
        return Interval(self.lo.reshape(shape), self.hi.reshape(shape))

    def where(self, mask: Mask, other: Interval) -> Interval:
        """The interval itself where the mask is True, the other one elsewhere."""
        return Interval(np.where(mask, self.lo, other.lo), np.where(mask, self.hi, other.hi))


def enclosing(value: Interval | float | Array) -> Interval:
    """An interval, unchanged; or a float as the interval of this number."""
    if isinstance(value, Interval):
        return value
    array = np.asarray(value, dtype=np.float64)
    return Interval(array, array)


def stacked(parts: Sequence[Interval], axis: int = -1) -> Interval:
    """Intervals of one shape along a new axis."""
    parts = [part.on(np.broadcast_shapes(*(other.lo.shape for other in parts))) for part in parts]
    return Interval(np.stack([part.lo for part in parts], axis), np.stack([part.hi for part in parts], axis))


WHOLE = Interval(np.asarray(-np.inf), np.asarray(np.inf))
UNKNOWN = enclosing(np.nan)
PI = Interval(np.asarray(np.pi), np.nextafter(np.pi, np.inf))


@dataclass(frozen=True, slots=True)
class Truth:
    """Whether a condition certainly holds on a whole box, and whether it may hold somewhere in the box."""

    surely: Mask
    possibly: Mask

    def __and__(self, other: Truth) -> Truth:
        return Truth(self.surely & other.surely, self.possibly & other.possibly)

    def __or__(self, other: Truth) -> Truth:
        return Truth(self.surely | other.surely, self.possibly | other.possibly)

    def __invert__(self) -> Truth:
        return Truth(~self.possibly, ~self.surely)


def almost_everywhere(sign: str, truth: Truth, varies: Mask, below: Mask, above: Mask) -> Truth:
    """A comparison of a with 0 almost everywhere on sets: where a certainly varies, it is 0 on a set of measure 0.

    Args:
        sign: Of the comparison.
        truth: Of the comparison in all points.
        varies: Where a varies.
        below: Where it varies, and is at most 0.
        above: Where it varies, and is at least 0.
    """
    match sign:
        case "==":
            return Truth(~varies & truth.surely, ~varies & truth.possibly)
        case "!=":
            return Truth(varies | truth.surely, varies | truth.possibly)
    holds, fails = (below, above) if sign[0] == "<" else (above, below)
    return Truth(truth.surely | (holds & ~fails), truth.possibly & ~(fails & ~holds))


class Elementary(Protocol):
    """Bounds of elementary functions at floats."""

    def bounds(self, name: str, *arguments: Array) -> tuple[Array, Array]:
        """Floats below and above values of exp, log, sin, cos, tan, tanh, erf (one argument), atan2 or pow (two)."""


erf_of = np.vectorize(math.erf, otypes=[float])
"""The error function of arrays."""


class FromNumPy:
    """NumPy's values, minus and plus ULPS units in the last place."""

    _FUNCTIONS: dict[str, Callable[..., Array]] = {  # noqa: RUF012
        "exp": np.exp,
        "log": np.log,
        "sin": np.sin,
        "cos": np.cos,
        "tan": np.tan,
        "tanh": np.tanh,
        "erf": erf_of,
        "atan2": np.arctan2,
        "pow": np.power,
    }

    def bounds(self, name: str, *arguments: Array) -> tuple[Array, Array]:
        """See `Elementary`."""
        values = self._FUNCTIONS[name](*arguments)
        slack = ULPS * np.spacing(np.abs(values))
        slack = np.where(np.isinf(values), 0.0, slack)
        return _down(values - slack), _up(values + slack)


def monotone(name: str, elementary: Elementary, a: Interval) -> Interval:
    """An increasing function of one argument."""
    return Interval(elementary.bounds(name, a.lo)[0], elementary.bounds(name, a.hi)[1])


def exp(elementary: Elementary, a: Interval) -> Interval:
    """The exponential."""
    result = monotone("exp", elementary, a)
    return Interval(np.maximum(result.lo, 0.0), result.hi)


def log(elementary: Elementary, a: Interval) -> Interval:
    """The logarithm; nothing is known where a may be negative."""
    return UNKNOWN.where(a.lo < 0, monotone("log", elementary, a))


def _sigmoid(name: str, elementary: Elementary, a: Interval) -> Interval:
    """Tanh or erf, which increase from −1 to 1."""
    result = monotone(name, elementary, a)
    return Interval(np.maximum(result.lo, -1.0), np.minimum(result.hi, 1.0))


tanh, erf = functools.partial(_sigmoid, "tanh"), functools.partial(_sigmoid, "erf")


def sqrt(_: Elementary, a: Interval) -> Interval:
    """The square root; nothing is known where a may be negative."""
    lo, hi = np.sqrt(a.lo), np.sqrt(a.hi)
    roots = Interval(np.where(lo == 0, 0.0, _down(lo)), np.where(hi == 0, 0.0, _up(hi)))
    return UNKNOWN.where(a.lo < 0, roots)


def absolute(a: Interval) -> Interval:
    """The absolute value."""
    lo = np.maximum(np.maximum(a.lo, -a.hi), 0.0)
    return Interval(lo, np.maximum(-a.lo, a.hi))


def smaller(a: Interval, b: Interval) -> Interval:
    """The smaller of two numbers."""
    return Interval(np.minimum(a.lo, b.lo), np.minimum(a.hi, b.hi))


def larger(a: Interval, b: Interval) -> Interval:
    """The larger of two numbers."""
    return Interval(np.maximum(a.lo, b.lo), np.maximum(a.hi, b.hi))


def _wave(name: str, elementary: Elementary, a: Interval) -> Interval:
    """Sin or cos; the maxima of sin are at (1/4 + k) 2π, those of cos at k 2π, and minima half a turn from them."""
    peak = 0.25 if name == "sin" else 0.0
    large = ~((a.lo > -LARGE) & (a.hi < LARGE))
    ends = [elementary.bounds(name, np.where(large, 0.0, end)) for end in (a.lo, a.hi)]
    turns = a / (2.0 * PI)
    highest = large | _has_integer(turns - peak)
    lowest = large | _has_integer(turns - (peak + 0.5))
    lo = np.where(lowest, -1.0, np.maximum(np.minimum(ends[0][0], ends[1][0]), -1.0))
    hi = np.where(highest, 1.0, np.minimum(np.maximum(ends[0][1], ends[1][1]), 1.0))
    unknown = np.where(np.isnan(a.lo) | np.isnan(a.hi), np.nan, 0.0)
    return Interval(lo + unknown, hi + unknown)


sin, cos = functools.partial(_wave, "sin"), functools.partial(_wave, "cos")


def _has_integer(a: Interval) -> Mask:
    return np.floor(a.hi) >= np.ceil(a.lo)


def tan(elementary: Elementary, a: Interval) -> Interval:
    """The tangent, which increases between its poles (1/2 + k) π; nothing is known where a pole may be."""
    pole = _has_integer(a / PI - 0.5) | ~((a.lo > -LARGE) & (a.hi < LARGE))
    safe = Interval(np.where(pole, 0.0, a.lo), np.where(pole, 0.0, a.hi))
    return UNKNOWN.where(pole, monotone("tan", elementary, safe))


def atan2(elementary: Elementary, y: Interval, x: Interval) -> Interval:
    """The angle of (x, y) in (−π, π]; π where y = ±0 and x < 0, and 0 in the origin.

    Away from the cut and the origin its largest and smallest values are in corners of the box.
    """
    corners = [elementary.bounds("atan2", b + 0.0, a + 0.0) for b in (y.lo, y.hi) for a in (x.lo, x.hi)]
    result = Interval(np.minimum.reduce([c[0] for c in corners]), np.maximum.reduce([c[1] for c in corners]))
    limit = Interval(-PI.hi, PI.hi).where(x.lo < 0, Interval(-PI.hi / 2, PI.hi / 2))
    on_cut = (y.lo < 0) & (y.hi >= 0) & (x.lo < 0)
    origin = (y.lo <= 0) & (y.hi >= 0) & (x.lo <= 0) & (x.hi >= 0)
    unknown = np.where(np.isnan(y.lo) | np.isnan(y.hi) | np.isnan(x.lo) | np.isnan(x.hi), np.nan, 0.0)
    result = limit.where(on_cut | origin, result)
    return Interval(result.lo + unknown, result.hi + unknown)


def power(elementary: Elementary, base: Interval, exponent: Interval) -> Interval:
    """A power; if the exponent is not one integer, nothing is known where the base may be negative."""
    if exponent.lo.ndim == 0 and exponent.lo == exponent.hi and float(exponent.lo).is_integer():
        n = int(exponent.lo)
        if abs(n) <= LARGEST_POWER:
            return _integer_power(base, n) if n >= 0 else 1.0 / _integer_power(base, -n)
    corners = [elementary.bounds("pow", a, b) for a in (base.lo, base.hi) for b in (exponent.lo, exponent.hi)]
    lo = np.maximum(np.minimum.reduce([c[0] for c in corners]), 0.0)
    hi = np.maximum.reduce([c[1] for c in corners])
    is_defined = (base.lo > 0) | ((base.lo == 0) & (exponent.lo > 0))
    return Interval(lo, hi).where(is_defined, UNKNOWN)


def _integer_power(base: Interval, n: int) -> Interval:
    if n % 2 == 0:
        return _size_power(absolute(base), n)
    lowest, highest = (enclosing(end) * _size_power(enclosing(np.abs(end)), n - 1) for end in (base.lo, base.hi))
    return Interval(lowest.lo, highest.hi)


def _size_power(size: Interval, n: int) -> Interval:
    """A power of numbers ≥ 0, by squaring."""
    if n == 0:
        return enclosing(np.ones_like(size.lo))
    half = _size_power(size, n // 2)
    square = Interval(_down(half.lo * half.lo), _up(half.hi * half.hi))
    product = square * size if n % 2 else square
    return Interval(np.maximum(product.lo, 0.0), np.where(size.hi == 0, 0.0, product.hi))
