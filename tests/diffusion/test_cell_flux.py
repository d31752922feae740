"""Products of fluxes cell by cell against the forms; fluxes on Γ_S by the equations of its facets."""

from itertools import chain
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_cube, create_unit_square
from mpi4py import MPI

from signorini_fenicsx.base.arrays import determinants, inverses
from signorini_fenicsx.base.owned import cell_nodes, owned_cells
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.mesh_spaces import assembled
from signorini_fenicsx.discrete.points import cell_quadrature
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.bound.relaxation import _Gap
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux, joined, mass_diagonal
from signorini_fenicsx.physics.diffusion.discrete.nodes import Jumps
from signorini_fenicsx.physics.diffusion.discrete.spaces import build_spaces
from signorini_fenicsx.physics.diffusion.solve.hybrid import HybridBackend


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


def test_nodes_of_cells_are_kept():
    """Some cells at a time must not cost a copy of the numbers of all; entries of one kind are together."""
    mesh = create_unit_cube(MPI.COMM_SELF, 2, 3, 2)
    assert cell_nodes(mesh) is cell_nodes(mesh)
    assert corners(mesh, slice(3, 9)) == pytest.approx(mesh.geometry.x[mesh.geometry.dofmaps[0][3:9]])
    assert corners(mesh).flags.f_contiguous


@pytest.mark.parametrize("name", ["crack", "sphere", "wall"])
def test_fluxes_of_iterates(name: str):
    """What decides about the sets while an iterative solver runs is what its solution has in the end."""
    case = load_case(name).with_values({"solve.h": 0.5})
    solution = solve_case(case, MPI.COMM_SELF)
    backend = HybridBackend(solution.spaces, solution.data, tuning=Tuning(direct_up_to=0))
    conditions = solution.outcome.conditions
    done = backend.solve(conditions)
    p, flux = backend.solve_until(conditions, lambda p, flux: False)
    np.testing.assert_allclose(p, done.p, atol=1e-13)
    np.testing.assert_allclose(flux, done.flux, atol=1e-9 * np.abs(done.flux).max())


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_small_matrices(dim: int):
    """Those of `numpy.linalg`; a matrix without an inverse has none that is finite."""
    matrices = np.random.default_rng(dim).normal(size=(50, dim, dim))
    assert determinants(matrices) == pytest.approx(np.linalg.det(matrices), rel=1e-11)
    if dim > 1:
        assert inverses(matrices) == pytest.approx(np.linalg.inv(matrices), rel=1e-9)
        with np.errstate(all="ignore"):
            assert not np.isfinite(inverses(np.ones((1, dim, dim)))).any()


@pytest.mark.parametrize("dim", [2, 3])
def test_gap_without_its_matrix(dim: int):
    """The gap, its slope and steps of CG are the same by the form alone and by its matrix."""
    mesh, random = (
        create_unit_square(MPI.COMM_SELF, 3, 4) if dim == 2 else create_unit_cube(MPI.COMM_SELF, 2, 3, 2),
        np.random.default_rng(2),
    )
    space, kappa = fem.functionspace(mesh, ("Lagrange", 2)), fem.Function(fem.functionspace(mesh, ("DG", 0)))
    y, v = fem.Function(fem.functionspace(mesh, ("RT", 1))), fem.Function(space)
    for function in (y, v, kappa):
        function.x.array[:] = random.uniform(1, 2, len(function.x.array))
    ones, zeros = np.ones(len(v.x.array)), np.zeros(len(v.x.array))
    nowhere: Any = None  # spaces are for jumps
    gap = _Gap(space, nowhere, y, (kappa, ufl.dx), ones, zeros, None, None, Jumps.nowhere(space))
    free = random.uniform(size=len(v.x.array)) < 0.7
    found = [gap.at(v), gap.lowered(np.where(free, gap.at(v)[1], 0.0), free, 3)]
    gap.assemble()
    again = [gap.at(v), gap.lowered(np.where(free, gap.at(v)[1], 0.0), free, 3)]
    for before, after in zip(chain(*found), chain(*again), strict=True):
        assert before == pytest.approx(after, rel=1e-11, abs=1e-11)
    gap.destroy()
