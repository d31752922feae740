"""Functions of one mesh at the points of another that need not be nested in it."""

import contextlib
import math
from collections.abc import Iterator, Sequence

import basix.ufl
import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem

from signorini_fenicsx.meshes.domain import Domain

QUADRATURE_DEGREE = 2
"""Exact for squares of RT0 differences on fine cells that one coarse cell covers."""


def curve_gap(domain: Domain) -> float:
    """A length above the gap between this mesh and a finer one of the same domain with a curved boundary."""
    return domain.curvature * domain.h**2


@contextlib.contextmanager
def of_unit_size(domain: Domain, *meshes: dolfinx.mesh.Mesh) -> Iterator[float]:
    """Magnify meshes of a domain to a size around 1, while DOLFINx searches with tolerances that are plain lengths.

    Yields:
        The factor, a power of 2, so that nothing is rounded; 1 for named shapes.
    """
    factor = 2.0 ** round(math.log2(domain.curvature))
    for mesh in meshes:
        mesh.geometry.x[:] *= factor
    try:
        yield factor
    finally:
        for mesh in meshes:
            mesh.geometry.x[:] /= factor


def sampled(
    functions: Sequence[fem.Function], mesh: dolfinx.mesh.Mesh, source: Domain, *, degree: int = QUADRATURE_DEGREE
) -> list[fem.Function]:
    """Functions of one other mesh at the quadrature points of this one; those of this mesh as they are (collective).

    Args:
        functions: On one mesh, or on this one.
        mesh: Where they are wanted.
        source: The domain that the other mesh covers, or whose boundary it is.
        degree: Of the quadrature.
    """
    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    samples = []
    search = None  # finding the points is the expensive part, and the same for all functions
    for function in functions:
        space = function.function_space
        if space.mesh is mesh:
            samples.append(function)
            continue
        element = basix.ufl.quadrature_element(mesh.basix_cell(), function.ufl_shape, degree=degree)
        sample = fem.Function(fem.functionspace(mesh, element))
        with of_unit_size(source, mesh, space.mesh) as factor:
            padding = factor * curve_gap(source)
            search = search or fem.create_interpolation_data(sample.function_space, space, cells, padding=padding)
            sample.interpolate_nonmatching(function, cells, search)
            if space.ufl_element().pullback is ufl.contravariant_piola:  # fluxes per area: J/det J
                sample.x.array[:] *= factor ** (mesh.topology.dim - 1)
        samples.append(sample)
    return samples
