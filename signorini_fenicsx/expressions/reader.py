"""The reader of expressions: Python's `ast` parses arithmetic, a whitelist checks it, and nothing is ever executed."""

import ast
import contextlib
import functools
import math
import re
import warnings
from collections.abc import Collection, Iterator
from decimal import Decimal

from ufl.core.expr import Expr

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.expressions.functions import FUNCTIONS
from signorini_fenicsx.expressions.symbolic import to_ufl
from signorini_fenicsx.expressions.tree import (
    ARITHMETIC,
    And,
    Binary,
    Call,
    Condition,
    Conditional,
    Coordinate,
    Negative,
    Not,
    Number,
    Or,
    Relation,
    Tree,
    exactly,
    substituted,
)

MAX_LENGTH = 2000
MAX_DEPTH = 150
"""Most terms of a sum, nested brackets or joined conditions for which UFL and FFCx do not run out of stack."""

ALLOWED = "it may have numbers with a point, + - * / **, functions such as sin(x), and 1 if x > 0 else 2"
"""What may be in an expression, in words."""
PI = Number(math.pi, math.pi, math.nextafter(math.pi, math.inf))
_OPERATORS: dict[type[ast.operator], str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^"}
_COMPARISONS: dict[type[ast.cmpop], str] = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
}

type Read = tuple[Tree, float | None]
"""A tree, and its value if it is constant, so that errors such as 1/0 are found while reading."""


class _Reader:
    """The reader of one syntax tree; node types that are not named here are refused."""

    def __init__(self, source: str):
        self.source = source
        self.names: dict[str, None] = {}  # that the text has, in their order
        self.depth = 0

    def enter(self, levels: int) -> None:
        self.depth += levels
        if self.depth > MAX_DEPTH:
            raise RecursionError

    def value(self, node: ast.expr) -> Read:
        """Read a node; constants must be finite, and the nesting must not be too deep for UFL."""
        self.enter(1)
        tree, constant = self._value(node)
        self.depth -= 1
        if constant is not None and not math.isfinite(constant):
            raise ValueError(f"{ast.unparse(node)} is not finite")
        return tree, constant

    def _value(self, node: ast.expr) -> Read:
        match node:
            case ast.Constant(value=bool() | str() | bytes() | complex() | None):
                raise InputError(f"{ast.unparse(node)} is not a number")
            case ast.Constant(value=int() | float()):
                number = self.number(node)
                return number, number.value
            case ast.Name(id="pi"):
                return PI, PI.value
            case ast.Name(id=name):
                self.names[name] = None
                return Coordinate(name), None
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                tree, constant = self.value(operand)
                return Negative(tree), None if constant is None else -constant
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.value(operand)
            case ast.BinOp(left=left, op=operator, right=right) if type(operator) in _OPERATORS:
                return self.binary(_OPERATORS[type(operator)], self.value(left), self.value(right))
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return Conditional(self.condition(test), self.value(body)[0], self.value(orelse)[0]), None
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self.call(name, arguments)
        raise InputError(f"'{ast.unparse(node)}' is not allowed in an expression; {ALLOWED}")

    def number(self, node: ast.Constant) -> Number:
        """A literal, enclosed by floats, because its decimal digits need not be a float."""
        value = float(node.value)  # type: ignore[arg-type]
        if not math.isfinite(value):
            raise ValueError(f"{ast.unparse(node)} is not finite")
        exact = Decimal(node.value if isinstance(node.value, int) else ast.get_source_segment(self.source, node))  # type: ignore[arg-type]
        difference = exact.compare(Decimal(value))
        below = math.nextafter(value, -math.inf) if difference < 0 else value
        above = math.nextafter(value, math.inf) if difference > 0 else value
        return Number(value, below, above, None if below == above else exact)

    @staticmethod
    def binary(sign: str, left: Read, right: Read) -> Read:
        tree = Binary(sign, left[0], right[0])
        if left[1] is None or right[1] is None:
            return tree, None
        if sign != "^":
            return tree, ARITHMETIC[sign](left[1], right[1])
        power = left[1] ** right[1]
        if isinstance(power, complex):
            raise ValueError("a root of a negative number")
        return tree, power

    def call(self, name: str, arguments: list[ast.expr]) -> Read:
        if name not in FUNCTIONS:
            raise InputError(f"unknown function '{name}'; known are {', '.join(FUNCTIONS)}")
        function = FUNCTIONS[name]
        fewest, most = function.fewest, function.most
        if not fewest <= len(arguments) <= most:
            wanted = str(fewest) if fewest == most else f"{fewest} to {most}"
            raise InputError(f"{name} takes {wanted} argument(s), not {len(arguments)}")

        def apply(*read: Read) -> Read:
            trees, constants = zip(*read, strict=True)
            constant = None if None in constants else float(function.constant(*constants))
            return Call(name, trees), constant

        read = [self.value(argument) for argument in arguments]
        return functools.reduce(apply, read) if fewest < most else apply(*read)

    def condition(self, node: ast.expr) -> Condition:
        self.enter(1)
        condition = self._condition(node)
        self.depth -= 1
        return condition

    def _condition(self, node: ast.expr) -> Condition:
        match node:
            case ast.Compare(left=left, ops=operators, comparators=comparators) if all(
                type(operator) in _COMPARISONS for operator in operators
            ):
                self.enter(len(operators))
                values = [self.value(value)[0] for value in (left, *comparators)]
                self.depth -= len(operators)
                signs = [_COMPARISONS[type(operator)] for operator in operators]
                tests = tuple(Relation(*test) for test in zip(signs, values[:-1], values[1:], strict=True))
                return tests[0] if len(tests) == 1 else And(tests)
            case ast.BoolOp(op=operator, values=operands):
                self.enter(len(operands))
                conditions = tuple(self.condition(operand) for operand in operands)
                self.depth -= len(operands)
                return And(conditions) if isinstance(operator, ast.And) else Or(conditions)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return Not(self.condition(operand))
        raise InputError(f"'{ast.unparse(node)}' is not a comparison such as x > 0")


@functools.lru_cache(maxsize=1000)
def _read(text: str) -> tuple[Read, list[str]]:
    """Read a tree and the names in it, each text of a run once; ^ becomes **, as Python's own ^ binds weaker than +."""
    source = text.strip().replace("^", "**")
    with warnings.catch_warnings(action="ignore"):  # Python warns of texts such as 1if x>0 else 2
        node = ast.parse(source, mode="eval").body
    reader = _Reader(source)
    return reader.value(node), [*reader.names]


def read(text: str, names: Collection[str]) -> Tree:
    """Read an expression such as `50*(1/2 - x)*sin(pi*y) if x > 0 else 0`.

    Allowed are numbers, pi, the names, + - * / ** ^, comparisons inside `a if condition else b` and the functions sin,
    cos, tan, tanh, erf, atan2, exp, log, sqrt, abs, min, max. atan2 takes −0 for 0, so its values are in (−π, π].

    Args:
        text: The expression.
        names: Names of the variables.

    Raises:
        InputError: If the text is anything else.
    """
    if len(text) > MAX_LENGTH:
        raise InputError(f"expression of {len(text)} characters; at most {MAX_LENGTH} are read")
    with _complaints(text, names):
        (tree, _), found = _read(text)
        if unknown := [name for name in found if name not in set(names)]:  # of a text its letters, not its pieces
            time = "; t is the time of a case with [time]" if unknown[0] == "t" else ""
            raise InputError(f"unknown name '{unknown[0]}'; known are {', '.join(['pi', *names])}{time}")
        return tree


@contextlib.contextmanager
def _complaints(text: str, names: Collection[str]) -> Iterator[None]:
    """Turn errors inside this context into one sentence about the text."""
    try:
        yield
    except InputError as error:
        raise InputError(f"expression '{_shortened(text)}': {error}") from None
    except SyntaxError as error:
        words = ", ".join(["pi", *names])
        what = f"expression '{_shortened(text)}' is not arithmetic in {words}"
        hint = f"; {ALLOWED}" if re.search(r"\?|\bif\b|\bthen\b|&|\|", text) else ""
        raise InputError(f"{what}: {_unbalanced(text) or _wrong_at(text, error)}{hint}") from None
    except (ArithmeticError, ValueError) as error:
        raise InputError(f"expression '{_shortened(text)}' cannot be evaluated: {error}") from None
    except (RecursionError, MemoryError):
        raise InputError(f"expression '{_shortened(text)}' is nested too deeply") from None


def parse_expression(text: str, x: Expr, t: float | None = None) -> Expr:
    """Read an expression as UFL, see `read`.

    Args:
        text: The expression.
        x: Spatial coordinate of the mesh, of dimension 2 or 3.
        t: The time, if the text may have t in it.

    Raises:
        InputError: If the text is not such an expression.
    """
    names = "xyz"[: len(x)] + ("" if t is None else "t")
    tree = read(text, names)
    if t is not None:
        tree = substituted(tree, "t", exactly(t))
    with _complaints(text, names):  # UFL finds that 1/(0*x) has no value
        return to_ufl(tree, x)


def _unbalanced(text: str) -> str:
    """The parenthesis of a text that has no partner, in words; empty if each has one."""
    opened = []
    for number, character in enumerate(text, 1):
        if character == "(":
            opened.append(number)
        elif character == ")" and opened:
            opened.pop()
        elif character == ")":
            return f"the ')' at character {number} closes nothing"
    return f"the '(' at character {opened[-1]} is not closed" if opened else ""


def _wrong_at(text: str, error: SyntaxError) -> str:
    """The place in a text at which Python finds no arithmetic; it has read ** for each ^."""
    first = len(text) - len(text.lstrip())
    above = sum(len(line) + 1 for line in text.strip().split("\n")[: (error.lineno or 1) - 1])
    line, read = text[first + above :], 0
    for number, character in enumerate(line):
        read += 2 if character == "^" else 1
        if error.offset and read >= error.offset:
            return f"see '{_shortened(line[number:])}' at character {first + above + number + 1}"
    return "it ends too early" if text.strip() else "it is empty"


def _shortened(text: str) -> str:
    """The beginning of the text for a message, with characters that cannot be printed escaped."""
    beginning = text if len(text) <= 60 else text[:57] + "..."
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in beginning)


def parse_number(text: str) -> float:
    """Read a number written as `0.0625`, `1/16` or `2^-4`.

    Raises:
        InputError: If the text is not such a number.
    """
    try:
        value = _read(text)[0][1] if len(text) <= MAX_LENGTH else None
    except (InputError, SyntaxError, ArithmeticError, ValueError, RecursionError, MemoryError):
        value = None
    if value is None:
        raise InputError(f"'{_shortened(text)}' is not a number such as 0.0625, 1/16 or 2^-4")
    return value
