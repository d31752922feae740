"""Sparse matrices for changes of unknowns."""

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array


def identity_with(
    comm: MPI.Intracomm,
    size: int,
    rows: npt.NDArray[np.integer],
    columns: npt.NDArray[np.integer],
    values: Array,
    ignored: npt.NDArray[np.integer] | None = None,
) -> PETSc.Mat:
    """The identity with more entries (collective).

    Args:
        comm: Communicator.
        size: Number of rows and of columns of this rank.
        rows: Rows of this rank of the entries, numbered over all ranks.
        columns: Their columns, numbered over all ranks.
        values: Their values.
        ignored: Rows of this rank, from 0, whose entry on the diagonal is 0, but stored.
    """
    first = int(comm.exscan(size) or 0)
    diagonal, every = np.ones(size), first + np.arange(size)
    diagonal[[] if ignored is None else ignored] = 0.0
    matrix = PETSc.Mat().createAIJ([(size, PETSc.DETERMINE)] * 2, comm=comm)
    matrix.setPreallocationCOO(*(np.concatenate([every, some]).astype(PETSc.IntType) for some in (rows, columns)))
    matrix.setValuesCOO(np.concatenate([diagonal, values]))
    return matrix
