"""The phreatic line, in space a surface: where the pressure of water is 0, between what is dry and what is not.

The pressure is linear on each cell between its means around the vertices. A vertex of a boundary facet on which the
pressure is known to be 0, as on a seepage face, is not dry: so the line ends where water begins to leave, and does not
follow the face. Of Baiocchi's dam, whose pressure is 0 in all that is dry, it is that of `seepage`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import dolfinx.mesh
import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.owned import cell_nodes, sums_at
from signorini_fenicsx.base.parallel import gather_rows
from signorini_fenicsx.base.polylines import chains
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.sections import PIECES
from signorini_fenicsx.meshes.domain import AXES
from signorini_fenicsx.pictures.sample import MeansAround
from signorini_fenicsx.solving.solved import Columns

if TYPE_CHECKING:  # it has these
    from signorini_fenicsx.physics.diffusion.solution import Solution

ZERO = 1e-9
"""A pressure head of less than this share of the size of the domain is 0."""


def phreatic(solution: Solution) -> list[Array]:
    """The lines, each of shape (points, 2), in space triangles of shape (3, 3), in order on rank 0 (collective)."""
    if solution.seepage is not None:
        return [solution.seepage.phreatic_line]
    water, mesh = solution.water_kind, solution.spaces.mesh
    assert water is not None
    dim, nodes, x = mesh.topology.dim, cell_nodes(mesh), corners(mesh)
    size = float(np.ptp(solution.spaces.domain.box(), axis=0).max())
    at_vertices = water.pressure(x, solution.u_vertices)
    pressure = MeansAround(mesh, nodes)(at_vertices[:, :, None])[:, 0]
    pressure[np.abs(pressure) <= ZERO * size] = 0.0
    wetted = _wetted(solution, ZERO * size)
    pressure[wetted] = np.maximum(pressure[wetted], 0.0)
    of_cells = pressure[nodes]
    dry = (of_cells < 0).sum(axis=1)
    crossed = (dry > 0) & (dry <= dim)
    numbers = mesh.geometry.input_global_indices[nodes[crossed]]
    count = dim + 1
    rows = gather_rows(mesh.comm, np.column_stack([numbers, of_cells[crossed], x[crossed].reshape(-1, count * dim)]))
    if rows is None:
        return []
    numbers, of_cells, x = np.split(rows, [count, 2 * count], axis=1)
    return _joined(numbers.astype(np.int64), of_cells, x.reshape(-1, count, dim))


def _wetted(solution: Solution, near: float) -> Indices:
    """The nodes of boundary facets on which the pressure is known to be 0 (collective)."""
    mesh, water = solution.spaces.mesh, solution.water_kind
    assert water is not None
    dim = mesh.topology.dim
    found = [np.empty((0, dim), dtype=np.int32)]
    for facets, values in solution.traces().values():
        middle = dolfinx.mesh.compute_midpoints(mesh, dim - 1, facets).reshape(-1, 3)[:, :dim]
        wet = facets[np.abs(np.nan_to_num(water.pressure(middle, values), nan=np.inf)) <= near]
        if len(wet):
            found.append(dolfinx.mesh.entities_to_geometry(mesh, dim - 1, wet).reshape(-1, dim))
    return np.flatnonzero(sums_at(mesh.geometry.index_map(), np.concatenate(found)) > 0)


def _joined(numbers: Indices, pressure: Array, x: Array) -> list[Array]:
    """The lines, or triangles, from the cells that they cross: numbers, pressures and places of their vertices."""
    dim = x.shape[2]
    order = np.lexsort((numbers, pressure >= 0), axis=1)
    numbers, pressure = np.take_along_axis(numbers, order, axis=1), np.take_along_axis(pressure, order, axis=1)
    x, dry = np.take_along_axis(x, order[:, :, None], axis=1), (pressure < 0).sum(axis=1)
    keys, places = [np.empty((0, dim, 2), dtype=np.int64)], [np.empty((0, dim, dim))]
    for number in range(1, dim + 1):
        for edges in PIECES[number, 0, dim + 1 - number]:  # dry vertices are the first ones
            one, other = np.array(edges).T
            rows = np.flatnonzero(dry == number)[:, None]
            share = pressure[rows, other] / (pressure[rows, other] - pressure[rows, one])
            places.append(x[rows, other] + share[:, :, None] * (x[rows, one] - x[rows, other]))
            ends = numbers[rows, one], numbers[rows, other]
            at_end = pressure[rows, other] == 0
            keys.append(np.sort(np.stack([np.where(at_end, ends[1], ends[0]), ends[1]], axis=2), axis=2))
    flat = np.concatenate(keys).reshape(-1, 2)
    _, first, place = np.unique(flat, axis=0, return_index=True, return_inverse=True)
    points, pieces_of = np.concatenate(places).reshape(-1, dim)[first], place.reshape(-1, dim)
    pieces_of = np.unique(np.sort(pieces_of, axis=1), axis=0)
    pieces_of = pieces_of[(np.diff(pieces_of, axis=1) > 0).all(axis=1)]
    if dim == 3:
        return list(points[pieces_of])
    lines = [points[vertices] for _, vertices in chains(pieces_of)]
    lines = [line if tuple(line[0]) <= tuple(line[-1]) else line[::-1] for line in lines]
    return sorted(lines, key=lambda line: tuple(line[0]))


def lines_in(columns: Columns) -> list[Array]:
    """The lines of the plane whose points are in a table."""
    points, number = np.column_stack([columns["x"], columns["y"]]), columns["line"]
    return [line for line in np.split(points, np.flatnonzero(np.diff(number)) + 1) if len(line)]


def table(solution: Solution) -> Columns:
    """The points of the lines in order, with the number of each line, or triangle; rows on rank 0 (collective)."""
    lines, dim = solution.phreatic, solution.spaces.mesh.topology.dim
    points = np.concatenate([np.empty((0, dim)), *lines])
    number = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
    return {"line" if dim == 2 else "triangle": number, **dict(zip(AXES[:dim], points.T, strict=True))}
