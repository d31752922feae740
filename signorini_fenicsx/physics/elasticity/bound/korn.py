"""Constants of Korn and Poincaré on single simplices: how far loads can move what is fixed against linear fields.

For a load g on a simplex T that is orthogonal to the linear fields P₁(T)ᵈ and all displacements w

    (g, w)_T ≤ c_T ‖g‖_T ‖ε(w)‖_T,   c_T ≤ ‖F‖² ‖F⁻¹‖ ĉ,

with F the derivative of the affine map from the regular simplex T̂ with edges of length 1, and ĉ its constant: ŵ = Fᵀw∘F
has ε(ŵ) = Fᵀε(w)F, and linear fields stay linear.

*A bound of ĉ.* Let a mesh of T̂ have cells K with c_K ≤ sĉ, s < 1. For linear p on K let Qp be the load that is constant
on each subcell and has the moments of p against P₁, and q the largest ‖p − Qp‖/‖p‖, the same for all K. For all v that
are linear on each K and orthogonal to P₁(T̂) let τ_h(v) be the stress of Johnson and Mercier with −∇·τ_h = Qv and τ_h n
= 0 on the boundary that has the least norm, and c_h the largest ‖τ_h(v)‖/‖v‖. Then

    ĉ ≤ c_h (sq + √(1 − s²)) / (1 − s²(1 + q²)).

Proof. Let g be orthogonal to P₁(T̂), ‖g‖ = 1. Its projection v onto linear fields on each K is so, too. g − Qv is
orthogonal to P₁(K) for all K, so (g − Qv, w) ≤ sĉ ‖g − Qv‖ ‖ε(w)‖, and (Qv, w) = (τ_h(v), ε(w)) ≤ c_h‖v‖ ‖ε(w)‖. With
a = ‖v‖ and b = ‖g − v‖ it is ‖g − Qv‖ ≤ ‖g − v‖ + ‖v − Qv‖ ≤ b + qa. Hence ĉ ≤ max c_h a + sĉ(b + qa) over a² + b² = 1,
that is ĉ² ≤ (c_h + sqĉ)² + s²ĉ². As ĉ is finite by Korn's inequality, it is at most the positive root. ∎

*Tractions.* For a traction r on a facet e of T that is orthogonal to the linear fields P₁(e)ᵈ and all displacements w

    ⟨r, w⟩_e ≤ t_T ‖r‖_e ‖ε(w)‖_T,   t_T ≤ ‖F‖² ‖F⁻¹‖ (|e|/|ê| · |T̂|/|T|)^½ t̂,

with t̂ the constant of a facet ê of T̂, by the same map.

*A bound of t̂.* Let a mesh of T̂ cut ê into facets whose edges are 1/n long. For all v on ê that are linear on each of
these and orthogonal to P₁(ê) let τ_h(v) be the stress of Johnson and Mercier with ∇·τ_h = 0, τ_h n = v on ê and 0 on
the other facets of T̂ that has the least norm, and t_h the largest ‖τ_h(v)‖/‖v‖. Then t̂ ≤ t_h/√(1 − 1/n).

Proof. Let r be orthogonal to P₁(ê), ‖r‖ = 1. Its projection v onto linear fields on each small facet is so, too. Over
each of these stands a regular simplex K with edges 1/n; K is in T̂, and no two of them overlap, as each apex is above
the middle of its facet. r − v is orthogonal to linear fields on each facet, and t_K = t̂/√n. So (v, w) = (τ_h(v), ε(w))
and ⟨r, w⟩ ≤ (t_h ‖v‖ + t̂ ‖r − v‖/√n) ‖ε(w)‖, where ‖v‖² + ‖r − v‖² = 1: t̂² ≤ t_h² + t̂²/n. ∎

c_h² and t_h² are the largest eigenvalues of finite problems. `scripts/measure.py korn` computes them and prints the
bounds.
"""

import numpy as np

from signorini_fenicsx.base.arrays import Array

KORN = {2: 0.353, 3: 0.430}
"""Upper bounds of ĉ, from 32 cells along an edge in the plane and 16 in space."""
TRACE = {2: 0.947, 3: 1.236}
"""Upper bounds of t̂, likewise."""
MOMENTS = {2: 1.1181, 3: 1.4833}
"""Upper bounds of q, which no affine map changes."""


def regular_simplex(dim: int) -> Array:
    """Edges of the regular simplex from one vertex, as columns; their length is 1."""
    if dim == 2:
        return np.array([[1, 0.5], [0, np.sqrt(3) / 2]])
    return np.array([[1, 0.5, 0.5], [0, np.sqrt(3) / 2, np.sqrt(3) / 6], [0, 0, np.sqrt(2 / 3)]])


def stretch(edges: Array) -> Array:
    """‖F‖² ‖F⁻¹‖ of simplices, shape (n,), from their edges at one vertex as columns, shape (n, d, d)."""
    sizes = np.linalg.svd(edges @ np.linalg.inv(regular_simplex(edges.shape[-1])), compute_uv=False)
    return sizes[:, 0] ** 2 / sizes[:, -1]


def korn_constants(edges: Array) -> Array:
    """The bounds of c_T of simplices, shape (n,), from their edges at one vertex as columns, shape (n, d, d)."""
    return KORN[edges.shape[-1]] * stretch(edges)


def trace_constants(edges: Array, measure: Array) -> Array:
    """The bounds of t_T of simplices and a facet of each, shape (n,).

    Args:
        edges: At one vertex, as columns, shape (n, d, d).
        measure: |e|.
    """
    dim = edges.shape[-1]
    of_facet = {2: 1.0, 3: np.sqrt(3) / 4}[dim]
    volumes = np.abs(np.linalg.det(edges)) / np.linalg.det(regular_simplex(dim))
    return TRACE[dim] * stretch(edges) * np.sqrt(measure / of_facet / volumes)
