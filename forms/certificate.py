"""The gap identity, which turns a discrete flux and a discrete trace into a guaranteed bound of the error.

Let u solve the Signorini problem and σ = κ∇u. For any v ∈ H¹ with v = u_D on Γ_D, v ≥ ψ on Γ_S, and any y ∈ H(div)
with ∇·y = −f, y·n = g_N on Γ_N, y·n ≥ q_S on Γ_S (Bartels, Gudi, Kaltenbach, arXiv 2407.10912, for κ = 1 and ψ = q_S =
0)

    ½|∇(v − u)|² + ⟨σ·n − q_S, v − ψ⟩ + ½‖y − σ‖² + ⟨y·n − q_S, u − ψ⟩ = ½‖κ∇v − y‖² + ⟨y·n − q_S, v − ψ⟩ =: gap(v, y)

with ⟨·,·⟩ on Γ_S and the energy norms |∇w|² = (κ∇w, ∇w), ‖τ‖² = (κ⁻¹τ, τ).

Proof: ½‖κ∇v − y‖² = ½|∇(v − u)|² + ½‖σ − y‖² + (∇(v − u), σ − y). As ∇·(σ − y) = 0, v = u on Γ_D and (σ − y)·n = 0 on
Γ_N, the last term is ⟨(σ − y)·n, v − u⟩, which is ⟨σ·n − q_S, v − ψ⟩ − ⟨y·n − q_S, v − ψ⟩ + ⟨y·n − q_S, u − ψ⟩ because
(u − ψ)(σ·n − q_S) = 0. All terms on the left are ≥ 0.

*A term cu* with c ≥ 0, −∇·σ + cu = f. Let r = f + ∇·y − cv, which is 0 where c = 0. Then

    ½‖κ∇v − y‖² + ½‖c^-½ r‖² + ⟨y·n − q_S, v − ψ⟩ on Γ_S

is the left side above plus ½‖c^½(v − u)‖² + ½‖c^-½ ∇·(y − σ)‖². Proof: with w = v − u and τ = y − σ, r = ∇·τ − cw, so
that ½‖c^-½ r‖² has −(∇·τ, w) in it, which with −(∇w, τ) from the first square makes −⟨τ·n, w⟩: the boundary term above.

*Other laws.* Let −σ·n ∈ ∂φ(u) on Γ_S with φ convex in each point, and φ* its conjugate. For any v with v = u_D on Γ_D
and any y with ∇·y = −f and y·n = g_N on Γ_N the same expansion gives

    ½‖κ∇v − y‖² + ∫ φ(v) + φ*(−y·n) + (y·n)v = ½|∇(v − u)|² + ½‖y − σ‖²
        + ∫ [φ(v) − φ(u) + σ·n(v − u)] + ∫ [φ*(−y·n) − φ*(−σ·n) + u(y·n − σ·n)],

integrals over Γ_S, since φ(u) + φ*(−σ·n) = −(σ·n)u. By the inequality of Fenchel and Young and the definition of the
subdifferential no term is negative. For the Signorini law φ(v) = −q_S v where v ≥ ψ, φ*(−s) = (q_S − s)ψ where s ≥ q_S.
"""
