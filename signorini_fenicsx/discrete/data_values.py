"""Values of the data over all ranks: their extent, their sum, and checks that they are finite and of usable size."""

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.base.text import place_in_words
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.points import (
    Points,
    cell_quadrature,
    facet_quadrature,
    facet_type,
    in_facets,
    quadratic_nodes,
)
from signorini_fenicsx.expressions import TREES
from signorini_fenicsx.expressions.enclosures import ranges, surely_above

DATA_RANGE = 1e-100, 1e100
ROUNDING = 1e-12
"""Relative size of a sum of loads that counts as rounding."""


def check_nodes(spaces: MeshSpaces, name: str, datum: Datum, facets: npt.NDArray[np.int32], where: str) -> None:
    """Make sure that continuous data are finite at the vertices and edge midpoints of these facets (collective).

    Raises:
        InputError: If they are not.
    """
    mesh = spaces.mesh
    values = datum.values(in_facets(mesh, facets, quadratic_nodes(facet_type(mesh.topology.dim))))
    if not mesh.comm.allreduce(bool(np.isfinite(values).all()), op=MPI.LAND):
        raise InputError(f"{in_problem(name)}: not finite everywhere {where}")


def check_finite(spaces: MeshSpaces, name: str, where: str, datum: Datum, cells: npt.NDArray[np.int32]) -> None:
    """Make sure that a scalar and its gradient are finite at the quadrature points of these cells (collective).

    Raises:
        InputError: If they are not.
    """
    if datum.number is not None:
        return
    blocks = cell_quadrature(spaces.mesh, cells, quadrature_degree(datum))
    finite = [bool(np.isfinite(datum.jet(points, gradient=True)).all()) for points in blocks]
    if not spaces.mesh.comm.allreduce(all(finite), op=MPI.LAND):
        raise InputError(f"{name}: it or its gradient is not finite everywhere {where}")


def least_value(spaces: MeshSpaces, datum: Datum, wanted: Array) -> tuple[float, tuple[float, ...]]:
    """The smallest known value of a scalar in the domain, or eigenvalue of a matrix, and where it is (collective).

    Of a scalar that was given as text it is looked for between the points of a quadrature too, in the owned cells where
    values below the `wanted` one of the cell are possible.
    """
    mesh, vertices = spaces.mesh, corners(spaces.mesh)
    candidates: list[tuple[float, tuple[float, ...]]] = [(np.inf, ())]
    for points in cell_quadrature(mesh, owned_cells(mesh), quadrature_degree(datum)):
        values = datum.values(points)
        values = values if values.ndim == 2 else np.linalg.eigvalsh(values)[:, :, 0]
        candidates += _least(values.ravel(), points.x.reshape(-1, mesh.geometry.dim))
    for tree, cells in datum.pieces_in(np.arange(len(vertices))):
        if isinstance(tree, TREES):
            cells = cells[~surely_above(tree, vertices[cells], spaces.frame, wanted[cells])]
            if mesh.comm.allreduce(len(cells)) > 0:
                of_tree = ranges(tree, vertices[cells], None, spaces.frame, wanted[cells], np.inf)
                candidates += _least(of_tree.least, of_tree.at)
    return min(mesh.comm.allgather(min(candidates)))


def worst_of(comm: MPI.Comm, excess: Array, points: Points) -> tuple[float, tuple[float, ...]]:
    """The largest of some numbers in points and its place; 0 and no place if none is above 0 (collective)."""
    worst: tuple[float, tuple[float, ...]] = (0.0, ())
    if excess.max(initial=0.0) > 0:
        place = int(np.argmax(excess))
        worst = float(excess[place]), tuple(points.x.reshape(len(excess), -1)[place].tolist())
    return max(comm.allgather(worst))


def _least(values: Array, places: Array) -> list[tuple[float, tuple[float, ...]]]:
    """The smallest of some values and its place; none if there are none."""
    if len(values) == 0:
        return []
    least = int(np.argmin(values))
    return [(float(values[least]), tuple(places[least].tolist()))]


def near_first(spaces: MeshSpaces, cells: Mask) -> str:
    """Near which place the first of some owned cells is, in words; empty if there are none (collective)."""
    places = map(tuple, corners(spaces.mesh)[cells].mean(axis=1).tolist())
    first = min(spaces.mesh.comm.allgather(min(places, default=(np.inf,))))
    return f" near {place_in_words(first)}" if first != (np.inf,) else ""


def check_means(name: str, where: str, means: Array, spaces: MeshSpaces) -> None:
    """Make sure that means are finite, and neither too large nor too small (collective).

    Raises:
        InputError: If they are not.
    """
    comm = spaces.mesh.comm
    if not comm.allreduce(bool(np.isfinite(means).all()), op=MPI.LAND):
        raise InputError(f"{in_problem(name)}: not finite everywhere {where}")
    largest = comm.allreduce(float(np.abs(means).max(initial=0.0)), MPI.MAX)
    low, high = DATA_RANGE
    if largest != 0 and not low <= largest <= high:
        raise InputError(
            f"{in_problem(name)}: its largest value, {largest:.1e}, is outside {low:g} … {high:g}; scale it"
        )


def check_cells(name: str, means: Array, spaces: MeshSpaces) -> None:
    """Make sure of means in the owned cells, see `check_means` (collective)."""
    where, wrong = "in the domain", ~np.isfinite(means).all(axis=tuple(range(1, means.ndim)))
    if spaces.mesh.comm.allreduce(bool(wrong.any()), op=MPI.LOR):
        where += near_first(spaces, wrong)
    check_means(name, where, means, spaces)


def facet_means(spaces: MeshSpaces, name: str, datum: Datum, facets: npt.NDArray[np.int32], where: str) -> Array:
    """Mean on each of these boundary facets (collective).

    Raises:
        InputError: If one is not finite, or they are too large or too small.
    """
    if datum.number is not None:
        means = np.full(len(facets), datum.number)
    else:
        points = facet_quadrature(spaces.mesh, facets, quadrature_degree(datum))
        means = points.means(datum.values(points))
    check_means(name, where, means, spaces)
    return means


def in_problem(name: str) -> str:
    """How a case file names a datum."""
    return name if name.startswith(("law.", "pair.", "[")) else f"[problem] {name}"


def extent(values: Array, comm: MPI.Comm) -> tuple[float, float]:
    """The smallest and the largest value over all ranks (collective)."""
    ends = np.array([-values.min(initial=np.inf), values.max(initial=-np.inf)])
    comm.Allreduce(MPI.IN_PLACE, ends, MPI.MAX)
    return -float(ends[0]), float(ends[1])


def total(loads: Array, comm: MPI.Comm) -> float:
    """The sum of the loads of all ranks, 0 if it is only rounding (collective)."""
    total, size = comm.allreduce(np.array([loads.sum(), np.abs(loads).sum()])).tolist()
    return 0.0 if abs(total) <= ROUNDING * size < np.inf else total
