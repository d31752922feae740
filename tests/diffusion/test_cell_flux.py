"""Products of fluxes cell by cell against the forms."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.discrete.mesh_spaces import assembled
from signorini_fenicsx.discrete.points import cell_quadrature
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux, joined, mass_diagonal
from signorini_fenicsx.physics.diffusion.discrete.spaces import build_spaces


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("shape", ["square", "cube"])
def test_flux(shape: str):
    spaces = build_spaces(build_domain(MPI.COMM_WORLD, shape, 0.5, mesh="unstructured"), ["bottom"])
    sigma, tau, dim = fem.Function(spaces.V), ufl.TestFunction(spaces.V), spaces.mesh.geometry.dim
    sigma.interpolate(lambda x: np.sin(9 * x[:dim]) + x[1])
    sigma.x.scatter_forward()
    flux, volume = CellFlux.of(spaces, sigma), spaces.cell_measures
    linear = fem.Function(fem.functionspace(spaces.mesh, ("DG", 1, (dim,))))
    linear.interpolate(sigma)
    np.testing.assert_allclose(flux.in_vertices(), linear.x.array.reshape(-1, dim + 1, dim), atol=1e-12)
    for points in cell_quadrature(spaces.mesh, owned_cells(spaces.mesh), 2):
        np.testing.assert_allclose(flux.at(points), points.of_ufl(sigma), atol=1e-12)
    divergence = assembled(ufl.div(sigma) * ufl.TestFunction(spaces.Q) * ufl.dx)
    np.testing.assert_allclose(volume * flux.divergence, divergence, atol=1e-13)
    x = np.arange(dim**2).reshape(dim, dim)
    matrix = (x + x.T) / 9 + 2 * np.eye(dim)
    image, owned = ufl.as_matrix(matrix.tolist()) * sigma, spaces.V.dofmap.index_map.size_local
    rows = fem.petsc.assemble_matrix(
        fem.form(ufl.inner(ufl.as_matrix(matrix) * ufl.TrialFunction(spaces.V), tau) * ufl.dx)
    )
    rows.assemble()
    twice = 2 * np.eye(dim)
    np.testing.assert_allclose(flux.squares(2.0), flux.squares(twice), rtol=1e-13)
    np.testing.assert_allclose(flux.tested(2.0), flux.tested(twice), atol=1e-13)
    np.testing.assert_allclose(mass_diagonal(spaces, 2.0), mass_diagonal(spaces, twice), rtol=1e-13)
    for each in (matrix, np.repeat(matrix[None], len(volume), axis=0)):
        square = assembled(ufl.inner(image, sigma) * ufl.TestFunction(spaces.Q) * ufl.dx)
        np.testing.assert_allclose(flux.squares(each), square, rtol=1e-11)
        found = joined(spaces, spaces.outflow * flux.tested(each))[:owned]
        np.testing.assert_allclose(found, assembled(ufl.inner(image, tau) * ufl.dx)[:owned], rtol=0, atol=1e-13)
        np.testing.assert_allclose(mass_diagonal(spaces, each)[:owned], rows.getDiagonal().array_r, rtol=1e-12)
