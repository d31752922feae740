"""−∇·(κ∇u) + cu = f with laws on Γ_S, in RT0/P0 and facet multipliers."""
