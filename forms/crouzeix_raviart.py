"""The Crouzeix-Raviart problem whose solution is that of the mixed RT0/P0 method, and the way back to it.

With f_h the P0 projection of f and κ_h constant on each cell, let u_CR have the mean of u_D on each facet of Γ_D and
solve

    (κ_h ∇_h u_CR, ∇_h v) = (f_h, v) + (g_h, v) on Γ_N and Γ_S,   g_h = mean of g_N or q_S per facet,

for all Crouzeix-Raviart v with mean 0 on Γ_D and the facets of Γ_S in contact, where the mean of u_CR is that of ψ.
Then, with x_T the centroid of cell T and d the dimension (Marini 1985, for κ = 1 and c = 0; for c > 0 see the end),

    p_h|_e = mean of u_CR on e,
    σ_h|_T = κ_h ∇u_CR − (f_h/d)(x − x_T),
    u_h|_T = mean over T of u_CR + (f_h/d²)(x − x_T)·κ_h⁻¹(x − x_T).

Proof. (9b): ∇·σ_h = −f_h by definition.

σ_h is in V_h: σ_h·n is constant on facets, because (x − x_T)·n is. Let v be the basis function of a facet e, with mean
1 on e and 0 on all other facets. On each cell T at e, f_h and κ_h are constant and

    (κ_h ∇u_CR, ∇v)_T − (f_h, v)_T = (σ_h, ∇v)_T + (f_h/d)(x − x_T, ∇v)_T − (f_h, v)_T.

The middle term vanishes, because ∇v is constant and x − x_T has mean 0. Integration by parts turns the first term into
∫_e σ_h·n − (∇·σ_h, v)_T, and its last part cancels −(f_h, v)_T. So the equation for v says: at an inner facet the
fluxes of both cells agree; on Γ_N, and on Γ_S without contact, σ_h·n = g_h.

(9a): for τ_h in V_h, (κ_h⁻¹σ_h, τ_h)_T = (∇u_CR, τ_h)_T − (f_h/d)(κ_h⁻¹(x − x_T), τ_h)_T. The first term is
−(u_CR, ∇·τ_h)_T + ⟨u_CR, τ_h·n⟩_∂T; the sum of its boundary parts over all T has only facet means of u_CR, and inner
facets cancel. In the second term τ_h = τ_h(x_T) + (∇·τ_h/d)(x − x_T), where the constant part gives 0, so it is
−(f_h/d²)((x − x_T)·κ_h⁻¹(x − x_T), ∇·τ_h)_T. Together (κ_h⁻¹σ_h, τ_h) + (u_h, ∇·τ_h) = ⟨p_h, τ_h·n⟩ + ⟨u_D, τ_h·n⟩.

*A source that depends on u.* The proof uses of f_h only that it is one number y_T = −∇·σ_h on each cell. So any y_T may
stand for f_h. Let ū_T be the mean of u_CR over T and m_T that of (x − x_T)·κ_h⁻¹(x − x_T), divided by d². Then
u_T = ū_T + m_T y_T, and with two numbers per cell, s_T ≥ 0 and b_T,

    y_T = b_T − s_T ū_T   puts   Σ |T| s_T ū_T v̄_T   on the left side and   Σ |T| b_T v̄_T   for (f_h, v) on the right.

The matrix stays symmetric and semidefinite. For −∇·σ + cu = f the source is y_T = f_T − c_T u_T, that is

    s_T = c_T/(1 + c_T m_T),   b_T = f_T/(1 + c_T m_T).

With f + cψ for f and c → ∞ this is s_T = 1/m_T, b_T = ψ_T/m_T, for which u_T = ψ_T.
"""

from ufl import Form, Measure, grad, inner
from ufl.core.expr import Expr

from signorini_fenicsx.forms.mixed import ONE, load


def stiffness(u: Expr, v: Expr, dx: Measure, kappa: Expr = ONE) -> Form:
    """(κ∇_h u, ∇_h v), cell by cell."""
    return inner(kappa * grad(u), grad(v)) * dx


def reaction(u: Expr, v: Expr, dx: Measure, s: Expr) -> Form:
    """Σ |T| s_T ū_T v̄_T: one point is exact, because u and v are linear on T."""
    return s * u * v * dx(degree=1)


def outflow(u_cr: Expr, source: Expr, v: Expr, dx: Measure, kappa: Expr = ONE) -> Form:
    """∫ σ_h·n out of each cell through its facets, for v in the same functions without their continuity.

    See the second part of the proof.
    """
    return stiffness(u_cr, v, dx, kappa) - load(source, v, dx)
