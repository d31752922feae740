"""Distributed arrays and matrices gathered on rank 0, for algorithms that are not parallel."""

import numpy as np
import numpy.typing as npt
import scipy.sparse
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.parallel import gather_rows


class RootRows:
    """Arrays with some rows per rank, gathered on rank 0 and scattered back; all methods are collective."""

    def __init__(self, comm: MPI.Comm, size: int):
        """Collect the number of rows of each rank."""
        self.comm = comm
        self._ends = np.cumsum(comm.allgather(size))[:-1]

    def gather(self, rows: npt.NDArray) -> npt.NDArray | None:
        """The rows of all ranks, in rank order, on rank 0; None elsewhere."""
        return gather_rows(self.comm, rows)

    def scatter(self, rows: npt.NDArray | None) -> npt.NDArray:
        """The rows of this rank, from all of them on rank 0."""
        parts = None if rows is None else np.split(rows, self._ends)
        return self.comm.scatter(parts)


def matrix_on_root(matrix: PETSc.Mat) -> scipy.sparse.csr_array | None:
    """The whole matrix on rank 0, None elsewhere (collective)."""
    comm = matrix.getComm().tompi4py()
    parts = comm.gather(matrix.getValuesCSR())
    if parts is None:
        return None
    counts = np.concatenate([np.diff(offsets) for offsets, _, _ in parts])
    offsets = np.concatenate([[0], np.cumsum(counts)])
    columns, values = (np.concatenate([part[i] for part in parts]) for i in (1, 2))
    return scipy.sparse.csr_array((values, columns, offsets), shape=matrix.getSize())
