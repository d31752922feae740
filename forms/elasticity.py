"""Elastic contact: the Hellinger-Reissner problem, its hybrid form, and the gap identity.

Strong form: σ = ℂ(ε(u) − ε₀), ∇·σ + f = 0 in Ω, u = u_D on Γ_D, σn = g_N on Γ_N, and without friction on Γ_C, where
u_n = u·n, σ_nn = n·σn and g is the gap along n,

    u_n ≤ g,   σ_nn ≤ 0,   (u_n − g) σ_nn = 0,   σn − σ_nn n = 0.

With p = g − u_n and the pressure −σ_nn in the place of σ·n this is the Signorini condition of the scalar problem. ε₀ is
the strain without stress, by heat say. ℂ and the compliance 𝔸 = ℂ⁻¹ are symmetric matrices that act on the entries of
symmetric matrices; those off the diagonal are weighted by √2, so that inner products of matrices are those of their
entries. `physics/elasticity/discrete/material.py` makes them.

*The element* (Johnson and Mercier 1978; Křížek 1982). A simplex T is split at its centroid into d + 1 subcells. The
stresses are symmetric and linear on each subcell, and σn is continuous in T. The displacements are linear on all of T.
∇·σ is a constant on each subcell, as many numbers as a linear displacement has; its moments against these determine it.
So f_h is the field of this kind with the moments of f, and −∇·σ_h = f_h holds pointwise.

*The hybrid form.* The traces û are linear on each facet and not continuous. On each T, for all stresses τ and
displacements v of it,

    (𝔸σ, τ)_T + (u, ∇·τ)_T = ⟨û, τn⟩_∂T − (ε₀, τ)_T,   (∇·σ, v)_T = −(f, v)_T,

and for all traces q that vanish where û is given, Σ_T ⟨σn, q⟩_∂T = ⟨g_N, q⟩. The last equation says that σn is the same
from both sides of a facet, since σn is linear there.

*What is solved.* With F the derivative of the affine map from a reference simplex T̂ to T, τ = Fτ̂Fᵀ/|det F| is
symmetric, τn dS = F τ̂n̂ dŜ and (v, ∇·τ)_T = (Fᵀv, ∇·τ̂)_T̂. So the split, the continuity of σn and zero divergence carry
over, and one basis on T̂ serves all cells: Z of the self-balanced stresses, whose number is that of all facet tractions
less the rigid motions, and one stress for each moment of the divergence. On T, σ = Z a + (what balances f), and a
minimises ½(𝔸σ, σ) + (ε₀, σ) − ⟨û, σn⟩: one small SPD system for each T. What remains is one SPD system for û, whose
matrix is on each T the G_Z A_ZZ⁻¹ G_Zᵀ of the tractions G_Z of Z.

*The gap identity.* For v with v = u_D on Γ_D and v_n ≤ g on Γ_C, and symmetric y with −∇·y = f, yn = g_N on Γ_N, and
y_nn ≤ 0, yn = y_nn n on Γ_C,

    ½|v − u|² + ½‖y − σ‖² + ⟨−σ_nn, g − v_n⟩ + ⟨−y_nn, g − u_n⟩ = ½‖s − y‖² + ⟨−y_nn, g − v_n⟩ =: gap(v, y)

with s = ℂ(ε(v) − ε₀), |w|² = (ℂε(w), ε(w)), ‖τ‖² = (𝔸τ, τ), and ⟨·,·⟩ on Γ_C. No constant of Korn is in it.

Proof: s − y = ℂε(v − u) + σ − y, so ½‖s − y‖² = ½|v − u|² + ½‖σ − y‖² + (ε(v − u), σ − y). As ∇·(σ − y) = 0 and
σ − y is symmetric, the last term is ⟨v − u, (σ − y)n⟩, which is on Γ_C alone and there ⟨v_n − u_n, σ_nn − y_nn⟩ =
⟨−σ_nn, g − v_n⟩ − ⟨−y_nn, g − v_n⟩ +
⟨−y_nn, g − u_n⟩, because (g − u_n)σ_nn = 0. All terms on the left are ≥ 0.

*Friction* (Tresca). In the place of σ_t = 0 it is |σ_t| ≤ k and k|u_t| + σ_t u_t = 0 on Γ_C. For y with |y_t| ≤ k

    the left side + ⟨k, |v_t|⟩ + ⟨σ_t, v_t⟩ + ⟨k, |u_t|⟩ + ⟨y_t, u_t⟩ = gap(v, y) + ⟨k, |v_t|⟩ + ⟨y_t, v_t⟩,

since the last term of the proof has ⟨v_t − u_t, σ_t − y_t⟩ as well, and −⟨u_t, σ_t⟩ = ⟨k, |u_t|⟩. All terms are ≥ 0.

*Pairs of surfaces* (a slave Γ₁ with the normal ν, opposite points χ(x) on a master Γ₂). With [v] = v₁ − v₂∘χ in the
place of v and g − ν·[v] in that of g − v_n the integrals are over Γ₁. σn on Γ₂ is χ_*(λν), λ the pressure on Γ₁, where
⟨χ_*(t), w⟩ = ⟨t, w∘χ⟩. Let y have the tractions χ_*(λ_y ν) − r there. Then

    the left side = gap(v, y) − ⟨r, v₂ − u₂⟩,

as (σ − y)n = χ_*((λ − λ_y)ν) + r on Γ₂, so that the last term of the proof is −⟨λ − λ_y, ν·[v − u]⟩ + ⟨r, v₂ − u₂⟩.
"""

from itertools import combinations

from ufl import Form, Measure, as_vector, dot, grad, inner, sqrt, sym
from ufl.core.expr import Expr


def pairs(dim: int) -> list[tuple[int, int]]:
    """Row and column of the entries of a symmetric matrix: the diagonal, then above it."""
    return [(i, i) for i in range(dim)] + list(combinations(range(dim), 2))


def vector(matrix: Expr) -> Expr:
    """The entries of a symmetric matrix, those off the diagonal weighted by √2."""
    return as_vector([matrix[i, j] if i == j else sqrt(2) * matrix[i, j] for i, j in pairs(matrix.ufl_shape[0])])


def strain(u: Expr) -> Expr:
    """ε(u)."""
    return sym(grad(u))


def product(tensor: Expr, one: Expr, other: Expr, dx: Measure) -> Form:
    """(𝔸σ, τ) or (ℂε, ε')."""
    return inner(dot(tensor, vector(one)), vector(other)) * dx


def off_law(v: Expr, y: Expr, compliance: Expr, eigenstrain: Expr) -> Expr:
    """The entries of ε(v) − ε₀ − 𝔸y."""
    return vector(strain(v)) - eigenstrain - dot(compliance, vector(y))


def square(stiffness: Expr, strain: Expr, q: Expr | float, dx: Measure) -> Form:
    """(ℂε, ε) from the entries of ε, weighted by q: with `off_law` what it contributes to 2 gap(v, y)."""
    return q * inner(dot(stiffness, strain), strain) * dx
