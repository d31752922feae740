"""Sparse matrices: for changes of unknowns, and sums of the matrices of cells."""

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt
from dolfinx import common, la
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array

type Nodes = npt.NDArray[np.int32]
type OfCells = tuple[Nodes, Array]
"""The nodes of some cells on this rank, shape (cells, m), and a matrix for each, in blocks, shape (cells, m b, m b)."""


def identity_with(
    comm: MPI.Intracomm,
    size: int,
    rows: npt.NDArray[np.integer],
    columns: npt.NDArray[np.integer],
    values: Array,
    ignored: npt.NDArray[np.integer] | None = None,
    block: int = 1,
) -> PETSc.Mat:
    """The identity with more entries (collective).

    Args:
        comm: Communicator.
        size: Number of rows and of columns of this rank.
        rows: Rows of this rank of the entries, numbered over all ranks.
        columns: Their columns, numbered over all ranks.
        values: Their values.
        ignored: Rows of this rank, from 0, whose entry on the diagonal is 0, but stored.
        block: Size of the blocks in which PETSc sees it.
    """
    first = int(comm.exscan(size) or 0)
    diagonal, every = np.ones(size), first + np.arange(size)
    diagonal[[] if ignored is None else ignored] = 0.0
    rows, columns = (np.append(every, each).astype(PETSc.IntType) for each in (rows, columns))
    matrix = PETSc.Mat().create(comm)
    matrix.setSizes([(size, PETSc.DETERMINE)] * 2, bsize=block)
    matrix.setType("aij")
    matrix.setPreallocationCOO(rows, columns)
    matrix.setValuesCOO(np.append(diagonal, values))
    return matrix


def of_cells(
    comm: MPI.Intracomm, numbers: common.IndexMap, block: int, nodes: Sequence[Nodes], parts: Iterable[OfCells]
) -> PETSc.Mat:
    """The sum of matrices of cells (collective).

    Its entries are counted by blocks, and PETSc adds up the values: sorted one by one, they take four times as long.

    Args:
        comm: The mesh's communicator. That of `numbers` is another one, which nobody asks PETSc to clean up.
        numbers: The nodes.
        block: Number of unknowns of each.
        nodes: Those of all cells of this rank.
        parts: The cells, each of them by one rank; they are asked for one after the other and not kept.
    """
    owned = numbers.size_local
    count, sizes = owned + numbers.num_ghosts, (block * owned, block * numbers.size_global)
    keys = [(each[:, :, None].astype(np.int64) * count + each[:, None]).ravel() for each in nodes]
    ascending = np.sort(np.concatenate(keys))
    rows, columns = np.divmod(ascending[np.diff(ascending, prepend=-1) > 0], count)
    owners = np.append(np.full(owned, comm.rank), numbers.owners)
    entries = la.vector(numbers, 2)  # at most so many blocks of a row are with its owner, and with other ranks
    entries.array[:] = np.bincount(2 * rows + (owners[rows] != owners[columns]), minlength=2 * count)
    entries.scatter_reverse(la.InsertMode.add)
    most = np.minimum(block * entries.array.reshape(-1, 2)[:owned], [sizes[0], sizes[1] - sizes[0]])
    matrix = PETSc.Mat().create(comm)
    matrix.setSizes([sizes, sizes], bsize=block)
    matrix.setType("aij")
    matrix.setPreallocationNNZ(tuple(most.astype(PETSc.IntType).repeat(block, axis=0).T))
    matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, True)  # said on all ranks, even without a row
    for part in parts:
        add_of_cells(matrix, numbers, *part)
    matrix.assemble()
    return matrix


def add_of_cells(matrix: PETSc.Mat, numbers: common.IndexMap, nodes: Nodes, matrices: Array) -> None:
    """Add matrices of cells, see `OfCells`; the matrix is to be assembled then."""
    places = numbers.local_to_global(nodes.ravel()).astype(PETSc.IntType).reshape(nodes.shape)
    matrix.setValuesBlockedRCV(places, places, np.ascontiguousarray(matrices), addv=True)
