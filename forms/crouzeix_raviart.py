"""The Crouzeix-Raviart problem whose solution is that of the mixed RT0/P0 method, and the way back to it.

With f_h the P0 projection of f, let u_CR solve (∇_h u_CR, ∇_h v) = (f_h, v) with the facet conditions of Γ_S imposed on
facet means. Then, with x_T the centroid of cell T and d the dimension (Marini 1985),

    p_h|_e = mean of u_CR on e,
    σ_h|_T = ∇u_CR − (f_h/d)(x − x_T),
    u_h|_T = mean over T of u_CR + (f_h/d²)|x − x_T|².

Why: this σ has ∇·σ = −f_h; its normal fluxes are constant on facets and, by the equation tested with the basis function
of a facet, equal from both sides; and integration by parts of (∇u_CR, τ) cell by cell gives (9a) with these u and p.
"""

from ufl import Form, SpatialCoordinate, dx, grad, inner
from ufl.core.expr import Expr


def stiffness(u: Expr, v: Expr) -> Form:
    """(∇_h u, ∇_h v), cell by cell."""
    return inner(grad(u), grad(v)) * dx


def recovered_flux(u_cr: Expr, f_h: Expr, centroid: Expr, x: SpatialCoordinate) -> Expr:
    """σ_h = ∇u_CR − (f_h/d)(x − x_T), an RT0 field."""
    return grad(u_cr) - f_h / len(x) * (x - centroid)


def recovered_scalar(u_cr: Expr, f_h: Expr, centroid: Expr, x: SpatialCoordinate, v: Expr) -> Form:
    """(u_CR + (f_h/d²)|x − x_T|², v), which divided by |T| is u_h for v the indicator of T."""
    return (u_cr + f_h / len(x) ** 2 * inner(x - centroid, x - centroid)) * v * dx
