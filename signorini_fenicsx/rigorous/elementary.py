"""exp, sin, … between floats, by Arb (python-flint): its balls are proved to contain the value."""

import math

import numpy as np
from flint import arb

from signorini_fenicsx.expressions.intervals import Array

_FUNCTIONS = {
    "exp": arb.exp,
    "log": arb.log,
    "sin": arb.sin,
    "cos": arb.cos,
    "tan": arb.tan,
    "tanh": arb.tanh,
    "atan2": arb.atan2,
    "pow": arb.__pow__,
}


class FromArb:
    """Bounds of elementary functions at floats, see `expressions.intervals.Elementary`."""

    def bounds(self, name: str, *arguments: Array) -> tuple[Array, Array]:
        """Floats below and above; NaN where Arb knows nothing."""
        function = _FUNCTIONS[name]
        spread = np.broadcast_arrays(*arguments)
        rows = zip(*(argument.ravel().tolist() for argument in spread), strict=True)
        ends = [_ends(function(*map(arb, row))) for row in rows]
        lo, hi = np.array(ends, dtype=np.float64).reshape(-1, 2).T
        return lo.reshape(spread[0].shape), hi.reshape(spread[0].shape)


def _ends(ball: arb) -> tuple[float, float]:
    """Floats to both sides of a ball. Its ends have at most 53 bits; the next floats see to those that are no floats."""
    lo, hi = float(ball.lower()), float(ball.upper())
    return (lo, hi) if lo == hi == 0 else (math.nextafter(lo, -math.inf), math.nextafter(hi, math.inf))
