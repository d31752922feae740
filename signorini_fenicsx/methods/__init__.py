"""How to find the sets: the registry of methods, the loop of the set rules, PETSc SNES, classical methods."""
