"""Reads Exodus II, the files of Cubit and MOOSE: blocks of elements, sets of nodes and of sides, values at points.

Such a file is netCDF, the classic kind or HDF5. Sides of elements have numbers from 1, as Exodus' manual has them; the
sides 1 and 2 of a shell are its two faces, those of its edges follow.
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.contents import DIMENSION, SECOND
from signorini_fenicsx.meshes.other_cells import simplices_of

ENDINGS = (".e", ".exo", ".ex2", ".g", ".gen")
"""Of its files."""
FAMILIES = {
    "TRI TRIANGLE TRISHELL": {3: "triangle", 6: "triangle6"},
    "QUAD SHELL": {3: "triangle", 4: "quad", 6: "triangle6"},
    "TET TETRA": {4: "tetra", 10: "tetra10"},
    "HEX HEXAHEDRON": {8: "hexahedron"},
    "WEDGE PRISM": {6: "wedge"},
    "PYRAMID PYRA": {5: "pyramid"},
    "BEAM BAR TRUSS EDGE": {2: "line", 3: "line3"},
    "SPHERE POINT": {1: "vertex"},
}
KINDS = {word: kinds for words, kinds in FAMILIES.items() for word in words.split()}
"""meshio's kinds by the beginning of Exodus' names and the number of points; others are refused by their names."""
SIDES: dict[str, list[tuple[int, ...]]] = {
    "triangle": [(0, 1), (1, 2), (2, 0)],
    "quad": [(0, 1), (1, 2), (2, 3), (3, 0)],
    "tetra": [(0, 1, 3), (1, 2, 3), (0, 3, 2), (0, 2, 1)],
    "wedge": [(0, 1, 4, 3), (1, 2, 5, 4), (0, 3, 5, 2), (0, 2, 1), (3, 4, 5)],
    "pyramid": [(0, 1, 4), (1, 2, 4), (2, 3, 4), (0, 4, 3), (0, 3, 2, 1)],
    "hexahedron": [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (0, 4, 7, 3), (0, 3, 2, 1), (4, 5, 6, 7)],
}
"""The corners of the sides 1, 2, … of an element."""
USED = ("connect", "coord", "eb_", "ns_", "ss_", "node_ns", "elem_ss", "side_ss", "name_nod_var", "vals_nod_var")
"""What the names of variables begin with that are read."""
SHELLS = ("SHELL", "TRISHELL")
"""Elements whose edges are the sides from 3 on; so are those of triangles in space."""


def read_exodus(path: Path) -> tuple[meshio.Mesh, dict[str, Indices]]:
    """Read a file (rank 0).

    Returns:
        The mesh with its blocks as sets of cells, and the facets of each set of sides by their corners.

    Raises:
        InputError: If it is of another kind, or a set is on elements that there are not.
    """
    with path.open("rb") as file:
        head = file.read(4)
    if head == b"\x89HDF":
        with h5py.File(path) as data:
            types = {name: _text(each.attrs.get("elem_type", b"")) for name, each in data.items()}
            return _mesh({name: np.asarray(data[name]) for name in data if name.startswith(USED)}, types)
    if head not in (b"CDF\x01", b"CDF\x02"):
        raise InputError("is no Exodus file of netCDF-3 or netCDF-4; `nccopy -k netCDF-4` makes one of other kinds")
    from scipy.io import netcdf_file  # slow to import

    with netcdf_file(path, mmap=False) as data:
        types = {name: _text(getattr(each, "elem_type", b"")) for name, each in data.variables.items()}
        return _mesh({name: np.array(data.variables[name].data) for name in types if name.startswith(USED)}, types)


def _text(value: Any) -> str:
    """A name of the file: a text, or characters."""
    if isinstance(value, np.ndarray):
        value = b"".join(value.astype("S1").ravel().tolist())
    words = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    return words.partition("\0")[0].strip()


def _mesh(data: Mapping[str, npt.NDArray[Any]], types: Mapping[str, str]) -> tuple[meshio.Mesh, dict[str, Indices]]:
    """The mesh and its sets of sides from the variables of a file, and the types of its blocks."""
    number = len([name for name in data if re.fullmatch(r"connect\d+", name)])
    blocks, shells = [], []
    points = (
        data["coord"].T if "coord" in data else np.stack([data[f"coord{x}"] for x in "xyz" if f"coord{x}" in data], 1)
    )
    for name in (f"connect{i}" for i in range(1, number + 1)):
        elements, word = np.asarray(data[name], dtype=np.int64) - 1, re.sub(r"\d+$", "", types[name].upper())
        blocks.append((KINDS.get(word, {}).get(elements.shape[1], types[name].lower()), elements))
        shells.append(word in SHELLS or (word in ("TRI", "TRIANGLE") and points.shape[1] == 3))
    cell_sets = {
        name: [
            np.arange(len(rows)) if i == block else np.empty(0, dtype=np.int64) for i, (_, rows) in enumerate(blocks)
        ]
        for block, name in enumerate(_names(data, "eb", number))
    }
    point_sets = {name: found - 1 for name, found in _sets(data, "ns", "node_ns")}
    mesh = meshio.Mesh(
        np.asarray(points, dtype=np.float64),
        blocks,
        point_data=_values(data),
        point_sets=point_sets,
        cell_sets=cell_sets,
    )
    sides = zip(_sets(data, "ss", "elem_ss"), _sets(data, "ss", "side_ss"), strict=True)
    facets = {name: _facets(name, blocks, shells, of - 1, side - 1) for (name, of), (_, side) in sides}
    return mesh, {name: found for name, found in facets.items() if len(found)}


def _names(data: Mapping[str, npt.NDArray[Any]], kind: str, number: int) -> list[str]:
    """The names of the blocks or sets of a kind, their numbers where they have none."""
    given = [_text(row) for row in data.get(f"{kind}_names", ())]
    ids = data.get(f"{kind}_prop1", np.arange(1, number + 1))
    return [name or str(int(own)) for name, own in zip((given + [""] * number)[:number], ids, strict=False)]


def _sets(data: Mapping[str, npt.NDArray[Any]], kind: str, key: str) -> Iterator[tuple[str, Indices]]:
    """The names of the sets of a kind that are not empty, and one of their arrays."""
    names = _names(data, kind, len(data.get(f"{kind}_prop1", data.get(f"{kind}_status", ()))))
    for i, name in enumerate(names, start=1):
        if f"{key}{i}" in data:
            yield name, np.asarray(data[f"{key}{i}"], dtype=np.int64)


def _facets(name: str, blocks: list[tuple[str, Indices]], shells: list[bool], of: Indices, side: Indices) -> Indices:
    """The facets of the mesh among the sides of elements, by their corners; both are counted from 0."""
    ends = np.cumsum([len(elements) for _, elements in blocks])
    if len(of) and (of.min() < 0 or of.max() >= ends[-1]):
        raise InputError(f"set of sides '{name}' is on elements that there are not")
    top, found = max(DIMENSION.get(kind, 0) for kind, _ in blocks), []
    for (kind, elements), is_shell, end in zip(blocks, shells, ends, strict=True):
        mine = (of >= end - len(elements)) & (of < end)
        corners = SIDES.get(SECOND.get(kind, kind), [])
        whole = [tuple(range(len(corners)))] * 2 if is_shell else []
        for number, places in enumerate([*whole, *corners]):
            rows = of[mine & (side == number)] - (end - len(elements))
            dim = 1 if len(places) == 2 else 2
            if len(rows) and dim == top - 1:
                some = elements[rows][:, list(places)]
                found.append(simplices_of("quad", some).reshape(-1, 3) if len(places) == 4 else some)
    return np.concatenate(found) if found else np.empty((0, top), dtype=np.int64)


def _values(data: Mapping[str, npt.NDArray[Any]]) -> dict[str, Array]:
    """Values at the points at the last time; those whose names end in x, y and z are one vector."""
    names, found = [_text(row) for row in data.get("name_nod_var", ())], dict[str, Array]()
    for i, name in enumerate(names, start=1):
        if (values := data.get(f"vals_nod_var{i}")) is not None and len(values):
            found[name] = np.asarray(values[-1], dtype=np.float64)
    for name in [name for name in found if name.lower().endswith("x")]:
        vector = [other for axis in ("x", "y", "z") if (other := name[:-1] + _like(axis, name[-1])) in found]
        if len(vector) > 1:
            found[name[:-1].rstrip("_")] = np.stack([found.pop(other) for other in vector], axis=1)
    return found


def _like(axis: str, letter: str) -> str:
    """The name of an axis as large as a letter."""
    return axis.upper() if letter.isupper() else axis
