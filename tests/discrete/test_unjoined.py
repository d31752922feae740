"""Bodies and sides of cracks that share no facets: what overlaps or lies on one another is refused in a sentence."""

import shutil
from pathlib import Path

import meshio
import numpy as np
import pytest
from commands import signorini
from mpi4py import MPI

from signorini_fenicsx import Contact, Diffusion, Dirichlet, Domain, Elasticity, InputError, Neumann, Signorini, solve
from signorini_fenicsx.base.rows import joined
from signorini_fenicsx.discrete.unjoined import check_joined
from signorini_fenicsx.meshes.checks import FileMesh, faces, neighbours
from signorini_fenicsx.meshes.cut import cut
from signorini_fenicsx.meshes.whole import handed_out
from signorini_fenicsx.physics.diffusion.discrete.spaces import build_spaces

type Piece = tuple[np.ndarray, np.ndarray]
"""Points and cells."""


def strip(n: int, left: float, y: float = 0.0) -> Piece:
    """Squares, n of them, one above the other, each cut into two triangles."""
    low = np.stack([np.full(n + 1, left), np.linspace(y, y + 1, n + 1)], axis=1)
    points = np.concatenate([low, low + np.array([1, 0])])
    a = np.arange(n)
    b, c, d = a + n + 1, a + n + 2, a + 1
    return points, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def block(low: list[float], high: list[float], flipped: bool = False) -> Piece:
    """A rectangle of two triangles; in space a box of tetrahedra from its middle to its faces, split in two ways."""
    dim = len(low)
    corners = np.array([[(low, high)[k >> i & 1][i] for i in range(dim)] for k in range(2**dim)], dtype=float)
    if dim == 2:
        return corners, np.array([[0, 1, 3], [0, 3, 2]])
    quads = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    triangles = []
    for a, b, c, d in quads:
        triangles += [(a, b, d), (b, c, d)] if flipped else [(a, b, c), (a, c, d)]
    return np.vstack([corners, corners.mean(axis=0)]), np.array([[*triangle, 8] for triangle in triangles])


def together(*pieces: Piece, join: bool = False, scale: float = 1.0) -> FileMesh:
    """Pieces as one mesh; if they are joined, equal points become one.

    Each has its boundary as a part: "body 0" and so on.
    """
    starts = np.cumsum([0] + [len(points) for points, _ in pieces])
    points = scale * np.concatenate([points for points, _ in pieces])
    cells = np.concatenate([cells + start for (_, cells), start in zip(pieces, starts, strict=False)])
    if join:
        points, number = np.unique(points, axis=0, return_inverse=True)
        cells = number.ravel()[cells]
    return FileMesh(points, cells, boundaries(cells), {})


def boundaries(cells: np.ndarray) -> dict[str, np.ndarray]:
    """The facets of the boundary of each component."""
    everything = faces(cells)
    component = np.tile(joined(len(cells), np.stack(neighbours(everything), axis=1) % len(cells)), cells.shape[1])
    _, first, times = np.unique(everything, axis=0, return_index=True, return_counts=True)
    outer = first[times == 1]
    return {f"body {k}": everything[outer[component[outer] == k]] for k in range(component.max() + 1)}


def slit() -> FileMesh:
    """One body, [0, 2] × [0, 1], with a slit from (1, 1/2) up: parts "one", "other" for its sides, and "rest"."""
    whole = together(strip(2, 0), strip(2, 1), join=True)
    facets = np.unique(faces(whole.cells), axis=0)
    x = whole.points[facets]
    done = cut(whole.points, whole.cells, facets[(x[..., 0] == 1).all(axis=1) & (x[..., 1] >= 0.5).all(axis=1)])
    one, other = done.sides.swapaxes(0, 1)
    (rest,) = boundaries(done.cells).values()
    rest = rest[~(rest[:, None] == done.sides.reshape(-1, 2)).all(axis=2).any(axis=1)]
    return FileMesh(done.points, done.cells, {"one": one, "other": other, "rest": rest}, {})


def checked(mesh: FileMesh, comm: MPI.Comm = MPI.COMM_SELF, **named: list[str]) -> list[str]:
    """The notices of a mesh with these parts of each kind of boundary (collective)."""
    domain = handed_out(comm, mesh if comm.rank == 0 else None, "mesh")
    spaces = build_spaces(domain, named.get("signorini", []), named.get("neumann", []))
    check_joined(spaces, named)
    return spaces.notices


OVERLAP: dict[str, tuple[list[Piece], float]] = {
    "by a strip": ([block([0, 0], [1, 1]), block([0, 0.99], [1, 2])], 0.01),
    "by a corner": ([block([0, 0], [1, 1]), block([0.995, 0.99], [2, 2])], 0.005),
    "crossed, no vertex in the other": ([block([0, 1], [3, 2]), block([1, 0], [1.1, 3])], 0.1),
    "one in the other": ([block([0, 0], [9, 9]), block([5, 2], [6, 2.5])], 0.2**0.5),
    "the same place": ([strip(2, 0), strip(3, 0)], 0.1**0.5),
    "corners of boxes": ([block([0, 0, 0], [1, 1, 1]), block([0.99] * 3, [2, 2, 2], flipped=True)], 0.01),
    "edges of boxes": ([block([0, 0, 0], [1, 1, 3]), block([0.98, 0.98, 1], [2, 2, 2])], 0.02),
    "crossed bars": ([block([0, 1, 0], [3, 2, 1]), block([1, 0, 0.4], [2, 3, 0.6])], 0.19),
    "one box in the other": ([block([0, 0, 0], [9, 9, 9]), block([1, 4, 7], [2, 5, 8], flipped=True)], 0.5),
}
LYING: dict[str, tuple[list[Piece], int]] = {
    "the same facets": ([strip(2, 0), strip(2, 1)], 4),
    "other facets": ([strip(2, 0), strip(3, 1)], 5),
    "a part of a facet": ([block([0, 0], [1, 1]), block([0.75, 1], [1.75, 2])], 2),
    "faces of boxes": ([block([0, 0, 0], [1, 1, 1]), block([1, 0, 0], [2, 1, 1])], 4),
    "faces split otherwise": ([block([0, 0, 0], [1, 1, 1]), block([1, 0, 0], [2, 1, 1], flipped=True)], 4),
    "a corner of a face": ([block([0, 0, 0], [1, 1, 1]), block([1, 0.9, 0.9], [2, 2, 2])], 4),
}
TURNED = block([0, 0], [1, 1])[0] @ [[1, 1], [-1, 1]] + [2, 0.0], block([0, 0], [1, 1])[1]
APART: dict[str, list[Piece]] = {
    "a narrow gap": [strip(2, 0), strip(2, 1 + 1e-3)],
    "corners": [block([0, 0], [1, 1]), block([1, 1], [2, 2])],
    "a corner on a side": [TURNED, block([0, -1], [4, 0])],
    "edges": [block([0, 0, 0], [1, 1, 1]), block([1, 1, 0.3], [2, 2, 2])],
    "a cell that is flat": [(strip(2, 0)[0] * [1, 1e-9], strip(2, 0)[1])],
}


@pytest.mark.parametrize("name", OVERLAP)
def test_bodies_that_overlap(name: str) -> None:
    pieces, depth = OVERLAP[name]
    with pytest.raises(InputError, match="two bodies overlap, by ") as caught:
        checked(together(*pieces), neumann=["body 0", "body 1"])
    assert float(str(caught.value).split()[4]) == pytest.approx(depth, rel=2e-2)


@pytest.mark.parametrize(("pitch", "depth"), [(0.2, 0.12), (0.5, 0.0)])
def test_a_body_that_overlaps_itself(pitch: float, depth: float) -> None:
    """A spiral whose second turn is in its first one, and one with more room."""
    points, cells = strip(12, 0)
    angle, radius = 7.2 * points[:, 1], 1 + points @ [0.3, pitch]
    mesh = together((np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1), cells))
    if depth == 0:
        assert checked(mesh, signorini=list(mesh.parts)) == []
        return
    with pytest.raises(InputError, match="a body overlaps itself, by ") as caught:
        checked(mesh, neumann=list(mesh.parts))
    assert float(str(caught.value).split()[5]) == pytest.approx(depth, rel=0.5)


@pytest.mark.parametrize("name", LYING)
@pytest.mark.parametrize("scale", [1.0, 1e-9])
def test_bodies_on_one_another(name: str, scale: float) -> None:
    """Refused, as whatever is given there is given twice; of free faces there is a notice."""
    pieces, facets = LYING[name]
    mesh = together(*pieces, scale=scale)
    for named in ({"signorini": ["body 0", "body 1"]}, {"signorini": ["body 0"], "neumann": ["body 1"]}, {}):
        with pytest.raises(InputError) as caught:
            checked(mesh, **named)
        message = str(caught.value)
        assert "part 'body 0' and part 'body 1' lie on one another (" in message
        assert f"({facets} facets, the first around" in message
        assert "BooleanFragments" in message
        assert "inner" in message
    (notice,) = checked(mesh, neumann=["body 0", "body 1"])
    assert "as at an open crack" in notice


@pytest.mark.parametrize("name", APART)
def test_bodies_that_do_not_meet_in_facets(name: str) -> None:
    mesh = together(*APART[name])
    assert checked(mesh, signorini=list(mesh.parts)) == []
    joint = together(strip(2, 0), strip(2, 1), join=True)
    assert checked(joint, signorini=list(joint.parts)) == []


def test_a_slit_of_one_body() -> None:
    """Both its sides may be free, and nothing else."""
    (notice,) = checked(slit(), neumann=["one", "other"])
    assert "part 'one' and part 'other' lie on one another (2 facets, the first around (1, 0.75))" in notice
    with pytest.raises(InputError, match="part 'one' and part 'other' lie on one another"):
        checked(slit(), signorini=["one"], neumann=["other"])
    mesh = slit()
    unnamed = FileMesh(mesh.points, mesh.cells, {"rest": mesh.parts["rest"]}, {})
    with pytest.raises(InputError, match=r"^facets in no part lie on one another"):
        checked(unnamed, signorini=["rest"])
    sheets = together(block([0, 0], [1, 1]), block([0, 0], [1, 1]))
    folded = FileMesh(sheets.points, sheets.cells, {"rest": np.concatenate([*sheets.parts.values()])}, {})
    with pytest.raises(InputError, match="overlap"):
        checked(folded, signorini=["rest"])


def write_mesh(path: Path, mesh: FileMesh) -> None:
    """Write a mesh in the plane with its parts for Gmsh."""
    points = np.pad(mesh.points, ((0, 0), (0, 1)))
    blocks = [("triangle", mesh.cells), *(("line", facets) for facets in mesh.parts.values())]
    tags = [np.full(len(elements), number, dtype=np.int32) for number, (_, elements) in enumerate(blocks, start=1)]
    names = {name: np.array([number, 1]) for number, name in enumerate(mesh.parts, start=2)}
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    meshio.write(path, meshio.Mesh(points, blocks, cell_data=data, field_data=names), "gmsh22", binary=False)


def two_bodies(gap: float) -> Domain:
    """Two squares, one on the other or with a gap between them, with "bottom", "lower", "upper" and "top"."""
    mesh = together(block([0, 0], [1, 1]), block([0, 1 + gap], [1, 2 + gap]))
    middles = {name: mesh.points[facets].mean(axis=1)[:, 1] for name, facets in mesh.parts.items()}
    heights = {"bottom": 0, "lower": 1, "upper": 1 + gap, "top": 2 + gap}
    body = {"bottom": "body 0", "lower": "body 0", "upper": "body 1", "top": "body 1"}
    parts = {name: mesh.parts[body[name]][middles[body[name]] == y] for name, y in heights.items()}
    return handed_out(MPI.COMM_SELF, FileMesh(mesh.points, mesh.cells, parts, {}), "mesh")


@pytest.mark.parametrize("physics", ["diffusion", "elasticity"])
def test_elastic_and_scalar_problems(physics: str) -> None:
    """Neither physics solves a problem in which both faces have a foundation of their own."""
    law = {"diffusion": [Signorini(["lower", "upper"])], "elasticity": [Contact(["lower", "upper"])]}[physics]
    held = [Dirichlet(["bottom"], 0), Dirichlet(["top"], -0.1 if physics == "diffusion" else ["0", "-0.1"])]
    given = {"diffusion": {"f": 0}, "elasticity": {"young": 1, "poisson": 0}}[physics]
    problem = {"diffusion": Diffusion, "elasticity": Elasticity}[physics]
    with pytest.raises(InputError, match="part 'lower' and part 'upper' lie on one another"):
        solve(two_bodies(0.0), problem(**given, conditions=[*law, *held]))


def test_bodies_that_face_each_other() -> None:
    """Between bodies that are a gap apart one presses on its foundation, not on the other: that is told, once."""
    held = [Dirichlet(["bottom"], 0), Dirichlet(["top"], ["0", "-0.1"])]
    for gap, parts, facing in ((0.05, ["lower", "upper"], True), (0.5, ["upper"], True), (3.0, ["upper"], False)):
        contact = Contact(parts, gap=0.05)
        free = [Neumann(part) for part in ("lower", "upper") if part not in parts]
        solution = solve(two_bodies(gap), Elasticity(young=1, poisson=0, conditions=[contact, *free, *held]))
        notices = solution.summary().get("notices", [])
        assert sum("has its rigid foundation where another body is" in each for each in notices) == facing


def test_command_line(tmp_path: Path) -> None:
    """`check` and `solve` tell of free faces once, and refuse others with status 2 before anything is written."""
    mesh = slit()
    write_mesh(tmp_path / "slit.msh", mesh)
    case = tmp_path / "slit.toml"
    text = '[geometry]\nfile = "slit.msh"\n[boundary]\nneumann = ["one"{}]\ndirichlet = ["rest"{}]\n[problem]\nf = 1\n'
    for command in (["check"], ["solve", "--output", "out"]):
        case.write_text(text.format(', "other"', ""), encoding="utf-8")
        done = signorini(tmp_path, command[0], "slit.toml", *command[1:])
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("as at an open crack") == 1
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        case.write_text(text.format("", ', "other"'), encoding="utf-8")
        done = signorini(tmp_path, command[0], "slit.toml", *command[1:])
        assert done.returncode == 2
        assert "part 'one' and part 'other' lie on one another" in done.stderr
        assert not (tmp_path / "out").exists()


@pytest.mark.parallel(2)
def test_ranks_tell_the_same() -> None:
    """The sentences do not depend on ranks, some of which have no facet there."""
    found = []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        for pieces, _ in (OVERLAP["by a strip"], OVERLAP["edges of boxes"], LYING["faces split otherwise"]):
            with pytest.raises(InputError) as caught:
                checked(together(*pieces), comm, signorini=["body 0", "body 1"])
            found.append(str(caught.value))
        found += checked(slit(), comm, neumann=["one", "other"])
    assert found[:4] == found[4:]
