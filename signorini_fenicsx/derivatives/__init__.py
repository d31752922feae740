"""Derivatives of solutions by their data, through contact."""
