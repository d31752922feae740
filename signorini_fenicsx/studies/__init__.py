"""Parameter studies: many runs of a case, kill-safe."""
