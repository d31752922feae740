"""The mixed multiplier formulations (MLM-I)_h, equation (9), and (MLM-II)_h, equation (10).

Strong form: σ = κ∇u, ∇·σ + f = 0 in Ω, u = u_D on Γ_D, σ·n = g_N on Γ_N, and on Γ_S with p = u

    p ≥ ψ,   σ·n ≥ q_S,   (p − ψ)(σ·n − q_S) = 0.

The slides have κ = 1, no Γ_N and all other data but f zero, and so have `mlm_1` and `mlm_2`. The terms that they are
made of are what backends assemble. The Dirichlet data are natural: where u_D ≠ 0, the flux equation gets the trace term
of u_D on Γ_D beside that of p. Flux data are essential.
"""

from typing import NamedTuple

from ufl import Form, Measure, as_ufl, div, dot, inner, inv, max_value
from ufl.core.expr import Expr

ONE = as_ufl(1.0)


class Fields(NamedTuple):
    """A flux in V_h, a scalar in Q_h and a trace in Λ_h: the unknowns (σ, u, p) or the test functions (τ, v, q)."""

    flux: Expr
    scalar: Expr
    trace: Expr


def mlm_1(unknowns: Fields, tests: Fields, f: Expr, rho: float, n: Expr, dx: Measure, ds: Measure) -> list[Form]:
    """(MLM-I)_h, the residuals of (9) for all τ, v, q; called by tests alone, as Algorithm 1 solves it by sets.

    (9c) is a variational inequality. As a projection, for any ρ > 0, it is the equation σ·n = max(0, σ·n − ρp).
    """
    (sigma, u, p), (tau, v, q) = unknowns, tests
    return [
        flux_equation(sigma, u, tau, dx) - trace_term(p, tau, n, ds),  # (9a)
        mass_balance(sigma, v, dx) + load(f, v, dx),  # (9b)
        (dot(sigma, n) - max_value(0, dot(sigma, n) - rho * p)) * q * ds,  # (9c)
    ]


def mlm_2(unknowns: Fields, tests: Fields, f: Expr, rho: float, n: Expr, dx: Measure, ds: Measure) -> list[Form]:
    """(MLM-II)_h, the residuals of (10) for all τ, v, q; called by tests alone, as Algorithm 2 solves it by sets.

    (10c) is a variational inequality. As a projection, for any ρ > 0, it is the equation p = max(0, p − ρσ·n).
    """
    (sigma, u, p), (tau, v, q) = unknowns, tests
    return [
        flux_equation(sigma, u, tau, dx) - trace_term(p, tau, n, ds),  # (10a)
        mass_balance(sigma, v, dx) + load(f, v, dx),  # (10b)
        (p - max_value(0, p - rho * dot(sigma, n))) * q * ds,  # (10c)
    ]


def flux_equation(sigma: Expr, u: Expr, tau: Expr, dx: Measure, kappa: Expr = ONE) -> Form:
    """(κ⁻¹σ, τ) + (u, ∇·τ): the left side of (11b), the right side of (12)."""
    return flux_product(sigma, tau, dx, kappa) + u * div(tau) * dx


def flux_product(sigma: Expr, tau: Expr, dx: Measure, kappa: Expr = ONE) -> Form:
    """(κ⁻¹σ, τ) with κ a scalar or a matrix."""
    return inner(inv(kappa) * sigma, tau) * dx


def trace_term(p: Expr, tau: Expr, n: Expr, ds: Measure) -> Form:
    """(p, τ·n): on Γ_S what (9a) takes from the flux equation, and the left side of (12)."""
    return p * dot(tau, n) * ds


def mass_balance(sigma: Expr, v: Expr, dx: Measure) -> Form:
    """(∇·σ, v)."""
    return div(sigma) * v * dx


def load(f: Expr, v: Expr, dx: Measure) -> Form:
    """(f, v)."""
    return f * v * dx
