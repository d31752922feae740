"""Output of solutions: checkpoints, fields, tables, pictures."""
