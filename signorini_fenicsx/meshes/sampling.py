"""Functions of one mesh at the points of another that need not be nested in it."""

import contextlib
import math
from collections.abc import Iterator, Sequence

import basix.ufl
import dolfinx.geometry
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.domain import Domain

QUADRATURE_DEGREE = 2
"""Exact for squares of RT0 differences on fine cells that one coarse cell covers."""
AT_BOUNDARY = 1e-10
"""A point that is this far outside a mesh, relative to its size, is on the boundary up to rounding."""


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


def at_points(functions: Sequence[fem.Function], domain: Domain, points: npt.ArrayLike) -> list[Array]:
    """Functions on the mesh of a domain at any points (collective).

    Args:
        functions: With up-to-date ghost values.
        domain: The mesh.
        points: What this rank asks for, shape (n, dim), wherever the cells are; another rank may ask for others.

    Returns:
        Of each function the values, shape (n, components): not a number outside the mesh; where cells meet, those in
        one of them, the same for all functions.

    Raises:
        InputError: On all ranks, if the points of one of them have another shape.
    """
    comm = domain.mesh.comm
    wanted = _in_space(domain.mesh, points)
    inside = np.isfinite(wanted).all(axis=1)
    padding = AT_BOUNDARY * float(np.ptp(domain.box(), axis=0).max())
    with of_unit_size(domain, domain.mesh) as factor:
        owners = dolfinx.geometry.determine_point_ownership(domain.mesh, factor * wanted[inside], factor * padding)
    inside[inside] = owners.src_owner >= 0
    places = [np.flatnonzero(inside)[owners.src_owner[owners.src_owner >= 0] == rank] for rank in range(comm.size)]
    values = []
    for function in functions:
        size = function.function_space.value_size
        found = function.eval(owners.dest_points / factor, owners.dest_cells).reshape(-1, size)
        answers = comm.alltoall([found[owners.dest_owner == rank] for rank in range(comm.size)])
        value = np.full((len(wanted), size), np.nan)
        for place, answer in zip(places, answers, strict=True):
            value[place] = answer
        values.append(value)
    return values


def _in_space(mesh: dolfinx.mesh.Mesh, points: npt.ArrayLike) -> Array:
    """Points as DOLFINx takes them, shape (n, 3) (collective).

    Raises:
        InputError: On all ranks, if one has something else.
    """
    dim, wrong = mesh.geometry.dim, False
    try:
        given = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError):
        given, wrong = np.empty((0, dim)), True
    if given.size == 0:
        given = np.empty((0, dim))
    wrong = wrong or given.ndim != 2 or given.shape[1] != dim
    if mesh.comm.allreduce(wrong, MPI.LOR):
        raise InputError(f"points: must be an array of shape (n, {dim}), a row for each point")
    return np.pad(given, ((0, 0), (0, 3 - dim)))
