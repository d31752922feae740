"""Rigid tools from surface meshes: distances, solutions under the same gaps, forces, bounds, files, refusals."""

import json
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from commands import signorini
from elastic import box
from mpi4py import MPI

from signorini_fenicsx import (
    Contact,
    Coulomb,
    Dirichlet,
    Elasticity,
    InputError,
    Neumann,
    certify,
    load_case,
    load_solution,
    solve,
    solve_case,
)
from signorini_fenicsx.meshes.surfaces import Foundation

COMM = MPI.COMM_WORLD
SIDES = Neumann(["x0", "x1", "y0", "y1"])


def roof(path: Path, height: float = 1.0) -> Path:
    """Two planes that meet along x = 1/2, as far from z = height as 0.2|x − 1/2| is, in a file of any kind."""
    points = [[x, y, height + 0.2 * abs(x - 0.5)] for x in (-1.0, 0.5, 2.0) for y in (-1.0, 2.0)]
    triangles = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]])
    if COMM.rank == 0:
        meshio.Mesh(np.array(points), [("triangle", triangles)]).write(path)
    COMM.barrier()
    return path


def test_distances():
    """Planes and a ball, along normals and obliquely; behind, missed, parallel, and along an edge."""
    corners = np.array([[[0.0, 0, 1], [2, 0, 2], [0, 2, 1]], [[2, 0, 2], [2, 2, 2], [0, 2, 1]]])  # z = 1 + x/2
    x = np.array([[0.5, 0.5, 0.0], [1.0, 1.0, 0.0], [0.5, 0.5, 2.0], [3.0, 0.5, 0.0], [0.5, 0.5, 0.0]])
    along = np.array([[0.0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 1, 0]])
    np.testing.assert_allclose(Foundation(corners).distances(x, along), [1.25, 1.5, -0.75, np.inf, np.inf], rtol=1e-14)
    oblique = np.array([[0.6, 0.0, 0.8]])
    np.testing.assert_allclose(Foundation(corners).distances(x[:1], oblique), 1.25 / 0.5)
    angles = np.linspace(0, 2 * np.pi, 401)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    wheel = Foundation(np.stack([circle[:-1], circle[1:]], axis=1))
    height = np.linspace(-0.9, 0.9, 37)
    starts, down = np.stack([height, np.full(37, 1.5)], axis=1), np.tile([0.0, -1.0], (37, 1))
    np.testing.assert_allclose(wheel.distances(starts, down), 1.5 - np.sqrt(1 - height**2), atol=1e-4)
    np.testing.assert_allclose(wheel.distances(starts, -down), np.sqrt(1 - height**2) - 1.5, atol=1e-4)


def pressed(**tool: Any) -> Elasticity:
    """A block on whose top a tool is."""
    rough = Contact("z1", friction=Coulomb(0.3), **tool)
    return Elasticity(1.0, 0.3, conditions=[Dirichlet("z0", ["0", "0", "0.05"]), SIDES, rough])


@pytest.mark.parallel([1, 3])
def test_roof(tmp_path_factory: pytest.TempPathFactory):
    """A tool of two planes under a force is the gap that it is; the bound says for which tool it holds."""
    force = {"z": -0.02, "x": 0.003}
    folder = COMM.bcast(str(tmp_path_factory.mktemp("roof")) if COMM.rank == 0 else None)
    domain, file = box(COMM, 2, [0.0] * 3, [1.0] * 3), roof(Path(folder, "roof.stl"))
    expected = solve(domain, pressed(gap="0.2*abs(x - 0.5) - 0.01", force=force))
    solution = solve(domain, pressed(surface=file, gap=-0.01, force=force))
    np.testing.assert_allclose(solution.stresses, expected.stresses, atol=1e-8)  # as exact as STL
    bounds = certify(solution), certify(expected)
    assert bounds[0].bound == pytest.approx(bounds[1].bound, rel=1e-5)
    assert "with tools as far as their surfaces are at the vertices of the mesh" in repr(bounds[0])
    assert COMM.allreduce(solution.contact.facets) > 0


@pytest.mark.parametrize("ending", ["msh", "xdmf"])
def test_round_tool_in_the_plane(ending: str, tmp_path: Path):
    """A polygon in place of a circle, with parts of the top that it does not cover, from files of several kinds."""
    x = np.linspace(0.0, 0.7, 141)
    points = np.stack([x, 1 + (x - 0.3) ** 2 / 2, 0 * x], axis=1)
    lines = np.stack([np.arange(140), np.arange(1, 141)], axis=1)
    file = tmp_path / f"arc.{ending}"
    meshio.Mesh(points, [("line", lines)]).write(file, **({"file_format": "gmsh22"} if ending == "msh" else {}))
    domain, found = box(MPI.COMM_SELF, 8, [0.0, 0.0], [1.0, 1.0]), []
    for tool in ({"surface": file}, {"gap": "(x - 0.3)^2/2"}):
        conditions = [Dirichlet("y0", 0), Neumann(["x0", "x1"]), Contact("y1", force={"y": -0.05}, **tool)]
        found.append(solve(domain, Elasticity(1.0, 0.3, conditions=conditions)))
    np.testing.assert_allclose(found[0].resultants()["y1"], found[1].resultants()["y1"], atol=1e-3)
    np.testing.assert_allclose(found[0].stresses, found[1].stresses, atol=5e-3)
    moved = [each.quantities()["tools"]["y1"]["displacement"]["y"] for each in found]
    assert moved[0] == pytest.approx(moved[1], rel=0.02)


CASE = """physics = "elasticity"
geometry = {shape = "cube", mesh = "structured"}
boundary = {neumann = ["left", "right", "front", "back"]}
problem = {young = 1, poisson = 0.3}
solve = {h = 0.9}
[[law]]
kind = "contact"
parts = ["top"]
surface = "roof.stl"
gap = "-0.05*t"
[time]
end = 2
steps = 2
"""


def test_case_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A case names the file as seen from its folder; the tool moves in steps; results can be read and certified."""
    (tmp_path / "cases").mkdir()
    roof(tmp_path / "cases" / "roof.stl")
    (tmp_path / "cases" / "press.toml").write_text(CASE, encoding="utf-8")
    done = signorini(tmp_path, "solve", "cases/press.toml", "--output", "out")
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    monkeypatch.chdir(tmp_path)
    case = load_case("cases/press.toml")
    law = {"kind": "contact", "parts": ["top"], "gap": "0.2*abs(x - 0.5) - 0.1"}
    expected = solve_case(case.with_values({"law": [law], "time": None}))
    assert summary["norms"]["energy"] == pytest.approx(expected.norms()["energy"], rel=1e-6)
    assert load_solution(tmp_path / "out").norms()["energy"] == pytest.approx(expected.norms()["energy"], rel=1e-6)


def test_refusals(tmp_path: Path):
    """What is no surface, or nowhere near the part: one sentence each, and status 2 on the command line."""
    domain = box(MPI.COMM_SELF, 1, [0.0] * 3, [1.0] * 3)
    (tmp_path / "text.stl").write_text("no surface", encoding="utf-8")
    meshio.Mesh(np.eye(3), [("line", np.array([[0, 1]]))]).write(tmp_path / "line.vtu")
    away = meshio.Mesh(np.array([[9.0, 0, 1], [8, 0, 1], [9, 1, 1]]), [("triangle", np.array([[0, 1, 2]]))])
    away.write(tmp_path / "away.stl")
    for name, message in (
        ("text.stl", "cannot be read"),
        ("line.vtu", "has no triangles"),
        ("away.stl", "no line along the normal from a vertex of part 'z1' meets it"),
    ):
        with pytest.raises(InputError, match=message):
            solve(domain, pressed(surface=tmp_path / name))
    (tmp_path / "press.toml").write_text(CASE.replace("roof.stl", "none.stl"), encoding="utf-8")
    done = signorini(tmp_path, "solve", "press.toml", "--output", "out")
    assert done.returncode == 2
    assert "none.stl: no such file" in done.stderr
    (tmp_path / "press.toml").write_text(CASE.replace('kind = "contact"', 'kind = "wall"\nbeta = 1'), encoding="utf-8")
    done = signorini(tmp_path, "check", "press.toml")
    assert done.returncode == 2
    assert "surface" in done.stderr
