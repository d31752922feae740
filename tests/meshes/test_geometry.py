"""Meshes: the wanted h, complete and disjoint boundary parts, vertices on curved boundaries."""

import dolfinx.mesh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx import InputError, domain_of
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.meshes.sampling import curve_gap, sampled
from signorini_fenicsx.meshes.shapes import SHAPES, shape_of

RECTANGLE = "[-2, -1] x [0.5, 3]"
MESHES = [(name, "unstructured", None) for name in (*SHAPES, RECTANGLE)] + [
    (name, "structured", diagonal)
    for name in ("square", "lshape", RECTANGLE)
    for diagonal in ("left", "right", "crossed")
] + [("cube", "structured", None), ("lprism", "structured", None)]  # fmt: skip


@pytest.mark.parametrize(("shape", "mesh", "diagonal"), MESHES)
def test_fineness_and_measure(shape: str, mesh: str, diagonal: str | None):
    for h in (0.5, 0.11) if shape_of(shape).dim == 2 else (0.5, 0.3):
        domain = build_domain(MPI.COMM_SELF, shape, h, mesh=mesh, diagonal=diagonal)
        assert h / 2 < domain.h <= h * (1 + 1e-12)
        measure = fem.assemble_scalar(fem.form(fem.Constant(domain.mesh, 1.0) * ufl.dx))
        curved = any(part.nearest is not None for part in shape_of(shape).parts.values())
        assert measure == pytest.approx(shape_of(shape).measure, rel=h**2 if curved else 1e-12)


@pytest.mark.parallel([1, 3])
def test_parts_cover_the_boundary_once():
    for shape, mesh, diagonal in MESHES:
        domain = build_domain(MPI.COMM_WORLD, shape, 0.3, mesh=mesh, diagonal=diagonal)
        named = np.sort(np.concatenate(list(domain.facets.values())))
        np.testing.assert_array_equal(named, np.sort(dolfinx.mesh.exterior_facet_indices(domain.mesh.topology)))


@pytest.mark.parametrize(("shape", "part", "radius"), [("half_disk", "arc", 1), ("annulus", "inner", 0.5)])
def test_vertices_on_the_curve(shape: str, part: str, radius: float):
    domain = build_domain(MPI.COMM_SELF, shape, 0.1, mesh="unstructured")
    vertices = dolfinx.mesh.entities_to_geometry(domain.mesh, 1, domain.facets[part])
    r = np.linalg.norm(domain.mesh.geometry.x[vertices.ravel()], axis=1)
    np.testing.assert_allclose(r, radius, rtol=1e-12)


@pytest.mark.parametrize(("shape", "radius"), [("ball", 1.0), ("annulus", 0.5)])
def test_searches_reach_the_curve_and_not_far_beyond(shape: str, radius: float):
    """Facets are at most as far from the curve as `curve_gap` says; a gap as large as the body made searches slow."""
    domain = build_domain(MPI.COMM_SELF, shape, radius, mesh="unstructured")
    mesh, dim = domain.mesh, domain.mesh.topology.dim
    middles = dolfinx.mesh.compute_midpoints(mesh, dim - 1, dolfinx.mesh.exterior_facet_indices(mesh.topology))
    distance = np.abs(np.linalg.norm(middles, axis=1)[:, None] - [1.0, radius]).min(axis=1)
    assert distance.max() <= curve_gap(domain) <= 0.25 * radius


@pytest.mark.parametrize("bulge", [0.0, 0.1])
def test_points_outside_a_mesh_of_the_user(bulge: float, monkeypatch: pytest.MonkeyPatch):
    """Each has the values of its cell; boxes wide enough for any curve are used only where points are outside."""
    searched, search = [], fem.create_interpolation_data
    spied = lambda *where, padding: searched.append(padding) or search(*where, padding=padding)  # noqa: E731
    monkeypatch.setattr(fem, "create_interpolation_data", spied)
    meshes = [dolfinx.mesh.create_unit_square(MPI.COMM_SELF, n, n) for n in (3, 7)]
    x = meshes[1].geometry.x
    x[:, 1] *= 1 + bulge * x[:, 0] * (1 - x[:, 0])
    domain, function = domain_of(meshes[0], {}), fem.Function(fem.functionspace(meshes[0], ("P", 1)))
    function.interpolate(lambda x: np.abs(x[0] - 1 / 3))  # linear in each cell
    (sample,) = sampled([function], meshes[1], domain)
    assert [padding > 1 for padding in searched] == ([False, True] if bulge else [])
    exact = fem.Function(sample.function_space)
    points = sample.function_space.element.interpolation_points
    exact.interpolate(fem.Expression(abs(ufl.SpatialCoordinate(meshes[1])[0] - 1 / 3), points))
    np.testing.assert_allclose(sample.x.array, exact.x.array, atol=1e-12)


def test_too_fine():
    with pytest.raises(InputError, match=r"asks for about .* cells"):
        build_domain(MPI.COMM_SELF, "square", 1e-5, mesh="structured")
