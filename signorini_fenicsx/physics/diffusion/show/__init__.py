"""What is told and drawn of a solution of diffusion problems."""
