"""Quadrilaterals, hexahedra, wedges and pyramids cut into simplices: all of each cell, and common faces alike."""

import json
from pathlib import Path

import meshio
import numpy as np
import pytest
from commands import signorini

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.meshes.checks import checked
from signorini_fenicsx.meshes.contents import Contents
from signorini_fenicsx.meshes.files import read_mesh_file
from signorini_fenicsx.meshes.other_cells import simplices_of

SQUARE = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
CUBE = np.concatenate([np.pad(SQUARE, [(0, 0), (0, 1)], constant_values=z) for z in (0.0, 1.0)])
WEDGE = CUBE[[0, 1, 2, 4, 5, 6]]
PYRAMID = np.concatenate([CUBE[:4], [[0.4, 0.7, 1.0]]])
CASE = """
[geometry]
file = "cubes.{ending}"
faces = {{low = "z min"}}
[boundary]
signorini = []
neumann = ["{part}"]
[problem]
f = 0
u_D = "1 + 2*x - y"
g_N = 2
"""


def volumes(points: Array, simplices: Indices) -> Array:
    """Measures of simplices, shape of the rows."""
    corners = points[simplices]
    dim = points.shape[1]
    return np.abs(np.linalg.det(corners[..., 1:, :] - corners[..., :1, :])) / (2, 6)[dim - 2]


@pytest.mark.parametrize(
    ("kind", "points", "measure", "number"),
    [
        ("quad", SQUARE, 1, 2),
        ("hexahedron", CUBE, 1, 6),
        ("wedge", WEDGE, 1 / 2, 3),
        ("pyramid", PYRAMID, 1 / 3, 2),
    ],
)
def test_any_numbering(kind: str, points: Array, measure: float, number: int):
    rng = np.random.default_rng(3)
    for _ in range(60):
        order = rng.permutation(len(points))  # the number of each corner
        placed = np.empty_like(points)
        placed[order] = points
        of_each = volumes(placed, simplices_of(kind, order[None])[0])
        assert len(of_each) == number
        assert of_each.min() > 0.01
        assert of_each.sum() == pytest.approx(measure)


def cubes(n: int, seed: int) -> tuple[Array, Indices, Indices]:
    """Points, n³ hexahedra and the quadrilaterals at x = 1 of the unit cube, with nodes in random order."""
    grid = np.stack(np.meshgrid(*[np.arange(n + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    order = np.random.default_rng(seed).permutation(len(grid))

    def node(corners: Array) -> Indices:
        return order[(corners * np.array([(n + 1) ** 2, n + 1, 1])).sum(axis=-1)]

    first = grid[(grid < n).all(axis=1)].astype(np.int64)
    hexahedra = node(first[:, None] + CUBE.astype(np.int64))
    right = first[first[:, 0] == n - 1][:, None] + CUBE.astype(np.int64)[[1, 2, 6, 5]]
    points = np.empty((len(grid), 3))
    points[order] = grid / n
    return points, hexahedra, node(right)


def test_common_faces_are_cut_alike():
    points, hexahedra, right = cubes(3, seed=5)
    contents = Contents(points, [("hexahedron", hexahedra), ("quad", right)], [("right", 2, [(1, np.arange(9))])])
    mesh = checked(contents)  # refuses what does not conform
    assert mesh.changed == "the 27 hexahedra of the mesh file are cut into simplices"
    assert len(mesh.cells) == 27 * 6
    assert volumes(mesh.points, mesh.cells).sum() == pytest.approx(1)
    assert len(mesh.parts["right"]) == 18
    assert np.all(mesh.points[mesh.parts["right"], 0] == 1)


def test_kinds_beside_one_another():
    points = np.concatenate([CUBE, [[0.5, 0.5, 1.6]], [[2.0, 0, 0], [2.0, 0, 1]]])
    pyramid, wedge = np.array([[4, 5, 6, 7, 8]]), np.array([[1, 9, 2, 5, 10, 6]])
    blocks = [("hexahedron", np.arange(8)[None]), ("pyramid", pyramid), ("wedge", wedge)]
    mesh = checked(Contents(points, blocks, []))
    assert mesh.changed.startswith("the 1 hexahedra, 1 pyramids, 1 wedges of the mesh file are cut")
    assert volumes(mesh.points, mesh.cells).sum() == pytest.approx(1 + 0.2 + 0.5)


@pytest.mark.parametrize("ending", ["vtu", "inp"])
def test_a_linear_u_is_exact(tmp_path: Path, ending: str):
    points, hexahedra, right = cubes(2, seed=1)
    if ending == "vtu":
        cells = [("hexahedron", hexahedra), ("quad", right)]
        meshio.Mesh(points, cells, cell_data={"part": [np.ones(8, int), np.full(4, 7)]}).write(tmp_path / "cubes.vtu")
        name = "7"
    else:
        nodes = [f"{k + 1}, " + ", ".join(map(str, x)) for k, x in enumerate(points)]
        bricks = [", ".join(map(str, (k + 1, *(row + 1)))) for k, row in enumerate(hexahedra)]
        at = np.flatnonzero(np.isin(hexahedra[:, [1, 2, 6, 5]], right).all(axis=1))
        faces = [f"{k + 1}, S4" for k in at]
        lines = ["*NODE", *nodes, "*ELEMENT, TYPE=C3D8R", *bricks, "*SURFACE, NAME=right, TYPE=ELEMENT", *faces]
        (tmp_path / "cubes.inp").write_text("\n".join(lines) + "\n")
        name = "right"
    case = CASE.format(ending=ending, part=name)
    (tmp_path / "case.toml").write_text(case)
    done = signorini(tmp_path, "solve", "case.toml", "--quiet", "--output", "out")
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert "the 8 hexahedra of the mesh file are cut into simplices" in summary["notices"]
    assert summary["norms"]["sigma_L2"] == pytest.approx(5**0.5)


def test_curved_quadrilaterals_are_refused(tmp_path: Path):
    meshio.Mesh(np.zeros((9, 3)), [("quad9", np.arange(9)[None])]).write(tmp_path / "curved.vtu")
    with pytest.raises(Exception, match="holds 1 element of kind 'quad9'"):
        read_mesh_file(str(tmp_path / "curved.vtu"))
