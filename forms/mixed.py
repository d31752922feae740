"""The mixed multiplier formulations (MLM-I)_h, equation (9), and (MLM-II)_h, equation (10).

Strong form: σ = κ∇u, ∇·σ + f = 0 in Ω, u = u_D on Γ_D, σ·n = g_N on Γ_N, and on Γ_S with p = u

    p ≥ ψ,   σ·n ≥ q_S,   (p − ψ)(σ·n − q_S) = 0.

In the slides, and in `mlm_1` and `mlm_2`, κ = 1, there is no Γ_N, and all data except f are zero. Backends assemble the
terms of these formulations. The Dirichlet data are natural: the flux equation gets the trace term of u_D on Γ_D in
addition to that of p. Flux data are essential.
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
    """(MLM-I)_h, the residuals of (9) for all τ, v, q; only tests call it, because Algorithm 1 works with sets.

    (9c) is a variational inequality. For any ρ > 0 it is equivalent to the equation σ·n = max(0, σ·n − ρp).
    """
    (sigma, u, p), (tau, v, q) = unknowns, tests
    return [
        flux_equation(sigma, u, tau, dx) - trace_term(p, tau, n, ds),  # (9a)
        mass_balance(sigma, v, dx) + load(f, v, dx),  # (9b)
        (dot(sigma, n) - max_value(0, dot(sigma, n) - rho * p)) * q * ds,  # (9c)
    ]


def mlm_2(unknowns: Fields, tests: Fields, f: Expr, rho: float, n: Expr, dx: Measure, ds: Measure) -> list[Form]:
    """(MLM-II)_h, the residuals of (10) for all τ, v, q; only tests call it, because Algorithm 2 works with sets.

    (10c) is a variational inequality. For any ρ > 0 it is equivalent to the equation p = max(0, p − ρσ·n).
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
    """(p, τ·n): subtracted in (9a) on Γ_S, and the left side of (12)."""
    return p * dot(tau, n) * ds


def mass_balance(sigma: Expr, v: Expr, dx: Measure) -> Form:
    """(∇·σ, v)."""
    return div(sigma) * v * dx


def load(f: Expr, v: Expr, dx: Measure) -> Form:
    """(f, v)."""
    return f * v * dx
