"""The primal formulations in conforming P1: (VI), (VL) and the penalty problem (P_ε).

Strong form: −Δu = f in Ω, u = u_D on Γ_D, u ≥ 0, λ := ∇u·n ≥ 0, uλ = 0 on Γ_S. With v ≥ 0 at the vertices of Γ_S the
discrete (VI) is a complementarity problem between the values u_i ≥ 0 and the reactions (∇u, ∇φ_i) − (f, φ_i) = w_i λ_i
≥ 0, where w_i = ∫_ΓS φ_i: the multiplier of (VL) by the trapezoidal rule on Γ_S, which also makes the penalty one value
per vertex,

    (VI), (VL)  min(u_i, λ_i) = 0,      (P_ε)  λ_i = [u_i]_-/ε,  that is  min(λ_i, u_i + ελ_i) = 0.

σ = κ_h∇u_h has no normal flux that is single valued. Its projection to RT0 in (κ_h⁻¹·, ·) together with the cell means
of u_h and the facet means of its trace satisfies (9a) exactly, since ∇·τ_h and τ_h·n are constant on cells and facets;
(9b) it does not satisfy.

General data shift the unknowns: u_i stands for u_i − ψ, λ for κ∇u·n − q_S.
"""

from ufl import Form, Measure, grad, inner
from ufl.core.expr import Expr


def mass(u: Expr, v: Expr, dx: Measure) -> Form:
    """(u, v)."""
    return inner(u, v) * dx


def vertex_weight(v: Expr, ds: Measure) -> Form:
    """(1, v) on Γ_S, the weight w_i of the trapezoidal rule for v = φ_i."""
    return v * ds


def gradient(u: Expr, tau: Expr, dx: Measure) -> Form:
    """(∇u, τ): with (κ_h⁻¹σ, τ) on the left its solution is a projection of κ_h∇u."""
    return inner(grad(u), tau) * dx
