"""Broken case files with laws, inner parts, an obstacle, steps in time, and elastic bodies."""

import json
import random
import shutil
from pathlib import Path

from fuzzing.broken import NUMBERS, OUTPUT, WORDS, Broken, Valid, damaged
from fuzzing.cases import VALUES
from signorini_fenicsx.base.shipped import data_folder

type Tree = dict[str, dict[str, str]]

SQUARE = {"geometry": {"shape": '"square"'}, "problem": {"f": '"x"'}, "solve": {"h": "0.5"}}
LAWS: tuple[dict[str, str], ...] = (
    {"kind": '"signorini"', "psi": '"-x/9"', "q_S": "0"},
    {"kind": '"friction"', "g": '"x"'},
    {"kind": '"two-sided"', "psi": "-1", "psi_upper": '"x"', "q_S": "0"},
    {"kind": '"wall"', "beta": "2", "level": '"x"'},
    {"kind": '"regulator"', "k": "2", "g_low": "-1", "g_high": '"x"', "a": "0"},
    {"kind": '"graph"', "corners": '[[-1, "x"], [1, 0]]', "before": '"vertical"', "beyond": "1"},
)
ELASTIC: Tree = {
    "": {"physics": '"elasticity"'},
    "geometry": {"shape": '"square"'},
    "boundary": {"contact": '["bottom"]', "neumann": '["top"]', "fixed": '{left = "x"}'},
    "law.0": {"kind": '"friction"', "parts": '["bottom"]', "mu": "0.3"},
    "problem": {
        **{"young": "2", "poisson": "0.3", "f": '["0", "-x"]', "u_D": "[0, 0]", "g_N": '{top = [0, "-x"]}'},
        **{"gap": '"x/9"', "plane": '"strain"'},
    },
    "solve": {"h": "0.5", "algorithm": '"alg1"', "max_iterations": "30"},
}
TIME = {"end": "1", "steps": "2", "initial": '"x"', "capacity": "1", "scheme": '"bdf2"'}
SPECIAL = (
    *(
        "-1e-30",
        '"-x"',
        '"t"',
        '"sqrt(x - 2)"',
        '"log(x - 1/2)"',
        '"1e300*x"',
        "1e200",
        '"abs(x)^1000"',
        '["bottom", "top"]',
    ),
    *(
        '["left"]',
        '"n"',
        '"xy"',
        '"z"',
        '{bottom = "x"}',
        '{top = ["0"]}',
        '{top = "0"}',
        "[[1, 0], [1, 1], [1, 0]]",
        "[[0, 0]]",
    ),
    *(
        "[[0, 0], [1, 1]]",
        '[["y", 0], ["x", 0]]',
        "0.5",
        "0.499999999999",
        "-0.99999",
        '"vertical"',
        '"bdf2"',
        '"strain"',
        "1e-300",
    ),
    *(
        '["0", "t"]',
        '["x", "y", "z"]',
        '"slit"',
        '["slit"]',
        '"elasticity"',
        '"scalar"',
        '{1 = "x"}',
        "{slit = [0, 0]}",
        "1000000000",
    ),
)
"""Values that are of the right type in one place and wrong in another."""
USUAL = (
    "0",
    "1",
    "-1",
    "0.3",
    "1e9",
    "1e-9",
    '"x"',
    '"-x"',
    '"x - 1/2"',
    '"y"',
    '"1 if x < 1/3 else -2"',
    '"x^2 - 1/3"',
    '"sin(9*x)"',
)
"""Values that most expressions may have."""
PARTS = (
    "[]",
    '["bottom"]',
    '["left"]',
    '["top", "right"]',
    '["bottom", "left"]',
    '["slit"]',
    '["fault"]',
    '["nowhere"]',
)
STEPS = ("0", "1", "3", "1e-9", "60", '"1/3"')
SCHEMES = ('"bdf2"', '"implicit-euler"', '"euler"')
SIDES = (
    "{}",
    "{fault = [0, 0]}",
    '{fault = "upper"}',
    '{fault = "x"}',
    "{fault = [1, 0]}",
    "{fault = [0, -1e-9, 0]}",
    "{slit = [0, 1]}",
)
FIXED = (
    "{}",
    '{left = "xy"}',
    '{left = "n"}',
    '{right = "n", left = "n"}',
    '{left = "z"}',
    '{left = ""}',
    '{bottom = "x"}',
    '{left = "xx"}',
)
CORNERS = (
    "[]",
    "[[0, 0]]",
    "[[0, 1], [0, 1]]",
    "[[1, 0], [0, 1]]",
    '[["x", 1], ["x", 0]]',
    '[["x", 1], [0.5, 0]]',
    "[[0, 1], [1, 0], [1, 0]]",
    "[[0]]",
)
MORE = (
    "inner",
    "sides",
    "contact",
    "fixed",
    "dirichlet",
    "obstacle",
    "c",
    "young",
    "gap",
    "g",
    "mu",
    "parts",
    "psi",
    "kappa",
    "t",
)


def law_file(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A case of a new kind with one or two wrong values, missing or unknown keys, or broken bytes."""
    name, tree = rng.choice([_with_law, _with_law, _inner, _in_time, _in_time, _obstacle, _dam, _elastic, _elastic])(
        rng
    )
    tree = {section: dict(keys) for section, keys in tree.items()}
    about = [_changed(rng, tree) for _ in range(rng.choice([1, 1, 2]))]
    data = "\n".join(_lines(tree)).encode(errors="replace")
    if rng.random() < 0.08:
        data, way = damaged(rng, data)
        about.append(way)
    (folder / "case.toml").write_bytes(data)
    shutil.copyfile(data_folder("meshes") / "fault.msh", folder / "fault.msh")
    return Broken(_words(rng), f"{name}: {', '.join(about)}"[:120])


def _with_law(rng: random.Random) -> tuple[str, Tree]:
    laws = rng.sample(LAWS, rng.choice([1, 1, 2]))
    named = {
        f"law.{i}": {"parts": f'["{part}"]', **law}
        for i, (part, law) in enumerate(zip(("bottom", "left"), laws, strict=False))
    }
    return "law", {**SQUARE, "boundary": {"signorini": '["right"]'}, **named}


def _inner(rng: random.Random) -> tuple[str, Tree]:
    law = rng.choice(LAWS)
    if rng.random() < 0.6:
        own = {
            "geometry": {"shape": '"slit"'},
            "boundary": {"inner": '["slit"]'},
            "law.0": {"parts": '["slit"]', **law},
        }
        return "slit", {**SQUARE, **own}
    boundary = {"inner": '["fault"]', "sides": "{fault = [0, 1]}"}
    own = {"geometry": {"file": '"fault.msh"'}, "boundary": boundary, "law.0": {"parts": '["fault"]', **law}}
    return "fault", {**own, "problem": SQUARE["problem"]}


def _in_time(rng: random.Random) -> tuple[str, Tree]:
    _, tree = _with_law(rng)
    problem = {"f": '"t"', "c": '"x"', "psi": "-0.1"} | ({"obstacle": "-1"} if rng.random() < 0.2 else {})
    return "time", {**tree, "problem": problem, "time": TIME}


def _obstacle(rng: random.Random) -> tuple[str, Tree]:
    return "obstacle", {
        **SQUARE,
        "boundary": {"signorini": "[]"},
        "problem": {"f": "-9", "obstacle": '"x/9 - 1"', "c": "1"},
    }


def _dam(rng: random.Random) -> tuple[str, Tree]:
    return "dam", {"dam": {"L": "2", "h": "1", "H": "3"}, "solve": {"h": "1"}}


def _elastic(rng: random.Random) -> tuple[str, Tree]:
    return "elastic", ELASTIC


def _changed(rng: random.Random, tree: Tree) -> str:
    """Change one key of a case; return what was changed."""
    if rng.random() < 0.2:
        return _spoilt(rng, tree)
    section = rng.choice([section for section in tree if section not in ("", "geometry", "solve")])
    keys = tree[section]
    key = rng.choice(list(keys) or ["neumann"])
    lists = {
        "parts": PARTS,
        "sides": SIDES,
        "fixed": FIXED,
        "corners": CORNERS,
        "steps": STEPS,
        "end": STEPS,
        "scheme": SCHEMES,
    }
    if key == "kind" and "mu" not in keys:
        tree[section] = {"parts": keys.get("parts", '["top"]'), **rng.choice(LAWS)}
    elif keys.get(key, "").startswith('["0"'):
        keys[key] = f"[{rng.choice(USUAL)}, {rng.choice([*USUAL, *SPECIAL])}]"
    else:
        keys[key] = rng.choice(lists.get(key, PARTS if section == "boundary" else (*USUAL, *USUAL, *SPECIAL)))
    return f"{section}.{key}={keys.get(key, 'another')[:30]}"


def _spoilt(rng: random.Random, tree: Tree) -> str:
    """Take a key away, add one, put a section in, or a value of any type."""
    section = rng.choice(list(tree))
    keys = tree[section]
    value = rng.choice([*VALUES, *SPECIAL, *map(json.dumps, (*NUMBERS, *WORDS))])
    way = rng.choice(["value", "gone", "more", "section"])
    if way == "section":
        tree[rng.choice(["time", "law.0", "dam", "exact", "boundary"])] = rng.choice(
            [TIME, dict(rng.choice(LAWS)), {"u": value}]
        )
        return "another section"
    key = rng.choice(MORE) if way == "more" or not keys else rng.choice(list(keys))
    if way == "gone":
        keys.pop(key, None)
    else:
        keys[key] = value
    return f"{way} {section}.{key}={value[:30]}"


def _lines(tree: Tree) -> list[str]:
    """The text of a case, with keys outside of sections first."""
    lines = []
    for section, keys in sorted(tree.items(), key=lambda item: item[0] != ""):
        header = "[[law]]" if section.startswith("law.") else f"[{section}]"
        lines += [header if section else "", *(f"{key} = {value}" for key, value in keys.items())]
    return lines


def _words(rng: random.Random) -> list[str]:
    """A command that reads the case, or --set of a key of it."""
    words = rng.choice(
        [["solve", "case.toml"]] * 4
        + [["check", "case.toml"], ["info", "case.toml"], ["adapt", "case.toml", "--max-cells", "300"]]
        + [["convergence", "case.toml", "--levels", "1:2", "--reference", "3"]]
    )
    if rng.random() < 0.2:
        key = rng.choice(
            [
                "law.0.g",
                "law.9.g",
                "law.x",
                "law",
                "law.0",
                "time.steps",
                "boundary.sides.slit",
                "boundary.fixed.left",
                "physics",
                "problem.g_N.top",
            ]
        )
        words = [*words, "--set", f"{key}={rng.choice([*SPECIAL, *VALUES]).strip(chr(34))[:2000]}"]
    return [*words, "--output", OUTPUT] if words[0] not in ("check", "info") else words
