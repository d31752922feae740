"""The primal formulations in conforming P1: (VI), (VL) and the penalty problem (P_ε).

Strong form: −Δu = f in Ω, u = u_D on Γ_D, u ≥ 0, λ := ∇u·n ≥ 0, uλ = 0 on Γ_S. The discrete (VI), with v ≥ 0 at the
vertices of Γ_S, is a complementarity problem between the values u_i ≥ 0 and the reactions (∇u, ∇φ_i) − (f, φ_i) = w_i
λ_i ≥ 0, where w_i = ∫_ΓS φ_i. Here λ_i is the multiplier of (VL) by the trapezoidal rule on Γ_S. The penalty uses the
same rule, so it too is one equation per vertex:

    (VI), (VL)  min(u_i, λ_i) = 0,      (P_ε)  λ_i = [u_i]_-/ε,  that is  min(λ_i, u_i + ελ_i) = 0.

σ = κ_h∇u_h has two different normal fluxes on an inner facet. Its projection to RT0 in (κ_h⁻¹·, ·), together with the
cell means of u_h and the facet means of its trace, satisfies (9a) exactly, since ∇·τ_h and τ_h·n are constant on cells
and facets. It does not satisfy (9b).

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
    """(∇u, τ): the right side that makes the solution σ of (κ_h⁻¹σ, τ) = (∇u, τ) a projection of κ_h∇u."""
    return inner(grad(u), tau) * dx
