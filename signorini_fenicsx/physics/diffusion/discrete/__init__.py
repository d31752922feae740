"""Spaces, data and laws of diffusion problems on a mesh."""
