"""The gap identity, which turns a discrete flux and a discrete trace into a guaranteed bound of the error.

Let u solve the Signorini problem and σ = ∇u. For any v ∈ H¹ with v = u_D on Γ_D, v ≥ 0 on Γ_S, and any y ∈ H(div)
with ∇·y = −f, y·n ≥ 0 on Γ_S (Bartels, Gudi, Kaltenbach, arXiv 2407.10912)

    ½‖∇(v − u)‖² + ⟨σ·n, v⟩ + ½‖y − σ‖² + ⟨y·n, u⟩ = ½‖∇v − y‖² + ⟨y·n, v⟩ =: gap(v, y),   ⟨·,·⟩ on Γ_S.

Proof: ½‖∇v − y‖² = ½‖∇(v − u)‖² + ½‖σ − y‖² + (∇(v − u), σ − y). As ∇·(σ − y) = 0 and v = u on Γ_D, the last term is
⟨(σ − y)·n, v − u⟩, which is ⟨σ·n, v⟩ − ⟨y·n, v⟩ + ⟨y·n, u⟩ because u σ·n = 0. All terms on the left are ≥ 0.
"""

from ufl import Form, Measure, conditional, div, dot, grad, gt, inner, max_value, pi
from ufl.core.expr import Expr


def reconstruction(u: Expr, sigma: Expr, centroid: Expr, second_moment: Expr, x: Expr) -> Expr:
    """The quadratic on each cell T with gradient σ_h and mean u_h: exact where σ_h and u_h are.

    As σ_h = σ_h(x_T) + (∇·σ_h/d)(x − x_T), it is u_h + σ_h(x_T)·(x − x_T) + (∇·σ_h/2d)(|x − x_T|² − M_T) with M_T the
    mean of |x − x_T|² over T, its `second_moment`.
    """
    r = x - centroid
    return u + dot(sigma, r) - div(sigma) / (2 * len(x)) * (dot(r, r) + second_moment)


def with_exact_dirichlet_values(v: Expr, u_D: Expr, interpolant: Expr, cut_off: Expr, floor: Expr) -> Expr:
    """max(v + χ(u_D − I_h u_D), ℓ): u_D itself on Γ_D, where v = I_h u_D, and not negative on Γ_S.

    Args:
        v: Continuous, v = I_h u_D on Γ_D.
        u_D: Dirichlet data, defined near Γ_D.
        interpolant: I_h u_D.
        cut_off: χ, continuous, 1 on Γ_D and 0 a cell away from it.
        floor: ℓ, continuous, 0 on Γ_S and far below v elsewhere.
    """
    return max_value(v + conditional(gt(cut_off, 0), cut_off * (u_D - interpolant), 0), floor)


def flux_gap(v: Expr, y: Expr, q: Expr, measure: Measure) -> Form:
    """‖∇v − y‖², weighted by q: with the indicator of T what T contributes to 2 gap(v, y)."""
    return inner(grad(v) - y, grad(v) - y) * q * measure


def contact_gap(v: Expr, y: Expr, n: Expr, q: Expr, ds_signorini: Measure) -> Form:
    """2⟨y·n, v⟩ on Γ_S, weighted by q: the rest of 2 gap(v, y)."""
    return 2 * dot(y, n) * v * q * ds_signorini


def oscillation_squared(f: Expr, f_h: Expr, diameter: Expr, q: Expr, measure: Measure) -> Form:
    """(h_T/π)²‖f − f_h‖²_T, weighted by q.

    (f − f_h, w) ≤ Σ_T (h_T/π)‖f − f_h‖_T ‖∇w‖_T, since f − f_h has mean 0 on T (Payne, Weinberger; Bebendorf).
    """
    return (diameter / pi * (f - f_h)) ** 2 * q * measure
