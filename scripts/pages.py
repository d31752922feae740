"""Makes again what pages of the documentation show: the reference atlas, the pictures of the gallery, and notebooks.

    uv run python scripts/pages.py atlas [PROBLEM …]
    uv run python scripts/pages.py gallery [CASE …]
    uv run python scripts/pages.py notebooks [FOLDER]

`atlas` runs the commands of data/atlas/atlas.csv, those of some problems or all, writes what they find into it, and
prints the table of docs/measured/atlas.md. A row has a problem, a quantity, its interval, whether that is guaranteed,
the unknowns of the last mesh, and the command that finds them. The ends are rounded outwards to a hundredth of the
length.

`gallery` draws the pictures of docs/gallery.md: u of some shipped cases on a coarse mesh, in small files. Of some cases
there is the whole `overview.png`, too. Without a case it draws all, the strip of the README, and the end of an adaptive
run with fluxes of order two.

`notebooks` makes notebooks for Jupyter of the tutorials, by default in `notebooks`: text and code of each page, with
the files that it shows. The build of the documentation makes them too, and each tutorial has a link to its own.
"""

import csv
import json
import math
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from PIL import Image

from signorini_fenicsx.base.shipped import case_names
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.pictures import style

ROOT = Path(__file__).parents[1]


def signorini(*words: str) -> None:
    """Run the program.

    Raises:
        subprocess.CalledProcessError: If it fails.
    """
    subprocess.run([str(Path(sys.executable).with_name("signorini")), *words, "--quiet"], check=True)


ATLAS = ROOT / "data" / "atlas" / "atlas.csv"


def read_atlas() -> list[dict[str, str]]:
    """The rows of the atlas."""
    with ATLAS.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write_atlas(rows: Sequence[dict[str, str]]) -> None:
    """Write the atlas."""
    with ATLAS.open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def rounded(lower: float, upper: float) -> tuple[str, str]:
    """The ends of an interval as decimals, rounded outwards to a hundredth of its length."""
    unit = Decimal(1).scaleb(math.floor(math.log10(upper - lower)) - 2)
    return str(Decimal(lower).quantize(unit, ROUND_FLOOR)), str(Decimal(upper).quantize(unit, ROUND_CEILING))


def rerun(row: dict[str, str], *options: str) -> dict[str, str]:
    """The row as its command finds it, with more options.

    Raises:
        subprocess.CalledProcessError: If the command fails.
    """
    _, *arguments = shlex.split(row["command"])
    with TemporaryDirectory() as folder:
        signorini(*arguments, *options, "--output", f"{folder}/found")
        summary = json.loads(Path(folder, "found", "summary.json").read_text(encoding="utf-8"))
    interval = summary["quantities"][row["quantity"]]
    lower, upper = rounded(interval["lower"], interval["upper"])
    guaranteed = "yes" if interval["guaranteed"] else "no"
    return row | {"lower": lower, "upper": upper, "guaranteed": guaranteed, "unknowns": str(summary["dofs"])}


def line(row: dict[str, str]) -> str:
    """The row in the table of the documentation."""
    sure = "" if row["guaranteed"] == "yes" else ", not guaranteed"
    return f"| {row['problem']} | {row['quantity']} | [{row['lower']}, {row['upper']}]{sure} | {row['unknowns']} |"


def atlas(names: Sequence[str]) -> None:
    """Run the commands of some problems, of all for none."""
    rows = read_atlas()
    unknown = set(names) - {row["problem"] for row in rows}
    if unknown:
        sys.exit(f"error: the atlas has no problem {', '.join(sorted(unknown))}")
    for number, row in enumerate(rows):
        if not names or row["problem"] in names:
            rows[number] = rerun(row)
            write_atlas(rows)
        sys.stdout.write(f"{line(rows[number])}\n")
        sys.stdout.flush()


GALLERY = ROOT / "docs" / "static" / "gallery"
CELLS_ACROSS = {2: 64, 3: 16}
"""The diameter of a shape divided by h."""
WIDTH, HIGHEST, SHARE = 900, 1400, 0.6
"""Pixels, and the share of those drawn that wide pictures have."""
FIRST = ("water", "deformed", "flow", "u")
"""Which picture is kept: the first one that there is."""
AS_SHIPPED = {"vauclin": "phreatic"}
"""Which picture is kept of cases that are drawn on their own mesh, as they are compared with measurements."""
WITH_OVERVIEW = ("example2", "dam", "electropainting", "two_obstacles")
STRIP = {
    "example2": (0.0715, 0.4158, 0.4145, 0.0724),
    "dam": (0.105, 1.2065, 0.87, 0.9373),
    "hertz": (0.165, 0.8727, 0.81, 0.1534),
    "ball": (0.062, 0.4046, 0.395, 0.0739),
}
"""Pictures of the strip, and which part of each, inside its axes: left, upper, right and lower edge.

They are from the left and from below, relative to the width, as lines of a title add to the height.
"""
STRIP_HEIGHT, GAP = 260, 20


def draw(name: str) -> None:
    """Solve one case and keep the picture of u, of an elastic one that of the body, in time over it if it can be."""
    case, size = load_case(name), list[str]()
    if case.geometry.shape is not None and name not in AS_SHIPPED:
        shape = shape_of(case.geometry.shape)
        if shape.dim == 2 or not case.is_vector:  # a vector in space takes too long
            size = ["--h", str(shape.diameter / CELLS_ACROSS[shape.dim])]
    with TemporaryDirectory() as folder:
        solved = end = Path(folder, "solved")
        signorini("solve", name, *size, "--plot", "--output", str(solved))
        over_time = [AS_SHIPPED[name]] if name in AS_SHIPPED else []
        if case.time is not None:
            over_time = over_time or ([] if getattr(case, "soil", None) else ["contact", "steps"])
            end = Path(folder, "end")
            signorini("export", str(solved), "--plot", "--output", str(end))
        pictures = [*(solved / f"{kind}.png" for kind in over_time), *(end / f"{kind}.png" for kind in FIRST)]
        drawn = Image.open(next(each for each in pictures if each.exists()))
        width = max(WIDTH, round(SHARE * drawn.width))
        save(drawn, GALLERY / f"{name}.png", min(width, round(HIGHEST * drawn.width / drawn.height)))
        if name in WITH_OVERVIEW:
            save(Image.open(end / "overview.png"), GALLERY / f"{name}_overview.png", 2 * WIDTH)


def save(picture: Image.Image, path: Path, width: int) -> None:
    """Write a picture with this width in few colours, among them those of sets: maps of u stay smooth."""
    size = (width, round(picture.height * width / picture.width))
    small = picture.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    sets = "".join(colour[1:] for colour in (style.CONTACT, style.FREE, *style.SEGMENTS, "#ffffff"))
    most = 256 - len(sets) // 6
    palette = small.quantize(most, Image.Quantize.MEDIANCUT, kmeans=2).getpalette() or []
    of_sets = Image.new("P", (1, 1))
    of_sets.putpalette([*palette[: 3 * most], *bytes.fromhex(sets)])
    few = small.quantize(palette=of_sets, dither=Image.Dither.NONE)
    few.paste(255, mask=Image.fromarray(np.all(np.asarray(small) == 255, axis=2)))  # which Pillow may have tinted
    few.save(path, optimize=True)


def draw_adapted() -> None:
    """Refine example5 until one per cent is certified, and keep the whole picture at the end."""
    with TemporaryDirectory() as folder:
        signorini("adapt", "example5", "--target", "0.01", "--plot", "--output", f"{folder}/adapted")
        save(Image.open(Path(folder, "adapted", "overview.png")), GALLERY / "order_two_overview.png", 2 * WIDTH)


def draw_strip() -> None:
    """Put the main panels of four pictures of the gallery side by side."""
    panels = []
    for name, (left, upper, right, lower) in STRIP.items():
        picture = Image.open(GALLERY / f"{name}.png").convert("RGB")
        corners = np.array([[left, -upper], [right, -lower]]) * picture.width + [0, picture.height]
        panel = picture.crop(corners.round().astype(int).ravel().tolist())
        panels.append(panel.resize((round(panel.width * STRIP_HEIGHT / panel.height), STRIP_HEIGHT)))
    strip = Image.new("RGB", (sum(panel.width + GAP for panel in panels), STRIP_HEIGHT), "white")
    across = 0
    for panel in panels:
        strip.paste(panel, (across, 0))
        across += panel.width + GAP
    strip.save(GALLERY.parent / "strip.png", optimize=True)


def gallery(names: Sequence[str]) -> None:
    """Draw some cases; for none all, the strip and the adaptive run."""
    for name in names or case_names():
        draw(name)
    if not names:
        draw_strip()
        draw_adapted()


PAGES = ROOT / "docs" / "tutorials"
BLOCK = re.compile(r"^```\{([\w-]+)\}([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
OPTIONS = re.compile(r"\A(:[\w-]+:[^\n]*\n)+")
HEAD = re.compile(r"\A---\n.*?\n---\n", re.DOTALL)
LINK = re.compile(r"!\[[^\]]*\]\(\.\.[^)]*\)|\[([^\]]*)\]\([^)\s]*\.md[^)\s]*\)")
"""A link to another page, and a picture of the gallery, which a notebook alone has not beside it."""


def cells(page: Path) -> Iterator[tuple[str, str]]:
    """The kind of each cell of a page, "markdown" or "code", and its text."""
    text, at = HEAD.sub("", page.read_text(encoding="utf-8")), 0
    for block in BLOCK.finditer(text):
        yield from _words(text[at : block.start()])
        at, (kind, argument, body) = block.end(), block.groups()
        if kind == "code-cell":
            yield "code", OPTIONS.sub("", body).strip("\n")
        elif kind == "literalinclude":
            shown = (page.parent / argument.strip()).resolve()
            yield "markdown", f"`{shown.name}`:\n\n```\n{shown.read_text(encoding='utf-8').rstrip()}\n```"
        else:
            raise ValueError(f"{page}: a notebook has no '{kind}'")
    yield from _words(text[at:])


def _words(text: str) -> Iterator[tuple[str, str]]:
    if text.strip():
        yield "markdown", LINK.sub(lambda link: link[1] or "", text).strip()


def notebook(page: Path) -> dict[str, Any]:
    """The notebook of a page, ready for JSON, in Jupyter's format 4.5."""
    made = []
    for number, (kind, text) in enumerate(cells(page)):
        cell = {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": text.splitlines(keepends=True)}
        made.append(cell | ({"execution_count": None, "outputs": []} if kind == "code" else {}))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def notebooks(folder: Path) -> list[Path]:
    """Write the notebooks of all tutorials into a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    made = []
    for page in sorted(PAGES.glob("*.md")):
        made.append(folder / f"{page.stem}.ipynb")
        made[-1].write_text(json.dumps(notebook(page), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return made


COMMANDS: dict[str, Callable[[Sequence[str]], None]] = {
    "atlas": atlas,
    "gallery": gallery,
    "notebooks": lambda names: print(*notebooks(Path(*names[:1] or ["notebooks"])), sep="\n"),
}

if __name__ == "__main__":
    what, *names = sys.argv[1:] or [""]
    if what not in COMMANDS:
        sys.exit(__doc__)
    COMMANDS[what](names)
