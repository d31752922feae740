"""Broken meshes, geometries and checkpoints, forged results folders, and the valid results that some inputs need."""

import contextlib
import io
import json
import os
import random
import re
import shutil
import time
import warnings
from pathlib import Path

import h5py
import meshio
import numpy as np
from broken_input import msh_text, square_msh
from geo_texts import HOSTILE, USUAL

from fuzzing import (
    BINARY,
    NUMBERS,
    OUTPUT,
    REFUSED,
    TEXT,
    Broken,
    Valid,
    changed,
    changed_json,
    damaged,
    make_odd,
)
from fuzzing.judge import Ending, Runner, make_folders
from signorini_fenicsx.base import exchange
from signorini_fenicsx.base.shipped import data_folder

CASE = """[geometry]
file = "{file}"
[boundary]
signorini = {parts}
[problem]
f = "10*(x - 0.4)"
"""
"""A case with a mesh file."""


def make_valid(pencil: Path, runner: Runner) -> Valid:
    """Make some results with the program itself.

    Raises:
        RuntimeError: If it fails.
    """
    root = pencil / "valid"
    make_folders(root)
    work = root / "work"
    (work / "square.msh").write_text(msh_text(*square_msh(3)), encoding="utf-8")
    (work / "mesh.toml").write_text(CASE.format(file="square.msh", parts='["bottom"]'), encoding="utf-8")

    def check(ending: Ending) -> None:
        if ending.status != 0:
            raise RuntimeError(f"a valid case is not solved: {ending.said}")

    began = time.monotonic()
    for output, words in {"shape": ["example1", "--h", "1/4"], "file": ["mesh.toml"]}.items():
        runner.start(["solve", *words, "--output", output], root, check)
    runner.finish()
    return Valid(work / "shape", work / "file", time.monotonic() - began)


def _read(rng: random.Random, folder: Path, about: str, parts: str, *, refused: bool = False) -> Broken:
    """A command that reads the mesh of a case."""
    (folder / "case.toml").write_text(CASE.format(file=about.split()[0], parts=parts), encoding="utf-8")
    command = rng.choice(["check", "check", "info", "solve"])
    words = [command, "case.toml", *(["--output", OUTPUT] if command == "solve" else [])]
    return Broken(words, about[:120], refused, earlier=command == "solve" and rng.random() < 0.5)


FORMATS = {
    "msh22": (".msh", "gmsh22", {"binary": False}),
    "msh22 binary": (".msh", "gmsh22", {"binary": True}),
    "msh4": (".msh", "gmsh", {"binary": False}),
    "msh4 binary": (".msh", "gmsh", {"binary": True}),
    "vtu ascii": (".vtu", "vtu", {"binary": False}),
    "vtu binary": (".vtu", "vtu", {"binary": True, "compression": None}),
    "vtu zlib": (".vtu", "vtu", {"binary": True, "compression": "zlib"}),
    "vtk": (".vtk", "vtk", {"binary": False}),
    "vtk binary": (".vtk", "vtk", {"binary": True}),
    "xdmf": (".xdmf", "xdmf", {"data_format": "HDF"}),
    "xdmf xml": (".xdmf", "xdmf", {"data_format": "XML"}),
    "medit": (".mesh", "medit", {}),
    "medit binary": (".meshb", "medit", {}),
    "abaqus": (".inp", "abaqus", {}),
    "med": (".med", "med", {}),
    "off": (".off", "off", {}),
    "obj": (".obj", "obj", {}),
    "nastran": (".bdf", "nastran", {}),
    "dolfin": (".xml", "dolfin-xml", {}),
    "dolfinx": (".xdmf", "", {"heavy": True}),
    "dolfinx xml": (".xdmf", "", {"heavy": False}),
}
"""Formats of meshes: the ending, meshio's name of the format, empty of that which DOLFINx writes, and options."""
SUFFIXES = (".msh", ".vtu", ".xdmf", ".mesh", ".geo", ".e", ".cgns", ".h5m", ".ply", ".txt", "", ".xml", ".node")
KINDS = ("triangle", "quad", "tetra", "line", "vertex", "triangle6", "polygon5", "wedge", "VTK_LAGRANGE_TRIANGLE")
DOLFINX = """<Xdmf Version="3.0"><Domain><Grid Name="mesh" GridType="Uniform">
<Topology TopologyType="Triangle" NumberOfElements="18" NodesPerElement="3">{cells}</Topology>
<Geometry GeometryType="XY">{points}</Geometry></Grid>
<Grid Name="sides" GridType="Uniform">
<Topology TopologyType="PolyLine" NumberOfElements="12" NodesPerElement="2">{sides}</Topology>
<Attribute Name="sides" AttributeType="Scalar" Center="Cell">{numbers}</Attribute></Grid></Domain></Xdmf>"""


def mesh_file(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A mesh that is broken in its bytes or as a mesh, or something else in its place."""
    way = rng.choice(["bytes", "bytes", "bytes", "arrays", "arrays", "odd"])
    if way == "odd":
        name = rng.choice(["mesh.msh", "mesh.vtu", "mesh.xdmf", "mesh.med", "x" * 300, "a\\u0000", "."])
        about = make_odd(rng, folder / name) if name.startswith("mesh") else ""
        return _read(rng, folder, f"{name} {about}", '["1"]', refused=True)
    name = rng.choice(sorted(FORMATS))
    path, mesh = folder / f"mesh{FORMATS[name][0]}", _square(name)
    about = _change(rng, mesh) if way == "arrays" else ""
    _write(path, name, mesh)
    if way == "bytes":
        path, about = _damage(rng, path, text="binary" not in name)
    return _read(rng, folder, f"{path.name} {name} {about}", '["1"]')


def _square(name: str) -> meshio.Mesh:
    """A valid mesh, with part numbers in the form of its format."""
    nodes, elements = square_msh(3)
    points = np.array([[float(x) for x in line.split()[1:]] for line in nodes])
    rows = [[int(word) for word in line.split()] for line in elements]
    cells, sides = (np.array([row[5:] for row in rows if row[1] == kind]) - 1 for kind in (2, 1))
    points = points[:, : 2 if name in ("xdmf", "medit", "dolfin", "dolfinx", "dolfinx xml") else 3]
    tags = [np.full(len(cells), 3), np.array([row[3] for row in rows if row[1] == 1])]
    key = {"msh": "gmsh:physical", "med": "cell_tags" if name == "med" else "medit:ref"}.get(name[:3], "number")
    blocks = [("triangle", cells), ("line", sides)][: 1 if name == "obj" else 2]
    data = {} if name in ("off", "obj", "dolfin", "nastran") else {key: tags}
    if name.startswith("msh"):
        data["gmsh:geometrical"] = tags
    nodes = {"gmsh:dim_tags": np.tile([2, 1], (len(points), 1))} if name.startswith("msh4") else {}
    return meshio.Mesh(points, blocks, nodes, data)


def _write(path: Path, name: str, mesh: meshio.Mesh) -> None:
    """Write a mesh, or as much of it as can be."""
    silent = io.StringIO()
    with (
        warnings.catch_warnings(action="ignore"),
        contextlib.redirect_stdout(silent),
        contextlib.redirect_stderr(silent),
        contextlib.suppress(Exception, SystemExit),
    ):
        _, by_meshio, options = FORMATS[name]
        if by_meshio:
            meshio.write(path, mesh, by_meshio, **options)
        else:
            _write_as_dolfinx(path, mesh, **options)


def _write_as_dolfinx(path: Path, mesh: meshio.Mesh, *, heavy: bool) -> None:
    """Write XDMF, with the arrays in it or in HDF5."""
    arrays = {"points": mesh.points, "cells": mesh.cells[0].data, "sides": mesh.cells[1].data}
    arrays["numbers"] = mesh.cell_data["number"][1]
    items = {}
    for key, values in arrays.items():
        text = f"mesh.h5:/{key}" if heavy else " ".join(map(str, values.ravel().tolist()))
        size = " ".join(map(str, values.shape))
        items[key] = f'<DataItem Dimensions="{size}" Format="{"HDF" if heavy else "XML"}">{text}</DataItem>'
    path.write_text(DOLFINX.format(**items), encoding="utf-8")
    if heavy:
        with h5py.File(path.with_suffix(".h5"), "w") as file:
            file.update(arrays)


def _damage(rng: random.Random, path: Path, *, text: bool) -> tuple[Path, str]:
    """Damage a file, or the one with the arrays beside it; sometimes it gets another ending."""
    heavy = path.with_suffix(".h5")
    broken = heavy if heavy.exists() and rng.random() < 0.5 else path
    text = text and broken.suffix not in (".h5", ".med") and rng.random() < 0.8
    data, about = damaged(rng, broken.read_bytes(), TEXT if text else BINARY)
    broken.write_bytes(data)
    return path if rng.random() < 0.9 else path.rename(path.with_suffix(rng.choice(SUFFIXES))), about


def _change(rng: random.Random, mesh: meshio.Mesh) -> str:
    """Change points, vertices, kinds of cells or numbers of parts."""
    block, place = rng.choice(mesh.cells), rng.choice(["points", "cells", "cells", "kind", "numbers"])
    way = ""
    if place == "points":
        mesh.points, way = changed(rng, mesh.points)
    elif place == "cells":
        block.data, way = changed(rng, block.data)
    elif place == "kind":
        block.type = rng.choice(KINDS)
    else:
        for arrays in mesh.cell_data.values():
            arrays[-1], way = changed(rng, arrays[-1])
    return f"{place} {way}"


CALL = 'SystemCall "touch hacked";'


def geometry(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A geometry with hostile pieces, words of the language in wrong places, or damage."""
    text = rng.choice([*USUAL.values(), (data_folder("meshes") / "dam.geo").read_text(encoding="utf-8")])
    way = rng.choice(["hostile", "hostile", "hostile", "words", "damage"])
    if way == "damage":
        data, way = damaged(rng, text.encode())
    else:
        pieces = rng.choices(HOSTILE, k=rng.choice([1, 1, 2, 3]))
        if way == "words":
            words = re.findall(r"\w+|\S", " ".join([*USUAL.values(), *pieces]))
            pieces = [" ".join(rng.choices((*words, *NUMBERS), k=rng.choice([1, 2, 6]))) for _ in pieces]
        for piece in pieces:
            at = rng.choice([0, len(text), *(match.end() for match in re.finditer(r";\s*?\n", text))])
            text = f"{text[:at]}\n{piece}\n{text[at:]}"
        data, way = text.encode(errors="replace"), " ".join(pieces)
    if rng.random() < 0.1:
        data = rng.choice([b"\xef\xbb\xbf" + data, data.replace(b"\n", b"\r\n"), data.rstrip()])
    data = data.replace(b"hacked", str(folder / "hacked").encode())  # Gmsh has its own working folder
    (folder / "mesh.geo").write_bytes(data)
    for name in ("other.geo", "mesh.geo.opt"):
        (folder / name).write_text(CALL, encoding="utf-8")
    return _read(rng, folder, f"mesh.geo {way!r}", "[]")


NEEDED = ("cells", "points", "sigma", "u", "facet_vertices")
"""Arrays of a checkpoint that all commands need."""


def checkpoint(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A results folder with a broken checkpoint, for export, comparison or as a start."""
    source = rng.choice([valid.shape, valid.shape, valid.file])
    shutil.copytree(source, folder / "res")
    for name in ("square.msh", "mesh.toml"):
        shutil.copyfile(valid.file.parent / name, folder / name)
    place = folder / "res" / "checkpoint"
    path, way = rng.choice(sorted(place.glob("*.npy"))), rng.choice(["array", "array", "array", "text", "odd", "bytes"])
    refused = False
    if way == "array":
        array, about = changed(rng, np.load(path))
        path.unlink()
        if array is not None:
            np.save(path, array)
        refused = path.stem in NEEDED and about in REFUSED
        about = f"{path.stem} {about}"
    elif way == "text":
        text, about = changed_json(rng, (place / "about.json").read_text(encoding="utf-8"))
        (place / "about.json").write_text(text, encoding="utf-8")
        refused = not about
    elif way == "odd":
        about = make_odd(rng, rng.choice([place, place / "about.json", place / "cells.npy", place / "u.npy"]))
        refused = True
    else:
        data, about = damaged(rng, path.read_bytes(), BINARY)
        path.write_bytes(data)
    case = ["example1", "--h", "1/4"] if source == valid.shape else ["mesh.toml"]
    both = rng.sample(["res", os.path.relpath(source, folder)], 2)
    words = rng.choice([["export", "res"], ["compare", *both], ["solve", *case, "--start-from", "res"]])
    return Broken([*words, "--output", OUTPUT], about, refused, earlier=rng.random() < 0.3)


OWN = {"written_by": exchange.__package__}
VICTIMS = (
    *("../home/.profile", "../../home/.profile", "../notes.txt", "notes.txt", "link/.profile", "link", "", "/", ".."),
    *("x" * 400, "home/.profile", "up/notes.txt"),
)
"""What a forged list of files names."""
RESULTS = ("summary.json", "u.png", "facets.csv", "history.csv", "solution.bp", "checkpoint", "facets", ".profile")


def forged(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A results folder and the folder of an interrupted run beside it, which another person made."""
    target, area, home = folder / OUTPUT, folder / f".{OUTPUT}.partial", folder.parent / "home"
    if rng.random() < 0.7:
        shutil.copytree(valid.shape, target)
    about = []
    if rng.random() < 0.1:
        area.symlink_to(rng.choice(["../home", "notes.txt", "missing", area.name, "."]))
        about.append("the area is a link")
    elif rng.random() < 0.5:
        about += _forge(rng, area / rng.choice(["done", "done", "failed", "7"]), home, depth=2)
        if rng.random() < 0.9:
            (area / "lock").touch()
    if not about or rng.random() < 0.3:
        about += _forge(rng, target, home, depth=1)
    example = ["example1", "--h", "1/4"]
    words = rng.choice(
        [
            ["solve", *example, "--output", OUTPUT],
            ["solve", *example, "--output", OUTPUT],
            ["export", OUTPUT, "--output", OUTPUT],
            ["export", OUTPUT],
            ["compare", OUTPUT, os.path.relpath(valid.shape, folder), "--output", "out2"],
            ["solve", *example, "--start-from", OUTPUT, "--output", OUTPUT],
            ["adapt", "example1", "--max-cells", "60", "--output", OUTPUT],
        ]
    )
    beginnings = (f"work/.{OUTPUT}.partial", f"work/{OUTPUT}", "work/out2")
    return Broken(words, f"forged: {', '.join(about)}"[:300], forged=beginnings)


def _forge(rng: random.Random, place: Path, home: Path, depth: int) -> list[str]:
    """Put forged results into a folder: files, links that lead elsewhere, folders, and a list with others' files."""
    place.mkdir(parents=True, exist_ok=True)
    names = rng.sample([*RESULTS, *["home", "link", "up"] * 3], rng.choice([0, 0, 1, 2]))
    about = [place.name]
    for name in names:
        path = place / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        match rng.choice(["file", "link", "folder"]):
            case "folder" if depth:
                about += _forge(rng, path, home, depth - 1)
            case "link":
                where = rng.choice([home, home / ".profile", home.parent / "work" / "notes.txt", path, Path("/")])
                path.symlink_to(rng.choice([where, os.path.relpath(where, place)]))
                about.append(f"{name} is a link")
            case _:
                path.write_text("forged", encoding="utf-8")
    path = place / "files.json"
    listed = json.loads(path.read_text(encoding="utf-8"))["files"] if path.is_file() else ["summary.json"]
    listed += [*names, *(f"{name}/.profile" for name in names), *rng.choices(VICTIMS, k=rng.choice([0, 1, 1, 2]))]
    text = json.dumps(OWN | {"files": listed})
    if rng.random() < 0.1:
        return [*about, make_odd(rng, path)]
    broken = changed_json(rng, text)[0].encode(), damaged(rng, text.encode())[0]
    path.write_bytes(rng.choice([*[text.encode()] * 6, *broken]))
    return about
