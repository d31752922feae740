"""Meshes from files: Gmsh's `.msh` and `.geo`, and what meshio reads (`meshio_files`).

All of this runs on rank 0. A file is read into blocks of elements and named groups of them (`Contents`); the cells of
its highest dimension become the mesh, groups of cells its regions, and groups of facets its boundary parts. Groups
without a name go by their number.
"""

import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from signorini_fenicsx.errors import InputError
from signorini_fenicsx.mesh_checks import Contents, FileMesh, checked

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
    from signorini_fenicsx.meshio_files import read_with_meshio  # slow to import, and seldom needed

    return read_with_meshio(path)


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
