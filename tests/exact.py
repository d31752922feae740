"""The energy of the error of an exact solution."""

import math

from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.discrete.points import cell_quadrature
from signorini_fenicsx.physics.diffusion.solution import Solution


def energy_error(solution: Solution) -> float:
    """‖κ^-½(σ − σ_h)‖ where u is known."""
    data, flux, square = solution.data, solution.cell_flux, 0.0
    assert data.exact is not None
    mesh = solution.spaces.mesh
    for points in cell_quadrature(mesh, owned_cells(mesh), 8):
        kappa = data.kappa.values(points)
        gap = kappa[:, :, None] * data.exact.jet(points, gradient=True)[:, :, 1:]
        gap -= flux.at(points)
        square += points.integrals((gap**2).sum(axis=2) / kappa).sum()
    return math.sqrt(mesh.comm.allreduce(square))
