"""What is computed cell by cell in NumPy, against DOLFINx and numpy.linalg."""

from itertools import chain

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, create_unit_cube, create_unit_square
from mpi4py import MPI

from signorini_fenicsx.base.small_matrices import determinants, inverses
from signorini_fenicsx.certificate.relaxation import _Gap
from signorini_fenicsx.discrete.cell_flux import CellFlux
from signorini_fenicsx.discrete.points import cell_quadrature, owned_cells

COMM = MPI.COMM_SELF
MESHES = {
    2: lambda: create_unit_square(COMM, 3, 4),
    3: lambda: create_unit_cube(COMM, 2, 3, 2, CellType.tetrahedron),
}


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_small_matrices(dim: int):
    """Those of `numpy.linalg`; a matrix without an inverse has none that is finite."""
    matrices = np.random.default_rng(dim).normal(size=(50, dim, dim))
    assert determinants(matrices) == pytest.approx(np.linalg.det(matrices), rel=1e-11)
    if dim > 1:
        assert inverses(matrices) == pytest.approx(np.linalg.inv(matrices), rel=1e-9)
        with np.errstate(all="ignore"):
            assert not np.isfinite(inverses(np.ones((1, dim, dim)))).any()


@pytest.mark.parametrize("dim", MESHES)
def test_flux(dim: int):
    """Values, divergence and squares of any flux, on cells of both orientations."""
    mesh, random = MESHES[dim](), np.random.default_rng(1)
    mesh.geometry.x[:, :dim] += random.uniform(-0.1, 0.1, (len(mesh.geometry.x), dim))
    sigma = fem.Function(fem.functionspace(mesh, ("RT", 1)))
    sigma.x.array[:] = random.normal(size=len(sigma.x.array))
    linear, constant = fem.functionspace(mesh, ("DG", 1, (dim,))), fem.functionspace(mesh, ("DG", 0))
    expected, flux = fem.Function(linear), CellFlux.of(sigma)
    expected.interpolate(sigma)
    assert flux.in_vertices() == pytest.approx(expected.x.array.reshape(-1, dim + 1, dim), rel=1e-11, abs=1e-11)
    for points in cell_quadrature(mesh, owned_cells(mesh), 2):
        assert flux.at(points) == pytest.approx(points.of_ufl(sigma), rel=1e-11, abs=1e-11)
        volume = points.integrals(np.ones(points.shape))
    v, matrix = ufl.TestFunction(constant), random.normal(size=(dim, dim))
    for found, form in (
        (flux.divergence, ufl.div(sigma)),
        (flux.squares(), ufl.inner(sigma, sigma)),
        (flux.squares(matrix), ufl.inner(ufl.as_matrix(matrix.tolist()) * sigma, sigma)),
    ):
        assert volume * found == pytest.approx(fem.assemble_vector(fem.form(form * v * ufl.dx)).array, rel=1e-10)


@pytest.mark.parametrize("dim", MESHES)
def test_gap_without_its_matrix(dim: int):
    """The gap, its slope and steps of CG are the same by the form alone and by its matrix."""
    mesh, random = MESHES[dim](), np.random.default_rng(2)
    space, kappa = fem.functionspace(mesh, ("Lagrange", 2)), fem.Function(fem.functionspace(mesh, ("DG", 0)))
    y, w, psi = fem.Function(fem.functionspace(mesh, ("RT", 1))), fem.Function(space), fem.Function(space)
    for function in (y, w, psi, kappa):
        function.x.array[:] = random.uniform(1, 2, len(function.x.array))
    gap = _Gap(space, psi, y, kappa, np.ones(len(w.x.array)), None, None)
    free = random.uniform(size=len(w.x.array)) < 0.7
    found = [gap.at(w), gap.lowered(np.where(free, gap.at(w)[1], 0.0), free, 3)]
    gap.assemble()
    again = [gap.at(w), gap.lowered(np.where(free, gap.at(w)[1], 0.0), free, 3)]
    for before, after in zip(chain(*found), chain(*again), strict=True):
        assert before == pytest.approx(after, rel=1e-11, abs=1e-11)
    gap.destroy()
