"""Makes notebooks for Jupyter of the tutorials: text and code of each page, with the files that it shows.

Usage: uv run python scripts/notebooks.py [FOLDER]      (default: notebooks)
       uv run --group notebook jupyter lab notebooks

The build of the documentation makes them too, and each tutorial has a link to its own.
"""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PAGES = Path(__file__).parents[1] / "docs" / "tutorials"
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


def make(folder: Path) -> list[Path]:
    """Write the notebooks of all tutorials into a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    made = []
    for page in sorted(PAGES.glob("*.md")):
        made.append(folder / f"{page.stem}.ipynb")
        made[-1].write_text(json.dumps(notebook(page), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return made


if __name__ == "__main__":
    for path in make(Path(*sys.argv[1:2] or ["notebooks"])):
        print(path)
