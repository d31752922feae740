"""Reads mesh files with meshio, and XDMF of DOLFINx, into blocks of elements and named groups of them."""

import contextlib
import io
import warnings
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import h5py
import meshio
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.rows import rows_of
from signorini_fenicsx.meshes.abaqus_files import read_abaqus
from signorini_fenicsx.meshes.checks import faces
from signorini_fenicsx.meshes.contents import DIMENSION, Contents, check_widths
from signorini_fenicsx.meshes.other_cells import in_simplices
from signorini_fenicsx.meshes.references import check_references


def read_with_meshio(path: Path) -> Contents:
    """Read a file (rank 0); meshio raises many kinds of errors for broken files.

    Raises:
        InputError: If it cannot be read.
    """
    try:
        with warnings.catch_warnings(action="ignore"), contextlib.redirect_stdout(io.StringIO()):
            check_references(path)
            if path.suffix == ".xdmf" and (contents := _dolfinx_xdmf(path)) is not None:
                return contents
            with contextlib.redirect_stderr(io.StringIO()) as said:
                mesh, facets = read_abaqus(path) if path.suffix.lower() == ".inp" else (meshio.read(path), {})
    except SystemExit:
        words = " ".join(said.getvalue().split()).removeprefix("Error: ")
        raise InputError(f"cannot be read: {words or 'its format is not known'}") from None
    except (InputError, MemoryError):
        raise
    except Exception as error:
        words = " ".join(str(error).split()).replace(str(path), path.name)
        raise InputError(f"cannot be read ({words[:200] or type(error).__name__})") from None
    blocks = [(block.type, _elements(block)) for block in mesh.cells]
    groups = [*_numbered(mesh, blocks), *_named(mesh, blocks)]
    facets = _facets_of_points(mesh, blocks) | facets
    for name in sorted(facets.keys() - {name for name, _, _ in groups}):
        groups.append((name, facets[name].shape[1] - 1, [(len(blocks), np.arange(len(facets[name])))]))
        blocks.append(("line" if facets[name].shape[1] == 2 else "triangle", facets[name]))
    values = {
        name: np.asarray(array, dtype=np.float64)
        for name, array in mesh.point_data.items()
        if np.issubdtype(np.asarray(array).dtype, np.number) and np.asarray(array).ndim <= 2
    }
    return Contents(np.asarray(mesh.points, dtype=np.float64), blocks, groups, values=values)


def _elements(block: meshio.CellBlock) -> Indices:
    """Points of each element; for kinds that are not accepted only the number of elements counts."""
    if block.type in DIMENSION:
        return np.asarray(block.data, dtype=np.int64)
    return np.empty((len(block.data), 0), dtype=np.int64)


def _numbered(mesh: meshio.Mesh, blocks: list[tuple[str, Indices]]) -> Iterator[tuple[str, int, list]]:
    """Groups of elements by the integers that a file gives them, with the file's names for these integers."""
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
    families = getattr(mesh, "cell_tags", {})  # MED: a number may have several names
    for dim in (1, 2, 3):
        members: dict[str, list[tuple[int, Indices]]] = {}
        names = {int(tag): [name] for name, (tag, at) in mesh.field_data.items() if at == dim}
        for index, (kind, _) in enumerate(blocks):
            if DIMENSION.get(kind) == dim:
                for number in np.unique(numbers[index]).tolist():
                    for name in names.get(number) or families.get(number) or [str(number)]:
                        members.setdefault(name, []).append((index, np.flatnonzero(numbers[index] == number)))
        yield from ((name, dim, rows) for name, rows in members.items())


def _named(mesh: meshio.Mesh, blocks: list[tuple[str, Indices]]) -> Iterator[tuple[str, int, list]]:
    """Groups that a file gives as sets of elements."""
    for name, members in mesh.cell_sets.items():
        if name.startswith("gmsh:"):
            continue
        for dim in (1, 2, 3):
            rows = [
                (index, np.asarray(member, dtype=np.int64))
                for index, ((kind, _), member) in enumerate(zip(blocks, members, strict=True))
                if DIMENSION.get(kind) == dim and member is not None and len(member) > 0
            ]
            if rows:
                yield name, dim, rows


def _facets_of_points(mesh: meshio.Mesh, blocks: list[tuple[str, Indices]]) -> dict[str, Indices]:
    """The facets of the boundary all of whose corners are in a set of points, by the names of such sets."""
    cut = in_simplices(Contents(np.empty((0, 3)), blocks, []))[0].blocks
    corners = [(DIMENSION[kind], rows) for kind, rows in cut if kind in DIMENSION]
    dim = max((dim for dim, rows in corners if len(rows)), default=0)
    if not mesh.point_sets or dim < 2:
        return {}
    cells = np.concatenate([rows[:, : dim + 1] for of, rows in corners if of == dim])
    rows, times = np.unique(faces(cells), axis=0, return_counts=True)
    found = {}
    for name, points in mesh.point_sets.items():
        chosen = np.isin(rows, np.asarray(points, dtype=np.int64)).all(axis=1) & (times == 1)
        if chosen.any():
            found[name] = rows[chosen]
    return found


def _dolfinx_xdmf(path: Path) -> Contents | None:
    """Read XDMF as DOLFINx writes it, one grid for the mesh and one for each `MeshTags`; None if it is not that."""
    grids = list(ElementTree.parse(path).getroot().iterfind("./Domain/Grid"))
    if len(grids) < 2 or any(grid.find("Topology") is None for grid in grids):
        return None
    kinds = {"PolyLine": "line", "Triangle": "triangle", "Tetrahedron": "tetra"}
    kinds |= {"Quadrilateral": "quad", "Hexahedron": "hexahedron"}
    points, blocks, groups = np.empty((0, 3)), [], []
    for index, grid in enumerate(grids):
        topology = grid.find("Topology")
        assert topology is not None
        kind = kinds.get(topology.get("TopologyType", ""), topology.get("TopologyType", "").lower())
        blocks.append((kind, _array(path, topology).astype(np.int64)))
        if index == 0:
            points = _array(path, grid.find("Geometry")).astype(np.float64)
        elif kind in DIMENSION:
            numbers = _array(path, grid.find("Attribute")).ravel()
            if len(numbers) != len(blocks[index][1]):
                raise InputError(
                    f"the grid '{grid.get('Name')}' has {len(numbers)} numbers for {len(blocks[index][1])} elements; "
                    "each element needs one"
                )
            for number in np.unique(numbers).tolist():
                groups.append((f"{number:.0f}", DIMENSION[kind], [(index, np.flatnonzero(numbers == number))]))
    check_widths(points, blocks)
    cells = DIMENSION.get(blocks[0][0])
    repeated = [i for i, (kind, _) in enumerate(blocks) if i > 0 and DIMENSION.get(kind) == cells]
    return Contents(points, *_as_cells_of_the_first(blocks, groups, repeated))


def _array(path: Path, owner: ElementTree.Element | None) -> npt.NDArray:
    """An array of an XDMF file, from its text or from the HDF5 file beside it."""
    item = None if owner is None else owner.find("DataItem")
    if item is None or not item.text:
        raise InputError("cannot be read: an array is missing")
    if item.get("Format") != "HDF":
        shape = tuple(int(n) for n in item.get("Dimensions", "").split())
        return np.array(item.text.split(), dtype=np.float64).reshape(shape)
    file, _, name = item.text.strip().partition(":")
    with h5py.File(path.resolve().parent / file, "r") as data:
        return np.asarray(data[name])


def _as_cells_of_the_first(
    blocks: list[tuple[str, Indices]], groups: list[tuple[str, int, list[tuple[int, Indices]]]], repeated: list[int]
) -> tuple[list[tuple[str, Indices]], list[tuple[str, int, list[tuple[int, Indices]]]]]:
    """Replace elements of some blocks, which repeat cells of the first block, by their rows in the first block."""
    first = np.sort(blocks[0][1], axis=1)
    rows = {index: rows_of(np.sort(blocks[index][1], axis=1), first) for index in repeated}
    if any(np.any(found < 0) for found in rows.values()):
        raise InputError("gives a number to a cell that the mesh does not have")
    moved = [
        (name, dim, [(0, rows[block][chosen]) if block in rows else (block, chosen) for block, chosen in members])
        for name, dim, members in groups
    ]
    return [(kind, cells[:0] if i in rows else cells) for i, (kind, cells) in enumerate(blocks)], moved
