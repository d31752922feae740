"""Abaqus files, `.inp`: what meshio leaves of them, which are other names of elements, and surfaces."""

import io
import re
from collections.abc import Iterator
from pathlib import Path

import meshio
import numpy as np

from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.contents import SECOND
from signorini_fenicsx.meshes.other_cells import simplices_of

LIKE = {
    "CPS3": "CPS3|CPE3|CAX3|CGAX3|DC2D3|DCAX3|AC2D3|M3D3|SFM3D3",
    "STRI65": "CPS6|CPE6|CAX6|CGAX6|DC2D6|DCAX6|AC2D6|M3D6|SFM3D6",
    "CPS4": "CPS4|CPE4|CAX4|CGAX4|DC2D4|DCAX4|AC2D4|M3D4|SFM3D4",
    "C3D4": "C3D4|DC3D4|AC3D4",
    "C3D6": "C3D6|DC3D6|AC3D6",
    "C3D8": "C3D8|DC3D8|AC3D8",
    "C3D10": "C3D10|DC3D10|AC3D10",
}
"""An element that meshio knows, and others with the same points; letters may follow their names."""
SIDES: dict[str, list[tuple[int, ...]]] = {
    "triangle": [(0, 1), (1, 2), (2, 0)],
    "quad": [(0, 1), (1, 2), (2, 3), (3, 0)],
    "tetra": [(0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)],
    "wedge": [(0, 1, 2), (3, 5, 4), (0, 3, 4, 1), (1, 4, 5, 2), (2, 5, 3, 0)],
    "hexahedron": [(0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)],
}
"""The corners of the faces S1, S2, … of an element."""
FLAGS = re.MULTILINE | re.IGNORECASE
type Lines = list[list[str]]


def read_abaqus(path: Path) -> tuple[meshio.Mesh, dict[str, Indices]]:
    """Read a file (rank 0).

    Returns:
        The mesh as meshio has it, and the facets of each surface by their corners.

    Raises:
        InputError: If it needs another file, or a surface is on elements that there are not.
    """
    text = path.read_text(encoding="utf-8", errors="replace")
    if re.search(r"^\s*\*INCLUDE", text, flags=FLAGS):
        raise InputError("needs another file, by *INCLUDE; write all into one file")
    for known, others in LIKE.items():
        text = re.sub(rf"^(\*ELEMENT\b.*TYPE\s*=\s*)({others})[A-Z]*(?=\s*(,|$))", rf"\g<1>{known}", text, flags=FLAGS)
    mesh = meshio.read(io.StringIO(text), file_format="abaqus")
    return mesh, dict(_surfaces(mesh, text))


def _blocks(text: str, keyword: str) -> Iterator[tuple[dict[str, str], Lines]]:
    """The options, in capital letters, and the entries of each line of all blocks with a keyword."""
    for block in re.split(r"^(?=\*(?!\*))", text, flags=re.MULTILINE):
        head, *lines = [line for line in block.splitlines() if line.strip() and not line.startswith("**")] or [""]
        word, *options = (part.strip() for part in head.split(","))
        if word.upper() == f"*{keyword}":
            pairs = (option.partition("=") for option in options)
            entries = [[entry.strip() for entry in line.rstrip(", ").split(",")] for line in lines]
            yield {key.strip().upper(): value.strip() for key, _, value in pairs}, entries


def _surfaces(mesh: meshio.Mesh, text: str) -> Iterator[tuple[str, Indices]]:
    """The facets of each surface that consists of faces of elements."""
    surfaces, labels = list(_blocks(text, "SURFACE")), []
    if not surfaces:
        return
    for block, (_, lines) in zip(mesh.cells, _blocks(text, "ELEMENT"), strict=True):
        numbers = np.array([int(entry) for line in lines for entry in line], dtype=np.int64)
        labels.append(numbers.reshape(len(block.data), -1)[:, 0])
    for options, lines in surfaces:
        if options.get("TYPE", "ELEMENT").upper() != "ELEMENT":
            continue
        name, found = options.get("NAME", "surface"), list[Indices]()
        for of, side in (line[:2] for line in lines if len(line) > 1 and re.fullmatch(r"[sS]\d", line[1])):
            chosen = list(_chosen(mesh, labels, of))
            if not any(len(rows) for _, rows in chosen):
                raise InputError(f"surface '{name}' is on elements that there are not: {of}")
            for index, rows in chosen:
                block, number = mesh.cells[index], int(side[1])
                sides = SIDES.get(SECOND.get(block.type, block.type), [])
                if len(rows) and 0 < number <= len(sides):
                    facets = np.asarray(block.data, dtype=np.int64)[rows][:, list(sides[number - 1])]
                    found.append(simplices_of("quad", facets).reshape(-1, 3) if facets.shape[1] == 4 else facets)
        if found:
            yield name, np.concatenate(found)


def _chosen(mesh: meshio.Mesh, labels: list[Indices], of: str) -> Iterator[tuple[int, Indices]]:
    """The rows in each block of an element, or of a set of elements."""
    if of.isdecimal():
        yield from ((index, np.flatnonzero(own == int(of))) for index, own in enumerate(labels))
    for index, rows in enumerate(mesh.cell_sets.get(of, ())):
        yield index, np.asarray(rows, dtype=np.int64)
