"""Broken inputs of all kinds, the processes that run them, and the judge of the results.

Here are the type of a broken input, and what breaks bytes, texts, arrays, JSON and files, whatever they are for.
"""

import json
import os
import random
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

sys.path.append(str(Path(__file__).parents[2] / "tests"))  # the folder of `broken_input`, `capabilities`, `geo_texts`

OUTPUT = "out"
"""Folder for the results of every command."""
NUMBERS = (
    "0", "-1", "1", "3", "7", "2147483648", "-9223372036854775809", "1e308", "-1e308", "1e-308", "1e999", "nan",
    "inf", "-inf", "9" * 25, "9" * 5000, "0x" + "f" * 400, "1e", "--1", "1,5", "1_0", "0.1.2", "٣", "1e-9", "0.25",
    "1/0", "2^-1000", "9^9^9",
)  # fmt: skip
WORDS = (
    "", " ", "\0", "\n", "\r\n", "\t", "é", "\u202e", "\ufeff", "🦆", "'", '"', "\\", "{", "}", "[", "]", "(", ")",
    "<", ">", "&", ";", "/*", "*/", "//", "#", "%s%n", "../../home/.profile", "/dev/zero", "/dev/stdin", "$HOME",
    "`id`", "true", "None", "A" * 3000, "(" * 600, "[" * 3000, "__import__('os')", r"$\bm{\sigma}$", "5$_$", "\x1b[31m",
)  # fmt: skip


@dataclass
class Broken:
    """One input: the arguments of the program, whose files are in the working folder.

    Attributes:
        words: The arguments after `signorini`.
        about: How it was broken, in words.
        refused: Whether only exit status 2 is right.
        solved: Whether only exit status 0 is right.
        earlier: Whether the output folder has an earlier result and files of the user.
        forged: Beginnings of the names of what is no file of the user, although it was there before.
        homeless: Whether HOME is not set.
        killed: Seconds after which a first run is killed; only the second run is judged.
    """

    words: list[str]
    about: str
    refused: bool = False
    solved: bool = False
    earlier: bool = False
    forged: tuple[str, ...] = ()
    homeless: bool = False
    killed: float | None = None


@dataclass(frozen=True)
class Valid:
    """Valid results from which some inputs are made.

    Attributes:
        shape: Results folder of a named shape.
        file: Results folder of a mesh file with names for its parts; the file and the case are beside it.
        seconds: How long both took together.
    """

    shape: Path
    file: Path
    seconds: float


type Damage = Callable[[random.Random, bytes], bytes]


def flipped(rng: random.Random, data: bytes) -> bytes:
    """Change some bits of some bytes."""
    changed = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 8, 64])):
        if changed:
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def respliced(rng: random.Random, data: bytes) -> bytes:
    """Remove a piece or the rest, repeat a piece, or insert random bytes."""
    at, size = rng.randrange(len(data) + 1), rng.choice([1, 4, 8, 100, 5000])
    piece, rest = data[at : at + size], len(data)
    new, skipped = rng.choice([(b"", size), (b"", rest), (2 * piece, size), (rng.randbytes(size), 0)])
    return data[:at] + new + data[at + skipped :]


def renumbered(rng: random.Random, data: bytes) -> bytes:
    """Replace one or two numbers of a text."""
    for _ in range(rng.choice([1, 1, 2])):
        data = _replaced(rng, data, rb"[-+]?\d+(\.\d*)?([eE][-+]?\d+)?", [rng.choice(NUMBERS).encode()])
    return data


def reworded(rng: random.Random, data: bytes) -> bytes:
    """Replace a word of a text by another word, or by one from elsewhere in the text."""
    words = re.findall(rb"[A-Za-z_]+", data)
    return _replaced(rng, data, rb"[A-Za-z_]+", [rng.choice(words or [b""]), rng.choice(WORDS).encode()])


def mixed(rng: random.Random, data: bytes) -> bytes:
    """Exchange two lines of a text, repeat one, or remove one."""
    lines = data.split(b"\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    match rng.randrange(3):
        case 0:
            lines[i], lines[j] = lines[j], lines[i]
        case 1:
            lines.insert(i, lines[j])
        case _:
            del lines[i]
    return b"\n".join(lines)


def _replaced(rng: random.Random, data: bytes, pattern: bytes, new: list[bytes]) -> bytes:
    places = list(re.finditer(pattern, data))
    if not places:
        return data
    place = rng.choice(places)
    return data[: place.start()] + rng.choice(new) + data[place.end() :]


BINARY: tuple[Damage, ...] = (flipped, flipped, respliced, respliced, respliced)
TEXT: tuple[Damage, ...] = (renumbered, renumbered, renumbered, reworded, reworded, mixed, mixed, *BINARY)


def damaged(rng: random.Random, data: bytes, ways: tuple[Damage, ...] = TEXT) -> tuple[bytes, str]:
    """Break bytes in one to three ways; return them and the names of these ways."""
    chosen = rng.choices(ways, k=rng.choice([1, 1, 2, 3]))
    for way in chosen:
        data = way(rng, data)
    return data, "+".join(way.__name__ for way in chosen)


type Array = npt.NDArray[Any]

STRANGE = {"i": [-1, 10**6, 2**31, 2**62, -(2**62), 0], "f": [np.nan, np.inf, 1e308, -1e30, -1e-320, 0]}
"""Whole numbers that refer to nothing, and others that are not finite, huge or tiny."""


def _other_type(rng: random.Random, array: Array) -> Array:
    kind = rng.choice(["f8", "f4", "f2", "c16", "i1", "u8", "?", ">f8", ">i8", "S3", "M8[s]", "V8"])
    try:
        return array.astype(kind)
    except (TypeError, ValueError):
        return np.zeros(array.shape, kind)


def _strange(rng: random.Random, array: Array) -> Array:
    array = array.copy()
    for _ in range(rng.choice([1, 1, 5])):
        array.flat[rng.randrange(array.size)] = rng.choice(STRANGE.get(array.dtype.kind, [0]))
    return array


ARRAYS: dict[str, Callable[[random.Random, Array], Array | None]] = {
    "missing": lambda rng, a: None,
    "narrow": lambda rng, a: a[..., :-1],
    "wide": lambda rng, a: np.concatenate([a, a[..., :1]], axis=-1),
    "pickled": lambda rng, a: np.array([{"a": 1}, None], dtype=object),
    "words": lambda rng, a: np.full(a.shape, "é"),
    "short": lambda rng, a: a[: rng.randrange(len(a))],
    "long": lambda rng, a: np.concatenate([a] * rng.choice([2, 3])),
    "flat": lambda rng, a: rng.choice([a.ravel(), a.T, a[None], np.float64(1.0), a[..., None]]),
    "equal": lambda rng, a: np.broadcast_to(a[:1], a.shape).copy(),
    "of another type": _other_type,
    "strange": _strange,
    "scaled": lambda rng, a: a * rng.choice([0, -1, 5, 1e-200, 1e160, 1e300]),
    "moved": lambda rng, a: a + rng.choice([-5, 0.5, 1e8, 1e16, 2**40]),
    "shuffled": lambda rng, a: a[rng.sample(range(len(a)), len(a))],
}
"""Ways to change an array that is not empty; None if it is gone."""
REFUSED = ("missing", "narrow", "wide", "pickled", "words")
"""Ways that nobody who needs the array may accept."""


def changed(rng: random.Random, array: Array) -> tuple[Array | None, str]:
    """Change an array in one of the ways; return it and the name of the way."""
    way = rng.choice(list(ARRAYS))
    with np.errstate(all="ignore"):
        return ARRAYS[way](rng, array) if array.ndim and array.size else array, way


JUNK: tuple[Any, ...] = (
    None, True, 0, -1, 3, 1e308, float("nan"), float("inf"), 10**400, "", "x", "\0", "é" * 300, [], [[]], {}, [None],
    {"a": {"b": []}}, ["top"], ["top", "bottom", "nowhere"], "square", "2", 2.5, [[0.5]], "2^-1000", "..", "a\0b",
)  # fmt: skip
NO_TREE = ("[" * 100_000, '{"a":' * 100_000, "null", "[]", "{", "9" * 5000)


def changed_json(rng: random.Random, text: str) -> tuple[str, str]:
    """JSON with something else in one place, or no valid JSON at all; and what was done, empty in the second case."""
    if rng.random() < 0.2:
        return rng.choice(NO_TREE), ""
    tree = json.loads(text)
    place = rng.choice(_places(tree))
    inner = tree
    for key in place[:-1]:
        inner = inner[key]
    if rng.random() < 0.25:
        del inner[place[-1]]
    else:
        inner[place[-1]] = rng.choice(JUNK)
    return json.dumps(tree), "/".join(map(str, place))


def _places(tree: Any, prefix: tuple = ()) -> list[tuple]:
    """Paths of all entries of nested lists and dictionaries."""
    pairs = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else []
    return [place for key, value in pairs for place in [(*prefix, key), *_places(value, (*prefix, key))]]


ODD: dict[str, Callable[[Path], object]] = {
    "missing": lambda path: None,
    "empty": Path.touch,
    "folder": Path.mkdir,
    "pipe": os.mkfifo,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "loop": lambda path: path.symlink_to(path.name),
    "link": lambda path: path.symlink_to("../home/.profile"),
    "large": lambda path: path.write_bytes(b"# \n" * 4_000_000),
}
"""What may lie in the place of a file."""


def make_odd(rng: random.Random, path: Path) -> str:
    """Put something odd in the place of a file or folder; return what it is."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    way = rng.choice(list(ODD))
    ODD[way](path)
    return f"{path.name}: {way}"


FILES = (".petscrc", "petscrc", "dolfinx_jit_options.json", "ffcx_options.json")
CONFIGURATIONS = (
    "-ksp_type nonsense\n", "-help\n", "-ksp_max_it 1 -ksp_type cg -pc_type none\n-snes_atol 1\n", "[", "[]", "{}",
    '{"cffi_extra_compile_args": "-O0"}', '{"scalar_type": "complex128"}', '{"timeout": "x"}', "\0", "é" * 400,
    '{"sum_factorization": true, "table_atol": 10.0, "table_rtol": 10.0}',
)  # fmt: skip


def put_configuration(rng: random.Random, folder: Path) -> None:
    """Put a file of PETSc's or DOLFINx's options into the current folder, which counts only with --local-options."""
    path = folder / rng.choice(FILES)
    if rng.random() < 0.35:
        make_odd(rng, path)
    else:
        path.write_text(rng.choice(CONFIGURATIONS), encoding="utf-8")
