"""Spaces, data and laws of elastic problems on a mesh."""
