"""Tables of a part of the boundary: one text file, or of large parts a Parquet file of each rank."""

import csv
import errno
from collections.abc import Callable, Iterable
from pathlib import Path

from mpi4py import MPI

from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.solving.solved import Columns


def write_columns(path: Path, tables: Iterable[Columns]) -> None:
    """Write tables with the same columns below each other as CSV (rank 0)."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        for number, columns in enumerate(tables):
            if number == 0:
                writer.writerow(columns)
            writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))


def write_by_rank(comm: MPI.Comm, folder: Path, columns: Callable[[], Columns]) -> None:
    """Write the rows of each rank as `<rank>.parquet` in a folder, which is made (collective).

    Args:
        comm: Communicator.
        folder: The folder.
        columns: Gives the columns of the rows of this rank.

    Raises:
        OSError: On all ranks, if the disk is full.
    """
    import pyarrow.parquet  # takes a second to import

    on_root(comm, lambda: folder.mkdir(exist_ok=True))
    failure, mine = "", columns()
    try:
        pyarrow.parquet.write_table(pyarrow.table(dict(mine)), folder / f"{comm.rank:05}.parquet")
    except OSError as error:
        failure = error.strerror or str(error)
    failure = comm.allreduce(failure, MPI.MAX)
    if failure:
        raise OSError(errno.EIO, failure, str(folder))
