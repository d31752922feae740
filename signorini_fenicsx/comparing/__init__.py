"""Solutions side by side: two of them, over h or ε, over all methods."""
