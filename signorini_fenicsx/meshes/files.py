"""Meshes from files: those that Gmsh reads or meshes (`gmsh_worker`), and formats that meshio reads (`meshio_files`).

All functions run on rank 0. A file is read in another process (`file_worker`), into blocks of elements and named groups
of them (`Contents`). The cells of the highest dimension become the mesh, groups of cells become its regions, and groups
of facets its boundary parts. The name of a group without a name is its number.
"""

import json
import tempfile
from collections.abc import Callable
from pathlib import Path

from signorini_fenicsx.base import confined
from signorini_fenicsx.base.errors import InputError, reading
from signorini_fenicsx.meshes.checks import FileMesh, checked
from signorini_fenicsx.meshes.contents import DRAWINGS, Contents
from signorini_fenicsx.meshes.file_worker import unpack

type Sizes = tuple[tuple[str, float], ...]
"""Sizes of cells by the names of parts or regions."""
MAX_CELLS = 10**8
"""Largest number of cells; more are regarded as a mistake in h."""


def is_geometry(path: str) -> bool:
    """Whether a file describes a geometry, which Gmsh meshes with any h, and not a mesh."""
    return Path(path).suffix.lower() in DRAWINGS


def read_mesh_file(path: str, h: float | None = None, refined: int = 0, sizes: Sizes = ()) -> FileMesh:
    """Read a mesh, or let Gmsh make one (rank 0).

    Args:
        path: Path of the file.
        h: Largest cell diameter of a mesh that Gmsh makes; None for the sizes of the file.
        refined: How often Gmsh refines a coarser mesh for that.
        sizes: Sizes of cells at parts or regions of a geometry, which h scales like the file's own.

    Raises:
        InputError: If the file cannot be read, or its mesh cannot be used.
    """
    return read_file("mesh", path, checked, h, refined, sizes)


def read_file[T](
    what: str, path: str, use: Callable[[Contents], T], h: float | None = None, refined: int = 0, sizes: Sizes = ()
) -> T:
    """Read the contents of a file in a confined process, and make something of them (rank 0).

    Args:
        what: What it is to be, in a word for messages.
        path: Path of the file.
        use: What is made of them.
        h: See `read_mesh_file`.
        refined: See `read_mesh_file`.
        sizes: See `read_mesh_file`.

    Raises:
        InputError: If the file cannot be read, or `use` raises it.
    """
    place = Path(path)
    with reading(f"{what} {path}"):
        if not place.is_file():
            raise InputError("is a folder, not a file" if place.is_dir() else "no such file")
        if place.stat().st_size == 0:
            raise InputError("the file is empty")
        with tempfile.TemporaryFile() as result:
            arguments = [str(place.absolute()), repr(h or 0.0), str(refined), repr(float(MAX_CELLS)), json.dumps(sizes)]
            confined.run("signorini_fenicsx.meshes.file_worker", arguments, result)
            result.seek(0)
            contents = unpack(result)
        return use(contents)
