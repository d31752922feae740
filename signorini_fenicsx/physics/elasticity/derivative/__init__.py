"""Solutions of elastic problems, linearised: how they change with their data."""
