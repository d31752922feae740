"""Rows of distributed arrays: fetched by their number, or looked up by their content.

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
        wanted: Numbers of the wanted rows; the numbers continue from rank to rank.
        rows: Rows of this rank; None for none, but not on all ranks.

    Returns:
        The wanted rows.
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
    """Look up rows of numbers in sets whose rows come from all ranks (collective).

    The numbers of a row determine the rank that looks it up.

    Args:
        comm: Communicator.
        rows: Rows of this rank, shape (n, k).
        marked: For each set its rows from this rank, shape (m, k); the same number of sets on all ranks.

    Returns:
        Mask of the rows in each set, shape (n, sets).
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
    """Mask of the rows that are in a table."""
    _, number = np.unique(np.concatenate([rows, table]), axis=0, return_inverse=True)
    return np.isin(number[: len(rows)], number[len(rows) :])
