"""The mixed multiplier formulations (MLM-I)_h, equation (9), and (MLM-II)_h, equation (10).

Strong form: σ = κ∇u, ∇·σ + f = 0 in Ω, u = u_D on Γ_D, σ·n = g_N on Γ_N, and on Γ_S with p = u

    p ≥ ψ,   σ·n ≥ q_S,   (p − ψ)(σ·n − q_S) = 0.

The slides have κ = 1, no Γ_N and all other data but f zero. The Dirichlet data are natural: where u_D ≠ 0, the flux
equation gets the trace term of u_D on Γ_D beside that of p. Flux data are essential.

(9c) and (10c) are variational inequalities; as the elementwise projections below they are equations, for any ρ > 0.
"""

from ufl import Form, Measure, as_ufl, div, dot, dx, inner, inv, max_value
from ufl.core.expr import Expr

ONE = as_ufl(1.0)


def flux_product(sigma: Expr, tau: Expr, kappa: Expr = ONE) -> Form:
    """(κ⁻¹σ, τ) with κ a scalar or a matrix."""
    return inner(inv(kappa) * sigma, tau) * dx


def flux_equation(sigma: Expr, u: Expr, tau: Expr, kappa: Expr = ONE) -> Form:
    """(κ⁻¹σ, τ) + (u, ∇·τ): the left side of (11b) and (12)."""
    return flux_product(sigma, tau, kappa) + u * div(tau) * dx


def trace_term(p: Expr, tau: Expr, n: Expr, ds_signorini: Measure) -> Form:
    """(p, τ·n) on Γ_S: what (9a) adds to the flux equation, and the left side of (12)."""
    return p * dot(tau, n) * ds_signorini


def mass_balance(sigma: Expr, v: Expr) -> Form:
    """(∇·σ, v): the left side of (9b)."""
    return div(sigma) * v * dx


def load(f: Expr, v: Expr) -> Form:
    """(f, v): local mass balance (9b) is mass_balance + load = 0."""
    return f * v * dx


def flux_projection(sigma: Expr, p: Expr, q: Expr, rho: float, n: Expr, ds_signorini: Measure) -> Form:
    """(σ·n − max(0, σ·n − ρp), q) on Γ_S, which (9c) makes vanish for all q."""
    flux = dot(sigma, n)
    return (flux - max_value(0, flux - rho * p)) * q * ds_signorini


def trace_projection(sigma: Expr, p: Expr, q: Expr, rho: float, n: Expr, ds_signorini: Measure) -> Form:
    """(p − max(0, p − ρσ·n), q) on Γ_S, which (10c) makes vanish for all q."""
    return (p - max_value(0, p - rho * dot(sigma, n))) * q * ds_signorini


def multiplier_residual(
    sigma: Expr,
    u: Expr,
    p: Expr,
    f: Expr,
    tau: Expr,
    v: Expr,
    n: Expr,
    ds_signorini: Measure,
    kappa: Expr = ONE,
) -> list[Form]:
    """Residuals of (9a) and (9b), which are also (10a) and (10b), as forms in τ and v."""
    return [
        flux_equation(sigma, u, tau, kappa) - trace_term(p, tau, n, ds_signorini),
        mass_balance(sigma, v) + load(f, v),
    ]
