"""Exact solutions: the energy of the error, and one on the unit square, in contact at the bottom for x < x0.

u = (s₊³ − y s₋³) x(1 − x)(1 − y²) with s = x − x0. On y = 0: u = s₊³ x(1 − x) ≥ 0 and σ·n = −∂_y u = s₋³ x(1 − x) ≥ 0,
never both positive; u = 0 on the other three sides.
"""

import math

from ufl import as_vector, max_value
from ufl.core.expr import Expr

from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.discrete.points import cell_quadrature
from signorini_fenicsx.physics.diffusion.solution import Solution

X0 = 0.413

F = (
    f"-((1-y^2)*((6*max(x-{X0},0) - 6*y*max({X0}-x,0))*x*(1-x)"
    f" + 2*(3*max(x-{X0},0)^2 + 3*y*max({X0}-x,0)^2)*(1-2*x)"
    f" - 2*(max(x-{X0},0)^3 - y*max({X0}-x,0)^3))"
    f" + x*(1-x)*(4*y*max({X0}-x,0)^3 - 2*(max(x-{X0},0)^3 - y*max({X0}-x,0)^3)))"
)
"""f = −Δu as a case writes it."""


def exact_u(x: Expr) -> Expr:
    """Solution u."""
    plus, minus = max_value(x[0] - X0, 0), max_value(X0 - x[0], 0)
    return (plus**3 - x[1] * minus**3) * x[0] * (1 - x[0]) * (1 - x[1] ** 2)


def exact_sigma(x: Expr) -> Expr:
    """σ = ∇u, written out because the derivative of max is not defined at the kink."""
    plus, minus = max_value(x[0] - X0, 0), max_value(X0 - x[0], 0)
    a, b, c = plus**3 - x[1] * minus**3, x[0] * (1 - x[0]), 1 - x[1] ** 2
    a_x = 3 * plus**2 + 3 * x[1] * minus**2
    return as_vector([(a_x * b + a * (1 - 2 * x[0])) * c, b * (-(minus**3) * c - 2 * x[1] * a)])


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
