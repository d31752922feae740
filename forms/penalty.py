"""The mixed penalty formulations (MPε-I)_h, equation (25), and (MPε-II)_h, equation (26).

Strong form: σ = ∇u, ∇·σ + f = 0 in Ω, u = 0 on Γ_D, and on Γ_S with p = u and [s]_- = max(0, −s)

    (MPε-I)   σ·n = [p]_-/ε,      (MPε-II)   p = [σ·n]_-/ε.

Each law is also a complementarity condition without 1/ε. Newton's method gets this one: with the law as it stands above
Newton stalls or converges falsely for small ε, because errors of p are divided by ε.

    (MPε-I)   min(σ·n, p + εσ·n) = 0,      (MPε-II)   min(p, σ·n + εp) = 0.
"""

from ufl import Form, Measure, dot, max_value, min_value
from ufl.core.expr import Expr

from signorini_fenicsx.forms.mixed import Fields, flux_equation, load, mass_balance, trace_term


def mp_eps_1(unknowns: Fields, tests: Fields, f: Expr, eps: Expr, n: Expr, dx: Measure, ds: Measure) -> list[Form]:
    """(MPε-I)_h, the residuals of (25) for all τ, v, q, with 1/ε; only tests call it."""
    (sigma, u, p), (tau, v, q) = unknowns, tests
    return [
        flux_equation(sigma, u, tau, dx) - trace_term(p, tau, n, ds),  # (25a)
        mass_balance(sigma, v, dx) + load(f, v, dx),  # (25b)
        (dot(sigma, n) - negative_part(p) / eps) * q * ds,  # (25c)
    ]


def mp_eps_2(unknowns: Fields, tests: Fields, f: Expr, eps: Expr, n: Expr, dx: Measure, ds: Measure) -> list[Form]:
    """(MPε-II)_h, the residuals of (26) for all τ, v, with 1/ε; only tests call it.

    The traces are not used: (26) has the unknowns σ and u alone.
    """
    (sigma, u, _), (tau, v, _) = unknowns, tests
    return [
        flux_equation(sigma, u, tau, dx) - trace_term(negative_part(dot(sigma, n)) / eps, tau, n, ds),  # (26a)
        mass_balance(sigma, v, dx) + load(f, v, dx),  # (26b)
    ]


def negative_part(s: Expr) -> Expr:
    """[s]_- = max(0, −s)."""
    return max_value(0, -s)


def trace_penalty_law(sigma: Expr, p: Expr, q: Expr, eps: Expr, n: Expr, ds: Measure) -> Form:
    """(25c) without 1/ε: (min(σ·n, p + εσ·n), q) on Γ_S."""
    flux = dot(sigma, n)
    return min_value(flux, p + eps * flux) * q * ds


def flux_penalty_law(sigma: Expr, p: Expr, q: Expr, eps: Expr, n: Expr, ds: Measure) -> Form:
    """The penalty of (26a) without 1/ε, with p as third unknown: (min(p, σ·n + εp), q) on Γ_S."""
    return min_value(p, dot(sigma, n) + eps * p) * q * ds
