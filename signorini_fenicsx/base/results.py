"""A results folder that appears whole or not at all: written beside its target, put in its place on success."""

import contextlib
import os
import shutil
import sys
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Self

from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError, WriteFailure
from signorini_fenicsx.base.exchange import (
    DONE,
    FAILED,
    area_of,
    check,
    commit,
    delete,
    failed_place,
    locked,
    release,
    settle,
    tidy,
)
from signorini_fenicsx.base.parallel import end_all, on_root
from signorini_fenicsx.base.signals import on_abort, postponed

PATIENCE = 1.0
"""Seconds to wait for a folder; a process that repairs it needs less."""
STATE = "checkpoint"
"""The folder that is kept if the others cannot be written."""


class ResultsFolder:
    """Staging area of one results folder; a context manager whose methods are all collective.

    Write into `path`, then call `publish` or `keep_failed`. If neither is called before the context ends, nothing
    stays: the staging area is removed, and parent folders made for it too. There is one exception: if the context ends
    because files cannot be written, a finished checkpoint stays as `<target>.failed`.
    """

    def __init__(self, comm: MPI.Comm, target: Path | str, *, saves_state: bool = True):
        """Check and lock the target and create the staging area beside it.

        Args:
            comm: Communicator.
            target: The folder.
            saves_state: Whether a checkpoint stays if the rest cannot be written.

        Raises:
            InputError: If the target is a file, is not writable, is a folder with other files in it, or another run is
                writing into it.
        """
        self._comm, self._saves_state = comm, saves_state
        self._area: _Area | None = None  # on rank 0

        def begin() -> tuple[Path, Path]:
            self._area = _Area(Path(target))
            return self._area.target, self._area.staging

        self.target, self.path = on_root(comm, begin)
        self._on_abort = on_abort(lambda: self._give_up("a library has aborted the program"))

    def __enter__(self) -> Self:
        self._on_abort.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, WriteFailure):
            self._give_up(str(error))
        self._on_abort.__exit__(None, None, None)
        if self._area is not None:
            if isinstance(error, OSError):
                error.strerror = f"{error.strerror or error}{self._state_saved()}"
                if Path(error.filename or self.path).is_relative_to(self.path):
                    error.filename = str(self.target)  # the user does not know the staging area
            self._area.close()

    def publish(self, *, add: bool = False) -> None:
        """Move the files to their place.

        They replace the files of the run before; with `add`, only those with the same names. The folder of an earlier
        failure is removed.
        """
        self._end(DONE, add=add)

    def keep_failed(self) -> Path:
        """Keep the files as `<target>.failed`, leave the target unchanged and return the new path."""
        self._end(FAILED)
        return failed_place(self.target)

    def _end(self, end: str, *, add: bool = False) -> None:
        self._comm.Barrier()  # all ranks have written
        with postponed():
            on_root(self._comm, lambda: commit(self.path, end, add=add))

    def _give_up(self, reason: str) -> NoReturn:
        """End all ranks, whatever the others are doing (called by one rank)."""
        with contextlib.suppress(OSError):
            reason += f"; free on the disk: {shutil.disk_usage(self.target.parent).free >> 10} kB"
        reason += self._state_saved()
        if self._area is not None:
            self._area.close()
        sys.stdout.flush()
        end_all(self._comm, f"failed: {self.target}: {reason}\n")

    def _state_saved(self) -> str:
        """Keep only the checkpoint, if there is one, and tell where it is (on any rank, not collective)."""
        if not self._saves_state or not (self.path / STATE).is_dir():
            return ""
        try:
            for entry in self.path.iterdir():
                if entry.name != STATE:
                    delete(entry)
            commit(self.path, FAILED)
        except OSError:
            return ""
        return f"; the state is in {failed_place(self.target)}, for export and --start-from"


class _Area:
    """The folder in which a run works until its results are in place (rank 0)."""

    def __init__(self, wanted: Path):
        """Lock the area of a target, complete what a killed run has left there, and create the staging folder.

        Raises:
            InputError: If the target cannot be a results folder, or another run is writing into it.
        """
        self._lock: int | None = None
        self._new_parents: list[Path] = []
        try:
            self._open(wanted)
        except OSError as error:
            self.close()
            raise InputError(f"output {wanted}: cannot be written ({error.strerror})") from None
        except ValueError as error:  # a null byte
            raise InputError(f"output {wanted!r}: {error}") from None
        except InputError:
            self.close()
            raise

    def _open(self, wanted: Path) -> None:
        self.target = Path(os.path.realpath(wanted))  # unlike resolve, the same for loops in all versions
        if self.target.is_symlink():  # all others are resolved
            raise InputError(f"output {self.target}: is a symlink loop")
        if os.path.ismount(self.target):
            raise InputError(f"output {self.target}: is a mount point, so files cannot be moved to it; take one below")
        self._new_parents = [folder for folder in self.target.parents if not folder.exists()]
        self.target.parent.mkdir(parents=True, exist_ok=True)
        self._path = area_of(self.target)
        self._lock = locked(self._path, PATIENCE)
        if self._lock is None:
            raise InputError(f"output {self.target}: another run is writing into it; wait for it, or choose another")
        settle(self._path)
        for place in (self.target, failed_place(self.target)):
            check(place)
        tidy(self._path)
        self.staging = self._path / str(os.getpid())
        self.staging.mkdir()

    def close(self) -> None:
        """Remove what is not complete and empty parents that were made for it, and release the lock."""
        with contextlib.suppress(OSError):  # the folder is gone, or the parents are in use by now
            if self._lock is not None:
                lock, self._lock = self._lock, None
                release(self._path, lock)
            for parent in self._new_parents:
                parent.rmdir()
