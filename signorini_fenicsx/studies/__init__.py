"""Parameter studies: many runs of a case, which may be killed and continued at any time."""
