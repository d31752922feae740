"""Squares of the norms in which the theory measures errors. To get a norm: integrate, sum over ranks, take the root."""

from ufl import Form, Measure, div, inner
from ufl.core.expr import Expr


def l2(v: Expr, measure: Measure) -> Form:
    """‖v‖² in L²: over Ω it is ‖u‖_Q², over Γ_S it is ‖p‖_Λ²."""
    return inner(v, v) * measure


def v_norm(sigma: Expr, measure: Measure) -> Form:
    """‖σ‖_V² = ‖σ‖² + ‖∇·σ‖²: the norm of H(div; Ω)."""
    return l2(sigma, measure) + l2(div(sigma), measure)
