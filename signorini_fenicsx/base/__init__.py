"""Tools for every part of the program: errors, MPI, signals, results folders, confined processes."""
