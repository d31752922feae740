"""A third physics, a bed of springs: k u = f in each cell, but u ≥ 0 in the cells behind Γ."""
