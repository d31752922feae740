"""Meshes from files: the same mesh in any format, parts and regions on any number of ranks, broken ones refused."""

import contextlib
import random
import tempfile
from pathlib import Path
from typing import BinaryIO

import dolfinx.mesh
import gmsh
import meshio
import numpy as np
import pytest
from broken_input import CASE_FOR_MESH, MESH_MUTATIONS, msh_text, square_msh, write_broken_mesh
from dolfinx import io
from made_cases import case_of
from mpi4py import MPI

from signorini_fenicsx import InputError, adapt_case, compare, load_case, load_solution, solve_case
from signorini_fenicsx.base import confined
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.certificate.adaptive import AdaptRow
from signorini_fenicsx.meshes import file_worker
from signorini_fenicsx.meshes.checks import FileMesh, checked
from signorini_fenicsx.meshes.files import read_mesh_file
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.meshes.meshio_files import read_with_meshio
from signorini_fenicsx.meshes.shapes import SHAPES
from signorini_fenicsx.output.writing import write_solution
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.solution import Solution

COMM = MPI.COMM_WORLD

SQUARE_GEO = """
Point(1) = {0, 0, 0, 0.2}; Point(2) = {1, 0, 0, 0.1}; Point(3) = {1, 1, 0, 0.2}; Point(4) = {0, 1, 0, 0.2};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
Physical Curve("bottom") = {1}; Physical Curve("others") = {2, 3, 4}; Physical Surface("inside") = {1};
"""

CUBE = """
[geometry]
file = "cube.xdmf"
[boundary]
signorini = ["5"]
[problem]
f = "40*(x - 0.5)"
kappa = {1 = 1, 2 = "2 + z"}
"""


def write(path: Path, text: str) -> Path:
    """Write a file on rank 0 (collective)."""
    if COMM.rank == 0:
        path.write_text(text, encoding="utf-8")
    COMM.Barrier()
    return path


def square_case(folder: Path, file: str = "square.msh", n: int = 4) -> Case:
    """A case on a square mesh in Gmsh's format 2.2 (collective)."""
    write(folder / "square.msh", msh_text(*square_msh(n)))
    return load_case(write(folder / "case.toml", CASE_FOR_MESH.format(file=file)))


def cube_case(folder: Path, n: int = 2) -> Case:
    """A case on a cube of two regions from an XDMF file with numbers only (collective)."""
    domain = build_domain(MPI.COMM_SELF, "cube", 3**0.5 / n * 1.001, mesh="structured")
    mesh = domain.mesh
    points = mesh.geometry.x
    cells = mesh.geometry.dofmaps[0]
    sides = [dolfinx.mesh.entities_to_geometry(mesh, 2, facets) for facets in domain.facets.values()]
    if COMM.rank == 0:
        region = 1 + (points[cells].mean(axis=1)[:, 0] > 1 / 2).astype(np.int64)
        numbers = np.repeat(np.arange(1, 7), [len(side) for side in sides])
        blocks = [("tetra", cells), ("triangle", np.concatenate(sides))]
        data = {"number": [region, numbers]}
        meshio.write(folder / "cube.xdmf", meshio.Mesh(points, blocks, cell_data=data))
    return load_case(write(folder / "case.toml", CUBE))


def test_formats_agree(tmp_path: Path):
    """Gmsh, XDMF, Medit, VTK: the same cells, parts and regions."""
    square_case(tmp_path)
    original = read_mesh_file(str(tmp_path / "square.msh"))
    assert original.parts.keys() == {"bottom", "others"}
    assert (len(original.cells), len(original.parts["bottom"]), len(original.parts["others"])) == (32, 4, 12)
    np.testing.assert_array_equal(original.regions["inside"], np.arange(32))
    mesh = meshio.read(tmp_path / "square.msh")
    numbers = mesh.cell_data["gmsh:physical"]
    flat = meshio.Mesh(mesh.points[:, :2], mesh.cells, cell_data={"tags": numbers})
    meshio.write(tmp_path / "a.xdmf", flat)
    meshio.write(tmp_path / "b.xdmf", flat, data_format="XML")
    meshio.write(tmp_path / "c.mesh", meshio.Mesh(mesh.points[:, :2], mesh.cells, cell_data={"medit:ref": numbers}))
    meshio.write(tmp_path / "d.vtu", meshio.Mesh(mesh.points, mesh.cells, cell_data={"tags": numbers}))
    names = {"bottom": "1", "others": "2", "inside": "3"}
    for file in ("a.xdmf", "b.xdmf", "c.mesh", "d.vtu"):
        read = checked(read_with_meshio(tmp_path / file))
        assert read.parts.keys() | read.regions.keys() == set(names.values())
        for name, number in names.items():
            np.testing.assert_allclose(midpoints(read, number), midpoints(original, name), atol=1e-14)


def midpoints(mesh: FileMesh, name: str) -> np.ndarray:
    """Midpoints of the facets or cells of a part or region, in an order that does not depend on their numbers."""
    vertices = mesh.parts[name] if name in mesh.parts else mesh.cells[mesh.regions[name]]
    middle = np.round(mesh.points[vertices].mean(axis=1), 10)
    return middle[np.lexsort(middle.T)]


def test_gmsh_versions_and_overlapping_groups(tmp_path: Path):
    """All versions keep names; an element may be in several groups, and format 2.2 then lists copies of it."""
    geo = tmp_path / "square.geo"
    geo.write_text(SQUARE_GEO + 'Physical Curve("all") = {1, 2, 3, 4}; Physical Surface("again") = {1};\n')
    sizes = []
    for version, binary in ((2.2, 0), (2.2, 1), (4.1, 0), (4.1, 1)):
        file = str(tmp_path / f"{version}-{binary}.msh")
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(geo))
        gmsh.model.mesh.generate(2)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.write(file)
        gmsh.finalize()
        mesh = read_mesh_file(file)
        groups = mesh.parts | mesh.regions
        sizes.append({name: len(rows) for name, rows in groups.items()} | {"cells": len(mesh.cells)})
    assert all(size == sizes[0] for size in sizes)
    assert sizes[0]["all"] == sizes[0]["bottom"] + sizes[0]["others"]
    assert sizes[0]["inside"] == sizes[0]["again"] == sizes[0]["cells"]


@pytest.mark.parallel(2)
def test_xdmf_of_dolfinx(folder: Path):
    """A mesh with facet and cell tags as DOLFINx writes it, in parallel."""
    domain = build_domain(COMM, "square", 0.3, mesh="structured")
    mesh = domain.mesh
    facets = np.concatenate([domain.facets[name] for name in ("bottom", "top")])
    values = np.repeat(np.array([7, 8], dtype=np.int32), [len(domain.facets[name]) for name in ("bottom", "top")])
    order = np.argsort(facets)
    sides = dolfinx.mesh.meshtags(mesh, 1, facets[order], values[order])
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    middle = dolfinx.mesh.compute_midpoints(mesh, 2, cells)
    regions = dolfinx.mesh.meshtags(mesh, 2, cells, (middle[:, 0] > 0.5).astype(np.int32))
    sides.name, regions.name = "sides", "regions"
    with io.XDMFFile(COMM, folder / "square.xdmf", "w") as file:
        file.write_mesh(mesh)
        file.write_meshtags(sides, mesh.geometry)
        file.write_meshtags(regions, mesh.geometry)
    COMM.Barrier()
    read = on_root(COMM, lambda: read_mesh_file(str(folder / "square.xdmf")))
    assert read.parts.keys() == {"7", "8"}
    assert np.all(read.points[read.parts["7"]][..., 1] == 0)
    assert len(read.parts["7"]) == COMM.allreduce(len(domain.facets["bottom"]))
    assert np.all(read.points[read.cells[read.regions["1"]]].mean(axis=1)[:, 0] > 0.5)
    assert len(read.regions["0"]) + len(read.regions["1"]) == len(read.cells)


@pytest.mark.parallel(2)
def test_parts_and_regions_on_any_number_of_ranks(folder: Path):
    """Solve, write, read on one rank, refine: facets, regions and numbers are those of one rank."""
    case = cube_case(folder)
    together = solve_case(case, COMM)
    check_cube(together)
    write_solution(together, folder / "x", fields=False)
    COMM.Barrier()
    read = load_solution(folder / "x", MPI.COMM_SELF)
    check_cube(read)
    assert case_of(read) == case
    assert read.norms() == pytest.approx(together.norms(), rel=1e-10)
    rows: list[list[AdaptRow]] = [[], []]
    for comm, history in zip((COMM, MPI.COMM_SELF), rows, strict=True):
        last, _ = adapt_case(case, comm, max_cells=300, on_row=history.append)
        check_cube(last)
    assert len(rows[0]) == len(rows[1]) > 1
    for a, b in zip(*rows, strict=True):
        assert (a.cells, a.contact_facets) == (b.cells, b.contact_facets)
        assert a.bound == pytest.approx(b.bound, rel=1e-9)


def check_cube(solution: Solution) -> None:
    """Parts and regions are in the right places and complete."""
    domain = solution.spaces.domain
    mesh, comm = domain.mesh, domain.mesh.comm
    places = zip(("1", "2", "3", "4", "5", "6"), SHAPES["cube"].parts.values(), strict=True)
    for name, part in places:
        nodes = dolfinx.mesh.entities_to_geometry(mesh, 2, domain.facets[name]).reshape(-1, 3)
        corners = mesh.geometry.x[nodes]
        assert part.contains(corners.reshape(-1, 3).T).all()
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
        assert comm.allreduce(area) == pytest.approx(1, rel=1e-12)
    for name, cells in domain.regions.items():
        x = mesh.geometry.x[mesh.geometry.dofmaps[0][cells]].mean(axis=1)[:, 0]
        assert np.all((x > 0.5) == (name == "2"))
    size = mesh.topology.index_map(3).size_local
    assert sum(map(len, domain.regions.values())) == size


def test_any_unit_of_length(tmp_path: Path):
    """Scaling lengths by 1e-12 changes only lengths, in solving, comparing and refining."""
    found = []
    for s in (1.0, 1e-12):
        solutions = []
        for n in (4, 7):
            nodes, elements = square_msh(n)
            scaled = [f"{k} {s * float(x)!r} {s * float(y)!r} 0" for k, x, y, _ in map(str.split, nodes)]
            (tmp_path / f"{n}.msh").write_text(msh_text(scaled, elements))
            path = tmp_path / f"{n}.toml"
            path.write_text(CASE_FOR_MESH.format(file=f"{n}.msh"))
            solutions.append(solve_case(load_case(path).with_values({"problem.f": f"10*(x/{s!r} - 0.4)/{s!r}^2"})))
        result = compare(*solutions)
        rows: list[AdaptRow] = []
        adapt_case(case_of(solutions[0]), max_cells=100, on_row=rows.append)
        relative = [(row.cells, row.contact_facets, row.iterations, row.relative) for row in rows]
        numbers = [result.jaccard, result.hausdorff / s, result.relative["u_Q"], result.relative["p_Lambda"]]
        found.append((numbers, relative))
    (numbers, relative), (scaled_numbers, scaled_relative) = found
    assert scaled_numbers == pytest.approx(numbers, rel=1e-7)
    np.testing.assert_allclose(scaled_relative, relative, rtol=1e-7)


MESSAGES = {
    "_empty": "the file is empty",
    "_prose": "is not a mesh of Gmsh",
    "_not_finite": "not a number, or infinite",
    "_coinciding_nodes": "without volume",
    "_folded": "overlap",
    "_out_of_plane": "z = const",
    "_quadrilateral": "overlap|more than two cells|more than once",
    "_second_order": "make a first-order mesh",
    "_doubled_cell": "listed more than once",
    "_third_cell": "more than two cells meet",
    "_no_group": "unknown part 'bottom'; the mesh has 'others'",
    "_left_facet": "1 facet in no part",
    "_overlap": "'others' and 'bottom' share 1 facet",
    "_inside": "has 1 facet inside the domain",
    "_nowhere": "has 1 facet without a cell",
    "_no_cells": "neither triangles nor tetrahedra",
    "_floating_component": "2 components .* no Dirichlet facet",
}


def read_here(module: str, arguments: list[str], result: BinaryIO) -> None:
    """Read a file as the confined process does, in this one, which takes a tenth of the time."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        try:
            file_worker.main(arguments, result)
        finally:
            if gmsh.isInitialized():
                gmsh.finalize()


@pytest.mark.parametrize("index", range(len(MESH_MUTATIONS)))
def test_broken_meshes_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, index: int):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(confined, "run", read_here)
    monkeypatch.setattr(confined, "seal", lambda: True)
    message = MESSAGES.get(MESH_MUTATIONS[index].__name__, "mesh")
    with pytest.raises(InputError, match=message) as caught:
        mesh_case(load_case(write_broken_mesh(tmp_path, random.Random(index), index)), MPI.COMM_SELF)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "hacked").exists()


@pytest.mark.parallel([2])
def test_all_ranks_refuse_together(folder: Path):
    write(folder / "empty.msh", "")
    case = square_case(folder)
    for values, message in [
        ({"geometry.file": str(folder / "empty.msh")}, "the file is empty"),
        ({"geometry.file": str(folder / "missing.msh")}, "no such file"),
        ({"boundary.signorini": ["top"]}, "unknown part 'top'; the mesh has 'bottom', 'others'"),
        ({"problem.f": "z"}, "z"),
        ({"problem.kappa": {"outside": "1"}}, "outside"),
    ]:
        with pytest.raises(InputError, match=message):
            solve_case(case.with_values(values), COMM)
    with pytest.raises(InputError, match="has its own h"):
        case.with_values({"solve.h": 0.1})


def test_a_geometry_is_meshed_as_finely_as_asked(tmp_path: Path):
    (tmp_path / "square.geo").write_text(SQUARE_GEO)
    case = square_case(tmp_path, "square.geo")
    assert 0.1 < mesh_case(case, MPI.COMM_SELF).h < 0.3
    for h in (0.6, 0.05):
        assert h / 2 < mesh_case(case.with_values({"solve.h": h}), MPI.COMM_SELF).h <= h
    with pytest.raises(InputError, match="asks for about"):
        mesh_case(case.with_values({"solve.h": 1e-7}), MPI.COMM_SELF)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('SystemCall "touch {folder}/hacked";', "Gmsh cannot use it: Could not find /bin/sh: aborting system call"),
        ('Printf("x") > "{folder}/hacked";', "Unable to open file"),
        ('Merge "other.geo";', "Unable to open file"),
        ("Exit;", "makes its reader fail"),
        ('Physical Curve(Sprintf("%s%n", 1)) = {{1}};', "makes its reader crash"),
        ("// two\n\nPoint(1) = {{0, 0}};", "Gmsh cannot use it: 'a.geo', line 2: syntax error"),
        ("// Save the Exit", "no surface and no volume"),
    ],
)
def test_a_geometry_runs_no_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, message: str):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.geo").write_text(text.format(folder=tmp_path))
    for beside in ("a.geo.opt", "other.geo"):
        (tmp_path / beside).write_text(f'SystemCall "touch {tmp_path}/hacked";')
    with pytest.raises(InputError, match=message):
        read_mesh_file("a.geo")
    assert not (tmp_path / "hacked").exists()
