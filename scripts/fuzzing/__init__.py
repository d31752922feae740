"""Broken inputs of all kinds, the processes that run them, and the judge of the results.

Here are the type of a broken input, and ways to break bytes and text that all kinds share.
"""

import random
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "tests"))  # the folder of `broken_input`

OUTPUT = "out"
"""Folder for the results of every command."""
CASE = """[geometry]
file = "{file}"
[boundary]
signorini = ["{part}"]
[problem]
f = "10*(x - 0.4)"
"""
"""A case with a mesh file."""

NUMBERS = (
    "0", "-1", "1", "3", "7", "2147483648", "-9223372036854775809", "1e308", "-1e308", "1e-308", "1e999", "nan",
    "inf", "-inf", "9" * 25, "9" * 5000, "0x" + "f" * 400, "1e", "--1", "1,5", "1_0", "0.1.2", "٣", "1e-9", "0.25",
    "1/0",
)  # fmt: skip
WORDS = (
    "", " ", "\0", "\n", "\r\n", "\t", "é", "\u202e", "\ufeff", "🦆", "'", '"', "\\", "{", "}", "[", "]", "(", ")",
    "<", ">", "&", ";", "/*", "*/", "//", "#", "%s%n", "../../home/.profile", "/dev/zero", "/dev/stdin", "$HOME",
    "`id`", "true", "None", "A" * 3000, "(" * 600, "[" * 3000, "__import__('os')",
)  # fmt: skip


@dataclass
class Broken:
    """One input: the arguments of the program, whose files are in the working folder.

    Attributes:
        words: The arguments after `signorini`.
        about: How it was broken, in words.
        refused: Whether only exit status 2 is right.
        earlier: Whether the output folder has an earlier result and files of the user.
        bounded: Whether a guaranteed bound must be of the size of the solution.
        solved: Whether only exit status 0 is right.
        flux: ‖σ‖ of the exact solution in L², where κ ≤ 1; None if it is not known.
        at_least: Whether `flux` is a lower bound.
        contact: The measure of contact; None if it is not known.
        values: Exact values of some quantities, by name.
        shown: Names of quantities whose values are in the tables: `flux` and `p` over the part in the table of the
            facets, `resultant` along x on the part `right`.
        forged: Beginnings of the names of what is no file of the user, although it was there before.
        homeless: Whether HOME is not set.
    """

    words: list[str]
    about: str
    refused: bool = False
    earlier: bool = False
    bounded: bool = False
    solved: bool = False
    flux: float | None = None
    at_least: bool = False
    contact: float | None = None
    values: dict[str, float] = field(default_factory=dict)
    shown: list[str] = field(default_factory=list)
    forged: tuple[str, ...] = ()
    homeless: bool = False


@dataclass(frozen=True)
class Valid:
    """Valid results from which some inputs are made.

    Attributes:
        shape: Results folder of a named shape.
        file: Results folder of a mesh file with names for its parts.
        opened: Results folder of an elastic body on a named shape, without contact.
        pencil: A folder for files that generators make only once.
    """

    shape: Path
    file: Path
    opened: Path
    pencil: Path


type Damage = Callable[[random.Random, bytes], bytes]


def flipped(rng: random.Random, data: bytes) -> bytes:
    """Change some bits of some bytes."""
    changed = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 8, 64])):
        if changed:
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def cut(rng: random.Random, data: bytes) -> bytes:
    """Remove the end."""
    return data[: rng.randrange(len(data) + 1)]


def dropped(rng: random.Random, data: bytes) -> bytes:
    """Remove a piece."""
    at = rng.randrange(len(data) + 1)
    return data[:at] + data[at + rng.choice([1, 4, 8, 100]) :]


def doubled(rng: random.Random, data: bytes) -> bytes:
    """Repeat a piece."""
    at, size = rng.randrange(len(data) + 1), rng.choice([1, 8, 100, 5000])
    return data[: at + size] + data[at : at + size] + data[at + size :]


def noisy(rng: random.Random, data: bytes) -> bytes:
    """Insert random bytes."""
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.randbytes(rng.choice([1, 4, 40, 400])) + data[at:]


def renumbered(rng: random.Random, data: bytes) -> bytes:
    """Replace one or two numbers of a text."""
    for _ in range(rng.choice([1, 1, 2])):
        numbers = list(re.finditer(rb"[-+]?\d+(\.\d*)?([eE][-+]?\d+)?", data))
        if numbers:
            data = _with(data, rng.choice(numbers), rng.choice(NUMBERS).encode())
    return data


def reworded(rng: random.Random, data: bytes) -> bytes:
    """Replace a word of a text by another word, or by one from elsewhere in the text."""
    words = list(re.finditer(rb"[A-Za-z_]+", data))
    if not words:
        return data
    word = rng.choice([rng.choice(words)[0], rng.choice(WORDS).encode()])
    return _with(data, rng.choice(words), word)


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


def _with(data: bytes, place: re.Match[bytes], new: bytes) -> bytes:
    return data[: place.start()] + new + data[place.end() :]


BINARY: tuple[Damage, ...] = (flipped, flipped, cut, dropped, doubled, noisy)
TEXT: tuple[Damage, ...] = (renumbered, renumbered, renumbered, reworded, reworded, mixed, mixed, *BINARY)


def damaged(rng: random.Random, data: bytes, ways: tuple[Damage, ...] = TEXT) -> tuple[bytes, str]:
    """Break bytes in one to three ways; return them and the names of these ways."""
    chosen = rng.choices(ways, k=rng.choice([1, 1, 2, 3]))
    for way in chosen:
        data = way(rng, data)
    return data, "+".join(way.__name__ for way in chosen)
