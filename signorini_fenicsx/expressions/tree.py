"""The expression tree, and its evaluation in any algebra."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from decimal import Decimal
from fractions import Fraction
from typing import Any, Protocol

LONG = 400
"""Numbers with so many digits before or behind the point are not made fractions."""


@dataclass(frozen=True, slots=True)
class Number:
    """A literal or pi: the nearest float, and floats below and above the exact number, equal to it if it is a float.

    A literal that is not a float has its decimal digits, too.
    """

    value: float
    below: float
    above: float
    digits: Decimal | None = None

    @property
    def fraction(self) -> Fraction | None:
        """The exact number; None for pi, and where numerator or denominator would be very long."""
        if self.below == self.above:
            return Fraction(self.value)
        return Fraction(self.digits) if self.digits is not None and abs(self.digits.adjusted()) < LONG else None


@dataclass(frozen=True, slots=True)
class Coordinate:
    """The name of a variable."""

    name: str


@dataclass(frozen=True, slots=True)
class Negative:
    """−a."""

    operand: Tree


@dataclass(frozen=True, slots=True)
class Binary:
    """A sum, difference, product, quotient or power (^), by its sign."""

    sign: str
    left: Tree
    right: Tree


@dataclass(frozen=True, slots=True)
class Call:
    """A function of the language."""

    name: str
    arguments: tuple[Tree, ...]


@dataclass(frozen=True, slots=True)
class Conditional:
    """`then` where the condition holds, `otherwise` elsewhere."""

    condition: Condition
    then: Tree
    otherwise: Tree


@dataclass(frozen=True, slots=True)
class Relation:
    """One of < <= > >= == !=; a chain of them is an `And`."""

    sign: str
    left: Tree
    right: Tree


@dataclass(frozen=True, slots=True)
class And:
    """A condition that holds where all of its operands hold."""

    operands: tuple[Condition, ...]


@dataclass(frozen=True, slots=True)
class Or:
    """A condition that holds where at least one of its operands holds."""

    operands: tuple[Condition, ...]


@dataclass(frozen=True, slots=True)
class Not:
    """The condition does not hold."""

    operand: Condition


type Tree = Number | Coordinate | Negative | Binary | Call | Conditional
type Condition = Relation | And | Or | Not


TREES = Number | Coordinate | Negative | Binary | Call | Conditional
"""All types of a tree, for isinstance."""


def exactly(value: float) -> Number:
    """A float as a number, without rounding."""
    return Number(float(value), float(value), float(value))


class Algebra(Protocol):
    """An algebra in which a tree is evaluated. Its values have + − * / and the unary −.

    `number` and `coordinate` give the leaves; `both`, `either` and `opposite` join conditions made by `compare`.
    """

    def number(self, number: Number) -> Any: ...

    def coordinate(self, name: str) -> Any: ...

    def power(self, base: Any, exponent: Any) -> Any: ...

    def call(self, name: str, arguments: Sequence[Any]) -> Any: ...

    def compare(self, sign: str, left: Any, right: Any) -> Any: ...

    def both(self, left: Any, right: Any) -> Any: ...

    def either(self, left: Any, right: Any) -> Any: ...

    def opposite(self, condition: Any) -> Any: ...

    def choose(self, condition: Any, then: Any, otherwise: Any) -> Any: ...


ARITHMETIC: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
}


def evaluate(tree: Tree, algebra: Algebra, known: dict[Tree, Any] | None = None) -> Any:
    """The value of a tree in an algebra; `known` keeps those of its parts, so that equal parts are evaluated once."""
    if known is None:
        return _evaluated(tree, algebra, None)
    if tree not in known:
        known[tree] = _evaluated(tree, algebra, known)
    return known[tree]


def _evaluated(tree: Tree, algebra: Algebra, known: dict[Tree, Any] | None) -> Any:
    def of(part: Tree) -> Any:
        return evaluate(part, algebra, known)

    match tree:
        case Number():
            return algebra.number(tree)
        case Coordinate(name=name):
            return algebra.coordinate(name)
        case Negative(operand=operand):
            return -of(operand)
        case Binary(sign=sign, left=left, right=right):
            return algebra.power(of(left), of(right)) if sign == "^" else ARITHMETIC[sign](of(left), of(right))
        case Call(name=name, arguments=arguments):
            return algebra.call(name, [of(argument) for argument in arguments])
        case Conditional(condition=condition, then=then, otherwise=otherwise):
            return algebra.choose(holds(condition, algebra, of), of(then), of(otherwise))


def holds(condition: Condition, algebra: Algebra, of: Callable[[Tree], Any]) -> Any:
    """Whether a condition holds in an algebra; `of` gives the values of trees in it."""
    match condition:
        case Relation(sign=sign, left=left, right=right):
            return algebra.compare(sign, of(left), of(right))
        case And(operands=operands) | Or(operands=operands):
            join = algebra.both if isinstance(condition, And) else algebra.either
            return functools.reduce(join, (holds(operand, algebra, of) for operand in operands))
        case Not(operand=operand):
            return algebra.opposite(holds(operand, algebra, of))


def substituted(node: Any, name: str, number: Number) -> Any:
    """A tree, or a part of one, with a number in the place of a variable."""
    match node:
        case Coordinate(name=found):
            return number if found == name else node
        case Number() | str():
            return node
        case tuple():
            return tuple(substituted(part, name, number) for part in node)
    return replace(node, **{each.name: substituted(getattr(node, each.name), name, number) for each in fields(node)})


def depends_on(tree: Tree, name: str) -> bool:
    """Whether a variable is in a tree."""
    return bool(substituted(tree, name, exactly(0.0)) != tree)


def is_polynomial(tree: Tree, degree: int) -> bool:
    """Whether a tree is written as a polynomial of at most this degree."""
    own = polynomial_degree(tree)
    return own is not None and own <= degree


def polynomial_degree(tree: Tree) -> int | None:
    """The degree of a tree that is written as a polynomial; None for anything else."""
    match tree:
        case Number():
            return 0
        case Coordinate():
            return 1
        case Negative(operand=operand):
            return polynomial_degree(operand)
        case Binary(sign=sign, left=left, right=right):
            a, b = polynomial_degree(left), polynomial_degree(right)
            if a is None or b is None:
                return None
            if sign == "^" and isinstance(right, Number) and right.value.is_integer() and right.value >= 0:
                return a * int(right.value)
            if sign == "*":
                return a + b
            if sign in "+-":
                return max(a, b)
            return a if sign == "/" and b == 0 else 0 if a == b == 0 else None
        case Call(arguments=arguments):
            return 0 if all(polynomial_degree(argument) == 0 for argument in arguments) else None
        case Conditional():
            return 0 if _is_constant(tree) else None


def _is_constant(part: Any) -> bool:
    """Whether there is no coordinate in a tree, or in a part of one."""
    if isinstance(part, tuple):
        return all(map(_is_constant, part))
    if isinstance(part, TREES | Relation | And | Or | Not):
        return not isinstance(part, Coordinate) and all(_is_constant(getattr(part, each.name)) for each in fields(part))
    return True
