"""What is told and drawn of a solution of elastic problems."""
