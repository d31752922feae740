"""Random expressions in a case file: mostly only read; a few known ones, hard to compute with, are solved."""

import json
import random
from pathlib import Path

from fuzz_expressions import KINDS, valid

from fuzzing.broken import OUTPUT, Broken, Valid

WEIGHTS = (6, 6, 6, 3, 3, 3, 0.2, 1)
"""Of the kinds of `fuzz_expressions`: the long ones are rare."""
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
        text = rng.choices(KINDS, WEIGHTS)[0](rng)
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
    text = rng.choice([valid(rng, 3), rng.choices(KINDS, WEIGHTS)[0](rng)[:20_000]])
    return _encodable(text).replace("\0", "")


def _encodable(text: str) -> str:
    return text.encode(errors="ignore").decode()


def _quoted(text: str) -> str:
    """The text as a string of TOML, which other than JSON knows no surrogates."""
    return json.dumps(_encodable(text), ensure_ascii=False).replace("\x7f", "\\u007f")
