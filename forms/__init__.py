"""The variational forms of the mixed Signorini methods in UFL: no mesh, no MPI, no PETSc.

- :mod:`signorini_fenicsx.forms.mixed`: the multiplier formulations (MLM-I)_h, (9), and (MLM-II)_h, (10).
- :mod:`signorini_fenicsx.forms.penalty`: the penalty formulations (MPε-I)_h, (25), and (MPε-II)_h, (26).
- :mod:`signorini_fenicsx.forms.crouzeix_raviart`: the facet problem with the same solution, and the way back.
- :mod:`signorini_fenicsx.forms.certificate`: the gap identity, for a guaranteed error bound.
- :mod:`signorini_fenicsx.forms.primal`: the formulations in conforming P1 that the classical algorithms solve.
- :mod:`signorini_fenicsx.forms.elasticity`: elastic contact: the hybrid form, the gap identity with proof.
- :mod:`signorini_fenicsx.forms.norms`: the norms of V, Q and Λ.

The folder stands at the top of the repository; the package holds a link to it and is installed with it.

Numbers in brackets are the equations of G. Zhou, Q. Wang, J. Hu, "The fully mixed methods for the Signorini
problem" (2024). Throughout, n is the outer unit normal, σ = ∇u the flux and p the trace of u on Γ_S. Measures are
always passed: dx is that of Ω, ds that of Γ_S or of another part of the boundary.
"""
