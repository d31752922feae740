"""The reader of one untrusted file, in a confined process (`confined`).

Only here Gmsh, meshio, XML and HDF5 read the file. Its contents go back as arrays.
"""

import json
import shutil
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from signorini_fenicsx.base import confined
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import printable
from signorini_fenicsx.meshes.contents import OF_GMSH, Contents


def main(arguments: list[str], result: BinaryIO) -> None:
    """Read a file and write its contents as arrays; the current folder is empty.

    Args:
        arguments: The file; h of the mesh that Gmsh makes, or 0 for the file's own sizes; how often Gmsh refines a
            coarser mesh for that; the largest number of cells; sizes at parts or regions as JSON.
        result: The file for `unpack`.
    """
    source, h = Path(arguments[0]), float(arguments[1]) or None
    if source.suffix.lower() in OF_GMSH:
        contents = _by_gmsh(source, h, int(arguments[2]), float(arguments[3]), json.loads(arguments[4]))
    else:
        from signorini_fenicsx.meshes.meshio_files import read_with_meshio

        confined.seal()
        contents = read_with_meshio(source)
    pack(contents, result)


def _by_gmsh(source: Path, h: float | None, refined: int, max_cells: float, sizes: list[tuple[str, float]]) -> Contents:
    """Let Gmsh read a copy; beside the original it would also read an `.opt` file.

    A `.geo` file is a program that may start others and write files, and Gmsh takes all else for one.
    """
    from signorini_fenicsx.meshes.gmsh_worker import read_with_gmsh

    with source.open("rb") as file:
        if source.suffix == ".msh" and not file.read(64).startswith(b"$MeshFormat"):
            raise InputError("is not a mesh of Gmsh, because it does not begin with $MeshFormat")
    copy = Path.cwd() / source.name
    shutil.copyfile(source, copy)
    if not confined.seal() and source.suffix == ".geo":
        raise InputError("is a program, which this system cannot confine; mesh it with Gmsh and give the .msh file")
    return read_with_gmsh(copy, h, refined, max_cells, sizes)


def pack(contents: Contents, result: BinaryIO) -> None:
    """Write contents as arrays."""
    arrays: dict[str, Any] = {"points": contents.points}
    arrays |= {f"block_{i}": elements for i, (_, elements) in enumerate(contents.blocks)}
    for i, (_, _, members) in enumerate(contents.groups):
        arrays |= {f"rows_{i}_{j}": rows for j, (_, rows) in enumerate(members)}
    arrays |= {f"values_{i}": values for i, values in enumerate(contents.values.values())}
    about = json.dumps(
        {
            "kinds": [kind for kind, _ in contents.blocks],
            "groups": [(name, dim, [block for block, _ in members]) for name, dim, members in contents.groups],
            "straight": contents.straight,
            "values": list(contents.values),
        }
    )
    np.savez(result, allow_pickle=False, about=np.array(about), **arrays)


def unpack(result: BinaryIO) -> Contents:
    """Read what `pack` wrote.

    Raises:
        InputError: If the process has written something else.
    """
    try:
        with np.load(result, allow_pickle=False) as arrays:
            about = json.loads(str(arrays["about"]))
            blocks = [(str(kind), arrays[f"block_{i}"]) for i, kind in enumerate(about["kinds"])]
            groups = [
                (printable(name), int(dim), [(block, arrays[f"rows_{i}_{j}"]) for j, block in enumerate(members)])
                for i, (name, dim, members) in enumerate(about["groups"])
            ]
            values = {printable(name): arrays[f"values_{i}"] for i, name in enumerate(about["values"])}
            return Contents(arrays["points"], blocks, groups, bool(about["straight"]), values)
    except (ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError("makes its reader fail") from error
