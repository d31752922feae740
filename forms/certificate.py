"""The gap identity, which turns a discrete flux and a discrete trace into a guaranteed bound of the error.

Let u solve the Signorini problem and σ = κ∇u. For any v ∈ H¹ with v = u_D on Γ_D, v ≥ ψ on Γ_S, and any y ∈ H(div)
with ∇·y = −f, y·n = g_N on Γ_N, y·n ≥ q_S on Γ_S (Bartels, Gudi, Kaltenbach, arXiv 2407.10912, for κ = 1 and ψ = q_S =
0)

    ½|∇(v − u)|² + ⟨σ·n − q_S, v − ψ⟩ + ½‖y − σ‖² + ⟨y·n − q_S, u − ψ⟩ = ½‖κ∇v − y‖² + ⟨y·n − q_S, v − ψ⟩ =: gap(v, y)

with ⟨·,·⟩ on Γ_S and the energy norms |∇w|² = (κ∇w, ∇w), ‖τ‖² = (κ⁻¹τ, τ).

Proof: ½‖κ∇v − y‖² = ½|∇(v − u)|² + ½‖σ − y‖² + (∇(v − u), σ − y). As ∇·(σ − y) = 0, v = u on Γ_D and (σ − y)·n = 0 on
Γ_N, the last term is ⟨(σ − y)·n, v − u⟩, which is ⟨σ·n − q_S, v − ψ⟩ − ⟨y·n − q_S, v − ψ⟩ + ⟨y·n − q_S, u − ψ⟩ because
(u − ψ)(σ·n − q_S) = 0. All terms on the left are ≥ 0.
"""

from ufl import (
    CellDiameter,
    CellVolume,
    FacetArea,
    FacetNormal,
    Form,
    Measure,
    conditional,
    div,
    dot,
    grad,
    gt,
    inner,
    inv,
    max_value,
    pi,
)
from ufl.core.expr import Expr


def second_moment(centroid: Expr, x: Expr, kappa: Expr) -> Expr:
    """(x − x_T)·κ_h⁻¹(x − x_T)."""
    return dot(inv(kappa) * (x - centroid), x - centroid)


def reconstruction(u: Expr, sigma: Expr, centroid: Expr, mean_moment: Expr, x: Expr, kappa: Expr) -> Expr:
    """The quadratic on each cell T with gradient κ_h⁻¹σ_h and mean u_h: exact where σ_h and u_h are.

    As σ_h = σ_h(x_T) + (∇·σ_h/d)(x − x_T), it is, with m the second moment and M_T its mean over T, u_h +
    κ_h⁻¹σ_h(x_T)·(x − x_T) + (∇·σ_h/2d)(m − M_T).
    """
    linear = dot(inv(kappa) * sigma, x - centroid)
    return u + linear - div(sigma) / (2 * len(x)) * (second_moment(centroid, x, kappa) + mean_moment)


def with_exact_dirichlet_values(w: Expr, w_D: Expr, interpolant: Expr, cut_off: Expr, floor: Expr) -> Expr:
    """max(w + χ(w_D − I_h w_D), ℓ): w_D itself on Γ_D, where w = I_h w_D, and not negative on Γ_S.

    Args:
        w: Continuous, w = I_h w_D on Γ_D.
        w_D: Dirichlet data less the bound of Γ_S, defined near Γ_D.
        interpolant: I_h w_D.
        cut_off: χ, continuous, 1 on Γ_D and 0 a cell away from it.
        floor: ℓ, continuous, 0 on Γ_S and far below w elsewhere.
    """
    return max_value(w + conditional(gt(cut_off, 0), cut_off * (w_D - interpolant), 0), floor)


def covered(psi: Expr, interpolant: Expr, cut_off: Expr) -> Expr:
    """I_h ψ + χ(ψ − I_h ψ): ψ itself on Γ_S, where χ is 1, and I_h ψ a cell away from it."""
    return interpolant + conditional(gt(cut_off, 0), cut_off * (psi - interpolant), 0)


def flux_gap(v: Expr, y: Expr, kappa: Expr, q: Expr, measure: Measure) -> Form:
    """‖κ∇v − y‖² in the energy norm, weighted by q: with the indicator of T what T contributes to 2 gap(v, y)."""
    return inner(grad(v) - inv(kappa) * y, kappa * grad(v) - y) * q * measure


def contact_gap(gap: Expr, excess: Expr, n: Expr, q: Expr, ds_signorini: Measure) -> Form:
    """2⟨y·n − q_S, v − ψ⟩ on Γ_S, weighted by q: the rest of 2 gap(v, y).

    Args:
        gap: v − ψ.
        excess: A vector whose normal component is y·n − q_S.
        n: Outer unit normal.
        q: Weight.
        ds_signorini: Measure of Γ_S.
    """
    return 2 * dot(excess, n) * gap * q * ds_signorini


def load_oscillation(f: Expr, f_h: Expr, kappa_min: Expr, q: Expr, measure: Measure) -> Form:
    """(h_T/π)²‖f − f_h‖²_T / κ_T, weighted by q, with κ_T the smallest eigenvalue of κ on T.

    (f − f_h, w) ≤ Σ_T (h_T/π)‖f − f_h‖_T ‖∇w‖_T, since f − f_h has mean 0 on T (Payne, Weinberger; Bebendorf).
    """
    diameter = CellDiameter(measure.ufl_domain())
    return (diameter / pi * (f - f_h)) ** 2 / kappa_min * q * measure


def flux_oscillation(g: Expr, g_h: Expr, kappa_min: Expr, q: Expr, ds: Measure) -> Form:
    """C_e²‖g − g_h‖²_e / κ_T for facets e of T, weighted by q, with C_e² = |e|h_T²/|T| (1/π² + 2/(πd)).

    (g − g_h, w)_e ≤ ‖g − g_h‖_e ‖w − w_T‖_e as g − g_h has mean 0 on e. With x_e the vertex opposite to e, the
    divergence theorem for (x − x_e) w² gives d|T|/|e| ‖w‖²_e = d‖w‖²_T + 2(w(x − x_e), ∇w)_T ≤ d‖w‖²_T +
    2h_T‖w‖_T‖∇w‖_T, and w − w_T, w_T the mean over T, has ‖w − w_T‖_T ≤ (h_T/π)‖∇w‖_T.
    """
    mesh = ds.ufl_domain()
    constant = (
        FacetArea(mesh) * CellDiameter(mesh) ** 2 / CellVolume(mesh) * (1 / pi**2 + 2 / (pi * len(FacetNormal(mesh))))
    )
    return constant * (g - g_h) ** 2 / kappa_min * q * ds
