"""Parts of Abaqus files by sets of nodes, surfaces and elements; straight elements of second order."""

from pathlib import Path

import numpy as np
import pytest

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.checks import checked
from signorini_fenicsx.meshes.files import read_mesh_file
from signorini_fenicsx.meshes.meshio_files import read_with_meshio

SQUARES = """*HEADING
Two by two squares in triangles
*NODE, NSET=all
1, 0, 0, 0
2, 0.5, 0, 0
3, 1, 0, 0
4, 0, 0.5, 0
5, 0.5, 0.5, 0
6, 1, 0.5, 0
7, 0, 1, 0
8, 0.5, 1, 0
9, 1, 1, 0
*ELEMENT, TYPE=CPS3, ELSET=body
11, 1, 2, 5
12, 1, 5, 4
13, 2, 3, 6
14, 2, 6, 5
15, 4, 5, 8
16, 4, 8, 7
17, 5, 6, 9
18, 5, 9, 8
"""
TETRAHEDRON = """*NODE
1, 0, 0, 0
2, 1, 0, 0
3, 0, 1, 0
4, 0, 0, 1
5, 0.5, 0, 0
6, 0.5, 0.5, 0
7, 0, 0.5, 0
8, 0, 0, 0.5
9, 0.5, 0, 0.5
10, 0, 0.5, 0.5
*ELEMENT, TYPE=C3D10M, ELSET=body
1, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10
"""


def places(folder: Path, text: str) -> dict[str, list[tuple[float, ...]]]:
    """The middles of the facets of each part, ascending."""
    path = folder / "mesh.inp"
    path.write_text(text, encoding="utf-8")
    mesh = checked(read_with_meshio(path))
    middles = {name: np.round(mesh.points[facets].mean(axis=1), 9) for name, facets in mesh.parts.items()}
    return {name: sorted(map(tuple, rows.tolist())) for name, rows in middles.items()}


BOTTOM, RIGHT = [(0.25, 0.0), (0.75, 0.0)], [(1.0, 0.25), (1.0, 0.75)]


@pytest.mark.parametrize(
    ("kind", "parts"),
    [
        ("CPS3", "*NSET, NSET=bottom\n1, 2, 3\n*NSET, NSET=right, GENERATE\n3, 9, 3\n"),
        ("CPE3T", "*Surface, name=bottom, type=ELEMENT\n11, S1\n13, S1\n*SURFACE, NAME=right\n 13, s2\n 17, S2\n"),
        (
            "DC2D3",
            "*ELSET, ELSET=low\n11, 13\n*ELSET, ELSET=east\n13, 17\n** a remark\n"
            "*SURFACE, NAME=bottom, TYPE=ELEMENT\nlow, S1\n*SURFACE, NAME=right, TYPE=ELEMENT\neast, S2,\n",
        ),
        (
            "S3",
            "*ELEMENT, TYPE=T2D2, ELSET=bottom\n1, 1, 2\n2, 2, 3\n*ELEMENT, TYPE=T2D2, ELSET=right\n3, 3, 6\n4, 6, 9\n",
        ),
    ],
    ids=["nodes", "faces", "sets", "elements"],
)
def test_parts(tmp_path: Path, kind: str, parts: str):
    """The same parts by all ways; a set of all nodes is all of the boundary."""
    found = places(tmp_path, SQUARES.replace("CPS3", kind) + parts)
    assert (found["bottom"], found["right"]) == (BOTTOM, RIGHT)


def test_second_order(tmp_path: Path):
    """Straight edges make straight cells; the surface has the corners of its face."""
    found = places(tmp_path, TETRAHEDRON + "*SURFACE, NAME=slope, TYPE=ELEMENT\nbody, S3\n")
    assert found["slope"] == [(0.333333333, 0.333333333, 0.333333333)]
    (tmp_path / "square.geo").write_text(
        "Point(1) = {0, 0, 0, 0.5}; Point(2) = {1, 0, 0, 0.5}; Point(3) = {0, 1, 0, 0.5};\n"
        "Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 1}; Curve Loop(1) = {1, 2, 3}; Plane Surface(1) = {1};\n"
        'Physical Curve("slope") = {2}; Physical Surface("all") = {1}; Mesh.ElementOrder = 2;\n',
        encoding="utf-8",
    )
    mesh = read_mesh_file(str(tmp_path / "square.geo"))
    assert "second order of the mesh file have straight edges" in mesh.changed
    assert len(mesh.parts["slope"]) == 3
    assert mesh.cells.shape[1] == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TETRAHEDRON.replace("6, 0.5, 0.5, 0", "6, 0.6, 0.6, 0"), "holds 1 curved element .'tetra10'."),
        (SQUARES + "*SURFACE, NAME=low, TYPE=ELEMENT\n99, S1\n", "surface 'low' is on elements that there are not: 99"),
        (SQUARES + "*Include, input=rest.inp\n", r"needs another file, by \*INCLUDE"),
        (SQUARES.replace("CPS3", "CPS4"), "cannot be read"),
    ],
)
def test_refusals(tmp_path: Path, text: str, message: str):
    """One sentence says what is wrong."""
    with pytest.raises(InputError, match=message):
        places(tmp_path, text)
