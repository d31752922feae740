"""Functions of one mesh at the points of another that need not be nested in it."""

from collections.abc import Sequence

import basix.ufl
import dolfinx.mesh
import numpy as np
from dolfinx import fem

from signorini_fenicsx.domain import Domain

QUADRATURE_DEGREE = 2
"""Exact for squares of RT0 differences on fine cells that one coarse cell covers."""


def curve_gap(domain: Domain) -> float:
    """A length above the gap between this mesh and a finer one of the same domain with a curved boundary."""
    return domain.bend * domain.h**2


def sampled(
    functions: Sequence[fem.Function], mesh: dolfinx.mesh.Mesh, padding: float, *, degree: int = QUADRATURE_DEGREE
) -> list[fem.Function]:
    """Functions of one other mesh at the quadrature points of this one; those of this mesh as they are (collective)."""
    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    samples = []
    search = None  # finding the points is the expensive part, and the same for all functions
    for function in functions:
        if function.function_space.mesh is mesh:
            samples.append(function)
            continue
        element = basix.ufl.quadrature_element(mesh.basix_cell(), function.ufl_shape, degree=degree)
        sample = fem.Function(fem.functionspace(mesh, element))
        search = search or fem.create_interpolation_data(
            sample.function_space, function.function_space, cells, padding=padding
        )
        sample.interpolate_nonmatching(function, cells, search)
        samples.append(sample)
    return samples
