"""Broken case files and studies."""

import json
import random
import re
import shutil
import tomllib
from pathlib import Path

from broken_input import CASE_MUTATIONS

from fuzzing import NUMBERS, OUTPUT, WORDS, Broken, Valid, damaged
from signorini_fenicsx.base.shipped import data_folder

COARSE = {
    **dict.fromkeys(["example1", "example2", "example3", "example4", "example5", "example6"], "1/4"),
    **dict.fromkeys(["cube", "lprism", "ball"], "0.8"),
}
"""Cases that are broken, and values of h with which they are fast."""
KEYS = (
    "geometry.shape", "geometry.mesh", "geometry.diagonal", "geometry.file", "boundary.signorini",
    "boundary.neumann", "boundary.dirichlet", "problem.f", "problem.kappa", "problem.u_D", "problem.g_N",
    "problem.psi", "problem.q_S", "exact.u", "solve.algorithm", "solve.backend", "solve.h", "solve.rho",
    "solve.eps", "solve.max_iterations", "solve.predict", "title", "name", "solve", "geometry", "", ".", "a.b.c.d",
    "problem.f.g", "__class__", "sol\u200bve.h",
)  # fmt: skip
VALUES = (
    "0", "-1", "1", "true", "nan", "inf", "-inf", "1e999", "[]", "{}", '""', '"x"', "[1, 2]", "{a = 1}",
    "1979-05-27", '["bottom"]', '["bottom", "bottom"]', '["top", 3]', "[[1, 0], [0, 1]]", '[["x", 0], [0, "y"]]',
    "[[1, 2], [2, 1]]", "[[1, 2, 3]]", "[[1, nan], [nan, 1]]", "[[-1, 0], [0, -1]]", '"\\u0000"', '"a\\u0000b.msh"',
    '"../home/secret.msh"', '"/dev/zero"', '"."', '"notes.txt"', '"x/0"', '"1/0"', '"z"', '"nan"', '"square"',
    '"cube"', '"alg2"', '"mixed"', "9" * 5000, "0x" + "f" * 300, "1" + "0" * 400 + ".0", '"2^-1000"', '"9**9**9"',
    '"' + "(" * 900 + '"', "[" * 300 + "]" * 300, '"' + "not " * 480 + 'x > 0"',
    '"1 if ' + "x < " * 300 + 'y else 0"', '"\\U0001F986"',
)  # fmt: skip


def case_file(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A shipped case with broken lines, bytes, or values."""
    if rng.random() < 0.1:
        return _not_a_case(rng, folder)
    name = rng.choice(sorted(COARSE) if rng.random() < 0.4 else ["example1", "example2", "example4", "example5", "dam"])
    text = _coarse(name)
    way = rng.choice(["lines", "lines", "bytes", "values", "values"])
    if way == "lines":
        data = text.encode()
        for _ in range(rng.randint(1, 3)):
            data = rng.choice(CASE_MUTATIONS)(rng, data)
    elif way == "bytes":
        data, way = damaged(rng, text.encode())
    else:
        data, way = _with_values(rng, text, KEYS, VALUES)
    (folder / "case.toml").write_bytes(data)
    if name == "dam":
        shutil.copyfile(data_folder("meshes") / "dam.msh", folder / "dam.msh")
    command = _command(rng, tomllib.loads(text), data)
    words = [command, "case.toml", *(["--output", OUTPUT] if command == "solve" else [])]
    if name in ("cube", "lprism", "ball") and command != "info":
        words += ["--h", COARSE[name]]  # without it a lost line could mean millions of cells
    return Broken(words, f"{name} {way}", earlier=command == "solve" and rng.random() < 0.5)


def _coarse(name: str) -> str:
    """Text of a case with a coarse h."""
    text = (data_folder("cases") / f"{name}.toml").read_text(encoding="utf-8").replace("../meshes/", "")
    return re.sub(r"(?m)^h = .*$", f'h = "{COARSE.get(name)}"', text)


def _command(rng: random.Random, tree: dict, data: bytes) -> str:
    """The command for a case; cases with new data are rarely solved, because compiling them takes seconds."""
    try:
        case = tomllib.loads(data.decode())
        is_compiled = case.get("problem") == tree["problem"] and case.get("exact") == tree.get("exact")
        is_compiled = is_compiled and case.get("boundary") == tree["boundary"]
    except (ValueError, RecursionError):
        is_compiled = True
    return rng.choice(["check", "solve", "solve", "info"]) if is_compiled or rng.random() < 0.05 else "info"


def _with_values(rng: random.Random, text: str, keys: tuple[str, ...], values: tuple[str, ...]) -> tuple[bytes, str]:
    """One or two keys with values of other types, in the right section or a second one of its name."""
    chosen = []
    for _ in range(rng.choice([1, 1, 2])):
        key, value = rng.choice(keys), rng.choice([*values, *map(json.dumps, (*NUMBERS, *WORDS))])
        section, _, last = key.partition(".") if "." in key else ("", "", key)
        line = f"{last} = {value}"
        if re.search(rf"(?m)^{re.escape(last)} *=", text) and last:
            text = re.sub(rf"(?m)^{re.escape(last)} *=.*$", lambda _, line=line: line, text, count=1)
        elif f"[{section}]" in text:
            text = text.replace(f"[{section}]", f"[{section}]\n{line}", 1)
        else:
            text = f"{text}\n[{section}]\n{line}\n" if section else f"{line}\n{text}"
        chosen.append(f"{key}={value[:30]}")
    return text.encode(errors="replace"), ", ".join(chosen)


def _not_a_case(rng: random.Random, folder: Path) -> Broken:
    """Something else instead of the file, which must be refused."""
    path = folder / "case.toml"
    way = rng.choice(["folder", "missing", "loop", "empty", "device", "utf16", "deep", "many", "long name"])
    match way:
        case "folder":
            path.mkdir()
        case "loop":
            path.symlink_to("case.toml")
        case "empty":
            path.touch()
        case "device":
            path.symlink_to("/dev/null")
        case "utf16":
            path.write_bytes(_coarse("example1").encode("utf-16"))
        case "deep":
            path.write_text("a = " + "[" * 100_000, encoding="utf-8")
        case "many":
            path.write_text("\n".join(f"[a{'.a' * 300}{i}]" for i in range(300)), encoding="utf-8")
    name = "x" * 300 + ".toml" if way == "long name" else "case.toml"
    return Broken([rng.choice(["check", "info", "solve"]), name], f"not a case: {way}", refused=True)


type Tree = dict[str, dict[str, str]]

SQUARE = {"geometry": {"shape": '"square"'}, "problem": {"f": '"x"'}, "solve": {"h": "0.5"}}
LAWS: tuple[dict[str, str], ...] = (
    {"kind": '"signorini"', "psi": '"-x/9"', "q_S": "0"}, {"kind": '"friction"', "g": '"x"'},
    {"kind": '"two-sided"', "psi": "-1", "psi_upper": '"x"', "q_S": "0"},
    {"kind": '"wall"', "beta": "2", "level": '"x"'},
    {"kind": '"regulator"', "k": "2", "g_low": "-1", "g_high": '"x"', "a": "0"},
    {"kind": '"graph"', "corners": '[[-1, "x"], [1, 0]]', "before": '"vertical"', "beyond": "1"},
)  # fmt: skip
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
    "-1e-30", '"-x"', '"t"', '"sqrt(x - 2)"', '"log(x - 1/2)"', '"1e300*x"', "1e200", '"abs(x)^1000"',
    '["bottom", "top"]', '["left"]', '"n"', '"xy"', '"z"', '{bottom = "x"}', '{top = ["0"]}', '{top = "0"}',
    "[[1, 0], [1, 1], [1, 0]]", "[[0, 0]]", "[[0, 0], [1, 1]]", '[["y", 0], ["x", 0]]', "0.5", "0.499999999999",
    "-0.99999", '"vertical"', '"bdf2"', '"strain"', "1e-300", '["0", "t"]', '["x", "y", "z"]', '"slit"', '["slit"]',
    '"elasticity"', '"scalar"', '{1 = "x"}', "{slit = [0, 0]}", "1000000000",
)  # fmt: skip
"""Values that are of the right type in one place and wrong in another."""
USUAL = (
    "0", "1", "-1", "0.3", "1e9", "1e-9", '"x"', '"-x"', '"x - 1/2"', '"y"', '"1 if x < 1/3 else -2"',
    '"x^2 - 1/3"', '"sin(9*x)"',
)  # fmt: skip
"""Values that most expressions may have."""
PARTS = (
    "[]", '["bottom"]', '["left"]', '["top", "right"]', '["bottom", "left"]', '["slit"]', '["fault"]',
    '["nowhere"]',
)  # fmt: skip
STEPS = ("0", "1", "3", "1e-9", "60", '"1/3"')
SCHEMES = ('"bdf2"', '"implicit-euler"', '"euler"')
SIDES = (
    "{}", "{fault = [0, 0]}", '{fault = "upper"}', '{fault = "x"}', "{fault = [1, 0]}", "{fault = [0, -1e-9, 0]}",
    "{slit = [0, 1]}",
)  # fmt: skip
FIXED = (
    "{}", '{left = "xy"}', '{left = "n"}', '{right = "n", left = "n"}', '{left = "z"}', '{left = ""}',
    '{bottom = "x"}', '{left = "xx"}',
)  # fmt: skip
CORNERS = (
    "[]", "[[0, 0]]", "[[0, 1], [0, 1]]", "[[1, 0], [0, 1]]", '[["x", 1], ["x", 0]]', '[["x", 1], [0.5, 0]]',
    "[[0, 1], [1, 0], [1, 0]]", "[[0]]",
)  # fmt: skip
MORE = (
    "inner", "sides", "contact", "fixed", "dirichlet", "obstacle", "c", "young", "gap", "g", "mu", "parts", "psi",
    "kappa", "t",
)  # fmt: skip


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
    return Broken(_reading(rng), f"{name}: {', '.join(about)}"[:120])


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


def _reading(rng: random.Random) -> list[str]:
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
STUDY_KEYS = (
    "name", "title", "case", "ranks_per_run", "fields", "plot", "set", "vary", "together", "convergence", "comment",
    "set.h", "vary.h", "vary.case", "vary.eps", "vary.rho", "vary.backend", 'vary."problem.f"',
    'set."geometry.shape"', 'set."boundary.signorini"', "convergence.levels", "convergence.reference",
    "convergence.vary", "convergence.varry", "convergence.extra", "set.h.x", "vary.solve", "vary.name",
    'vary."a.b.c"',
)  # fmt: skip
STUDY_VALUES = (
    '"x"', "1", "-1", "0", "true", "[]", "[[]]", "{}", "[{}]", "{a = 1}", "nan", "inf", "[nan]", "[0]", "[1, 2]",
    '["1/2"]', '["2^-1000"]', '["example1", "case.toml"]', '["../home/x.toml"]', '[["top"], ["bottom"], []]',
    '"eps=h"', '["eps"]', '"\\u0000"', "[" + "0.5, " * 3000 + "]", "[" * 400 + "]" * 400, "9" * 5000,
    "0x" + "f" * 300, "1979-05-27",
)  # fmt: skip
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
        data, way = _with_values(rng, text, STUDY_KEYS, STUDY_VALUES)
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
