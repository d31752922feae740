"""Linear systems: PETSc's solvers, matrices with changing conditions, factorisations that are kept, two levels."""
