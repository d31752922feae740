"""Mesh files read by meshio, and XDMF of DOLFINx, as blocks of elements and named groups of them.

*Abaqus files, `.inp`*: what meshio leaves of them, which are other names of elements, and surfaces.

*Checks the references in mesh files*: XML may refer to HDF5 files in its folder, and nothing may grow when read.
"""

import contextlib
import io
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import h5py
import meshio
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Indices, rows_of
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.contents import DIMENSION, SECOND, Contents, check_widths, faces
from signorini_fenicsx.meshes.exodus import ENDINGS as EXODUS
from signorini_fenicsx.meshes.exodus import read_exodus
from signorini_fenicsx.meshes.other_cells import in_simplices, simplices_of

XML = (".vtu", ".xdmf", ".xmf", ".xml")
HDF5 = (".h5m", ".hmf", ".med", ".cgns")


def check_references(path: Path) -> None:
    """Check a file before a library reads it.

    Raises:
        InputError: If it has a reference that is not allowed, or declares XML entities.
    """
    suffix = path.suffix.lower()  # like meshio
    if suffix in XML:
        _check_head(path)
    if suffix in HDF5 or (suffix in EXODUS and h5py.is_hdf5(path)):
        _check_hdf5(path)
    if suffix in (".xdmf", ".xmf"):
        for file in {_beside(path, item) for item in ElementTree.parse(path).iter()} - {None}:
            _check_hdf5(Path(str(file)))


class _Root(Exception):
    """The end of the parser at the first element, after which nothing can be declared."""


def _check_head(path: Path) -> None:
    """Refuse declarations: entities can be other files or fill the memory. The empty DOCTYPE of DOLFINx is allowed."""

    def refuse(*_: object) -> None:
        raise InputError(
            "declares entities or defaults in its DOCTYPE, which can grow or be other files; leave them out"
        )

    def stop(*_: object) -> None:
        raise _Root

    parser = expat.ParserCreate()
    parser.EntityDeclHandler = parser.AttlistDeclHandler = refuse
    parser.ElementDeclHandler = parser.NotationDeclHandler = refuse
    parser.StartElementHandler = stop
    try:
        with path.open("rb") as file:
            parser.ParseFile(file)
    except _Root:
        return
    except expat.ExpatError as error:
        raise InputError(f"is not XML ({error})") from None


def _beside(path: Path, item: ElementTree.Element) -> Path | None:
    """The HDF5 file of an array in XDMF, or None; meshio reads arrays from elements with any name."""
    kind, text = item.get("Format", "XML"), (item.text or "").strip()
    if kind == "XML":
        return None
    if kind != "HDF":
        raise InputError(f"has an array in the format '{kind}'; use XML or HDF")
    name = text.partition(":")[0]
    folder = path.resolve().parent
    if not name or Path(name).is_absolute() or not (folder / name).resolve().is_relative_to(folder):
        raise InputError(f"has an array in '{name}', which is outside the folder of the mesh")
    if not (folder / name).is_file():
        raise InputError(f"has an array in '{name}', and there is no such file beside it")
    return folder / name


def _check_hdf5(path: Path) -> None:
    """Refuse links to other files, and arrays whose values lie in other files."""
    with h5py.File(path, "r") as file:
        seen: set[int] = set()
        todo: list[h5py.Group] = [file]
        while todo:
            group = todo.pop()
            for name in group:
                try:
                    link = group.get(name, getlink=True)
                except TypeError:
                    link = None
                if isinstance(link, h5py.SoftLink):  # its target is checked in its own place
                    continue
                if not isinstance(link, h5py.HardLink):
                    raise InputError(
                        f"'{name}' in {path.name} is a link to another file; an array has to be in the file"
                    )
                item = group[name]
                address = h5py.h5o.get_info(item.id).addr
                if isinstance(item, h5py.Group) and address not in seen:
                    todo.append(item)
                seen.add(address)
                if isinstance(item, h5py.Dataset) and (item.is_virtual or item.external):
                    raise InputError(
                        f"the values of '{name}' in {path.name} are in another file; an array has to be in the file"
                    )


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


READ = {".inp": read_abaqus} | dict.fromkeys(EXODUS, read_exodus)
"""What reads files by their ending, if it is not meshio alone: its mesh, and facets by the names of their parts."""


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
                mesh, facets = READ.get(path.suffix.lower(), lambda path: (meshio.read(path), {}))(path)
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
