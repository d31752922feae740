"""What is written: checkpoints, fields, tables, pictures."""
