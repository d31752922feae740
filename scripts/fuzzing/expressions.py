"""Random expressions: texts for the reader, which must soon give UFL or a clean refusal, and case files with one.

The trees of valid texts are enclosed over random boxes: no value or derivative in a point may be outside the enclosure.
"""

import contextlib
import json
import random
import resource
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import ufl
from mpi4py import MPI
from ufl.core.expr import Expr

from fuzzing import OUTPUT, Broken, Valid
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.expressions.differentiation import Differentiated, Dual
from signorini_fenicsx.expressions.evaluation import Intervals, values_and_gradient
from signorini_fenicsx.expressions.intervals import FromNumPy, Interval, enclosing
from signorini_fenicsx.expressions.reader import parse_expression, parse_number, read
from signorini_fenicsx.expressions.tree import Tree, evaluate
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.discrete.spaces import build_spaces

SECONDS = 2.0
"""Largest CPU time for a text."""
COMPILED = 2000
"""Of so many accepted texts one is compiled."""
NAMES = ["x", "y", "z", "pi"]
FUNCTIONS = ["sin", "cos", "tan", "tanh", "atan2", "exp", "log", "sqrt", "abs", "min", "max"]
NUMBERS = ["0", "1", "2", "-1", "1/2", "0.5", "1e308", "1e-308", "1e999", "9" * 400, "31", "-0.0", "1_0", "0xF", "7j"]
TOKENS = [
    *NAMES, *FUNCTIONS, *NUMBERS, *"+-*/^%@&|~()[]{}<>=!,.:;#'\"\\ \n\t\0", "**", "//", "<=", "==", "!=", "->", ":=",
    "...", "if", "else", "and", "or", "not", "in", "is", "lambda", "for", "await", "yield", "None", "True", "f'{x}'",
    "b'1'", "import os", "__import__", "__class__", "eval", "exec", "nan", "inf", "w", "ａ", "ｘ", "π", "²", "∞", "−",
    "\ud800", "\u202e", "🦆",
]  # fmt: skip
NASTY = [
    "9**9**9**9", "2**(10**6)", "1e308*10", "x if x else y", "lambda: x", "x.real", "f'{x}'", "(x := 1)", "x\0",
    "\ud800", "x**1e308", "x**-1e308", "(x**30)**30", "((x**30)**30)**30", "0**-1", "0.0**x", "(-1)**x",
    "exp(exp(exp(9)))", "1if x>0 else 2", "log(-1)", "sqrt(-1)", "tan(pi/2)", "atan2(0, 0)", "x < y < z", "not x",
    "1 if not not x > 0 else 2",
    "min()", "max(" + "x," * 500 + ")", "1 if 1 < 2 else x", "x / 0", "0 / x", "x ** (1/0)", "x == x",
    "abs(-x)**0.5", "int(9)", "10**400", "x**(2**31)", "x**y**x**y",
]  # fmt: skip


def interval_and_gradient(tree: Tree, box: dict[str, Interval]) -> tuple[Interval, list[Interval]]:
    """Enclosures of all values, and of all derivatives with respect to each name."""
    variables = {name: Dual((value,), {name: enclosing(1.0)}) for name, value in box.items()}
    with np.errstate(all="ignore"):
        dual: Dual = evaluate(tree, Differentiated(Intervals({}, FromNumPy()), variables))
    shape = next(iter(box.values())).lo.shape
    return dual.values[0].on(shape), [dual.gradient.get(name, enclosing(0.0)).on(shape) for name in box]


def valid(rng: random.Random, depth: int) -> str:
    """An expression of the grammar, nested up to this depth."""
    if depth <= 0 or rng.random() < 0.1:
        return rng.choice([*NAMES[:2], "pi", str(rng.randint(0, 9)), f"{rng.uniform(-1e3, 1e3):g}"])
    a, b, c, d = (valid(rng, depth - rng.randint(1, 3)) for _ in range(4))
    return rng.choice(
        [
            f"({a} {rng.choice(['+', '-', '*', '/', '**', '^'])} {b})",
            f"-{a}",
            f"{rng.choice(FUNCTIONS)}({a})",
            f"{rng.choice(['min', 'max', 'atan2'])}({a}, {b})",
            f"({a} if {b} {rng.choice(['<', '<=', '>', '>=', '==', '!='])} {c} else {d})",
            f"({a} if {b} < {c} and not {c} > {d} or {a} < 1 else {d})",
            f"({a})^{rng.randint(0, 40)}",
        ]
    )


def soup(rng: random.Random) -> str:
    """Tokens in any order."""
    return rng.choice(["", " "]).join(rng.choices(TOKENS, k=rng.randint(1, 30)))


def spoiled(rng: random.Random) -> str:
    """A valid expression with some characters removed, doubled, swapped or replaced by strange ones."""
    text = list(valid(rng, 6))
    for _ in range(rng.randint(1, 3)):
        i = rng.randrange(len(text))
        text[i] = rng.choice(["", text[i] * 2, text[i - 1], rng.choice(TOKENS), chr(rng.randrange(0x110000))])
    return "".join(text)


def deep(rng: random.Random) -> str:
    """Nesting of one kind, from harmless to absurd."""
    n = int(10 ** rng.uniform(0, 3.3))
    before, inside, after = rng.choice(
        [("(", "x", ")"), ("-", "x", ""), ("sin(", "x", ")"), ("1+(", "x", ")"), ("", "x", "+x"), ("", "x", "*x"),
         ("", "2", "**2"), ("", "x", "^2"), ("x if x < 0 else ", "y", ""), ("(", "x", ")**2"),
         ("1 if not ", "x>0", " else 2"), ("[", "x", "]"), ("", "1 if x", " < x"), ("max(x,", "y", ")"),
         ("", "1", "/x"), ("not ", "x", ""), ("x.", "y", ""), ("exp(x)*(", "x", ")")]
    )  # fmt: skip
    return before * n + inside + after * n


def numbers(rng: random.Random) -> str:
    """Arithmetic of large and small numbers."""
    parts = [f"{rng.choice(['', '-'])}{rng.choice(NUMBERS)}" for _ in range(rng.randint(2, 6))]
    text = parts[0]
    for part in parts[1:]:
        text += rng.choice(["**", "*", "/", "+", "-", "^", "**x*"]) + part
    return text


def strange(rng: random.Random) -> str:
    """Random code points."""
    return "".join(chr(rng.choice([rng.randrange(128), rng.randrange(0x110000)])) for _ in range(rng.randint(0, 40)))


def long(rng: random.Random) -> str:
    """Texts of about the allowed length, and much longer ones."""
    return rng.choice(["x+", "(", "1", "x ", "sin(", " "]) * rng.choice([400, 1000, 10_000, 1_000_000]) + "x"


WAYS: list[Callable[[random.Random], str]] = [
    soup, lambda rng: valid(rng, rng.randint(1, 12)), spoiled, deep, numbers, strange, long,
    lambda rng: rng.choice(NASTY),
]  # fmt: skip
WEIGHTS = (6, 6, 6, 3, 3, 3, 0.2, 1)
"""The long ones are rare."""


def texts(seed: int) -> Iterator[str]:
    """An endless sequence of texts; those of `long` are rare."""
    rng = random.Random(seed)
    while True:
        yield rng.choices(WAYS, WEIGHTS)[0](rng)


def outcome(text: str, x: ufl.SpatialCoordinate) -> str:
    """Read a text; return "UFL" or "refused".

    Raises:
        AssertionError: If it was anything else, or took too long.
    """
    began = time.process_time()
    message = ""
    expression: Expr | None = None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            expression = parse_expression(text, x)
        except InputError as error:
            message = str(error)
        with contextlib.suppress(InputError):
            assert isinstance(parse_number(text), float), text
    if expression is not None:
        assert isinstance(expression, Expr), text
        assert expression.ufl_shape == () == expression.ufl_free_indices, text
        assert 8 <= quadrature_degree(Datum(expression)) <= 30, text
    assert message.isprintable(), f"the message of {text!r} cannot be printed"
    took = time.process_time() - began
    assert took < SECONDS, f"{text[:200]!r} took {took:.1f} s"
    return "refused" if expression is None else "UFL"


def check_enclosures(seed: int) -> bool:
    """Whether the random tree of a seed has enclosures over most of some random boxes.

    Raises:
        AssertionError: If a value or a derivative in a point, computed with 64 bits, is outside.
    """
    rng = np.random.default_rng(seed)
    text = valid(random.Random(seed), int(rng.integers(1, 8)))
    try:
        tree = read(text, "xy")
    except InputError:
        return False
    boxes = 40
    centres = rng.uniform(-2, 2, (2, boxes))
    centres[:, ::5] = np.round(centres[:, ::5])  # where values are 0 and boxes touch branches
    sizes = 10 ** rng.uniform(-6, 0.5, boxes)
    lo, hi = (centres + sign * sizes * rng.integers(0, 2, (2, boxes)) for sign in (-1, 1))
    value, gradient = interval_and_gradient(tree, {"x": Interval(lo[0], hi[0]), "y": Interval(lo[1], hi[1])})
    share = rng.random((2, 30, boxes))
    share[:, :4] = rng.integers(0, 2, (2, 4, boxes))
    points = np.clip(lo[:, None] + share * (hi - lo)[:, None], lo[:, None], hi[:, None]).astype(np.longdouble)
    values, gradients = values_and_gradient(tree, np.moveaxis(points, 0, -1))
    for sampled, enclosure in [(values, value), (gradients[..., 0], gradient[0]), (gradients[..., 1], gradient[1])]:
        outside = (sampled < enclosure.lo) | (sampled > enclosure.hi)  # False if one of them is NaN
        assert not outside.any(), f"outside of the enclosure of {text!r}"
    return bool(np.isfinite([value.lo, value.hi]).all(axis=0).mean() > 0.5)


def read_texts(minutes: float, seed: int) -> None:
    """Read texts for some minutes and print the counts; ends with a traceback at the first failure."""
    spaces = build_spaces(build_domain(MPI.COMM_SELF, "square", 1.0, mesh="structured"), ["bottom"])
    x = ufl.SpatialCoordinate(spaces.mesh)
    counts: Counter[str] = Counter()
    slowest, ends = 0.0, time.monotonic() + 60 * minutes
    for text in texts(seed):
        if time.monotonic() > ends:
            break
        began = time.process_time()
        result = outcome(text, x)
        slowest = max(slowest, time.process_time() - began)
        counts[result] += 1
        if result == "UFL" and counts[result] % COMPILED == 0:
            f = parse_expression(text, x)
            degree = quadrature_degree(Datum(f))
            spaces.integrate(f * ufl.Measure("dx", domain=spaces.mesh, metadata={"quadrature_degree": degree}))
            counts["compiled"] += 1
        if check_enclosures(seed + counts.total()):
            counts["enclosed"] += 1
    megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{dict(counts)}; slowest {slowest:.2f} s; {megabytes:.0f} MB")


HARD = (
    *("1/(x - 1/2)", "log(x)", "sqrt(x - 2)", "tan(pi*y)", "1e308", "1e-320", "x**-30", "exp(700*x)", "1e200*x*1e200"),
    *("0/x", "-1", "1 if x < 1/2 else 1e12", "sqrt(-1*x)", "(-1*x)**0.5", "atan2(0*x, 0*x)", "max(x, log(y - 2))"),
)
"""Valid texts whose values may be infinite, undefined, enormous, or negative where they must not be."""
KEYS = ("f", "kappa", "psi", "u_D", "g_N", "q_S")
CASE = """[geometry]
shape = "square"
mesh = "structured"
[boundary]
signorini = ["bottom"]
neumann = ["left"]
[problem]
{problem}
[solve]
h = 0.75
algorithm = "{algorithm}"
"""


def expression(rng: random.Random, folder: Path, valid_results: Valid) -> Broken:
    """A case with one random text; one in six is a known one that is solved."""
    key = rng.choice([*KEYS, "u"])
    solved = rng.random() < 1 / 6
    if solved:
        key, text = rng.choice(["f", "kappa", "psi"]), rng.choice(HARD)
    elif rng.random() < 0.1:
        text = _number(rng)
        return Broken(["info", "example1", "--h", text], f"h = {text[:40]!r}")
    else:
        text = rng.choices(WAYS, WEIGHTS)[0](rng)
    problem = {"f": "10*(x - 0.4)"} | ({} if key == "u" else {key: text})
    lines = [f"{name} = {_quoted(value)}" for name, value in problem.items()]
    algorithm = rng.choice(["alg1", "alg2"])
    more = f"\n[exact]\nu = {_quoted(text)}\n" if key == "u" else ""
    content = CASE.format(problem="\n".join(lines), algorithm=algorithm) + more
    (folder / "case.toml").write_text(content, encoding="utf-8")
    words = ["solve", "case.toml", "--output", OUTPUT] if solved else ["info", "case.toml"]
    return Broken(words, f"{key} = {text[:40]!r}", earlier=solved and rng.random() < 0.5)


def _number(rng: random.Random) -> str:
    """A text for an option that wants a number; a command line holds no zeros."""
    text = rng.choice([valid(rng, 3), rng.choices(WAYS, WEIGHTS)[0](rng)[:20_000]])
    return _encodable(text).replace("\0", "")


def _encodable(text: str) -> str:
    return text.encode(errors="ignore").decode()


def _quoted(text: str) -> str:
    """The text as a string of TOML, which other than JSON knows no surrogates."""
    return json.dumps(_encodable(text), ensure_ascii=False).replace("\x7f", "\\u007f")
