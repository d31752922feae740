"""Arrays whose rows come from all ranks, in NumPy's `.npy` files or HDF5: by MPI-IO, each rank its own rows."""

import errno
import io
import math
import os
import tokenize
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.rows import share

UNREADABLE = (ValueError, EOFError, RecursionError, Warning, SyntaxError, tokenize.TokenError, zipfile.BadZipFile)
"""Errors of NumPy and zipfile for damaged files. NumPy also warns when it reads something that it never wrote."""


@dataclass(frozen=True)
class Header:
    """What a file says about its array.

    Attributes:
        shape: Its shape.
        kind: Type of its numbers.
        begin: Where the numbers begin, in bytes.
    """

    shape: tuple[int, ...]
    kind: np.dtype
    begin: int

    def place(self, row: int) -> int:
        """The byte at which a row begins."""
        return self.begin + row * self.kind.itemsize * math.prod(self.shape[1:])


def write_arrays(comm: MPI.Comm, folder: Path, arrays: Mapping[str, npt.NDArray]) -> None:
    """Write arrays as files `<name>.npy` into an existing folder (collective).

    The space for all files is allocated first, so a full disk is noticed before anything is written.

    Args:
        comm: Communicator.
        folder: The folder.
        arrays: The rows of this rank by the name of the array; rows continue from rank to rank.

    Raises:
        OSError: On all ranks, if the disk is full, or a rank cannot write.
    """
    firsts, totals = _shares(comm, arrays)
    heads = [_head(rows, total) for rows, total in zip(arrays.values(), totals, strict=True)]
    paths = [folder / f"{name}.npy" for name in arrays]

    def allocate() -> None:
        for path, (head, header) in zip(paths, heads, strict=True):
            with path.open("wb") as file:
                os.posix_fallocate(file.fileno(), 0, header.place(header.shape[0]))
                file.write(head)

    on_root(comm, allocate)
    for path, (_, header), first, rows in zip(paths, heads, firsts, arrays.values(), strict=True):
        _together(comm, path, MPI.MODE_WRONLY, header.place(first), np.ascontiguousarray(rows))


def add_to_hdf5(comm: MPI.Comm, path: Path, arrays: Mapping[str, npt.NDArray]) -> list[Header]:
    """Add arrays to an HDF5 file, which is made if there is none (collective).

    Rank 0 makes the datasets and allocates their space, by an HDF5 that needs to know nothing of MPI.

    Args:
        comm: Communicator.
        path: The file.
        arrays: The rows of this rank by the name of the dataset; rows continue from rank to rank.

    Returns:
        Shape, type and place of each, on all ranks.

    Raises:
        OSError: On all ranks, if the disk is full, or a rank cannot write.
    """
    firsts, totals = _shares(comm, arrays)

    def allocate() -> list[Header]:
        import h5py  # takes a quarter of a second to import

        early = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        early.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        early.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        heads = []
        with h5py.File(path, "a") as file:
            for (name, rows), total in zip(arrays.items(), totals, strict=True):
                shape = (total, *rows.shape[1:])
                place = file.create_dataset(name, shape, rows.dtype, dcpl=early).id.get_offset()
                heads.append(Header(shape, rows.dtype, place or 0))  # empty ones are nowhere
        with path.open("r+b") as opened:
            os.posix_fallocate(opened.fileno(), 0, path.stat().st_size)
        return heads

    heads: list[Header] = on_root(comm, allocate)
    for header, first, rows in zip(heads, firsts, arrays.values(), strict=True):
        _together(comm, path, MPI.MODE_WRONLY, header.place(first), np.ascontiguousarray(rows))
    return heads


def _shares(comm: MPI.Comm, arrays: Mapping[str, npt.NDArray]) -> tuple[list[int], list[int]]:
    """The first row of this rank in each array, and the number of rows of all ranks (collective)."""
    lengths = np.array(comm.allgather([len(rows) for rows in arrays.values()]))  # by rank and array
    return lengths[: comm.rank].sum(axis=0, dtype=np.int64).tolist(), lengths.sum(axis=0).tolist()


def _head(rows: npt.NDArray, total: int) -> tuple[bytes, Header]:
    """The first bytes of a file, and what they say."""
    shape = (total, *rows.shape[1:])
    head = io.BytesIO()
    about = {"descr": np.lib.format.dtype_to_descr(rows.dtype), "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(head, about)
    return head.getvalue(), Header(shape, rows.dtype, head.tell())


def read_header(path: Path) -> Header:
    """What a file says about its array, if its size agrees (on any rank, not collective).

    Raises:
        ValueError: If it is no file of an array of numbers, or does not have the size that it states. For other
            damage NumPy raises other errors.
        OSError: If it cannot be read.
    """
    with path.open("rb") as file:
        try:
            version = np.lib.format.read_magic(file)
            readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
            shape, by_columns, kind = readers[version](file)
        except (KeyError, ValueError) as error:
            raise ValueError(f"{path.name} is not an array: {error}") from None
        header = Header(tuple(int(length) for length in shape), kind, file.tell())
    if by_columns and len(shape) > 1:
        raise ValueError(f"{path.name} has its columns one after the other")
    size = header.begin + kind.itemsize * math.prod(header.shape)
    if kind.hasobject or min(header.shape, default=0) < 0 or path.stat().st_size != size:
        raise ValueError(f"{path.name} does not have the size that it states")
    return header


def read_share(comm: MPI.Comm, path: Path, header: Header) -> npt.NDArray:
    """This rank's share of the rows of a file, see `rows.share` (collective).

    Raises:
        OSError: On all ranks, if a rank cannot read.
    """
    chosen = share(comm, header.shape[0])
    rows = np.empty((chosen.stop - chosen.start, *header.shape[1:]), dtype=header.kind)
    _together(comm, path, MPI.MODE_RDONLY, header.place(chosen.start), rows)
    return rows


def _together(comm: MPI.Comm, path: Path, mode: int, place: int, rows: npt.NDArray) -> None:
    """Write these rows at this place of a file, or read them, on all ranks at once (collective)."""
    reason = ""
    assert isinstance(comm, MPI.Intracomm)
    try:
        file = MPI.File.Open(comm, path, mode)
        try:
            (file.Write_at_all if mode == MPI.MODE_WRONLY else file.Read_at_all)(place, rows.view(np.uint8).ravel())
        finally:
            file.Close()
    except MPI.Exception as error:
        reason = error.Get_error_string()
    reason = comm.allreduce(reason, MPI.MAX)
    if reason:
        raise OSError(errno.EIO, reason, str(path))
