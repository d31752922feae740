"""What every part may use: errors, MPI, signals, files that are not lost, sealed processes."""
