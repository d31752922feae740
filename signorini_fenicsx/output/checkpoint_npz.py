"""Reads the checkpoints of versions up to 0.3: one NumPy archive, read on rank 0 without trusting it."""

import warnings
import zipfile
from pathlib import Path

import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.errors import InputError

OLD_FILE = "checkpoint.npz"


def read_npz(path: Path) -> dict[str, npt.NDArray]:
    """All arrays of a file. Their stated sizes are compared with the size of the file before memory is allocated.

    Raises:
        InputError: If it is an archive that this program never wrote.
        ValueError: If it is damaged; NumPy and zipfile also raise other errors.
    """
    with zipfile.ZipFile(path) as archive, warnings.catch_warnings(action="error"):
        entries = archive.infolist()
        if any(entry.flag_bits & 1 or entry.compress_type != zipfile.ZIP_STORED for entry in entries):
            raise InputError("not a readable solution (it is compressed or encrypted; this program never does that)")
        if sum(entry.file_size for entry in entries) > path.stat().st_size:
            raise InputError("not a readable solution (it states larger sizes than it has)")
        return {entry.filename.removesuffix(".npy"): _array(archive, entry) for entry in entries}


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> npt.NDArray:
    header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    with archive.open(entry) as file:
        version = np.lib.format.read_magic(file)
        if version not in header:
            raise InputError(f"not a readable solution ({entry.filename} is not an array)")
        shape, _, kind = header[version](file)
        count = 1
        for length in shape:
            count *= length
        if kind.hasobject or min(shape, default=0) < 0 or count * kind.itemsize != entry.file_size - file.tell():
            raise InputError(f"not a readable solution ({entry.filename} does not have the size that it states)")
        file.seek(0)
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False))
