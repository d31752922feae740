"""Meshes from files: Gmsh's `.msh` and `.geo`, XDMF, and what else meshio reads.

All of this runs on rank 0. A file is read into blocks of elements and named groups of them (`Contents`); the cells of
its highest dimension become the mesh, groups of cells its regions, and groups of facets its boundary parts. Groups
without a name go by their number.
"""

import contextlib
import io
import json
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import h5py
import meshio
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.errors import InputError
from signorini_fenicsx.mesh_checks import SIMPLICES, Contents, FileMesh, checked, rows_of

type Array = npt.NDArray[np.float64]
type Indices = npt.NDArray[np.int64]

MAX_CELLS = 10**8
"""More cells than this are taken for a mistake in h."""
FORBIDDEN = (
    *("SystemCall", "NonBlockingSystemCall", "System", "OnelabRun", "OnelabAction", "ExternalProcess", "CommandLine"),
    *("Plugin", "Include", "Merge", "MergeWithBoundingBox", "Open", "ShapeFromFile", "ListFromFile", "GetEnv"),
    *("Save", "Print", "CreateDir", "SetString", "Exit", "Abort", "Sleep"),
)
"""Words of Gmsh's language that run programs, read or write other files, or end the process."""
LITERAL = re.compile(r'"[^"]*"|\'[^\']*\'|/\*.*?\*/|//[^\n]*', re.DOTALL)
LONGEST_STRING = 1000
"""Gmsh ends strings that are somewhat longer than this, and takes the rest for commands."""


def is_geometry(path: str) -> bool:
    """Whether a file describes a geometry, which Gmsh meshes as finely as one likes, and not a mesh."""
    return Path(path).suffix == ".geo"


def read_mesh_file(path: str, h: float | None = None) -> FileMesh:
    """Read a mesh, or let Gmsh make one (rank 0).

    Args:
        path: Of the file.
        h: Largest cell diameter of a mesh that Gmsh makes; the sizes of the `.geo` file without one.

    Raises:
        InputError: If the file cannot be read, or its mesh cannot be computed on.
    """
    place = Path(path)
    if not place.is_file():
        raise InputError(f"mesh {path}: {'is a folder, not a file' if place.is_dir() else 'no such file'}")
    try:
        if place.stat().st_size == 0:
            raise InputError("the file is empty")
        return checked(_read(place, h))
    except InputError as error:
        raise InputError(f"mesh {path}: {error}") from None
    except OSError as error:
        raise InputError(f"mesh {path}: {error.strerror or error}") from None


def _read(path: Path, h: float | None) -> Contents:
    if path.suffix == ".geo":
        _refuse_commands(path.read_bytes())
        return _gmsh(path, h)
    if path.suffix == ".msh":
        with path.open("rb") as file:
            if not file.read(64).lstrip().startswith(b"$MeshFormat"):  # Gmsh would take it for a .geo file
                raise InputError("is not a mesh of Gmsh, which would begin with $MeshFormat")
        return _gmsh(path, None)
    return _meshio(path)


def _refuse_commands(content: bytes) -> None:
    """Refuse a `.geo` file that could do more than describe a geometry: Gmsh itself can be told to refuse nothing."""
    try:
        text = content.decode()
    except UnicodeDecodeError:
        raise InputError("is not a text file") from None
    if "\0" in text:  # Gmsh would end comments there
        raise InputError("is not a text file")
    if any(len(literal[0]) > LONGEST_STRING for literal in LITERAL.finditer(text) if literal[0][0] != "/"):
        raise InputError(f"has a string of more than {LONGEST_STRING} characters, which Gmsh does not take")
    commands = LITERAL.sub(" ", text)
    word = re.search(rf"\b({'|'.join(FORBIDDEN)})\b", commands)
    if word is not None or re.search(r"Printf\s*\([^;]*\)\s*>", commands):
        raise InputError(
            f"'{word[1] if word else 'Printf to a file'}' is not allowed: a .geo file may not run programs, use other "
            "files, or end the program; mesh it with Gmsh and give the .msh file"
        )


def _gmsh(path: Path, h: float | None) -> Contents:
    """Let Gmsh read or mesh a file, in another process, and from a copy: beside it, Gmsh would read its `.opt` file."""
    worker = Path(__file__).with_name("gmsh_worker.py")
    with tempfile.TemporaryDirectory(prefix="signorini-") as folder:
        source, target = Path(folder, "mesh" + path.suffix), Path(folder, "mesh.npz")
        shutil.copyfile(path, source)
        if path.suffix == ".geo":  # else Gmsh ignores a last line that does not end
            with source.open("ab") as file:
                file.write(b"\n")
        command = [sys.executable, "-P", str(worker), str(source), str(target), repr(h or 0.0), repr(float(MAX_CELLS))]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace", check=False)
        if done.returncode != 0:
            words = done.stderr.strip().splitlines()
            reason = words[-1].replace(str(source), path.name) if done.returncode > 0 and words else "it crashed"
            raise InputError(f"Gmsh cannot use it: {reason}")
        with np.load(target, allow_pickle=False) as arrays:
            about = json.loads(str(arrays["about"]))
            blocks = [(kind, arrays[f"block_{i}"].astype(np.int64)) for i, kind in enumerate(about["kinds"])]
            groups = [
                (name, dim, [(block, np.arange(len(blocks[block][1]))) for block in members])
                for dim, name, members in about["groups"]
            ]
            return Contents(arrays["points"], blocks, groups)


def _meshio(path: Path) -> Contents:
    """Read what meshio reads; it complains in many ways about a file that is broken."""
    try:
        with warnings.catch_warnings(action="ignore"), contextlib.redirect_stdout(io.StringIO()):
            if path.suffix == ".xdmf" and (contents := _dolfinx_xdmf(path)) is not None:
                return contents
            with contextlib.redirect_stderr(io.StringIO()) as said:
                mesh = meshio.read(path)
    except SystemExit:
        words = " ".join(said.getvalue().split()).removeprefix("Error: ")
        raise InputError(f"cannot be read: {words or 'its format is not known'}") from None
    except (MemoryError, Exception) as error:
        words = " ".join(str(error).split())
        raise InputError(f"cannot be read ({words[:200] or type(error).__name__})") from None
    blocks = [(block.type, np.asarray(block.data, dtype=np.int64)) for block in mesh.cells]
    groups = [*_numbered(mesh, blocks), *_named(mesh, blocks)]
    return Contents(np.asarray(mesh.points, dtype=np.float64), blocks, groups)


def _numbered(mesh: meshio.Mesh, blocks: list[tuple[str, Indices]]) -> Iterator[tuple[str, int, list]]:
    """Groups by the integers that a file gives its elements, under the names that it has for them."""
    arrays = {
        key: values
        for key, values in mesh.cell_data.items()
        if key != "gmsh:geometrical"
        and all(np.issubdtype(block.dtype, np.integer) and block.ndim == 1 for block in values)
    }
    if not arrays:
        return
    if len(arrays) > 1 and "gmsh:physical" not in arrays:
        raise InputError(f"several arrays could number its parts: {', '.join(arrays)}; keep one of them")
    numbers = arrays.get("gmsh:physical", next(iter(arrays.values())))
    families = getattr(mesh, "cell_tags", {})  # MED: a number may stand for several names
    for dim in (1, 2, 3):
        members: dict[str, list[tuple[int, Indices]]] = {}
        names = {int(tag): [name] for name, (tag, at) in mesh.field_data.items() if at == dim}
        for index, (kind, _) in enumerate(blocks):
            if SIMPLICES.get(kind) == dim:
                for number in np.unique(numbers[index]).tolist():
                    for name in names.get(number) or families.get(number) or [str(number)]:
                        members.setdefault(name, []).append((index, np.flatnonzero(numbers[index] == number)))
        yield from ((name, dim, rows) for name, rows in members.items())


def _named(mesh: meshio.Mesh, blocks: list[tuple[str, Indices]]) -> Iterator[tuple[str, int, list]]:
    """Groups that a file has as sets of elements."""
    for name, members in mesh.cell_sets.items():
        if name.startswith("gmsh:"):
            continue
        for dim in (1, 2, 3):
            rows = [
                (index, np.asarray(member, dtype=np.int64))
                for index, ((kind, _), member) in enumerate(zip(blocks, members, strict=True))
                if SIMPLICES.get(kind) == dim and member is not None and len(member) > 0
            ]
            if rows:
                yield name, dim, rows


def _dolfinx_xdmf(path: Path) -> Contents | None:
    """Read XDMF as DOLFINx writes it, one grid for the mesh and one for each `MeshTags`; None if it is not that."""
    grids = list(ElementTree.parse(path).getroot().iterfind("./Domain/Grid"))
    if len(grids) < 2 or any(grid.find("Topology") is None for grid in grids):
        return None

    def read(owner: ElementTree.Element | None) -> npt.NDArray:
        item = None if owner is None else owner.find("DataItem")
        if item is None or not item.text:
            raise InputError("cannot be read: an array is missing")
        if item.get("Format") != "HDF":
            shape = tuple(int(n) for n in item.get("Dimensions", "").split())
            return np.array(item.text.split(), dtype=np.float64).reshape(shape)
        file, _, name = item.text.strip().partition(":")
        with h5py.File(path.parent / file, "r") as data:
            return np.asarray(data[name])

    kinds = {"PolyLine": "line", "Triangle": "triangle", "Tetrahedron": "tetra"}
    points, blocks, groups = np.empty((0, 3)), [], []
    for index, grid in enumerate(grids):
        topology = grid.find("Topology")
        assert topology is not None
        kind = kinds.get(topology.get("TopologyType", ""), topology.get("TopologyType", "").lower())
        blocks.append((kind, read(topology).astype(np.int64)))
        if index == 0:
            points = read(grid.find("Geometry")).astype(np.float64)
        elif kind in SIMPLICES:
            numbers = read(grid.find("Attribute")).ravel()
            for number in np.unique(numbers).tolist():
                groups.append((f"{number:.0f}", SIMPLICES[kind], [(index, np.flatnonzero(numbers == number))]))
    cells = SIMPLICES.get(blocks[0][0])
    repeated = [i for i, (kind, _) in enumerate(blocks) if i > 0 and SIMPLICES.get(kind) == cells]
    return Contents(points, *_as_cells_of_the_first(blocks, groups, repeated))


def _as_cells_of_the_first(
    blocks: list[tuple[str, Indices]], groups: list[tuple[str, int, list[tuple[int, Indices]]]], repeated: list[int]
) -> tuple[list[tuple[str, Indices]], list[tuple[str, int, list[tuple[int, Indices]]]]]:
    """Turn the elements of some blocks, which repeat cells of the first, into rows of that."""
    first = np.sort(blocks[0][1], axis=1)
    rows = {index: rows_of(np.sort(blocks[index][1], axis=1), first) for index in repeated}
    moved = [
        (name, dim, [(0, rows[block][chosen]) if block in rows else (block, chosen) for block, chosen in members])
        for name, dim, members in groups
    ]
    return [(kind, cells[:0] if i in rows else cells) for i, (kind, cells) in enumerate(blocks)], moved
