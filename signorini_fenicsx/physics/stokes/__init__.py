"""Viscous flow with laws on the boundary, solved as an incompressible body: its rooms are those of elasticity."""
