"""Gradients by forward differentiation, in any algebra: arrays, intervals, or this algebra for second derivatives."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from signorini_fenicsx.expressions.functions import FUNCTIONS
from signorini_fenicsx.expressions.tree import Number

type Gradient = dict[str, Any]
"""Derivatives by the names of the variables; missing ones are 0."""


@dataclass(frozen=True, slots=True)
class Dual:
    """Values in one or more places, and derivatives in the first place.

    Attributes:
        values: The values, for example over boxes and in their centres.
        gradient: The derivatives in the first place.
    """

    values: tuple[Any, ...]
    gradient: Gradient

    def __neg__(self) -> Dual:
        return Dual(tuple(-a for a in self.values), {name: -a for name, a in self.gradient.items()})

    def __add__(self, other: Dual) -> Dual:
        return Dual(self._with(operator.add, other), total(self.gradient, other.gradient))

    def __sub__(self, other: Dual) -> Dual:
        return Dual(self._with(operator.sub, other), total(self.gradient, (-other).gradient))

    def __mul__(self, other: Dual) -> Dual:
        change = total(scaled(self.gradient, other.values[0]), scaled(other.gradient, self.values[0]))
        return Dual(self._with(operator.mul, other), change)

    def __truediv__(self, other: Dual) -> Dual:
        values = self._with(operator.truediv, other)
        change = total(self.gradient, scaled(other.gradient, -values[0]))
        return Dual(values, {name: a / other.values[0] for name, a in change.items()})

    def _with(self, operation: Callable[[Any, Any], Any], other: Dual) -> tuple[Any, ...]:
        return tuple(operation(a, b) for a, b in zip(self.values, other.values, strict=True))


def total(a: Gradient, b: Gradient) -> Gradient:
    """The sum of two gradients."""
    return a | {name: a[name] + value if name in a else value for name, value in b.items()}


def scaled(gradient: Gradient, factor: Any) -> Gradient:
    """A gradient times a number."""
    return {name: factor * a for name, a in gradient.items()}


class Differentiated:
    """Values of another algebra together with their gradients, by the rules of the table of functions."""

    def __init__(self, base: Any, names: Mapping[str, Dual]):
        self._base = base
        self._names = names
        self._places = len(next(iter(names.values())).values)

    def constant(self, value: float) -> Dual:
        return Dual((self._base.constant(value),) * self._places, {})

    def number(self, number: Number) -> Dual:
        return Dual((self._base.number(number),) * self._places, {})

    def coordinate(self, name: str) -> Dual:
        return self._names[name]

    def power(self, base: Dual, exponent: Dual) -> Dual:
        m = self._base
        values = tuple(m.power(a, b) for a, b in zip(base.values, exponent.values, strict=True))
        a, b = base.values[0], exponent.values[0]
        gradient: Gradient = {}
        if base.gradient:
            gradient = scaled(base.gradient, b * m.power(a, b - m.constant(1.0)))
        if exponent.gradient:
            gradient = total(gradient, scaled(exponent.gradient, values[0] * m.call("log", [a])))
        return Dual(values, gradient)

    def call(self, name: str, arguments: Sequence[Dual]) -> Dual:
        m = self._base
        values = tuple(m.call(name, place) for place in zip(*(a.values for a in arguments), strict=True))
        partials = FUNCTIONS[name].partials
        if partials is None:  # min, max, and abs as max(a, −a)
            left, right = arguments if len(arguments) == 2 else (arguments[0], -arguments[0])
            first = self.compare("<=" if name == "min" else ">=", left, right)[0]
            return Dual(values, self._chosen(m.choose, first, left.gradient, right.gradient))
        gradient: Gradient = {}
        for argument, partial in zip(arguments, partials(m, *(a.values[0] for a in arguments)), strict=True):
            gradient = total(gradient, scaled(argument.gradient, partial))
        return Dual(values, gradient)

    def compare(self, sign: str, left: Dual, right: Dual) -> tuple[Any, ...]:
        return tuple(self._base.compare(sign, a, b) for a, b in zip(left.values, right.values, strict=True))

    def both(self, left: tuple[Any, ...], right: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(self._base.both(a, b) for a, b in zip(left, right, strict=True))

    def either(self, left: tuple[Any, ...], right: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(self._base.either(a, b) for a, b in zip(left, right, strict=True))

    def opposite(self, condition: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(self._base.opposite(place) for place in condition)

    def choose(self, condition: tuple[Any, ...], then: Dual, otherwise: Dual) -> Dual:
        choices = zip(condition, then.values, otherwise.values, strict=True)
        values = tuple(self._base.choose(*choice) for choice in choices)
        return Dual(values, self._chosen(self._base.jump, condition[0], then.gradient, otherwise.gradient))

    def jump(self, condition: tuple[Any, ...], then: Dual, otherwise: Dual) -> Dual:
        choices = zip(condition, then.values, otherwise.values, strict=True)
        values = tuple(self._base.jump(*choice) for choice in choices)
        return Dual(values, self._chosen(self._base.jump, condition[0], then.gradient, otherwise.gradient))

    def _chosen(self, choose: Callable[..., Any], condition: Any, then: Gradient, otherwise: Gradient) -> Gradient:
        zero = self._base.constant(0.0)
        return {name: choose(condition, then.get(name, zero), otherwise.get(name, zero)) for name in self._names}
