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
from broken_input import MESH_MUTATIONS, msh_text, square_msh, write_broken_mesh
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
    """A command that reads the mesh of a case, which is written unless there is one."""
    if not (folder / "case.toml").exists():
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
}
"""Formats that meshio writes: the ending, meshio's name of the format, its options."""
SUFFIXES = (".msh", ".vtu", ".xdmf", ".mesh", ".geo", ".e", ".cgns", ".h5m", ".ply", ".txt", "", ".xml", ".node")
KINDS = ("triangle", "quad", "tetra", "line", "vertex", "triangle6", "polygon5", "wedge", "VTK_LAGRANGE_TRIANGLE")
LAUGHS = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 10))
DOCTYPES = (
    f'<!DOCTYPE VTKFile [<!ENTITY l0 "lol">{LAUGHS}]>',
    '<!DOCTYPE VTKFile [<!ENTITY l9 SYSTEM "file:///etc/hostname">]>',
    '<!DOCTYPE VTKFile [<!ENTITY % p SYSTEM "http://127.0.0.1:9/x.dtd"> %p; <!ENTITY l9 "1">]>',
    '<!DOCTYPE VTKFile [<!ENTITY l9 "' + "1 " * 5_000_000 + '">]>',
)
DOLFINX = """<Xdmf Version="3.0"><Domain><Grid Name="mesh" GridType="Uniform">
<Topology TopologyType="Triangle" NumberOfElements="18" NodesPerElement="3">{cells}</Topology>
<Geometry GeometryType="XY">{points}</Geometry></Grid>
<Grid Name="sides" GridType="Uniform">
<Topology TopologyType="PolyLine" NumberOfElements="12" NodesPerElement="2">{sides}</Topology>
<Attribute Name="sides" AttributeType="Scalar" Center="Cell">{numbers}</Attribute></Grid></Domain></Xdmf>"""


def mesh_file(rng: random.Random, folder: Path, valid: Valid) -> Broken:
    """A mesh that is broken in a known way, in its bytes or as a mesh; or a hostile file."""
    way = rng.choice(["known", "bytes", "bytes", "bytes", "arrays", "arrays", "twice", "dolfinx", "hostile", "odd"])
    if way == "known":
        index = rng.randrange(len(MESH_MUTATIONS))
        write_broken_mesh(folder, rng, index).rename(folder / "case.toml")
        return _read(rng, folder, MESH_MUTATIONS[index].__name__, "", refused=True)
    if way == "odd":
        name = rng.choice(["mesh.msh", "mesh.vtu", "mesh.xdmf", "mesh.med", "x" * 300, "a\\u0000", "."])
        about = make_odd(rng, folder / name) if name.startswith("mesh") else ""
        return _read(rng, folder, f"{name} {about}", '["1"]', refused=True)
    name = rng.choice(["vtu ascii", "xdmf xml", "xdmf"] if way == "hostile" else sorted(FORMATS))
    path, refused, about = folder / f"mesh{FORMATS[name][0]}", way == "hostile", way
    if way == "dolfinx":
        path, about = _dolfinx(rng, folder)
    else:
        mesh = _square(name)
        if way == "twice":
            refused = _double(rng, mesh)
        elif way == "arrays":
            about = _change(rng, mesh)
        _write(path, name, mesh)
    if way == "bytes":
        path, about = _damage(rng, path, text="binary" not in name)
    elif way == "hostile":
        _refer(rng, path)
    broken = _read(rng, folder, f"{path.name} {name} {about}", '["1"]', refused=refused)
    broken.refused &= way != "twice" or broken.words[0] != "info"  # which looks for no overlaps
    return broken


def _arrays() -> dict[str, np.ndarray]:
    """Points, cells, sides and the numbers of the parts of a small square."""
    nodes, elements = square_msh(3)
    rows = [[int(word) for word in line.split()] for line in elements]
    ends = [row for row in rows if row[1] == 1]
    return {
        "points": np.array([[float(x) for x in line.split()[1:]] for line in nodes]),
        "cells": np.array([row[5:] for row in rows if row[1] == 2]) - 1,
        "sides": np.array([row[5:] for row in ends]) - 1,
        "numbers": np.array([row[3] for row in ends]),
    }


def _square(name: str) -> meshio.Mesh:
    """A valid mesh, with part numbers in the form of its format."""
    arrays = _arrays()
    points = arrays["points"][:, : 2 if name in ("xdmf", "medit", "dolfin") else 3]
    tags = [np.full(len(arrays["cells"]), 3), arrays["numbers"]]
    key = {"msh": "gmsh:physical", "med": "cell_tags" if name == "med" else "medit:ref"}.get(name[:3], "number")
    blocks = [("triangle", arrays["cells"]), ("line", arrays["sides"])][: 1 if name == "obj" else 2]
    data = {} if name in ("off", "obj", "dolfin", "nastran") else {key: tags}
    if name.startswith("msh"):
        data["gmsh:geometrical"] = tags
    nodes = {"gmsh:dim_tags": np.tile([2, 1], (len(points), 1))} if name.startswith("msh4") else {}
    return meshio.Mesh(points, blocks, nodes, data)


def _write(path: Path, name: str, mesh: meshio.Mesh) -> None:
    """Write a mesh, or as much of it as meshio can."""
    silent = io.StringIO()
    with (
        warnings.catch_warnings(action="ignore"),
        contextlib.redirect_stdout(silent),
        contextlib.redirect_stderr(silent),
        contextlib.suppress(Exception, SystemExit),
    ):
        meshio.write(path, mesh, FORMATS[name][1], **FORMATS[name][2])


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


def _double(rng: random.Random, mesh: meshio.Mesh) -> bool:
    """Put the cells there once more, above the others; whether they overlap or lie on one another."""
    above, points = rng.choice([0.0, 0.5, 1.0, 1 - 10 ** rng.uniform(-4, -1), 1.1]), mesh.points
    moved = points + np.array([0.0, above, 0.0])[: points.shape[1]]
    mesh.points = np.concatenate([points, moved])
    mesh.cells = [
        meshio.CellBlock(block.type, np.concatenate([block.data, block.data + len(points)])) for block in mesh.cells
    ]
    mesh.cell_data = {key: [np.tile(array, 2) for array in arrays] for key, arrays in mesh.cell_data.items()}
    mesh.point_data = {key: np.tile(array, (2, 1)) for key, array in mesh.point_data.items()}
    return above <= 1


def _dolfinx(rng: random.Random, folder: Path) -> tuple[Path, str]:
    """XDMF as DOLFINx writes it, with a changed array, a wrong place of one, or damage."""
    arrays, path = _arrays(), folder / "mesh.xdmf"
    arrays["points"] = arrays["points"][:, :2]
    broken, way = rng.choice(list(arrays)), rng.choice(["arrays", "arrays", "place", "text"])
    if way == "arrays":
        array, way = changed(rng, arrays[broken])
        arrays[broken] = np.zeros(0) if array is None or array.dtype.kind in "OUSMV" else array
    heavy = rng.random() < 0.5
    with h5py.File(folder / "mesh.h5", "w") as file:
        for key, values in arrays.items():
            file[key] = values

    def item(key: str) -> str:
        text = f"mesh.h5:/{key}" if heavy else " ".join(map(str, arrays[key].ravel().tolist()))
        if way == "place" and key == broken:
            text = rng.choice(["nothing.h5:/x", "mesh.h5:/x", "mesh.h5", ":", "../home/.profile:/x"])
        size = " ".join(map(str, arrays[key].shape))
        return f'<DataItem Dimensions="{size}" Format="{"HDF" if heavy else "XML"}">{text}</DataItem>'

    data = DOLFINX.format(**{key: item(key) for key in arrays}).encode()
    path.write_bytes(damaged(rng, data)[0] if way == "text" else data)
    return path, f"{broken} {way}"


def _refer(rng: random.Random, path: Path) -> None:
    """Let a mesh refer to other files, by entities in XML or links in HDF5."""
    if not path.with_suffix(".h5").exists():
        text = path.read_text(encoding="utf-8").replace('<?xml version="1.0"?>', "")
        path.write_text(rng.choice(DOCTYPES) + text.replace("0 ", "&l9; ", 1), encoding="utf-8")
        return
    home = path.parent.parent / "home"
    with h5py.File(path.with_suffix(".h5"), "a") as file, h5py.File(home / "other.h5", "w") as other:
        key = rng.choice(list(file))
        other["data"] = file[key][()]
        del file[key]
        file[key] = rng.choice([h5py.ExternalLink("../home/other.h5", "data"), h5py.SoftLink(f"/{key}")])


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
HEADERS = {
    "long header": "{'descr': '<f8', 'fortran_order': False, 'shape': (" + "1, " * 50_000 + "), }",
    "huge shape": "{'descr': '<f8', 'fortran_order': False, 'shape': (4000000000000,), }",
    "code in the header": "__import__('os').system('touch hacked')",
}


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
    elif rng.random() < 0.7:
        data, about = damaged(rng, path.read_bytes(), BINARY)
        path.write_bytes(data)
    else:
        about = rng.choice(list(HEADERS))
        header = HEADERS[about].encode() + b"\n"
        (place / "u.npy").write_bytes(b"\x93NUMPY\x02\x00" + len(header).to_bytes(4, "little") + header + bytes(64))
        refused = True
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
