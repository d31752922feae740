"""Squares that are cut by several lines, and cubes cut by a plane, as mesh files."""

import os
from pathlib import Path

import meshio
import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.meshes.checks import faces
from signorini_fenicsx.meshes.grids import Share, rectangle_grid, tetrahedron_grid
from signorini_fenicsx.physics.diffusion.case import Case

type Lines = dict[str, tuple[int, float, float]]

LINES: Lines = {"fault": (1, 0, 1), "cross": (0, 0, 1)}
"""Inner parts: the axis whose coordinate is 1/2, and from where to where."""


def crossed_square(folder: Path, n: int, text: str, lines: Lines | None = None) -> Case:
    """A case on a square of n × n squares cut in halves, by the text of its file without geometry and sides."""
    points, cells = rectangle_grid(np.zeros(2), np.ones(2), 2**0.5 / n, "right", Share())
    edges = np.unique(faces(cells), axis=0)
    x = points[edges]
    names = {"left": (0, 0.0), "right": (0, 1.0), "bottom": (1, 0.0), "top": (1, 1.0)}
    parts = {name: edges[(x[:, :, axis] == at).all(axis=1)] for name, (axis, at) in names.items()}
    below = parts["bottom"]
    parts["floor"] = below[points[below].mean(axis=1)[:, 0] > 0.5]  # half of the bottom
    parts["bottom"] = below[points[below].mean(axis=1)[:, 0] < 0.5]
    lines = LINES if lines is None else lines
    for name, (axis, begin, end) in lines.items():
        along = x[:, :, 1 - axis]
        on = (x[:, :, axis] == 0.5) & (along > begin - 1e-9) & (along < end + 1e-9)
        parts[name] = edges[on.all(axis=1)]
    sides = {name: [1 - axis, axis] for name, (axis, *_) in lines.items()}
    return _case(folder / f"{n}", points, cells, parts, text, sides)


def cut_cube(folder: Path, n: int, text: str) -> Case:
    """A case on a cube of n³ cubes with "fault", z = 1/2, by the text of its file without geometry and sides."""
    points, cells = tetrahedron_grid(3**0.5 / n, "right", Share())
    facets = np.unique(faces(cells), axis=0)
    fault = facets[(points[facets][:, :, 2] == 0.5).all(axis=1)]
    return _case(folder / f"{n}", points, cells, {"fault": fault}, text, {"fault": [0, 0, 1]})


def _case(
    file: Path, points: Array, cells: Indices, parts: dict[str, Indices], text: str, sides: dict[str, list[int]]
) -> Case:
    kinds = {3: ("line", "triangle"), 4: ("triangle", "tetra")}[cells.shape[1]]
    dim = points.shape[1]
    tags = [np.full(len(part), 2 + number) for number, part in enumerate(parts.values())]
    blocks = [(kinds[1], cells), *((kinds[0], part) for part in parts.values())]
    physical = [np.ones(len(cells), dtype=np.int32), *(tag.astype(np.int32) for tag in tags)]
    known = {name: np.array([2 + number, dim - 1]) for number, name in enumerate(parts)} | {"body": np.array([1, dim])}
    data = {"gmsh:physical": physical, "gmsh:geometrical": physical}
    mesh = meshio.Mesh(points, blocks, cell_data=data, field_data=known)
    written = file.with_suffix(f".{os.getpid()}")  # of this rank: others may read the file while it is written
    meshio.write(written, mesh, file_format="gmsh22", binary=False)
    written.replace(file.with_suffix(".msh"))
    named = ", ".join(f"{name} = {direction}" for name, direction in sides.items())
    path = file.with_suffix(".toml")
    written.write_text(f'[geometry]\nfile = "{file.name}.msh"\n' + text.replace("SIDES", f"sides = {{{named}}}"))
    written.replace(path)
    return load_case(str(path))
