"""Files that somebody else has put there: forged results folders, and configuration files in the current folder."""

import json
import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

from fuzzing.broken import NUMBERS, OUTPUT, Broken, Valid, damaged

OWN = {"written_by": "signorini_fenicsx"}
VICTIMS = ("../home/.profile", "../../home/.profile", "../notes.txt", "notes.txt", "link/.profile", "link", "")
NAMES = (".petscrc", "petscrc", "dolfinx_jit_options.json", "ffcx_options.json")
TEXTS = (
    "-ksp_type nonsense\n",
    "-help\n",
    "-ksp_max_it 1 -ksp_type cg -pc_type none\n-snes_atol 1\n",
    "[",
    "[]",
    "{}",
    '{"cffi_extra_compile_args": "-O0"}',
    '{"scalar_type": "complex128"}',
    '{"sum_factorization": true, "table_atol": 10.0, "table_rtol": 10.0}',
    '{"timeout": "x"}',
    "\0",
    "é" * 400,
)


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
    text = rng.choice(TEXTS)
    path.write_text(text, encoding="utf-8")
    return repr(text[:30])
