"""The mixed penalty formulations (MPε-I)_h, equation (25), and (MPε-II)_h, equation (26).

Strong form: σ = ∇u, ∇·σ + f = 0 in Ω, u = 0 on Γ_D, and on Γ_S with p = u and [s]_- = max(0, −s)

    (MPε-I)   σ·n = [p]_-/ε,      (MPε-II)   p = [σ·n]_-/ε.

Each law is also a complementarity condition without 1/ε, which is what Newton's method is given: the literal one stalls
or converges falsely for small ε, because an error of p appears divided by ε.

    (MPε-I)   min(σ·n, p + εσ·n) = 0,      (MPε-II)   min(p, σ·n + εp) = 0.
"""

from ufl import Coefficient, Form, Measure, dot, max_value, min_value
from ufl.core.expr import Expr

from signorini_fenicsx.forms.mixed import flux_equation, load, mass_balance, multiplier_residual


def negative_part(s: Expr) -> Expr:
    """[s]_- = max(0, −s)."""
    return max_value(0, -s)


def trace_penalty_residual(
    sigma: Coefficient,
    u: Coefficient,
    p: Coefficient,
    f: Expr,
    tau: Expr,
    v: Expr,
    q: Expr,
    eps: Expr,
    n: Expr,
    ds_signorini: Measure,
) -> list[Form]:
    """(25a), (25b), (25c) as they stand, as forms in τ, v and q."""
    law = (dot(sigma, n) - negative_part(p) / eps) * q * ds_signorini
    return [*multiplier_residual(sigma, u, p, f, tau, v, n, ds_signorini), law]


def flux_penalty_residual(
    sigma: Coefficient, u: Coefficient, f: Expr, tau: Expr, v: Expr, eps: Expr, n: Expr, ds_signorini: Measure
) -> list[Form]:
    """(26a), (26b) as they stand, as forms in τ and v."""
    penalty = negative_part(dot(sigma, n)) / eps * dot(tau, n) * ds_signorini
    return [flux_equation(sigma, u, tau) - penalty, mass_balance(sigma, v) + load(f, v)]


def trace_penalty_law(sigma: Expr, p: Expr, q: Expr, eps: Expr, n: Expr, ds_signorini: Measure) -> Form:
    """(25c) without 1/ε: (min(σ·n, p + εσ·n), q) on Γ_S."""
    flux = dot(sigma, n)
    return min_value(flux, p + eps * flux) * q * ds_signorini


def flux_penalty_law(sigma: Expr, p: Expr, q: Expr, eps: Expr, n: Expr, ds_signorini: Measure) -> Form:
    """The penalty of (26a) without 1/ε, with p as third unknown: (min(p, σ·n + εp), q) on Γ_S."""
    return min_value(p, dot(sigma, n) + eps * p) * q * ds_signorini
