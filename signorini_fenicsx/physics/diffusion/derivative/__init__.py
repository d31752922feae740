"""Solutions of diffusion problems, linearised: how they change with their data."""
