"""The functions of the language, one row each, with everything that the evaluations need."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from ufl.core.expr import Expr

from signorini_fenicsx.expressions import intervals
from signorini_fenicsx.expressions.intervals import Elementary, Interval


@dataclass(frozen=True)
class Function:
    """One function of the language.

    Attributes:
        fewest: Number of arguments of the evaluations below.
        most: Largest number of arguments in a text; more than `fewest` are combined from left to right.
        constant: Its evaluation for floats.
        symbolic: Its evaluation for UFL expressions.
        numeric: Its evaluation for arrays.
        enclosure: Its evaluation for intervals.
        partials: Its derivatives with respect to each argument, in any algebra; None for min, max and abs, which have
            the derivative of one of their branches.
    """

    fewest: int
    most: int
    constant: Callable[..., float]
    symbolic: Callable[..., Expr]
    numeric: Callable[..., Any]
    enclosure: Callable[..., Interval]
    partials: Callable[..., tuple[Any, ...]] | None = None


def _positive_zero(a: Expr) -> Expr:
    """The expression with 0 in place of −0. UFL would drop a term + 0."""
    return ufl.conditional(ufl.eq(a, 0.0), 0.0, a)


def _size(a: Expr) -> Expr:
    """|a|. In UFL the abs of an abs would be an operand of itself, and algorithms on it would not end."""
    return a if isinstance(a, ufl.algebra.Abs) else abs(a)


def _exact(enclosure: Callable[..., Interval]) -> Callable[..., Interval]:
    """An enclosure that needs no bounds of elementary functions."""

    def apply(_: Elementary, *arguments: Interval) -> Interval:
        return enclosure(*arguments)

    return apply


def _square(m: Any, a: Any) -> Any:
    return m.power(a, m.constant(2.0))


def _angle_partials(m: Any, y: Any, x: Any) -> tuple[Any, Any]:
    square, zero = _square(m, x) + _square(m, y), m.constant(0.0)
    beside = m.either(m.compare(">=", y, zero), m.compare("<=", y, zero))
    uncut = m.either(m.compare(">=", x, zero), beside)
    return tuple(m.jump(uncut, partial, partial) for partial in (x / square, -y / square))


FUNCTIONS: dict[str, Function] = {
    "sin": Function(1, 1, math.sin, ufl.sin, np.sin, intervals.sin, lambda m, a: (m.call("cos", [a]),)),
    "cos": Function(1, 1, math.cos, ufl.cos, np.cos, intervals.cos, lambda m, a: (-m.call("sin", [a]),)),
    "tan": Function(
        1, 1, math.tan, ufl.tan, np.tan, intervals.tan, lambda m, a: (m.constant(1.0) + _square(m, m.call("tan", [a])),)
    ),
    "tanh": Function(
        1,
        1,
        math.tanh,
        ufl.tanh,
        np.tanh,
        intervals.tanh,
        lambda m, a: (m.constant(1.0) - _square(m, m.call("tanh", [a])),),
    ),
    "erf": Function(
        1,
        1,
        math.erf,
        ufl.erf,
        intervals.erf_of,
        intervals.erf,
        lambda m, a: (m.constant(2 / math.sqrt(math.pi)) * m.call("exp", [-_square(m, a)]),),
    ),
    # the angle in (−π, π]; −0 counts as 0 in every evaluation, so it is π where y = 0 and x < 0
    "atan2": Function(
        2,
        2,
        lambda y, x: math.atan2(y + 0.0, x + 0.0),
        lambda y, x: ufl.atan2(_positive_zero(y), _positive_zero(x)),
        lambda y, x: np.arctan2(y + 0.0, x + 0.0),
        intervals.atan2,
        _angle_partials,
    ),
    "exp": Function(1, 1, math.exp, ufl.exp, np.exp, intervals.exp, lambda m, a: (m.call("exp", [a]),)),
    "log": Function(1, 1, math.log, ufl.ln, np.log, intervals.log, lambda m, a: (m.constant(1.0) / a,)),
    "sqrt": Function(
        1, 1, math.sqrt, ufl.sqrt, np.sqrt, intervals.sqrt, lambda m, a: (m.constant(0.5) / m.call("sqrt", [a]),)
    ),
    "abs": Function(1, 1, abs, _size, np.abs, _exact(intervals.absolute)),
    "min": Function(2, 10, min, ufl.min_value, np.minimum, _exact(intervals.smaller)),
    "max": Function(2, 10, max, ufl.max_value, np.maximum, _exact(intervals.larger)),
}
