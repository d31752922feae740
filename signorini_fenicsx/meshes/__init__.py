"""Domains: named shapes, files of meshes and geometries, their checks, refinement, sampling."""
