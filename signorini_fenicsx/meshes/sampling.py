"""Evaluates functions of one mesh at points of another mesh; the meshes need not be nested."""

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
    """Upper bound of the distance between this mesh and a finer mesh of the same domain with a curved boundary."""
    return domain.curvature * domain.h**2


@contextlib.contextmanager
def of_unit_size(domain: Domain, *meshes: dolfinx.mesh.Mesh) -> Iterator[float]:
    """Scale meshes of a domain to a size around 1 inside this context, because DOLFINx searches with fixed tolerances.

    Yields:
        The factor, a power of 2, so that scaling is exact; 1 for named shapes.
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
    """Functions of one other mesh at the quadrature points of this mesh (collective).

    Args:
        functions: Functions on one other mesh, or on this mesh; the latter are returned unchanged.
        mesh: This mesh.
        source: The domain of the other mesh, or whose boundary the other mesh covers.
        degree: Degree of the quadrature.
    """
    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    samples = []
    search = None  # the search of points is expensive, and the same for all functions
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
