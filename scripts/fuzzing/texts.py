"""Broken case files, studies, command lines and expressions, and kills.

What is broken are the commands and cases of `tests/capabilities.py`, which together take all paths of the program.
"""

import json
import random
import re
import shutil
from pathlib import Path

import capabilities
import typer

from fuzzing import NUMBERS, OUTPUT, WORDS, Broken, Valid, damaged, make_odd
from signorini_fenicsx.base.shipped import data_folder
from signorini_fenicsx.cli.app import app

SHIPPED = {path.stem: path.read_text(encoding="utf-8") for path in data_folder("cases").glob("*.toml")}
CORPUS = [
    (list(each.commands[-1]), each.files)
    for each in capabilities.capabilities()
    if not each.slow and not any("/tests/" in word for word in each.commands[-1])
]
"""Commands with the texts of their files, by name; none names a folder outside the working one."""
TEXTS = [*SHIPPED.values(), *(text for _, files in CORPUS for text in files.values())]
PAIRS = [pair for text in TEXTS for pair in re.findall(r"(?m)^(\w+) *= *(.+)$", text)]
"""Keys with values, as cases have them."""


def _sections(text: str) -> list[str]:
    return re.split(r"(?m)^(?=\[)", text)


SECTIONS = [section for text in TEXTS for section in _sections(text) if section.startswith("[")]
KEYS = [
    f"{found[2]}{'.0' if found[1] == '[[' else ''}.{key}"
    for section in SECTIONS
    for found in re.finditer(r"(\[+)([\w.]+)", section.split("\n")[0])
    for key in re.findall(r"(?m)^(\w+) *=", section)
]
"""Keys of cases with their sections, as `--set` has them."""
WRITING = ("solve", "adapt", "convergence", "compare", "export", "study")
OPTIONS = {
    name: [(word, not option.is_flag) for option in command.params for word in option.opts if word.startswith("-")]
    for name, command in typer.main.get_command(app).commands.items()  # type: ignore[attr-defined]
}
"""All options of the commands, and whether they take a value."""


def _a_value(rng: random.Random, key: str = "") -> str:
    """A value as TOML has it: one that this key has elsewhere, that any key has, or none that makes sense."""
    same = [value for name, value in PAIRS if name == key] or ["1"]
    words = [rng.choice(NUMBERS), json.dumps(rng.choice([*NUMBERS, *WORDS])), "{a = 1}", "[[1, nan], [nan, 1]]"]
    odd = rng.choice([*words, "1979-05-27", "[" * 300 + "]" * 300, '"a\\u0000b.msh"'])
    text = text_of_expression(rng).encode(errors="ignore").decode()
    expression = json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
    return rng.choice([*rng.choices(same, k=4), rng.choice(PAIRS)[1], odd, expression])


def _with_a_value(rng: random.Random, text: str) -> str:
    """A text with another value of a key, or another key after it."""
    places = list(re.finditer(r'(?m)^([\w."]+) *= *(.+)$', text))
    if not places:
        return text
    place = rng.choice(places)
    key = place[1] if rng.random() < 0.8 else rng.choice(PAIRS)[0]
    kept = place[0] + "\n" if key != place[1] else ""
    return f"{text[: place.start()]}{kept}{key} = {_a_value(rng, key)}{text[place.end() :]}"


def broken_toml(rng: random.Random, text: str) -> tuple[bytes, str]:
    """A case or study with other values or sections, or broken bytes; and how it was broken."""
    way = rng.choice([*["values"] * 5, "section", "section", "bytes"])
    if way == "bytes":
        return damaged(rng, text.encode())
    data = text.encode()
    for _ in range(rng.choice([1, 1, 2])):
        if way == "values":
            data = _with_a_value(rng, data.decode()).encode(errors="replace")
        else:
            section = rng.choice(SECTIONS)
            header = section.split("]")[0] if section[1] != "[" else None
            pieces = [piece for piece in _sections(data.decode()) if piece.split("]")[0] != header]
            if rng.random() < 0.8:
                data = "\n".join([*pieces, section]).encode()
            else:
                data = f"{section.split()[0].strip('[]')} = {_a_value(rng)}\n{''.join(pieces)}".encode()
    return data, way


def _put(folder: Path, valid: Valid, words: list[str], files: dict[str, str]) -> list[str]:
    """Put what a command of the corpus needs into a folder; return its words without its output folder."""
    for name, text in files.items():
        fault = data_folder("meshes") / "fault.msh"
        (folder / name).write_text(text.replace("FAULT", str(fault)), encoding="utf-8")
    if words[0] in WRITING:
        at = words.index("--output")
        words = words[:at] + words[at + 2 :]
    words = ["res" if word == "out" else word for word in words]
    for name in {"res", "finer"} & set(words):
        shutil.copytree(valid.shape, folder / name)
    return words


def _finished(rng: random.Random, words: list[str], about: str, **known: bool) -> Broken:
    """The input with an output folder, and without characters that a command line cannot contain."""
    words = [word.replace("\0", "").encode(errors="ignore").decode()[:100_000] for word in words]
    writes = words[0] in WRITING
    at = words.index("--") if "--" in words else len(words)
    words[at:at] = ["--output", OUTPUT] if writes else []
    earlier = writes and words[0] != "study" and rng.random() < 0.5
    return Broken(words, about.replace("\n", " ")[:120], earlier=earlier, homeless=rng.random() < 0.05, **known)


def case_file(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A command with a broken case, or with something else in its place, which must be refused."""
    words, files = rng.choice([entry for entry in CORPUS if entry[0][0] not in ("export", "compare", "study")])
    words, name = _put(folder, valid, words, files), words[1]
    path = folder / "case.toml"
    if rng.random() < 0.08:
        return _finished(rng, [words[0], "case.toml"], make_odd(rng, path), refused=True)
    data, way = broken_toml(rng, (files.get(name) or SHIPPED[name]).replace("FAULT", "fault.msh"))
    for place in re.findall(r'"([\w./]{1,99}\.(?:msh|geo))"', data.decode(errors="replace")):
        sources = [data_folder("cases") / place, data_folder("meshes") / Path(place).name]
        for source in filter(Path.is_file, sources):
            shutil.copyfile(source, folder / Path(place).name)
    path.write_bytes(data.replace(b"../meshes/", b""))
    words[:2] = [words[0] if rng.random() < 0.8 else rng.choice(["check", "info"]), "case.toml"]
    if words[0] in ("check", "info"):
        words = words[:2]
    elif words[0] == "solve" and rng.random() < 0.1:
        words.append("--plot")
    return _finished(rng, words, f"{name} {way}")


CONVERGENCE = capabilities.STUDY + "[convergence]\nlevels = [1, 2]\nreference = 3\n"
TAME = (b'h = "1/8"', b"levels = [1, 2]\nreference = 3"), (b"problem", b"shape", b"boundary", b"plot", b"case.")
"""What a study has if its runs are small, one of these words, and what none of these has."""


def study(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A study that is broken, or its folder is; only those with small runs are run."""
    text, way = rng.choice([*[capabilities.STUDY] * 3, CONVERGENCE]), ""
    data = text.encode()
    if rng.random() < 0.75:
        data, way = broken_toml(rng, text)
    else:
        place = folder / OUTPUT
        place.mkdir()
        (place / "mine.txt").write_text("the user's", encoding="utf-8")
        (place / ".lock").touch()
        name = rng.choice([".lock", ".claims", "runs", "table.csv", "runs/example1-alg1-0123456789ab/summary.json"])
        way = make_odd(rng, place / name)
    (folder / "study.toml").write_bytes(data)
    small = any(word in data for word in TAME[0]) and not any(word in data for word in TAME[1])
    words = ["study", "study.toml", *(["--dry-run"] if not small or rng.random() < 0.4 else [])]
    return _finished(rng, words + (["--retry-failed"] if rng.random() < 0.1 else []), way)


PETSC = (
    *("ksp_type", "pc_type", "snes_type", "mat_type", "vec_type", "ksp_rtol", "ksp_atol", "ksp_max_it", "snes_rtol"),
    *("snes_atol", "snes_stol", "snes_max_it", "snes_max_funcs", "snes_divergence_tolerance", "mat_mumps_icntl_7"),
    *("mat_mumps_icntl_14", "pc_factor_zeropivot", "ksp_convergence_test", "ksp_norm_type", "options_file", "ksp_view"),
    *("pc_factor_mat_solver_type", "", "- -", "nonsense"),
)
FOR_PETSC = (
    *("nonsense", "cg", "none", "jacobi", "preonly", "richardson", "lu", "skip", "case.toml", "0", "1", "-1", "3"),
    *("0.9", "0.1", "99", "1e6", "1e10", "1e300", "nan", "x"),
)
"""PETSc options and values of them; none asks PETSc for a debugger or an abort, because PETSc would obey."""
OTHERS: tuple[list[str], ...] = (["check", "example2"], ["info", "example3"], ["methods"], ["version"], ["cases"])


def option(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A command of the corpus with one to three broken words."""
    words, files = rng.choice(CORPUS) if rng.random() < 0.85 else (list(rng.choice(OTHERS)), {})
    words, about = _put(folder, valid, words, files), []
    for _ in range(rng.choice([0, 1, 1, 2])):
        after = [at for at, word in enumerate(words, start=1) if at > 1 and word.startswith("--")]
        at, key, value = rng.choice(after or [len(words)]), rng.choice(KEYS), rng.choice([*NUMBERS, *WORDS])
        match rng.choice([*["value", "option", "set", "set"] * 4, "gone", "twice", "more"]):
            case "value" if after:
                words[at : at + 1] = [value]
            case "option" if OPTIONS[words[0]]:
                name, takes_value = rng.choice(OPTIONS[words[0]])
                words += [name, *[value] * takes_value]
            case "gone":
                words = words[:at] + words[at + 1 :]
            case "twice":
                words.insert(at, rng.choice(words))
            case "more":
                words.insert(at, rng.choice([value, f"--{value}", "-x", "--h=", "--json"]))
            case _:
                words += ["--set", f"{key}={_a_value(rng, key.split('.')[-1]).strip(chr(34))}"]
        about.append(value[:30])
    words = [word for word in words if word not in ("--", "--help", "--output")]
    if words[0] == "solve" and (not about or rng.random() < 0.2):
        words.append("--")
        for name in rng.choices(PETSC, k=rng.choice([1, 1, 2, 3])):
            words += [f"-{name}", *[rng.choice(FOR_PETSC)] * (rng.random() < 0.9)]
    return _finished(rng, words, ", ".join(about))


def killed(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A run that is killed at any time; the next one solves the case, with or without an earlier result there."""
    words = ["solve", "example1", "--h", "1/8", *rng.choice([[], ["--plot"], ["--html"]]), "--output", OUTPUT]
    share = rng.uniform(0, 2)
    about = f"after {share:.3f} times what a small problem takes"
    return Broken(words, about, solved=True, earlier=rng.random() < 0.7, killed=share * valid.seconds)


def grammatical(rng: random.Random, depth: int) -> str:
    """An expression of the grammar, nested up to this depth."""
    if depth <= 0 or rng.random() < 0.1:
        return rng.choice(["x", "y", "x", "y", "z", "pi", str(rng.randint(0, 9)), f"{rng.uniform(-1e3, 1e3):g}"])
    a, b, c, d = (grammatical(rng, depth - rng.randint(1, 3)) for _ in range(4))
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


FUNCTIONS = ("sin", "cos", "tan", "tanh", "atan2", "exp", "log", "sqrt", "abs", "min", "max")
TOKENS = (
    *FUNCTIONS, *"xyz+-*/^%@&|~()[]{}<>=!,.:;#'\"\\ \n\t\0", "pi", "**", "//", "<=", "==", "->", ":=", "...", "if",
    "else", "and", "or", "not", "in", "is", "lambda", "for", "await", "yield", "None", "True", "f'{x}'", "b'1'",
    "import os", "__import__", "__class__", "eval", "w", "ａ", "π", "²", "∞", "−", "\ud800", "\u202e", "🦆", "7j",
    "31", "1e-320",
)  # fmt: skip
NESTS = ("({})", "-{}", "sin({})", "1+({})", "{}+x", "{}**2", "({})**2", "[{}]", "not {}", "{} < x", "max(x,{})",
         "1/{}", "x.{}", "x if x < 0 else {}", "1 if {} else 2")  # fmt: skip


def text_of_expression(rng: random.Random) -> str:
    """A valid or a spoilt expression, tokens in any order, deep nesting, numbers, or letters; rarely a long one."""
    if rng.random() < 0.01:
        return rng.choice(["x+", "(", "1", "x ", "sin(", " "]) * rng.choice([400, 1000, 10_000, 1_000_000]) + "x"
    match rng.choice(["valid", "valid", "soup", "soup", "spoilt", "spoilt", "deep", "numbers", "strange"]):
        case "valid":
            return grammatical(rng, rng.randint(1, 12))
        case "soup":
            return rng.choice(["", " "]).join(rng.choices((*TOKENS, *NUMBERS), k=rng.randint(1, 30)))
        case "spoilt":
            text = list(grammatical(rng, 6))
            for _ in range(rng.randint(1, 3)):
                i = rng.randrange(len(text))
                text[i] = rng.choice(["", text[i] * 2, text[i - 1], rng.choice(TOKENS), chr(rng.randrange(0x110000))])
            return "".join(text)
        case "deep":
            before, after = rng.choice(NESTS).split("{}")
            times = int(10 ** rng.uniform(0, 3.3))
            return before * times + rng.choice(["x", "y", "2", "x>0"]) + after * times
        case "numbers":
            pieces = [rng.choice([*NUMBERS, *"+-*/^", "**", "**x*"]) for _ in range(rng.randint(3, 11))]
            return "".join(pieces)
    return "".join(chr(rng.choice([rng.randrange(128), rng.randrange(0x110000)])) for _ in range(rng.randint(0, 40)))
