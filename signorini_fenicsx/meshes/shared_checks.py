"""Checks of the cells of a mesh that all ranks hold together, before DOLFINx makes the mesh of them."""

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.rows import Exchange, fetch_rows, first_row
from signorini_fenicsx.meshes.checks import FLAT, diameters


def check_cells(comm: MPI.Comm, points: Array, cells: Indices) -> None:
    """Refuse cells that are flat or overlap their neighbours, and points without cells (collective).

    Args:
        comm: Communicator.
        points: The points of this rank; their numbers continue from rank to rank.
        cells: The cells of this rank, by the numbers of their points.

    Raises:
        InputError: On all ranks, if there is one of them.
    """
    total = comm.allreduce(len(points))
    refuse(comm, "an element has a point that is not in the file" * bool(np.any((cells < 0) | (cells >= total))))
    used, local = np.unique(cells, return_inverse=True)
    corners, local = fetch_rows(comm, used, points), np.sort(local.reshape(cells.shape), axis=1)
    longest = diameters(corners, local)
    edges = corners[local[:, 1:]] - corners[local[:, :1]]
    volumes = np.linalg.det(edges / np.where(longest > 0, longest, 1.0)[:, None, None])
    refuse(comm, "a cell is without volume" * bool(np.any((np.abs(volumes) <= FLAT) | (longest == 0))))
    _check_facets(comm, used[local], volumes > 0)
    seen = np.zeros(len(points), dtype=bool)
    ends = np.cumsum(comm.allgather(len(points)))
    rank = np.searchsorted(ends, used, side="right")
    seen[Exchange(comm, rank).send(used) - first_row(comm, len(points))] = True
    refuse(comm, "a point has no cell" * (not seen.all()))


def _check_facets(comm: MPI.Comm, cells: Indices, positive: Mask) -> None:
    """Refuse more than two cells at a facet, and two on the same side of it (collective).

    The rank that decides about a facet is determined by its vertices. The vertices of a cell are ascending; then the
    cell's orientation and the place of the opposite vertex determine the side of a facet on which the cell is.
    """
    width = cells.shape[1]
    facets = np.concatenate([np.delete(cells, opposite, axis=1) for opposite in range(width)])
    side = np.concatenate([positive ^ (opposite % 2 == 1) for opposite in range(width)])
    rows = Exchange(comm, facets.sum(axis=1) % comm.size).send(np.column_stack([facets, side]))
    rows = rows[np.lexsort(rows[:, :-1].T)]
    same = np.all(rows[1:, :-1] == rows[:-1, :-1], axis=1)
    refuse(comm, "more than two cells meet at a facet" * bool(np.any(same[1:] & same[:-1])))
    folded = same & (rows[1:, -1] == rows[:-1, -1])
    refuse(comm, "neighbouring cells overlap (inverted or folded cells)" * bool(folded.any()))


def refuse(comm: MPI.Comm, reason: str) -> None:
    """Raise an error on all ranks if one of them has a reason (collective).

    Raises:
        InputError: With this reason.
    """
    reason = comm.allreduce(reason, MPI.MAX)
    if reason:
        raise InputError(reason)
