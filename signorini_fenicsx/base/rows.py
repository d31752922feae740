"""Rows of arrays that are spread over the ranks: fetched by their number, and looked up by their content.

No rank ever holds more than its share. (`parallel.gather_rows` brings all rows to rank 0.)
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Indices, Mask


def fetch_rows(comm: MPI.Comm, wanted: Indices, rows: npt.NDArray | None) -> npt.NDArray:
    """Fetch rows by their number (collective).

    Args:
        comm: Communicator.
        wanted: Numbers of rows, counted from rank to rank.
        rows: Those of this rank; None for none, but not on all ranks.
    """
    about = comm.allgather(None if rows is None else (len(rows), rows.shape[1:], rows.dtype))
    ends = np.cumsum([0 if one is None else one[0] for one in about])
    starts = np.concatenate([[0], ends[:-1]])
    owner = np.searchsorted(ends, wanted, side="right")
    places = [np.flatnonzero(owner == rank) for rank in range(comm.size)]
    asked = comm.alltoall([wanted[place] - start for place, start in zip(places, starts, strict=True)])
    answers = comm.alltoall([None if rows is None else rows[each] for each in asked])
    _, shape, kind = next(one for one in about if one is not None)
    found = np.empty((len(wanted), *shape), dtype=kind)
    for place, answer in zip(places, answers, strict=True):
        if len(place) > 0:
            found[place] = answer
    return found


def marked_rows(comm: MPI.Comm, rows: Indices, marked: Sequence[Indices]) -> Mask:
    """Look rows of numbers up in sets to which any rank may have contributed (collective).

    Each row is looked up on a rank that its numbers choose.

    Args:
        comm: Communicator.
        rows: Shape (n, k).
        marked: For each set the rows that this rank contributes, shape (m, k); as many sets on all ranks.

    Returns:
        Which row is in which set, shape (n, sets).
    """

    def sent(table: Indices) -> list[Indices]:
        rank = table.sum(axis=1) % comm.size
        return [table[rank == each] for each in range(comm.size)]

    asked = comm.alltoall(sent(rows))
    known = [np.concatenate(comm.alltoall(sent(table))) for table in marked]
    answers = comm.alltoall([np.stack([_is_in(each, table) for table in known], axis=1) for each in asked])
    found = np.empty((len(rows), len(marked)), dtype=bool)
    rank = rows.sum(axis=1) % comm.size
    for each, answer in enumerate(answers):
        found[rank == each] = answer
    return found


def _is_in(rows: Indices, table: Indices) -> Mask:
    """Which rows are among those of a table."""
    _, number = np.unique(np.concatenate([rows, table]), axis=0, return_inverse=True)
    return np.isin(number[: len(rows)], number[len(rows) :])
