"""Rows of distributed arrays: sent to other ranks, fetched by their number, looked up by their content, sorted.

No rank ever holds more than its share. (`parallel.gather_rows` brings all rows to rank 0.)
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, rows_of

DIGITS = 12


class Exchange:
    """A way of rows to ranks, and of answers back. All methods are collective.

    Rows arrive in the order of their senders, and those of one sender in its order.
    """

    def __init__(self, comm: MPI.Comm, ranks: Indices):
        """Say where the rows go (collective).

        Args:
            comm: Communicator.
            ranks: For each row of this rank the rank that gets it.
        """
        self._comm = comm
        self._order = np.argsort(ranks, kind="stable")
        self._sent = np.bincount(ranks, minlength=comm.size)
        self._received = np.empty_like(self._sent)
        comm.Alltoall(self._sent, self._received)

    def send(self, rows: npt.NDArray) -> npt.NDArray:
        """The rows that arrive here; the same type and width on all ranks."""
        return self._moved(np.ascontiguousarray(rows[self._order]), self._sent, self._received)

    def answer(self, rows: npt.NDArray) -> npt.NDArray:
        """The answers to the rows that this rank has sent; `rows` has an answer for each row that arrived."""
        back = self._moved(np.ascontiguousarray(rows), self._received, self._sent)
        answers = np.empty_like(back)
        answers[self._order] = back
        return answers

    def _moved(self, rows: npt.NDArray, sent: Indices, received: Indices) -> npt.NDArray:
        arrived = np.empty((int(received.sum()), *rows.shape[1:]), dtype=rows.dtype)
        kind = MPI.BYTE.Create_contiguous(rows.dtype.itemsize * math.prod(rows.shape[1:])).Commit()
        self._comm.Alltoallv([rows, sent, kind], [arrived, received, kind])
        kind.Free()
        return arrived


class Order:
    """All rows of a distributed array, ordered by numbers that differ. All methods are collective.

    Each rank gets the rows whose numbers are in its range, so the rows continue from rank to rank.
    """

    def __init__(self, comm: MPI.Comm, numbers: Indices):
        """Find the order (collective).

        Args:
            comm: Communicator.
            numbers: Number of each row of this rank, ≥ 0; numbers may be missing.
        """
        self._comm = comm
        self._end = max(1, comm.allreduce(int(numbers.max(initial=0)) + 1, MPI.MAX))
        self._exchange = Exchange(comm, self._rank(numbers))
        arrived = self._exchange.send(numbers)
        self._order = np.argsort(arrived)
        self._numbers = arrived[self._order]

    def _rank(self, numbers: Indices) -> Indices:
        return numbers * self._comm.size // self._end

    def sorted(self, rows: npt.NDArray) -> npt.NDArray:
        """The rows that are this rank's share in the order."""
        return self._exchange.send(rows)[self._order]

    def places(self, wanted: Indices) -> Indices:
        """Places in the order of these numbers, which must be among those of all ranks."""
        exchange = Exchange(self._comm, self._rank(wanted))
        place = np.searchsorted(self._numbers, exchange.send(wanted))
        return exchange.answer(first_row(self._comm, len(self._numbers)) + place)


def first_row(comm: MPI.Comm, rows: int) -> int:
    """Number of rows on the ranks before this one, which has `rows` of them (collective)."""
    return sum(comm.allgather(rows)[: comm.rank])


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
    _, shape, kind = next(one for one in about if one is not None)
    rows = np.empty((0, *shape), dtype=kind) if rows is None else rows
    exchange = Exchange(comm, np.searchsorted(ends, wanted, side="right"))
    return exchange.answer(rows[exchange.send(np.asarray(wanted)) - (ends[comm.rank] - len(rows))])


def find_rows(comm: MPI.Comm, rows: Indices, tables: Sequence[Indices]) -> Indices:
    """Look up rows of numbers in tables whose rows come from all ranks (collective).

    The numbers of a row determine the rank that looks it up.

    Args:
        comm: Communicator.
        rows: Rows of this rank, shape (n, k).
        tables: Tables by their rows on this rank, shape (m, k); as many on all ranks.

    Returns:
        For each row its number in each table, where numbers continue from rank to rank; −1 if it is not there. Shape
        (n, tables).
    """
    exchange = Exchange(comm, rows.sum(axis=1) % comm.size)
    asked, columns = exchange.send(rows), []
    for table in tables:
        to_keepers = Exchange(comm, table.sum(axis=1) % comm.size)
        number = to_keepers.send(first_row(comm, len(table)) + np.arange(len(table)))
        columns.append(np.append(number, -1)[rows_of(asked, to_keepers.send(table))])
    return exchange.answer(np.stack(columns, axis=1))


def in_digits(places: Array) -> Array:
    """Coordinates without their last digits, which depend on the partition, in units of about the largest one.

    Rows are sorted by them (not collective).
    """
    scale = 2.0 ** np.ceil(np.log2(np.abs(places).max(initial=np.finfo(np.float64).tiny)))
    return np.round(places / scale, DIGITS)


def share(comm: MPI.Comm, rows: int) -> slice:
    """The rows that this rank takes if all ranks take about as many."""
    return slice(rows * comm.rank // comm.size, rows * (comm.rank + 1) // comm.size)


def joined(number: int, groups: npt.NDArray) -> Indices:
    """The sets into which groups join items of this rank, as a number of its set for each item.

    Each set, an item at first, is joined to that with the smallest number in its groups, until none has any. SciPy's
    `connected_components` does the same, but is slow to import.

    Args:
        number: Number of items.
        groups: Items that belong together, shape (groups, n).

    Returns:
        Numbers from 0 without gaps, in the order of the first item of each set.
    """
    items = np.arange(number)
    of_item = items
    while True:
        around = of_item[groups]
        apart = (around != around[:, :1]).any(axis=1)
        if not apart.any():
            return (np.cumsum(of_item == items) - 1)[of_item]
        groups, around, target = groups[apart], around[apart], items.copy()
        smallest = around.min(axis=1)
        for column in around.T:
            np.minimum.at(target, column, smallest)
        while not np.array_equal(further := target[target], target):
            target = further
        of_item = target[of_item]
