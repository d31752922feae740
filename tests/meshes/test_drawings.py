"""Drawings in STEP and BREP, meshes in UNV and BDF, and names of faces by where they are."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import signorini

from signorini_fenicsx import InputError, load_case
from signorini_fenicsx.meshes.checks import FileMesh
from signorini_fenicsx.meshes.files import read_mesh_file
from signorini_fenicsx.meshes.meshing import MeshFile
from signorini_fenicsx.meshes.named_faces import Rule, named

PLATE = """
import sys, gmsh
gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
box, hole = gmsh.model.occ.addBox(0, 0, 0, 2, 1, 1), gmsh.model.occ.addCylinder(1, 0.5, -1, 0, 0, 3, 0.2)
(solid,), _ = gmsh.model.occ.cut([(3, box)], [(3, hole)])
gmsh.model.occ.synchronize()
gmsh.option.setNumber("Mesh.MeshSizeMin", 0.3)
for ending in ("step", "brep"):
    gmsh.write(f"{sys.argv[1]}/plate.{ending}")
gmsh.model.mesh.generate(3)
gmsh.write(f"{sys.argv[1]}/plate.bdf")
gmsh.model.addPhysicalGroup(3, [solid[1]], name="steel")
gmsh.model.addPhysicalGroup(2, [1], name="left")
gmsh.write(f"{sys.argv[1]}/plate.unv")
"""
CASE = """
[geometry]
file = "plate.step"
faces = {held = "x min", pressed = "x = 2", hole = ["face7"]}
[boundary]
dirichlet = ["held"]
signorini = ["pressed"]
neumann = ["face2", "face3", "face4", "face5", "hole"]
[problem]
f = -1
[solve]
h = 1
"""


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a plate with a hole in four formats, written by Gmsh in a process of its own."""
    folder = tmp_path_factory.mktemp("plate")
    subprocess.run([sys.executable, "-c", PLATE, str(folder)], check=True, stdout=subprocess.DEVNULL)
    return folder


def volume(mesh: FileMesh) -> float:
    """The volume of a mesh in space."""
    corners = mesh.points[mesh.cells]
    return float(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6)


@pytest.mark.parametrize("ending", ["step", "brep", "STP"])
def test_solids_of_drawings_are_meshed(plate: Path, ending: str):
    file = plate / f"plate.{ending}"
    if ending == "STP":
        file.write_bytes((plate / "plate.step").read_bytes())
    mesh = read_mesh_file(str(file), 0.5)
    assert set(mesh.parts) == {f"face{number}" for number in range(1, 8)}
    assert len(mesh.regions) == 1  # the label that Gmsh writes into STEP, or a number
    assert volume(mesh) == pytest.approx(2 - np.pi * 0.04, rel=0.02)
    assert sum(map(len, mesh.parts.values())) == 4 * len(mesh.cells) - 2 * interior(mesh)


def interior(mesh: FileMesh) -> int:
    """The number of facets between two cells."""
    faces = np.concatenate([np.sort(np.delete(mesh.cells, vertex, axis=1), axis=1) for vertex in range(4)])
    return int(np.count_nonzero(np.unique(faces, axis=0, return_counts=True)[1] == 2))


def test_meshes_of_other_programs(plate: Path):
    groups, numbers = (read_mesh_file(str(plate / f"plate.{ending}")) for ending in ("unv", "bdf"))
    assert list(groups.parts) == ["left"]
    assert list(groups.regions) == ["steel"]
    assert np.all(groups.points[groups.parts["left"], 0] == 0)
    assert list(numbers.regions) == ["solid1"]
    assert len(numbers.cells) == len(groups.cells)


def test_faces_by_where_they_are(plate: Path):
    rules: dict[str, Rule] = {"low": "z min", "right": " x=2.0 ", "both": ("face1", "face6")}
    mesh = MeshFile(str(plate / "plate.step"), rules).read(1.0)[0]
    assert len(mesh.parts["low"]) > 10
    assert np.all(mesh.points[mesh.parts["low"], 2] == 0)
    assert np.all(mesh.points[mesh.parts["right"], 0] == 2)
    sizes = [len(mesh.parts[part]) for part in ("face1", "face6", "both")]
    assert sizes[2] == sizes[0] + sizes[1] > 0


@pytest.mark.parametrize(
    ("rules", "words"),
    [
        ({"face1": "z min"}, "'face1' is a part of the file already; choose another name"),
        ({"a": "x = 0.5"}, "a: no facet of the boundary is at x = 0.5"),
        ({"a": ("face9",)}, "a: unknown part 'face9'; there are face1,"),
    ],
)
def test_wrong_faces(plate: Path, rules: dict[str, Rule], words: str):
    mesh = read_mesh_file(str(plate / "plate.brep"))
    with pytest.raises(InputError, match=words):
        named(mesh, rules, "plate.brep")


def test_no_z_in_the_plane():
    flat = FileMesh(np.eye(3, 2), np.arange(3)[None], {}, {})
    assert len(named(flat, {"a": "y min"}, "flat.msh").parts["a"]) == 1
    both = named(flat, {"a": ("y min", "x min")}, "flat.msh").parts
    assert len(named(replace(flat, parts=both), {"b": ("a", "y min")}, "flat.msh").parts["b"]) == 2
    with pytest.raises(InputError, match=r"mesh flat.msh: \[geometry\] faces: a mesh in the plane has no z"):
        named(flat, {"a": "z min"}, "flat.msh")


def test_a_drawing_is_no_case(plate: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(plate)
    with pytest.raises(InputError, match=r"plate.brep: is no case, a .toml file; `signorini init my-case.toml --mesh"):
        load_case("plate.brep")


def test_a_case_with_a_drawing(plate: Path):
    (plate / "plate.toml").write_text(CASE)
    done = signorini(plate, "solve", "plate.toml", "--quiet", "--output", "out")
    assert done.returncode == 0, done.stderr
    assert json.loads((plate / "out" / "summary.json").read_text())["cells"] > 100
    (plate / "wrong.toml").write_text(CASE.replace("x min", "x mid"))
    wrong = signorini(plate, "solve", "wrong.toml")
    assert wrong.returncode == 2
    assert (
        "[geometry] faces.held: must be such as 'z min', 'x max' or 'y = 0.5', or a list of these and of parts"
        in wrong.stderr
    )


def test_sizes_at_a_face(plate: Path):
    file = str(plate / "plate.step")
    usual, fine = (MeshFile(file, sizes=sizes).read(None)[0] for sizes in ((), (("face7", 0.1),)))
    assert len(fine.parts["face7"]) > 3 * len(usual.parts["face7"])
    assert len(fine.parts["face1"]) < 1.3 * len(usual.parts["face1"])
    scaled = MeshFile(file, sizes=(("face7", 0.1),)).read(1.0)[0]
    assert len(scaled.cells) < len(fine.cells)
    with pytest.raises(InputError, match="sizes: there is no part or region 'face8'"):
        MeshFile(file, sizes=(("face8", 0.1),)).read(None)
    (plate / "wrong.toml").write_text(CASE.replace("faces =", "sizes = {face7 = 0}\nfaces ="))
    assert "[geometry] sizes.face7: " in signorini(plate, "check", "wrong.toml").stderr
    (plate / "wrong.toml").write_text(CASE.replace("faces =", "sizes = {left = 1}\nfaces =").replace("step", "unv"))
    assert "sizes apply to drawings, such as .step and .geo" in signorini(plate, "check", "wrong.toml").stderr


def test_what_is_no_drawing(tmp_path: Path):
    file = tmp_path / "plate.step"
    file.write_text('SystemCall "touch here";\n')
    with pytest.raises(InputError, match=r"mesh .*plate.step: "):
        read_mesh_file(str(file))
    assert list(tmp_path.iterdir()) == [file]
