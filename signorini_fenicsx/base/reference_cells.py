"""The reference simplices, and what Basix has on them."""

from functools import cache

import basix

from signorini_fenicsx.base.arrays import Array

SIMPLEX = {1: basix.CellType.interval, 2: basix.CellType.triangle, 3: basix.CellType.tetrahedron}
"""By dimension."""
FEW_POINTS_UP_TO = {basix.CellType.interval: -1, basix.CellType.triangle: 30, basix.CellType.tetrahedron: 15}
"""Largest degree of the quadratures of Xiao and Gimbutas."""
EDGES = {1: ((0, 1),), 2: ((1, 2), (0, 2), (0, 1)), 3: ((2, 3), (1, 3), (1, 2), (0, 3), (0, 2), (0, 1))}
"""By dimension the vertices of the edges, as Basix and DOLFINx number these."""


def positive_quadrature(cell: basix.CellType, degree: int) -> tuple[Array, Array]:
    """Points and weights > 0 on the reference cell; the default, Keast's rules, has negative ones too."""
    few = degree <= FEW_POINTS_UP_TO[cell]
    rule = basix.QuadratureType.xiao_gimbutas if few else basix.QuadratureType.gauss_jacobi
    points, weights = basix.make_quadrature(cell, degree, rule)
    return points, weights


@cache
def orthonormal(cell: basix.CellType, degree: int) -> basix.finite_element.FiniteElement:
    """Polynomials of a degree, orthonormal on the reference cell; those of lower degree come first."""
    legendre = basix.LagrangeVariant.legendre
    return basix.create_element(basix.ElementFamily.P, cell, degree, legendre, basix.DPCVariant.unset, True)
