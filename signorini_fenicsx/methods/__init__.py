"""Methods that find the contact sets: the registry, the loop of the set rules, PETSc SNES, classical methods."""
