"""Quantities of elastic bodies from both sides."""
