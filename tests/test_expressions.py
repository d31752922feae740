"""Text to UFL: values are right, and nothing but arithmetic gets through."""

import itertools
import math

import pytest
import ufl
from fuzz_expressions import outcome, texts

from signorini_fenicsx.case import reference_coordinate
from signorini_fenicsx.errors import InputError
from signorini_fenicsx.expressions import parse_expression, parse_number

X = reference_coordinate(2)
POINT = (0.3, -0.7)


def at_point(text: str) -> float:
    expression = parse_expression(text, X)
    return float(expression(POINT))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("50*(1/2 - x)*(1/2 - y)", 50 * 0.2 * 1.2),
        ("x^2 + y**3", 0.09 - 0.343),
        ("-x + +y", -1.0),
        ("sin(pi*x)*cos(y/3)", math.sin(math.pi * 0.3) * math.cos(0.7 / 3)),
        ("tan(x) + tanh(y) + exp(x) + log(x) + sqrt(x) + abs(y)",
         math.tan(0.3) + math.tanh(-0.7) + math.exp(0.3) + math.log(0.3) + math.sqrt(0.3) + 0.7),
        ("atan2(y, x)", math.atan2(-0.7, 0.3)),
        ("min(x, y, 0) + max(x, y)", -0.7 + 0.3),
        ("1 if x > 0 else 2", 1.0),
        ("1 if 0 < y < 1 or not x < 1 else 2", 2.0),
        ("1 if x >= 0 and y <= 0 and x != 5 else 2", 1.0),
        ("2^-4", 0.0625),
        ("0*x", 0.0),
        ("x^2^2", 0.3**4),
    ],
)  # fmt: skip
def test_values(text: str, value: float):
    assert at_point(text) == pytest.approx(value, abs=1e-14)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "x.ufl_domain()",
        "x.__class__",
        "(lambda: 1)()",
        "[x for x in (1, 2)]",
        "open('/etc/passwd')",
        "'text'",
        "b'1'",
        "True",
        "1j",
        "x if x else y",
        "x > 0",
        "x[0]",
        "{1: 2}",
        "x := 1",
        "w",
        "z",
        "sin",
        "sin(x, y)",
        "sin(x=1)",
        "sin(*x)",
        "min(x)",
        "f'{x}'",
        "x; y",
        "x\ny",
        "",
        "x +",
        "1/0",
        "log(0)",
        "(-1)^(1/2)",
        "9**9**9**9",
        "1e999",
        "x // 2",
        "x % 2",
        "x @ y",
        "...",
        "(" * 300 + "x" + ")" * 300,
        "-" * 1500 + "x",
        "x" * 3000,
        "\0",
    ],
)
def test_refused(text: str):
    with pytest.raises(InputError):
        parse_expression(text, X)


def test_z_exists_in_3d():
    x = reference_coordinate(3)
    assert parse_expression("z", x)((0.0, 0.0, 5.0)) == 5.0


def test_integer_powers_keep_their_degree():
    expression = parse_expression("x^3", X)
    assert ufl.algorithms.estimate_total_polynomial_degree(expression) == 3


@pytest.mark.parametrize(("text", "value"), [("0.0625", 0.0625), ("1/16", 0.0625), ("2^-4", 0.0625), ("1e-2", 0.01)])
def test_numbers(text: str, value: float):
    assert parse_number(text) == value


@pytest.mark.parametrize("text", ["", "x", "1/0", "one", "__import__", "1, 2", "(-8)^(1/3)"])
def test_not_numbers(text: str):
    with pytest.raises(InputError, match="is not a number"):
        parse_number(text)


def test_random_texts():
    """What ten minutes of `scripts/fuzz_expressions.py` look for, for a moment."""
    for text in itertools.islice(texts(seed=7), 400):
        outcome(text, X)


def test_messages_can_be_printed():
    with pytest.raises(InputError, match=r"expression 'x \+\\n\\ud800\\x1b\[2J'") as caught:
        parse_expression("x +\n\ud800\x1b[2J", X)
    assert str(caught.value).isprintable()
