"""Broken checkpoints: arrays of other widths, types and numbers, texts that do not fit them, strange archives."""

import json
import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fuzzing import BINARY, OUTPUT, Broken, Valid, damaged

type Arrays = dict[str, npt.NDArray]

JUNK: tuple[Any, ...] = (
    None, True, 0, -1, 3, 1e308, float("nan"), float("inf"), 10**400, "", "x", "\0", "é" * 300, [], [[]], {},
    [None], {"a": {"b": []}}, ["top"], ["top", "bottom", "nowhere"], "square", "cube", "2", 2.5, [[0.5]], "2^-1000",
    "hybrid",
)  # fmt: skip


def checkpoint(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A results folder with a broken checkpoint, for export, comparison or as a start."""
    source = rng.choice([valid.shape, valid.shape, valid.file])
    shutil.copytree(source, folder / "res")
    for name in ("square.msh", "mesh.toml"):
        if (valid.file.parent / name).exists():
            shutil.copyfile(valid.file.parent / name, folder / name)
    path = folder / "res" / "checkpoint"
    way = rng.choice([_arrays, _arrays, _arrays, _story, _story, _one_file, _bytes])
    if way is _bytes:
        path = rng.choice(sorted(path.iterdir()))
    about, refused = way(rng, path, valid)
    case = ["example1", "--h", "1/4"] if source == valid.shape else ["mesh.toml"]
    other = os.path.relpath(source, folder)
    words = rng.choice(
        [
            ["export", "res", "--output", OUTPUT],
            ["export", "res", "--output", OUTPUT],
            ["compare", *rng.choice([("res", other), (other, "res")]), "--output", OUTPUT],
            ["solve", *case, "--start-from", "res", "--output", OUTPUT],
        ]
    )
    return Broken(words, about, refused, earlier=rng.random() < 0.3)


def _load(path: Path) -> Arrays:
    """All arrays, with the texts as `about`."""
    arrays = {file.stem: np.load(file) for file in sorted(path.glob("*.npy"))}
    return arrays | {"about": np.array((path / "about.json").read_text(encoding="utf-8"))}


def _save(path: Path, arrays: Arrays) -> None:
    shutil.rmtree(path)
    path.mkdir()
    for name, array in arrays.items():
        if name == "about":
            (path / "about.json").write_text(str(array), encoding="utf-8")
        else:
            np.save(path / f"{name}.npy", array)


def _arrays(rng: random.Random, path: Path, valid: Valid) -> tuple[str, bool]:
    """Change one or two arrays; most of the new lengths, types and numbers cannot be right."""
    arrays, done = _load(path), []
    for _ in range(rng.choice([1, 1, 1, 2])):
        way = rng.choice(list(ARRAY_WAYS))
        names, change = ARRAY_WAYS[way]
        key = rng.choice([name for name in arrays if name in names or not (names or name == "about")] or ["cells"])
        if way == "missing" and key.startswith(OPTIONAL):
            key = "cells"
        done.append(f"{key} {way}")
        with np.errstate(all="ignore"):
            arrays |= {key: change(rng, arrays[key])} if key in arrays else {}
    _save(path, {key: array for key, array in arrays.items() if array is not None})
    return ", ".join(done), any(way in text for text in done for way in REFUSED)


def _other_type(rng: random.Random, array: npt.NDArray) -> npt.NDArray:
    kind = rng.choice(["f4", "f2", "c16", "i1", "u8", "?", ">f8", ">i8", "S3", "M8[s]", "V8"])
    try:
        return array.astype(kind)
    except (TypeError, ValueError):
        return np.zeros(array.shape, kind)


def _other_number(rng: random.Random, array: npt.NDArray) -> npt.NDArray:
    """One number, or some, that refers to nothing, or is not finite."""
    values = {"i": [-1, 10**6, 2**31, 2**62, -(2**62), 0], "f": [np.nan, np.inf, 1e308, -1e30, 0]}.get(array.dtype.kind)
    array = array.copy()
    for _ in range(rng.choice([1, 1, 5]) if values and array.size else 0):
        array.flat[rng.randrange(array.size)] = rng.choice(values)
    return array


OPTIONAL = ("part_", "inside", "facet_part", "facet_x", "facet_along", "facet_measure", "facet_u")
"""Beginnings of names of arrays that not all commands need."""
REFUSED = ("missing", "narrow", "wide", "pickled", "words")
"""Ways that no command may accept."""
ARRAY_WAYS: dict[str, tuple[tuple[str, ...], Callable[[random.Random, npt.NDArray], Any]]] = {
    "missing": ((), lambda rng, a: None),
    "narrow": (("cells", "sigma", "facet_vertices", "points"), lambda rng, a: a[:, :-1] if a.ndim > 1 else a),
    "wide": (("cells", "sigma", "facet_vertices"), lambda rng, a: np.column_stack([a, a[:, 0]]) if a.ndim > 1 else a),
    "pickled": (("cells",), lambda rng, a: np.array([{"a": 1}, None], dtype=object)),
    "words": (("cells", "points", "u", "sigma"), lambda rng, a: np.full(a.shape, "é")),
    "short": ((), lambda rng, a: a[: rng.randrange(len(a))] if a.ndim and len(a) else a),
    "long": ((), lambda rng, a: np.concatenate([a] * rng.choice([2, 3])) if a.ndim else a),
    "flat": ((), lambda rng, a: rng.choice([a.ravel(), a.T, a[None], np.float64(1.0), a[..., None]])),
    "of another type": ((), _other_type),
    "with another number": ((), _other_number),
    "scaled": (
        ("sigma", "u", "facet_p", "facet_flux", "divergence"),
        lambda rng, a: a * 5 if a.dtype.kind == "f" else a,
    ),
    "shuffled": ((), lambda rng, a: a[rng.sample(range(len(a)), len(a))] if a.ndim else a),
}
"""Ways to change an array: names of those that it is for, of all if there are none, and the new array, or None."""


def _story(rng: random.Random, path: Path, valid: Valid) -> tuple[str, bool]:
    """Change the texts about the solution somewhere, or make them invalid JSON."""
    arrays = _load(path)
    text = str(arrays["about"])
    if rng.random() < 0.25:
        text, about = rng.choice(
            [
                ("[" * 100_000, "deep"),
                ('{"a":' * 100_000, "deep"),
                ("null", "null"),
                ("[]", "a list"),
                (text[:-1], "cut"),
                ("9" * 5000, "long integer"),
                (text.replace("0.25", "9" * 5000), "long integer within"),
            ]
        )
        refused = True
    else:
        tree = json.loads(text)
        place = rng.choice(list(_places(tree)))
        about, refused = "/".join(map(str, place)), False
        _change(rng, tree, place)
        text = json.dumps(tree)
    arrays["about"] = np.array(text)
    _save(path, arrays)
    return f"about {about}", refused


def _places(tree: Any, prefix: tuple = ()) -> list[tuple]:
    """Paths of all entries of nested lists and dictionaries."""
    pairs = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else []
    return [place for key, value in pairs for place in [(*prefix, key), *_places(value, (*prefix, key))]]


def _change(rng: random.Random, tree: Any, place: tuple) -> None:
    for key in place[:-1]:
        tree = tree[key]
    if rng.random() < 0.25:
        del tree[place[-1]]
    else:
        tree[place[-1]] = rng.choice(JUNK)


def _bytes(rng: random.Random, path: Path, valid: Valid) -> tuple[str, bool]:
    data, about = damaged(rng, path.read_bytes(), BINARY)
    path.write_bytes(data)
    return about, False


def _one_file(rng: random.Random, path: Path, valid: Valid) -> tuple[str, bool]:
    """One of the files of a checkpoint, or its folder, is no such file."""
    file = path / rng.choice(["u.npy", "cells.npy", "about.json"])
    way = rng.choice(["gone", "empty", "folder", "device", "loop", "no folder", *HEADERS])
    if way == "no folder":
        shutil.rmtree(path)
        path.touch()
        return way, True
    file.unlink()
    match way:
        case "empty":
            file.touch()
        case "folder":
            file.mkdir()
        case "device":
            file.symlink_to("/dev/zero")
        case "loop":
            file.symlink_to(file.name)
        case "gone":
            pass
        case _:
            file.write_bytes(_headed(way))
    return f"{file.name} {way}", True


HEADERS = {
    "long header": "{'descr': '<f8', 'fortran_order': False, 'shape': (" + "1, " * 50_000 + "), }",
    "huge shape": "{'descr': '<f8', 'fortran_order': False, 'shape': (4000000000000,), }",
    "code in the header": "__import__('os').system('touch hacked')",
}


def _headed(way: str) -> bytes:
    """A short array with one of the strange headers."""
    text = HEADERS[way]
    return b"\x93NUMPY\x02\x00" + (len(text) + 1).to_bytes(4, "little") + text.encode() + b"\n" + b"\0" * 64
