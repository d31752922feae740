"""Text to UFL: arithmetic in x, y, z read with `ast` against a whitelist; nothing in the text is ever executed."""

import ast
import math
import warnings
from collections.abc import Callable

import ufl
from ufl.core.expr import Expr

from signorini_fenicsx.errors import InputError

MAX_LENGTH = 2000
MAX_INTEGER_POWER = 30
MAX_DEPTH = 150
"""Terms of a sum or nested brackets that UFL and FFCx follow without running out of stack."""

type Value = float | Expr
"""Constant sub-expressions stay Python floats, so that errors such as 1/0 show while reading."""


def _either(constant: Callable[..., float], symbolic: Callable[..., Expr]) -> Callable[..., Value]:
    """A function that stays in floats while all its arguments are floats."""

    def apply(*arguments: Value) -> Value:
        if all(isinstance(a, float) for a in arguments):
            return float(constant(*arguments))
        return symbolic(*(ufl.as_ufl(a) for a in arguments))

    return apply


def _fold(constant: Callable[..., float], symbolic: Callable[..., Expr]) -> Callable[..., Value]:
    """A binary function applied from left to right to two or more arguments."""
    binary = _either(constant, symbolic)

    def apply(first: Value, *rest: Value) -> Value:
        for argument in rest:
            first = binary(first, argument)
        return first

    return apply


_FUNCTIONS: dict[str, tuple[Callable[..., Value], int, int]] = {  # name: function, fewest and most arguments
    "sin": (_either(math.sin, ufl.sin), 1, 1),
    "cos": (_either(math.cos, ufl.cos), 1, 1),
    "tan": (_either(math.tan, ufl.tan), 1, 1),
    "tanh": (_either(math.tanh, ufl.tanh), 1, 1),
    "atan2": (_either(math.atan2, ufl.atan2), 2, 2),
    "exp": (_either(math.exp, ufl.exp), 1, 1),
    "log": (_either(math.log, ufl.ln), 1, 1),
    "sqrt": (_either(math.sqrt, ufl.sqrt), 1, 1),
    "abs": (_either(abs, abs), 1, 1),
    "min": (_fold(min, ufl.min_value), 2, 10),
    "max": (_fold(max, ufl.max_value), 2, 10),
}


def _power(base: Value, exponent: Value) -> Value:
    if isinstance(base, float) and isinstance(exponent, float):
        result = base**exponent
        if isinstance(result, complex):
            raise ValueError("a root of a negative number")
        return result
    if isinstance(exponent, float) and exponent.is_integer() and abs(exponent) <= MAX_INTEGER_POWER:
        exponent = int(exponent)  # UFL estimates quadrature degrees from integer powers
    return ufl.as_ufl(base) ** exponent


_OPERATORS: dict[type[ast.operator], Callable[[Value, Value], Value]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: _power,
}
_COMPARISONS: dict[type[ast.cmpop], Callable[[Value, Value], Expr]] = {
    ast.Lt: ufl.lt,
    ast.LtE: ufl.le,
    ast.Gt: ufl.gt,
    ast.GtE: ufl.ge,
    ast.Eq: ufl.eq,
    ast.NotEq: ufl.ne,
}


class _Reader:
    """Walks one expression tree; every node type that is not named here is refused."""

    def __init__(self, names: dict[str, Value]):
        self.names = names
        self.depth = 0

    def value(self, node: ast.expr) -> Value:
        """Value of a node; constants must be finite, and the nesting such that UFL can follow it."""
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise RecursionError
        value = self._value(node)
        self.depth -= 1
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"{ast.unparse(node)} is not finite")
        return value

    def _value(self, node: ast.expr) -> Value:
        match node:
            case ast.Constant(value=bool() | str() | bytes() | complex() | None):
                raise InputError(f"{ast.unparse(node)} is not a number")
            case ast.Constant(value=int() | float() as number):
                return float(number)
            case ast.Name(id=name):
                if name not in self.names:
                    raise InputError(f"unknown name '{name}'; known are {', '.join(self.names)}")
                return self.names[name]
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -self.value(operand)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.value(operand)
            case ast.BinOp(left=left, op=operator, right=right) if type(operator) in _OPERATORS:
                return _OPERATORS[type(operator)](self.value(left), self.value(right))
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return ufl.conditional(self.condition(test), self.value(body), self.value(orelse))
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self.call(name, arguments)
        raise InputError(f"'{ast.unparse(node)}' is not allowed in an expression")

    def call(self, name: str, arguments: list[ast.expr]) -> Value:
        if name not in _FUNCTIONS:
            raise InputError(f"unknown function '{name}'; known are {', '.join(_FUNCTIONS)}")
        function, fewest, most = _FUNCTIONS[name]
        if not fewest <= len(arguments) <= most:
            wanted = str(fewest) if fewest == most else f"{fewest} to {most}"
            raise InputError(f"{name} takes {wanted} argument(s), not {len(arguments)}")
        return function(*(self.value(a) for a in arguments))

    def condition(self, node: ast.expr) -> Expr:
        match node:
            case ast.Compare(left=left, ops=operators, comparators=comparators) if all(
                type(operator) in _COMPARISONS for operator in operators
            ):
                values = [self.value(v) for v in (left, *comparators)]
                tests = [
                    _COMPARISONS[type(operator)](a, b)
                    for operator, a, b in zip(operators, values[:-1], values[1:], strict=True)
                ]
                return self.join(ufl.And, tests)
            case ast.BoolOp(op=ast.And(), values=values):
                return self.join(ufl.And, [self.condition(v) for v in values])
            case ast.BoolOp(op=ast.Or(), values=values):
                return self.join(ufl.Or, [self.condition(v) for v in values])
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return ufl.Not(self.condition(operand))
        raise InputError(f"'{ast.unparse(node)}' is not a comparison such as x > 0")

    @staticmethod
    def join(operator: Callable[[Expr, Expr], Expr], tests: list[Expr]) -> Expr:
        first, *rest = tests
        for test in rest:
            first = operator(first, test)
        return first


def _tree(text: str) -> ast.expr:
    """Python's syntax tree; ^ becomes ** first, because Python's own ^ binds weaker than +."""
    with warnings.catch_warnings(action="ignore"):  # Python's advice on texts such as 1if x>0 else 2
        return ast.parse(text.strip().replace("^", "**"), mode="eval").body


def parse_expression(text: str, x: Expr) -> Expr:
    """Read an expression such as `50*(1/2 - x)*sin(pi*y) if x > 0 else 0` as UFL.

    Allowed are numbers, pi, the coordinates, + - * / ** ^, comparisons inside `a if condition else b` and the
    functions sin, cos, tan, tanh, atan2, exp, log, sqrt, abs, min, max.

    Args:
        text: The expression.
        x: Spatial coordinate of the mesh, of dimension 2 or 3.

    Raises:
        InputError: If the text is anything else.
    """
    if len(text) > MAX_LENGTH:
        raise InputError(f"expression of {len(text)} characters; at most {MAX_LENGTH} are read")
    names: dict[str, Value] = {"pi": math.pi} | dict(zip("xyz", x, strict=False))
    try:
        return ufl.as_ufl(_Reader(names).value(_tree(text)))
    except InputError as error:
        raise InputError(f"expression '{_shortened(text)}': {error}") from None
    except SyntaxError:
        raise InputError(f"expression '{_shortened(text)}' is not arithmetic in {', '.join(names)}") from None
    except (ArithmeticError, ValueError) as error:
        raise InputError(f"expression '{_shortened(text)}' cannot be evaluated: {error}") from None
    except (RecursionError, MemoryError):
        raise InputError(f"expression '{_shortened(text)}' is nested too deeply") from None


def _shortened(text: str) -> str:
    """The text for a message: its beginning, what cannot be printed as in Python's strings."""
    beginning = text if len(text) <= 60 else text[:57] + "..."
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in beginning)


def parse_number(text: str) -> float:
    """Read a number written as `0.0625`, `1/16` or `2^-4`.

    Raises:
        InputError: If the text is not such a number.
    """
    try:
        value = _Reader({"pi": math.pi}).value(_tree(text))
    except (InputError, SyntaxError, ArithmeticError, ValueError, RecursionError, MemoryError):
        value = None
    if not isinstance(value, float):
        raise InputError(f"'{_shortened(text)}' is not a number such as 0.0625, 1/16 or 2^-4")
    return value
