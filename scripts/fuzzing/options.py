"""Broken command lines, and what others may have left: forged results folders, configuration files."""

import json
import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

from fuzzing import NUMBERS, OUTPUT, WORDS, Broken, Valid, damaged
from fuzzing.texts import KEYS, VALUES
from signorini_fenicsx.methods.registry import METHODS

SIZES = (
    *NUMBERS, "2^-1000", "2^0.5", "1e-300", "x", "pi", "1/4", "0.3", "1/3", "9^9^9", "not 1", "-(1/4)",
    "1/4 if 1 < 2 else 1",
)  # fmt: skip
PETSC = (
    "-mat_type nonsense", "-ksp_type nonsense", "-pc_type nonsense", "-pc_type jacobi", "-ksp_max_it 0",
    "-ksp_rtol nan", "-ksp_max_it 1 -ksp_type cg -pc_type none", "-snes_type nonsense", "-snes_max_it 0",
    "-vec_type nonsense", "-ksp_type", "-pc_factor_mat_solver_type nonsense", "-mat_mumps_icntl_7 99",
    "-options_file missing", "-options_file case.toml", "-ksp_rtol x", "nonsense", "- -", "-", "-ksp_max_it 1e10",
    "-ksp_atol -1", "-mat_mumps_icntl_14 -100", "-snes_rtol -1", "-pc_type lu -pc_factor_zeropivot 1e300",
    "-sub_pc_type nonsense", "-options_left", "-ksp_monitor", "-ksp_view",
)  # fmt: skip
"""PETSc options to try; none asks PETSc for other files, a debugger or an abort, because PETSc would obey."""
OPTIONS = {
    **dict.fromkeys(["--h", "--rho", "--eps", "--theta", "--target"], SIZES),
    **dict.fromkeys(["--backend", "--algorithm", "--start-from"], WORDS),
    "--max-cells": (*NUMBERS, "1", "50"),
    "--levels": ("", "2", "2:", ":", "3:2", "2:99", "a:b", "1:1:1"),
    "--reference": NUMBERS,
    "--vary": ("", "eps", "eps=h^9", "x", "h,eps"),
    "--plot": ("",),
}
COMMANDS = (
    ["solve", "example1"], ["solve", "example1"], ["solve", "example4", "--algorithm", "alg3"],
    ["check", "example2"], ["info", "example3"], ["adapt", "example1"], ["convergence", "example1"],
    ["compare", "a", "b"], ["export", "a"], ["study", "iterations", "--dry-run"], ["methods"], ["version"],
    ["solve"], ["info"],
)  # fmt: skip
EARLY = (
    "-snes_atol 1", "-snes_atol 1e6", "-snes_rtol 0.9", "-snes_stol 1", "-snes_max_it 1", "-snes_max_funcs 2",
    "-snes_divergence_tolerance 1e-9", "-snes_force_iteration 0", "-snes_type nrichardson", "-snes_type ksponly",
    "-ksp_type cg -pc_type none -ksp_rtol 0.5", "-ksp_type gmres -pc_type jacobi -ksp_atol 1", "-ksp_max_it 1",
    "-ksp_type richardson -pc_type none -ksp_max_it 3", "-ksp_type preonly -pc_type jacobi", "-ksp_norm_type none",
    "-ksp_type cg -pc_type gamg -ksp_rtol 0.1", "-ksp_convergence_test skip -ksp_max_it 2",
    "-snes_vi_zero_tolerance 1",
)  # fmt: skip
"""Options with which PETSc's solvers end before they have a solution."""
SMALL = {
    "solve": {"--h": "1/4"},
    "adapt": {"--max-cells": "60"},
    "convergence": {"--levels": "1:2", "--reference": "3"},
}
"""Options that keep a valid command fast."""
WRITING = ("solve", "adapt", "convergence", "compare", "export")
HOSTILE_OUTPUTS = (
    *("", ".", "..", "/", "notes.txt", "notes.txt/out", "photos", "../home", "/dev/null", "/proc/self/out", "x" * 300),
    *("y/" * 3000 + "z", "loop", "loop/out", "readonly/out", "/dev/full/x"),
)
"""Folders that belong to the user, cannot be made, or are not folders."""


def option(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A command with one to three broken options."""
    ways = [_values, _values, _settings, _outputs, _petsc, _methods, _words]
    return rng.choice(ways)(rng, folder)


def _values(rng: random.Random, folder: Path) -> Broken:
    """Values of the options that need a number or a name."""
    words = list(rng.choice(COMMANDS))
    usual = {
        "solve": ["--h", "--rho", "--eps", "--backend", "--algorithm", "--start-from"],
        "adapt": ["--target", "--max-cells", "--theta", "--h", "--rho", "--eps"],
        "convergence": ["--levels", "--reference", "--vary", "--h", "--eps"],
    }
    own = usual.get(words[0], ["--h", "--algorithm", "--backend"])
    for name in rng.choices(own if rng.random() < 0.9 else sorted(OPTIONS), k=rng.choice([1, 1, 2])):
        words += [name, rng.choice(OPTIONS[name])]
    for name, value in SMALL.get(words[0], {}).items():
        words += [] if name in words else [name, value]
    return _finished(rng, words, words[2:])


def _settings(rng: random.Random, folder: Path) -> Broken:
    """--set with keys and values of all sorts."""
    words = [rng.choice(["check", "info", "info"]), rng.choice(["example1", "example5", "dam"])]
    for _ in range(rng.choice([1, 1, 2, 3])):
        value = rng.choice([*VALUES, *NUMBERS, *WORDS])
        words += ["--set", rng.choice([f"{rng.choice(KEYS)}={value}", f"{rng.choice(KEYS)}={value}", value])]
    return _finished(rng, words, words[2:])


def _outputs(rng: random.Random, folder: Path) -> Broken:
    """Output folders that are not folders or belong to others; all of them must be refused."""
    (folder / "photos").mkdir()
    shutil.copyfile(folder / "notes.txt", folder / "photos" / "photo.png")
    (folder / "loop").symlink_to("loop")
    (folder / "readonly").touch()  # a file instead of a folder stops even root
    place = rng.choice(HOSTILE_OUTPUTS)
    command = rng.choice([["solve", "example1", "--h", "1/4"], ["adapt", "example1", "--max-cells", "30"]])
    return Broken([*command, "--output", place], f"output {place[:40]!r}", refused=True)


def _petsc(rng: random.Random, folder: Path) -> Broken:
    """Options after -- that PETSc does not know, or cannot solve with."""
    (folder / "case.toml").write_text("-ksp_type = [nonsense\n-mat_type", encoding="utf-8")
    chosen = rng.choice(PETSC)
    algorithm = rng.choice(["alg1", "alg1", "alg3", "vi", "snes1"])
    words = ["solve", "example4", "--h", "1/4", "--algorithm", algorithm, "--output", OUTPUT]
    words += rng.choice([[], ["--backend", "mixed"]]) if algorithm.startswith("alg") else []
    return Broken([*words, "--", *chosen.split()], f"{algorithm} -- {chosen}", earlier=rng.random() < 0.5)


def ends_early(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A method whose solver ends early: the residuals are those of the problem, whatever the solver says."""
    chosen = rng.choice(EARLY)
    algorithm = rng.choice(["snes1", "snes2", "vi", "alg1", "alg2", "alg3", "alg4"])
    words = ["solve", rng.choice(["example1", "example3", "example4"]), "--h", "1/6", "--algorithm", algorithm]
    words += rng.choice([[], ["--backend", "mixed"]]) if algorithm.startswith("alg") else []
    return Broken([*words, "--output", OUTPUT, "--", *chosen.split()], f"{algorithm} -- {chosen}")


def _methods(rng: random.Random, folder: Path) -> Broken:
    """A random algorithm with parameters at and beyond the ends of their ranges."""
    words = ["solve", "example1", "--h", "1/3", "--algorithm", rng.choice(list(METHODS)), "--set"]
    words += [f"solve.max_iterations={rng.choice(['1', '2', '200', '0', '1.5', '-1', 'true'])}"]
    for name in rng.sample(["--rho", "--eps"], rng.choice([0, 1, 2])):
        words += [name, rng.choice(["1e-100", "1e100", "1e-14", "1e6", "1e-320", "1e-13", "1e3", "1", "nan"])]
    return _finished(rng, words, words[5:])


def _words(rng: random.Random, folder: Path) -> Broken:
    """Words in any order, twice, or of no meaning."""
    words = list(rng.choice(COMMANDS)) + rng.choice([[], ["--quiet"], ["--json"], ["--plot"]])
    for _ in range(rng.choice([1, 2, 3])):
        at = rng.randrange(len(words) + 1)
        words.insert(
            at, rng.choice([rng.choice(words), rng.choice(WORDS), f"--{rng.choice(WORDS)}", "-x", "--h=", "--json"])
        )
    words += [word for pair in SMALL.get(words[0], {}).items() for word in pair]
    return _finished(rng, words, words)


def _finished(rng: random.Random, words: list[str], shown: list[str]) -> Broken:
    """Add an output folder, and remove characters that a command line cannot contain."""
    writes = words[0] in WRITING
    words = [word.replace("\0", "").encode(errors="ignore").decode()[:100_000] for word in words]
    words = [word for word in words if word not in ("--", "--help")] + (["--output", OUTPUT] if writes else [])
    return Broken(words, " ".join(shown)[:60].replace(os.linesep, " "), earlier=writes and rng.random() < 0.5)


OWN = {"written_by": "signorini_fenicsx"}
VICTIMS = ("../home/.profile", "../../home/.profile", "../notes.txt", "notes.txt", "link/.profile", "link", "")
NAMES = (".petscrc", "petscrc", "dolfinx_jit_options.json", "ffcx_options.json")
CONFIGURATIONS = (
    "-ksp_type nonsense\n", "-help\n", "-ksp_max_it 1 -ksp_type cg -pc_type none\n-snes_atol 1\n", "[", "[]", "{}",
    '{"cffi_extra_compile_args": "-O0"}', '{"scalar_type": "complex128"}',
    '{"sum_factorization": true, "table_atol": 10.0, "table_rtol": 10.0}', '{"timeout": "x"}', "\0", "é" * 400,
)  # fmt: skip


def forged(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A folder of an interrupted run, which another person made, beside a results folder."""
    target = folder / OUTPUT
    if rng.random() < 0.7:
        shutil.copytree(valid.shape, target)
    area = folder / f".{OUTPUT}.partial"
    ways = [_area, _area, _area, _area_is_a_link, _links_in_the_target, _odd_list]
    about = rng.choice(ways)(rng, folder, target, area)
    words = rng.choice(
        [
            ["solve", "example1", "--h", "1/4", "--output", OUTPUT],
            ["solve", "example1", "--h", "1/4", "--output", OUTPUT],
            ["export", OUTPUT, "--output", OUTPUT],
            ["export", OUTPUT],
            ["compare", OUTPUT, os.path.relpath(valid.shape, folder), "--output", "out2"],
            ["solve", "example1", "--h", "1/4", "--start-from", OUTPUT, "--output", OUTPUT],
            ["adapt", "example1", "--max-cells", "60", "--output", OUTPUT],
        ]
    )
    beginnings = [f"work/.{OUTPUT}.partial", f"work/{OUTPUT}", "work/out2"]
    return Broken(words, f"forged: {about}", forged=tuple(beginnings))


def _area(rng: random.Random, folder: Path, target: Path, area: Path) -> str:
    """A complete result that waits for its move, with links and names that lead out of it."""
    name = rng.choice(["done", "done", "failed"])
    place = area / name
    place.mkdir(parents=True)
    files = rng.sample(["summary.json", "u.png", ".profile", "facets.csv"], 3)
    for file in files:
        (place / file).write_text("forged", encoding="utf-8")
    links = {"home": "../../../home", "link": str((folder / "../home").resolve()), "up": "../..", "checkpoint": "/"}
    for link in rng.sample(sorted(links), 2):
        (place / link).symlink_to(links[link])
        if rng.random() < 0.5 and not (target / link).exists():
            target.mkdir(exist_ok=True)
            (target / link).symlink_to((folder / "../home").resolve())
    (place / "sub").mkdir()
    (place / "sub" / ".profile").write_text("forged", encoding="utf-8")
    listed = [*files, *rng.choices(VICTIMS, k=3), "home/.profile", "link/.profile", "up/notes.txt"]
    (place / "files.json").write_text(json.dumps(OWN | {"files": listed}), encoding="utf-8")
    if rng.random() < 0.8:
        (area / "lock").touch()
    if rng.random() < 0.3:
        (area / "remove").write_text(json.dumps(rng.choices(VICTIMS, k=3)), encoding="utf-8")
    if rng.random() < 0.3:
        (area / str(rng.randrange(9))).symlink_to((folder / "../home").resolve())
    return f"area with {name}"


def _area_is_a_link(rng: random.Random, folder: Path, target: Path, area: Path) -> str:
    """The folder beside the target leads elsewhere."""
    area.symlink_to(rng.choice(["../home", "notes.txt", "missing", f".{OUTPUT}.partial", "."]))
    return "area is a link"


def _links_in_the_target(rng: random.Random, folder: Path, target: Path, area: Path) -> str:
    """Names of results that lead elsewhere, on a list of files or not."""
    target.mkdir(exist_ok=True)
    names = rng.sample(["summary.json", "history.csv", "solution.bp", "checkpoint", "facets"], 3)
    for name in names:
        if (target / name).is_dir():
            shutil.rmtree(target / name)
        (target / name).unlink(missing_ok=True)
        (target / name).symlink_to(rng.choice(["../../home/.profile", "../../home", "../notes.txt", "missing"]))
    listed = [*names, "checkpoint/.profile", "solution.bp/.profile", "../notes.txt"]
    (target / "files.json").write_text(json.dumps(OWN | {"files": listed}), encoding="utf-8")
    return f"links {', '.join(names)}"


def _odd_list(rng: random.Random, folder: Path, target: Path, area: Path) -> str:
    """A list of files that is none."""
    place = rng.choice([target, area / "done", area / "failed"])
    place.mkdir(parents=True, exist_ok=True)
    if place.parent == area:
        (area / "lock").touch()
    path = place / "files.json"
    path.unlink(missing_ok=True)
    way = rng.choice(["fifo", "zero", "folder", "broken", "names"])
    match way:
        case "fifo":
            os.mkfifo(path)
        case "zero":
            path.symlink_to("/dev/zero")
        case "folder":
            path.mkdir()
        case "broken":
            path.write_bytes(damaged(rng, json.dumps(OWN | {"files": ["u.png", "summary.json"]}).encode())[0])
        case _:
            names = [
                rng.choice([*NUMBERS, "\0", "a\0b", "x" * 400, "..", ".", "/", None, 3, ["u.png"]]) for _ in range(4)
            ]
            path.write_text(json.dumps(OWN | {"files": names}), encoding="utf-8")
    return f"list is {way}"


def configuration(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """Files of PETSc's and DOLFINx's options in the current folder, which count only with --local-options."""
    names = rng.sample(NAMES, rng.choice([1, 1, 2]))
    ways = [_put(rng, folder / name) for name in names]
    if rng.random() < 0.3:
        (folder / "mine").mkdir()
    words = ["solve", "example1", "--h", "1/4", "--output", OUTPUT]
    asked = rng.random() < 0.5
    words += ["--local-options"] if asked else []
    return Broken(words, f"{', '.join(names)}: {', '.join(ways)}", solved=not asked)


def _put(rng: random.Random, path: Path) -> str:
    """Something with this name, in words."""
    makers: dict[str, Callable[[], object]] = {
        "fifo": lambda: os.mkfifo(path),
        "/dev/zero": lambda: path.symlink_to("/dev/zero"),
        "folder": path.mkdir,
        "loop": lambda: path.symlink_to(path.name),
        "large": lambda: path.write_bytes(b"# \n" * 4_000_000),
    }
    if rng.random() < 0.35:
        way = rng.choice(sorted(makers))
        makers[way]()
        return way
    text = rng.choice(CONFIGURATIONS)
    path.write_text(text, encoding="utf-8")
    return repr(text[:30])
