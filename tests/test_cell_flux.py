"""Products of fluxes cell by cell against the forms; fluxes on Γ_S by the equations of its facets."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.backends.hybrid import HybridBackend
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.discrete.cell_flux import CellFlux
from signorini_fenicsx.discrete.spaces import assembled, build_spaces
from signorini_fenicsx.meshes.meshing import build_domain


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("shape", ["square", "cube"])
def test_products(shape: str):
    spaces = build_spaces(build_domain(MPI.COMM_WORLD, shape, 0.5, mesh="unstructured"), ["bottom"])
    sigma, tau, dim = fem.Function(spaces.V), ufl.TestFunction(spaces.V), spaces.mesh.geometry.dim
    sigma.interpolate(lambda x: np.sin(9 * x[:dim]) + x[1])
    sigma.x.scatter_forward()
    cells, x = CellFlux.of(spaces, sigma), np.arange(dim**2).reshape(dim, dim)
    matrix = (x + x.T) / 9 + 2 * np.eye(dim)
    per_cell = np.repeat(matrix[:, :, None], len(cells.out), axis=2)
    for weight, form in ((2.0, 2 * ufl.Identity(dim)), (per_cell, ufl.as_matrix(matrix))):
        image = form * sigma
        square = spaces.integrate(ufl.inner(image, sigma) * ufl.dx)
        assert MPI.COMM_WORLD.allreduce(cells.squares(weight).sum()) == pytest.approx(square, rel=1e-12)
        owned = spaces.V.dofmap.index_map.size_local
        found = cells.joined(spaces.outflow * cells.tested(weight))[:owned]
        np.testing.assert_allclose(found, assembled(ufl.inner(image, tau) * ufl.dx)[:owned], rtol=0, atol=1e-13)
        rows = fem.petsc.assemble_matrix(fem.form(ufl.inner(form * ufl.TrialFunction(spaces.V), tau) * ufl.dx))
        rows.assemble()
        np.testing.assert_allclose(cells.mass_diagonal(weight)[:owned], rows.getDiagonal().array_r, rtol=1e-12)
    np.testing.assert_allclose(cells.out, assembled(ufl.div(sigma) * ufl.TestFunction(spaces.Q) * ufl.dx), atol=1e-13)


@pytest.mark.parametrize("name", ["crack", "sphere", "wall"])
def test_fluxes_of_iterates(name: str):
    """What decides about the sets while an iterative solver runs is what its solution has in the end."""
    case = load_case(name).with_values({"solve.h": 0.5})
    solution = solve_case(case, MPI.COMM_SELF)
    backend = HybridBackend(solution.spaces, solution.data, tuning=Tuning(direct_up_to=0))
    conditions = solution.outcome.conditions
    if solution.data.obstacle is not None:
        contact = solution.outcome.iterate.contact
        conditions = backend.chains.conditions((~contact).astype(np.int8))
    done = backend.solve(conditions)
    p, flux = backend.solve_until(conditions, lambda p, flux: False)
    np.testing.assert_allclose(p, done.p, atol=1e-13)
    np.testing.assert_allclose(flux, done.flux, atol=1e-9 * np.abs(done.flux).max())
