"""Comparisons of solutions: of two, over h or ε, and of all methods."""
