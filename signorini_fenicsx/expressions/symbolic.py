"""Trees as UFL. Constant sub-expressions stay Python floats, so that errors such as 1/0 are found while reading."""

import math
from collections.abc import Callable, Sequence

import ufl
from ufl.core.expr import Expr

from signorini_fenicsx.expressions.functions import FUNCTIONS
from signorini_fenicsx.expressions.tree import Number, Tree, evaluate

MAX_INTEGER_POWER = 30

type Value = float | Expr

_COMPARISONS: dict[str, Callable[[Value, Value], Expr]] = {
    "<": ufl.lt,
    "<=": ufl.le,
    ">": ufl.gt,
    ">=": ufl.ge,
    "==": ufl.eq,
    "!=": ufl.ne,
}


def to_ufl(tree: Tree, x: Expr) -> Expr:
    """A tree as UFL in these coordinates, which must include all variables of the tree."""
    return ufl.as_ufl(evaluate(tree, _Symbolic(x)))


class _Symbolic:
    def __init__(self, x: Expr):
        self._names = dict(zip("xyz", x, strict=False))

    def number(self, number: Number) -> Value:
        return number.value

    def coordinate(self, name: str) -> Value:
        return self._names[name]

    def power(self, base: Value, exponent: Value) -> Value:
        if isinstance(base, float) and isinstance(exponent, float):
            return math.pow(base, exponent)  # refuses a root of a negative number
        if isinstance(exponent, float) and exponent.is_integer() and abs(exponent) <= MAX_INTEGER_POWER:
            exponent = int(exponent)  # UFL estimates quadrature degrees from integer powers
        return ufl.as_ufl(base) ** exponent

    def call(self, name: str, arguments: Sequence[Value]) -> Value:
        function = FUNCTIONS[name]
        if all(isinstance(argument, float) for argument in arguments):
            return float(function.constant(*arguments))
        return function.symbolic(*(ufl.as_ufl(argument) for argument in arguments))

    def compare(self, sign: str, left: Value, right: Value) -> Expr:
        return _COMPARISONS[sign](left, right)

    def both(self, left: Expr, right: Expr) -> Expr:
        return ufl.And(left, right)

    def either(self, left: Expr, right: Expr) -> Expr:
        return ufl.Or(left, right)

    def opposite(self, condition: Expr) -> Expr:
        return ufl.Not(condition)

    def choose(self, condition: Expr, then: Value, otherwise: Value) -> Expr:
        return ufl.conditional(condition, then, otherwise)
