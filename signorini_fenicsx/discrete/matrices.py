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
    rows, columns = np.concatenate([every, rows]), np.concatenate([every, columns])
    return of_entries(comm, size, rows, columns, np.concatenate([diagonal, values]))


def of_entries(
    comm: MPI.Intracomm,
    size: int,
    rows: npt.NDArray[np.integer],
    columns: npt.NDArray[np.integer],
    values: Array,
    block: int = 1,
) -> PETSc.Mat:
    """A square matrix of these entries, which add up where several have the same place (collective).

    Args:
        comm: Communicator.
        size: Number of rows and of columns of this rank.
        rows: Their rows, of any rank, numbered over all ranks.
        columns: Their columns, numbered over all ranks.
        values: Their values.
        block: Size of the blocks of the matrix.
    """
    matrix = PETSc.Mat().create(comm)
    matrix.setSizes([(size, PETSc.DETERMINE)] * 2, bsize=block)
    matrix.setType("aij")
    matrix.setPreallocationCOO(rows.astype(PETSc.IntType), columns.astype(PETSc.IntType))
    matrix.setValuesCOO(values)
    return matrix
