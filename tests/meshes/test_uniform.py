"""Uniform refinement: the same domain and parts, good cells, the same mesh on any number of ranks."""

import itertools
import math
from pathlib import Path

import dolfinx.mesh
import numpy as np
import pytest
from mpi4py import MPI

from signorini_fenicsx.base.rows import Order, fetch_rows, find_rows
from signorini_fenicsx.meshes import meshing
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.files import read_mesh_file
from signorini_fenicsx.meshes.meshing import MeshFile, build_domain, own_domain
from signorini_fenicsx.meshes.shapes import SHAPES
from signorini_fenicsx.meshes.uniform import parents, refined_uniformly

COMM = MPI.COMM_WORLD
SQUARE = """h = 0.3;
Point(1) = {{0, 0, 0, h}}; Point(2) = {{1, 0, 0, h}}; Point(3) = {{1, 1, 0, h}}; Point(4) = {{0, 1, 0, h}};
Point(5) = {{0.5, 0, 0, h}}; Line(1) = {{1, 5}}; Line(5) = {{5, 2}}; Line(2) = {{2, 3}}; Line(3) = {{3, 4}}; {curve}
Curve Loop(1) = {{1, 5, 2, 3, last}}; Plane Surface(1) = {{1}}; Line(6) = {{5, 3}}; Line{{6}} In Surface{{1}};
Physical Curve("bottom") = {{1, 5}}; Physical Curve("rest") = {{2, 3, last}}; Physical Surface("all") = {{1}};
"""


def corners(domain: Domain) -> np.ndarray:
    """Of all cells of all ranks."""
    mesh = domain.mesh
    dim = mesh.topology.dim
    size = mesh.topology.index_map(dim).size_local
    return np.concatenate(mesh.comm.allgather(mesh.geometry.x[mesh.geometry.dofmaps[0][:size]][:, :, :dim]))


def serial(shape: str, h: float) -> Domain:
    """The same mesh on each rank."""
    return build_domain(MPI.COMM_SELF, shape, h, mesh="unstructured")


def quality(x: np.ndarray) -> np.ndarray:
    """Smallest angle of triangles; of tetrahedra 3 times the radius of the inscribed sphere over the other one's."""
    if x.shape[2] == 2:
        sides = [x[:, (i + 1) % 3] - x[:, i] for i in range(3)]
        lengths = [np.linalg.norm(side, axis=1) for side in sides]
        cosines = [-(sides[i] * sides[i - 1]).sum(axis=1) / (lengths[i] * lengths[i - 1]) for i in range(3)]
        return np.arccos(np.max(cosines, axis=0))
    edges = x[:, 1:] - x[:, :1]
    normals = [np.cross(x[:, b] - x[:, a], x[:, c] - x[:, a]) for a, b, c in itertools.combinations(range(4), 3)]
    inner = np.abs(np.linalg.det(edges)) / sum(np.linalg.norm(normal, axis=1) for normal in normals)
    centre = np.linalg.solve(2 * edges, (edges**2).sum(axis=2)[:, :, None])
    return 3 * inner / np.linalg.norm(centre, axis=(1, 2))


def measure(x: np.ndarray) -> float:
    return float(np.abs(np.linalg.det(x[:, 1:] - x[:, :1])).sum()) / math.factorial(x.shape[2])


@pytest.mark.parallel([1, 3])
def test_children():
    for name, shape in SHAPES.items():
        coarse = build_domain(COMM, name, 0.5 if shape.dim == 3 else 0.4, mesh="gmsh")
        domain = coarse
        for _ in range(5 - shape.dim):
            domain = refined_uniformly(domain)
        before, x = corners(coarse), corners(domain)
        assert len(x) == len(before) * 2 ** (shape.dim * (5 - shape.dim))
        curved = any(part.nearest is not None for part in shape.parts.values())
        assert measure(x) == pytest.approx(shape.measure, rel=0.3 * domain.h**2 if curved else 1e-12)
        assert np.quantile(quality(x), 0.01) >= 0.8 * np.quantile(quality(before), 0.01)
        assert domain.ancestor(2) is domain.coarser
        assert domain.ancestor(64) is None
        named = np.sort(np.concatenate(list(domain.facets.values())))
        np.testing.assert_array_equal(named, np.sort(dolfinx.mesh.exterior_facet_indices(domain.mesh.topology)))
        for part, facets in domain.facets.items():
            vertices = dolfinx.mesh.entities_to_geometry(domain.mesh, shape.dim - 1, facets)
            assert np.all(shape.parts[part].contains(domain.mesh.geometry.x[vertices.ravel()].T))


@pytest.mark.parallel([2, 3])
@pytest.mark.parametrize(("shape", "h"), [("half_disk", 0.04), ("cube", 0.2)])
def test_large_meshes_are_refined_ones(shape: str, h: float, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(meshing, "REFINED_FROM", 6_000)
    monkeypatch.setattr(meshing, "COARSEST", 500)
    domain = build_domain(COMM, shape, h, mesh="unstructured")
    assert h / 2 < domain.h <= h
    assert domain.origin() == "Gmsh, refined uniformly 1 time"
    centres, alone = (np.round(x.mean(axis=1), 9) for x in (corners(domain), corners(serial(shape, h))))
    np.testing.assert_allclose(centres[np.lexsort(centres.T)], alone[np.lexsort(alone.T)], atol=1e-8)


def test_geometries_from_files(tmp_path: Path):
    """A curved one is left to Gmsh."""
    straight, curved = tmp_path / "straight.geo", tmp_path / "curved.geo"
    straight.write_text(SQUARE.format(curve="last = 4; Line(4) = {4, 1};"))
    curved.write_text(SQUARE.format(curve="last = 4; Point(9) = {0, 0.5, 0, h}; Circle(4) = {4, 9, 1};"))
    assert read_mesh_file(str(straight)).straight
    assert not read_mesh_file(str(curved)).straight
    h = 0.009
    domain = own_domain(COMM, MeshFile(str(straight)), h, {"signorini": ["bottom"]})
    assert domain.origin() == "Gmsh, refined uniformly 1 time"
    assert h / 2 < domain.h <= h
    assert len(domain.regions["all"]) == len(corners(domain))
    points = dolfinx.mesh.compute_midpoints(domain.mesh, 1, domain.facets["bottom"])
    np.testing.assert_allclose(points[:, 1], 0, atol=1e-14)
    assert len(points) >= 1 / h


def test_geometries_in_space(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Children of tetrahedra are longer than half of them, so the mesh of Gmsh is made finer until they are not."""
    monkeypatch.setattr(meshing, "REFINED_FROM", 6_000)
    monkeypatch.setattr(meshing, "COARSEST", 500)
    path = tmp_path / "cube.geo"
    path.write_text('SetFactory("OpenCASCADE"); Box(1) = {0, 0, 0, 1, 1, 1}; Physical Volume("all") = {1};')
    h = 0.19  # for which three more meshes are made
    domain = own_domain(MPI.COMM_SELF, MeshFile(str(path)), h, {})
    assert domain.origin() == "Gmsh, refined uniformly 1 time"
    assert h / 2 < domain.h <= h
    assert measure(corners(domain)) == pytest.approx(1, rel=1e-12)


@pytest.mark.parallel([2, 3])
@pytest.mark.parametrize("shape", ["lshape", "cube"])
def test_parents(shape: str):
    """Each node is in the middle between its parents, or is the only one of them."""
    fine = refined_uniformly(build_domain(COMM, shape, 0.4, mesh="unstructured"))
    assert fine.coarser is not None
    pairs, coarse = parents(fine), fine.coarser.mesh.geometry
    assert pairs.shape == (len(fine.mesh.geometry.x), 2)
    np.testing.assert_allclose(fine.mesh.geometry.x, coarse.x[pairs].mean(axis=1), atol=1e-14)
    own = fine.mesh.geometry.index_map().size_local
    kept = COMM.allreduce(int((pairs[:own, 0] == pairs[:own, 1]).sum()))
    assert kept == coarse.index_map().size_global


@pytest.mark.parallel([2, 3])
def test_rows_of_other_ranks():
    """Ranks that have no row, and rows that several ranks have marked."""
    own = None if COMM.rank == 0 and COMM.size > 1 else np.arange(10.0).reshape(5, 2) + 100 * COMM.rank
    count = 5 * (COMM.size - (COMM.size > 1))
    everything = np.concatenate([rows for rows in COMM.allgather(own) if rows is not None])
    wanted = np.random.default_rng(COMM.rank).integers(count, size=7 * COMM.rank)
    np.testing.assert_array_equal(fetch_rows(COMM, wanted, own), everything[wanted])
    rows = np.array([[1, 2, 3], [4, 5, 6], [7, 8, COMM.rank]])
    last = COMM.rank == COMM.size - 1
    tables = [rows[:1] if last else rows[:0], np.array([[7, 8, 0], [4, 5, 6]])[: 2 * last]]
    np.testing.assert_array_equal(find_rows(COMM, rows, tables), [[0, -1], [-1, 1], [-1, 0 if COMM.rank == 0 else -1]])
    numbers = np.random.default_rng(5).permutation(100)[COMM.rank : 40 : COMM.size]
    order, everything = Order(COMM, numbers), np.sort(np.concatenate(COMM.allgather(numbers)))
    np.testing.assert_array_equal(np.concatenate(COMM.allgather(order.sorted(3 * numbers))), 3 * everything)
    np.testing.assert_array_equal(order.places(numbers), np.searchsorted(everything, numbers))


def test_large_meshes_in_space_have_few_cells_for_their_h():
    """Of several coarse meshes that with the fewest cells is refined; Gmsh has improved its worst tetrahedra."""
    domain = build_domain(MPI.COMM_SELF, "lprism", 0.13, mesh="unstructured")
    assert domain.coarser is not None
    assert 0.98 * 0.13 < domain.h <= 0.13
    x = corners(domain)
    assert len(x) * domain.h**3 < 165
    volumes = np.linalg.det(x[:, 1:] - x[:, :1]) / 6
    edges = sum(((x[:, a] - x[:, b]) ** 2).sum(axis=1) for a, b in itertools.combinations(range(4), 2))
    quality = 12 * (3 * np.abs(volumes)) ** (2 / 3) / edges  # 1 for the regular tetrahedron
    assert np.quantile(quality, 0.01) > 0.6
