"""Broken case files."""

import json
import random
import re
import shutil
import tomllib
from pathlib import Path

from broken_input import CASE_MUTATIONS

from fuzzing.broken import NUMBERS, OUTPUT, WORDS, Broken, Valid, damaged
from signorini_fenicsx.base.shipped import data_folder

COARSE = {
    **dict.fromkeys(["example1", "example2", "example3", "example4", "example5", "example6"], "1/4"),
    **dict.fromkeys(["cube", "lprism", "ball"], "0.8"),
}
"""Cases that are broken, and values of h with which they are fast."""
KEYS = (
    *(
        "geometry.shape",
        "geometry.mesh",
        "geometry.diagonal",
        "geometry.file",
        "boundary.signorini",
        "boundary.neumann",
    ),
    *("boundary.dirichlet", "problem.f", "problem.kappa", "problem.u_D", "problem.g_N", "problem.psi", "problem.q_S"),
    *("exact.u", "solve.algorithm", "solve.backend", "solve.h", "solve.rho", "solve.eps", "solve.max_iterations"),
    *(
        "solve.predict",
        "title",
        "name",
        "solve",
        "geometry",
        "",
        ".",
        "a.b.c.d",
        "problem.f.g",
        "__class__",
        "sol\u200bve.h",
    ),
)
VALUES = (
    *(
        "0",
        "-1",
        "1",
        "true",
        "nan",
        "inf",
        "-inf",
        "1e999",
        "[]",
        "{}",
        '""',
        '"x"',
        "[1, 2]",
        "{a = 1}",
        "1979-05-27",
    ),
    *(
        '["bottom"]',
        '["bottom", "bottom"]',
        '["top", 3]',
        "[[1, 0], [0, 1]]",
        '[["x", 0], [0, "y"]]',
        "[[1, 2], [2, 1]]",
    ),
    *(
        "[[1, 2, 3]]",
        "[[1, nan], [nan, 1]]",
        "[[-1, 0], [0, -1]]",
        '"\\u0000"',
        '"a\\u0000b.msh"',
        '"../home/secret.msh"',
    ),
    *('"/dev/zero"', '"."', '"notes.txt"', '"x/0"', '"1/0"', '"z"', '"nan"', '"square"', '"cube"', '"alg2"', '"mixed"'),
    *("9" * 5000, "0x" + "f" * 300, "1" + "0" * 400 + ".0", '"2^-1000"', '"9**9**9"', '"' + "(" * 900 + '"'),
    *("[" * 300 + "]" * 300, '"' + "not " * 480 + 'x > 0"', '"1 if ' + "x < " * 300 + 'y else 0"', '"\\U0001F986"'),
)


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
        data, way = _with_values(rng, text)
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


def _with_values(rng: random.Random, text: str) -> tuple[bytes, str]:
    """One or two keys with values of other types, in the right section or a second one of its name."""
    chosen = []
    for _ in range(rng.choice([1, 1, 2])):
        key, value = rng.choice(KEYS), rng.choice([*VALUES, *map(json.dumps, (*NUMBERS, *WORDS))])
        section, _, last = key.rpartition(".")
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
