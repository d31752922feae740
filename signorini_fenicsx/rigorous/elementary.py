"""Floats below and above exp, sin, …, by Arb (python-flint), whose balls are proven to contain the value."""

import math

import numpy as np
from flint import arb

from signorini_fenicsx.base.arrays import Array

_FUNCTIONS = {
    "exp": arb.exp,
    "log": arb.log,
    "sin": arb.sin,
    "cos": arb.cos,
    "tan": arb.tan,
    "tanh": arb.tanh,
    "erf": arb.erf,
    "atan2": arb.atan2,
    "pow": arb.__pow__,
}


REMEMBERED = 32
"""Number of results that are kept, because derivatives contain the same functions of the same numbers."""
PRECISE = 40
"""Bits that are right in all but rare cases."""


class FromArb:
    """Bounds of elementary functions at floats, see `expressions.intervals.Elementary`."""

    def __init__(self) -> None:
        self._known: dict[tuple[str | bytes, ...], tuple[Array, Array]] = {}

    def bounds(self, name: str, *arguments: Array) -> tuple[Array, Array]:
        """Floats below and above the values; NaN where Arb knows nothing."""
        spread = np.broadcast_arrays(*arguments)
        key: tuple[str | bytes, ...] = (name, *(argument.tobytes() for argument in spread))
        if key not in self._known:
            if len(self._known) >= REMEMBERED:
                del self._known[next(iter(self._known))]
            function = _FUNCTIONS[name]
            rows = zip(*(argument.ravel().tolist() for argument in spread), strict=True)
            self._known[key] = _ends([function(*map(arb, row)) for row in rows])
        lo, hi = self._known[key]
        return lo.reshape(spread[0].shape), hi.reshape(spread[0].shape)


def _ends(balls: list[arb]) -> tuple[Array, Array]:
    """Floats below and above balls whose radius is less than |middle| 2^-bits and whose middle has 53 bits."""
    middle = np.array([float(ball) for ball in balls])
    bits = np.array([min(ball.rel_accuracy_bits(), 2000) for ball in balls], dtype=np.int64)
    radius = np.ldexp(np.abs(middle), -bits)
    with np.errstate(invalid="ignore"):
        lo, hi = np.nextafter(middle - radius, -np.inf), np.nextafter(middle + radius, np.inf)
    ordinary = (np.abs(middle) > 1e-280) & (np.abs(middle) < 1e280) & (bits > PRECISE)
    for i in np.flatnonzero(~ordinary):
        lo[i], hi[i] = _ends_of(balls[i])
    return lo, hi


def _ends_of(ball: arb) -> tuple[float, float]:
    """Floats below and above any ball. Its ends have at most 53 bits; the next floats cover ends that are no floats."""
    if ball.is_zero():
        return 0.0, 0.0
    return math.nextafter(float(ball.lower()), -math.inf), math.nextafter(float(ball.upper()), math.inf)
