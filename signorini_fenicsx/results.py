"""A results folder that appears whole or not at all: written beside its target, swapped in on success."""

import contextlib
import os
import shutil
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Self

from mpi4py import MPI

from signorini_fenicsx.errors import InputError
from signorini_fenicsx.parallel import on_root

MARK = "summary.json"
"""A folder that holds this file is a results folder and may be replaced."""

OUTPUTS = (MARK, "run.json", "checkpoint.npz", "*.csv", "*.png", "*.bp", "solution.xdmf", "solution.h5")


class ResultsFolder:
    """Staging area of one results folder; a context manager whose methods are all collective.

    Write into `path`, then call `publish` or `keep_failed`. If neither is called before the context ends, nothing
    stays: neither the staging area nor parents made for it.
    """

    def __init__(self, comm: MPI.Comm, target: Path | str):
        """Check the target and create the staging area beside it.

        Raises:
            InputError: If the target is a file, is not writable, or is a folder with something else in it.
        """
        self._comm = comm
        self.target, self.path, self._new_parents = on_root(comm, lambda: _open(Path(target)))
        self._failed = failed_place(self.target)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._comm.rank == 0 and self.path.exists():
            shutil.rmtree(self.path, ignore_errors=True)
            with contextlib.suppress(OSError):  # somebody else uses them by now
                for parent in self._new_parents:
                    parent.rmdir()

    def publish(self) -> None:
        """Put the staging area in the target's place; an earlier failure is then out of date and goes."""
        self._replace(self.target)
        if self._comm.rank == 0:
            shutil.rmtree(self._failed, ignore_errors=True)

    def keep_failed(self) -> Path:
        """Keep the staging area as `<target>.failed`, leave the target alone and return the new path."""
        self._replace(self._failed)
        return self._failed

    def _replace(self, place: Path) -> None:
        self._comm.Barrier()  # all ranks have written

        def swap() -> None:
            if place.exists():
                old = self.path.with_suffix(".old")
                place.rename(old)
                self.path.rename(place)
                for entry in old.iterdir():  # what the user put there stays
                    if not any(entry.match(pattern) for pattern in OUTPUTS):
                        entry.rename(place / entry.name)
                shutil.rmtree(old)
            else:
                self.path.rename(place)

        on_root(self._comm, swap)


def failed_place(target: Path) -> Path:
    """Where the state of a failed run is kept."""
    return target.with_name(target.name + ".failed")


def _open(wanted: Path) -> tuple[Path, Path, list[Path]]:
    """Resolve and check the target and create the staging area: target, staging area, parents made (rank 0).

    Raises:
        InputError: If it cannot be a results folder.
    """
    try:
        target = Path(os.path.realpath(wanted))  # other than resolve, it treats loops alike in all versions of Python
        _check(target)
        missing = [folder for folder in target.parents if not folder.exists()]
        target.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".partial", dir=target.parent))
        umask = os.umask(0)
        os.umask(umask)
        staging.chmod(0o777 & ~umask)  # mkdtemp makes folders private
    except OSError as error:
        raise InputError(f"output {wanted}: cannot be written ({error.strerror})") from None
    except ValueError as error:  # a null byte
        raise InputError(f"output {wanted!r}: {error}") from None
    return target, staging, missing


def _check(target: Path) -> None:
    if target.is_symlink():  # all others are resolved
        raise InputError(f"output {target}: is a symlink loop")
    if os.path.ismount(target):
        raise InputError(f"output {target}: is a mount point, which cannot be replaced; choose a folder in it")
    if target == Path.cwd():
        raise InputError(f"output {target}: is the current folder, which cannot be replaced; choose another")
    for place in (target, failed_place(target)):
        if place.exists() and not place.is_dir():
            raise InputError(f"output {place}: is a file, not a folder")
        if place.is_dir() and any(place.iterdir()) and not (place / MARK).is_file():
            raise InputError(f"output {place}: is not empty and holds no {MARK}; choose another folder")
