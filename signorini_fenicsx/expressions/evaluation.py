"""Trees in NumPy and in intervals, with gradients.

Variables are given by name, such as `{"x": ..., "y": ...}`; a gradient has one entry for each of them, in this order.
Where min, max, abs or a condition change branch there is no gradient. NumPy then gives the gradient of the branch
taken. Intervals enclose the gradients of both branches if these certainly meet continuously (Clarke's gradient, for
which the mean value theorem holds), and all numbers otherwise.
"""

import operator
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.expressions import intervals
from signorini_fenicsx.expressions.differentiation import Differentiated, Dual
from signorini_fenicsx.expressions.functions import FUNCTIONS
from signorini_fenicsx.expressions.intervals import Elementary, FromNumPy, Interval, Truth, enclosing
from signorini_fenicsx.expressions.tree import (
    Binary,
    Call,
    Conditional,
    Coordinate,
    Negative,
    Number,
    Relation,
    Tree,
    evaluate,
    exactly,
    holds,
)

COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
CHOICES: dict[str, Callable[..., Conditional]] = {
    "max": lambda a, b: Conditional(Relation(">=", a, b), a, b),
    "min": lambda a, b: Conditional(Relation("<=", a, b), a, b),
    "abs": lambda a: Conditional(Relation(">=", a, exactly(0.0)), a, Negative(a)),
}
"""Functions of the language that are choices."""
LONGEST = 100_000
"""Most binary digits of a power in exact arithmetic."""


class Logic:
    """Conditions joined by & | ~."""

    def both(self, left: Any, right: Any) -> Any:
        return left & right

    def either(self, left: Any, right: Any) -> Any:
        return left | right

    def opposite(self, condition: Any) -> Any:
        return ~condition


class Numeric(Logic):
    """The algebra of arrays.

    What depends on NaN is NaN: also a power that IEEE makes 1, and a choice by a comparison with NaN.
    """

    def __init__(self, names: Mapping[str, Array]):
        self._names = names

    def constant(self, value: float) -> Any:
        return np.float64(value)

    def number(self, number: Number) -> Any:
        return np.float64(number.value)

    def coordinate(self, name: str) -> Array:
        return self._names[name]

    def power(self, base: Array, exponent: Array) -> Any:
        value = np.power(base, exponent)
        unknown = np.isnan(base) | np.isnan(exponent)
        return np.where(unknown, np.nan, value) if unknown.any() else value

    def call(self, name: str, arguments: Sequence[Array]) -> Any:
        return FUNCTIONS[name].numeric(*arguments)

    def compare(self, sign: str, left: Array, right: Array) -> Truth:
        unknown = np.isnan(left) | np.isnan(right)
        surely = COMPARISONS[sign](left, right) & ~unknown
        return Truth(surely, surely | unknown)

    def choose(self, condition: Truth, then: Array, otherwise: Array) -> Any:
        return np.where(condition.surely, then, np.where(condition.possibly, np.nan, otherwise))

    jump = choose
    """The gradient of a choice between branches that may not meet."""


class Intervals(Logic):
    """The algebra of intervals."""

    def __init__(self, names: Mapping[str, Interval], elementary: Elementary):
        self._names = names
        self._elementary = elementary

    def constant(self, value: float) -> Interval:
        return enclosing(value)

    def number(self, number: Number) -> Interval:
        if number.below == number.above:
            return enclosing(number.value)
        return Interval(np.asarray(number.below), np.asarray(number.above))

    def coordinate(self, name: str) -> Interval:
        return self._names[name]

    def power(self, base: Interval, exponent: Interval) -> Interval:
        return intervals.power(self._elementary, base, exponent)

    def call(self, name: str, arguments: Sequence[Interval]) -> Interval:
        return FUNCTIONS[name].enclosure(self._elementary, *arguments)

    def compare(self, sign: str, left: Interval, right: Interval) -> Truth:
        match sign:
            case "<":
                return Truth(left.hi < right.lo, ~(left.lo >= right.hi))
            case "<=":
                return Truth(left.hi <= right.lo, ~(left.lo > right.hi))
            case "==":
                return self.compare("<=", left, right) & self.compare("<=", right, left)
            case "!=":
                return ~self.compare("==", left, right)
        return self.compare(sign.replace(">", "<"), right, left)

    def choose(self, condition: Truth, then: Interval, otherwise: Interval) -> Interval:
        undecided = then.hull(otherwise)
        return then.where(condition.surely, undecided.where(condition.possibly, otherwise))

    def jump(self, condition: Truth, then: Interval, otherwise: Interval) -> Interval:
        return then.where(condition.surely, intervals.WHOLE.where(condition.possibly, otherwise))


class _Rational(Logic):
    """The algebra of arrays of fractions; there are neither functions nor choices."""

    def __init__(self, names: Mapping[str, Any]):
        self._names = names

    def number(self, number: Number) -> Fraction:
        if number.fraction is None:
            raise ArithmeticError("a number that is not rational")
        return number.fraction

    def coordinate(self, name: str) -> Any:
        return self._names[name]

    def power(self, base: Any, exponent: Any) -> Any:
        if not isinstance(exponent, Fraction) or exponent.denominator != 1:
            raise ArithmeticError("a root")
        digits = max(each.numerator.bit_length() + each.denominator.bit_length() for each in np.atleast_1d(base).flat)
        if digits * abs(exponent) > LONGEST:
            raise ArithmeticError("a number with too many digits")
        return base ** int(exponent)

    def call(self, name: str, arguments: Sequence[Any]) -> Any:
        raise ArithmeticError("a function")

    def compare(self, sign: str, left: Any, right: Any) -> Any:
        raise ArithmeticError("a choice")

    choose = compare


def rational(tree: Tree, x: Any) -> Any:
    """Exact values in points given by fractions; None if the tree is not written with + − * / and decimal numbers."""
    try:
        value = evaluate(tree, _Rational(_coordinates(x)))
    except ArithmeticError:
        return None
    return np.array(np.broadcast_to(value, x.shape[:-1]))


def values(tree: Tree, x: Array) -> Array:
    """Values in points, whose coordinates are the last axis; NaN or ±inf where there is no value."""
    with np.errstate(all="ignore"):
        value = evaluate(tree, Numeric(_coordinates(x)))
    return np.array(np.broadcast_to(value, x.shape[:-1]))


def linear_terms(tree: Tree) -> list[tuple[float, Tree]]:
    """Numbers and trees whose products add up to a tree.

    Sums are taken apart, and numbers out of products: for a(t) b(x) the tree is b(x) whatever t is.
    """
    value = _number(tree)
    if value is not None:
        return [(value, exactly(1.0))]
    match tree:
        case Negative(operand=operand):
            return [(-factor, term) for factor, term in linear_terms(operand)]
        case Binary(sign="+" | "-" as sign, left=left, right=right):
            return linear_terms(left) + linear_terms(right if sign == "+" else Negative(right))
        case Binary(sign="*", left=left, right=right):
            return _product(linear_terms(left), linear_terms(right)) or [(1.0, tree)]
        case Binary(sign="/", left=left, right=right) if (value := _number(right)) is not None:
            with np.errstate(all="ignore"):
                return [(float(np.float64(factor) / value), term) for factor, term in linear_terms(left)]
    return [(1.0, tree)]


def difference(left: Tree, right: Tree) -> Tree:
    """The difference of two trees without the summands that both have, of which rounding would leave something."""
    number = Counter({term: 0 for tree in (left, right) for _, term in _summands(tree, 1)})
    for tree, factor in ((left, 1), (right, -1)):
        for sign, term in _summands(tree, factor):
            number[term] += sign
    terms = [(count > 0, term) for term, count in number.items() for _ in range(abs(count))]
    terms.sort(key=lambda entry: not entry[0])  # one that is added comes first, if there is one
    if not terms:
        return exactly(0.0)
    (added, first), *others = terms
    total = first if added else Negative(first)
    for added, term in others:
        total = Binary("+" if added else "-", total, term)
    return total


def _summands(tree: Tree, sign: int) -> Iterator[tuple[int, Tree]]:
    match tree:
        case Negative(operand=operand):
            yield from _summands(operand, -sign)
        case Binary(sign="+" | "-" as between, left=left, right=right):
            yield from _summands(left, sign)
            yield from _summands(right, sign if between == "+" else -sign)
        case _:
            yield sign, tree


def _product(left: list[tuple[float, Tree]], right: list[tuple[float, Tree]]) -> list[tuple[float, Tree]] | None:
    """The product of two sums, if one of them is a number, or both have one term."""
    for sums, others in ((left, right), (right, left)):
        (factor, term), *more = sums
        if not more and term == exactly(1.0):
            return [(factor * of_other, other) for of_other, other in others]
    if len(left) == len(right) == 1:
        (a, one), (b, other) = *left, *right
        return [(a * b, Binary("*", one, other))]
    return None


def _number(tree: Tree) -> float | None:
    """The value of a tree without variables; None for others."""
    try:
        with np.errstate(all="ignore"):
            return float(evaluate(tree, Numeric({})))
    except KeyError:
        return None


def values_and_gradient(tree: Tree, x: Array, variables: str = "xyz") -> tuple[Array, Array]:
    """Values in points, and the derivatives by each coordinate, or variable, as a last axis."""
    names = {name: Dual((value,), {name: np.float64(1.0)}) for name, value in _coordinates(x, variables).items()}
    with np.errstate(all="ignore"):
        dual: Dual = evaluate(tree, Differentiated(Numeric({}), names))
    shape = x.shape[:-1]
    gradient = [np.broadcast_to(dual.gradient.get(name, 0.0), shape) for name in names]
    return np.array(np.broadcast_to(dual.values[0], shape)), np.stack(gradient, axis=-1)


def interval(tree: Tree, box: Mapping[str, Interval], elementary: Elementary | None = None) -> Interval:
    """An enclosure of all values on boxes; NaN where the expression may be undefined somewhere in a box."""
    with np.errstate(all="ignore"):
        enclosure: Interval = evaluate(tree, Intervals(box, elementary or FromNumPy()))
    return enclosure.on(next(iter(box.values())).lo.shape)


def decided(tree: Tree, box: Mapping[str, Interval]) -> Tree:
    """The tree on a box, without the choices, max, min and abs among them, of which one branch holds everywhere there.

    So u_D = "-8 if x < 12 else -2" is a number where x > 20.
    """
    match tree:
        case Number() | Coordinate():
            return tree
        case Negative(operand=operand):
            return Negative(decided(operand, box))
        case Binary(sign=sign, left=left, right=right):
            return Binary(sign, decided(left, box), decided(right, box))
        case Call(name=name, arguments=arguments):
            choice = CHOICES[name](*arguments) if name in CHOICES else None
            branch = None if choice is None else _branch(choice, box)
            return branch or Call(name, tuple(decided(argument, box) for argument in arguments))
        case Conditional(condition=condition, then=then, otherwise=otherwise):
            return _branch(tree, box) or Conditional(condition, decided(then, box), decided(otherwise, box))


def _branch(choice: Conditional, box: Mapping[str, Interval]) -> Tree | None:
    """The branch of a choice that holds everywhere on a box, None if there is none."""
    with np.errstate(all="ignore"):
        truth = holds(choice.condition, Intervals(box, FromNumPy()), lambda part: interval(part, box))
    if truth.surely:
        return decided(choice.then, box)
    return None if truth.possibly else decided(choice.otherwise, box)


def _coordinates(x: Array, variables: str = "xyz") -> dict[str, Array]:
    """Points by the names of their coordinates."""
    return dict(zip(variables, np.moveaxis(x, -1, 0), strict=False))
