"""Broken study files, and folders of studies in which something is broken."""

import json
import random
from pathlib import Path

from broken_input import CASE_MUTATIONS

from fuzzing.broken import NUMBERS, OUTPUT, WORDS, Broken, Valid, damaged

STUDY = """title = "A small study"
case = "example1"
ranks_per_run = 1
fields = false

[set]
eps = 1e-6
"geometry.mesh" = "structured"

[vary]
h = ["1/2", 0.75]
algorithm = ["alg1", "alg3"]
"""
CONVERGENCE = """case = "example4"
[set]
algorithm = "alg3"
[vary]
eps = [1e-2, 1e-6]
[convergence]
levels = [1, 2]
reference = 3
"""
KEYS = (
    *("name", "title", "case", "ranks_per_run", "fields", "plot", "set", "vary", "together", "convergence", "comment"),
    *(
        "set.h",
        "vary.h",
        "vary.case",
        "vary.eps",
        "vary.rho",
        "vary.backend",
        'vary."problem.f"',
        'set."geometry.shape"',
    ),
    *(
        'set."boundary.signorini"',
        "convergence.levels",
        "convergence.reference",
        "convergence.vary",
        "convergence.varry",
    ),
    *("convergence.extra", "set.h.x", "vary.solve", "vary.name", 'vary."a.b.c"'),
)
VALUES = (
    *(
        '"x"',
        "1",
        "-1",
        "0",
        "true",
        "[]",
        "[[]]",
        "{}",
        "[{}]",
        "{a = 1}",
        "nan",
        "inf",
        "[nan]",
        "[0]",
        "[1, 2]",
        '["1/2"]',
    ),
    *(
        '["2^-1000"]',
        '["example1", "case.toml"]',
        '["../home/x.toml"]',
        '[["top"], ["bottom"], []]',
        '"eps=h"',
        '["eps"]',
    ),
    *('"\\u0000"', "[" + "0.5, " * 3000 + "]", "[" * 400 + "]" * 400, "9" * 5000, "0x" + "f" * 300, "1979-05-27"),
)
FOLDERS = ("lock is a folder", "runs is a file", "table is a folder", "broken record", "empty run", "claims is a file")


def study(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A study with broken lines, bytes or values, or its folder broken."""
    text = STUDY if rng.random() < 0.8 else CONVERGENCE
    way = rng.choice(["lines", "bytes", "values", "values", "folder"])
    data = text.encode()
    if way == "lines":
        for _ in range(rng.randint(1, 3)):
            data = rng.choice(CASE_MUTATIONS)(rng, data)
    elif way == "bytes":
        data, way = damaged(rng, data)
    elif way == "values":
        data, way = _with_values(rng, text)
    else:
        way = _broken_folder(rng, folder / OUTPUT)
    (folder / "study.toml").write_bytes(data)
    (folder / "case.toml").write_text('[geometry]\nshape = "square"', encoding="utf-8")
    dry = rng.random() < (0.2 if way in FOLDERS else 0.6) or not _is_tame(data)
    words = ["study", "study.toml", "--output", OUTPUT, *(["--dry-run"] if dry else [])]
    return Broken(words + (["--retry-failed"] if rng.random() < 0.1 else []), way)


def _is_tame(data: bytes) -> bool:
    """Whether a study asks only for runs as tiny as the original ones, or is not a study."""
    sizes = b'h = ["1/2", 0.75]' in data or b"levels = [1, 2]\nreference = 3" in data
    return sizes and not any(word in data for word in (b"problem", b"shape", b"boundary", b"plot"))


def _with_values(rng: random.Random, text: str) -> tuple[bytes, str]:
    chosen = []
    for _ in range(rng.choice([1, 1, 2])):
        key, value = rng.choice(KEYS), rng.choice([*VALUES, *map(json.dumps, (*NUMBERS, *WORDS))])
        section, _, last = key.partition(".")
        if not last:
            text = f"{section} = {value}\n{text}"
        elif f"[{section}]" in text:
            text = text.replace(f"[{section}]", f"[{section}]\n{last} = {value}", 1)
        else:
            text += f"\n[{section}]\n{last} = {value}\n"
        chosen.append(f"{key}={value[:30]}")
    return text.encode(errors="replace"), ", ".join(chosen)


def _broken_folder(rng: random.Random, place: Path) -> str:
    """A folder instead of the study's own folder, with something wrong in it."""
    way = rng.choice(FOLDERS)
    run = place / "runs" / "example1-alg1-0123456789ab"
    place.mkdir()
    (place / "mine.txt").write_text("the user's", encoding="utf-8")
    match way:
        case "lock is a folder":
            (place / ".lock").mkdir()
        case "runs is a file":
            (place / ".lock").touch()
            (place / "runs").touch()
        case "table is a folder":
            (place / ".lock").touch()
            (place / "table.csv").mkdir()
        case "claims is a file":
            (place / ".lock").touch()
            (place / ".claims").touch()
        case _:
            (place / ".lock").touch()
            run.mkdir(parents=True)
            if way == "broken record":
                (run / "summary.json").write_text('{"a": ', encoding="utf-8")
                (run / "run.json").write_text("[1]", encoding="utf-8")
    return way
