"""Quantities of diffusion problems from both sides."""
