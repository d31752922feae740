"""A results folder that appears whole or not at all: written beside its target, put in its place on success."""

import contextlib
import os
import shutil
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Self

from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError, WriteFailure
from signorini_fenicsx.base.exchange import DONE, FAILED, Area, delete, failed_place
from signorini_fenicsx.base.parallel import end_all, on_root
from signorini_fenicsx.base.signals import on_abort, postponed

STATE = "checkpoint"
"""The folder that is kept if the others cannot be written."""
ATTEMPTS = 5
"""So often it is tried to keep it alone."""


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
        self._work: _Work | None = None  # on rank 0

        def begin() -> tuple[Path, Path]:
            self._work = _Work(Path(target))
            return self._work.area.target, self._work.staging

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
        if self._work is not None:
            if isinstance(error, OSError):
                error.strerror = f"{error.strerror or error}{self._state_saved()}"
                if Path(error.filename or self.path).is_relative_to(self.path):
                    error.filename = str(self.target)  # the user does not know the staging area
            self._work.close()

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
            on_root(self._comm, lambda: self._commit(end, add=add))

    def _commit(self, end: str, *, add: bool) -> None:
        if self._work is not None:  # so on rank 0
            self._work.area.commit(end, add=add)

    def _give_up(self, reason: str) -> NoReturn:
        """End all ranks, whatever the others are doing (called by one rank)."""
        with contextlib.suppress(OSError):
            reason += f"; free on the disk: {shutil.disk_usage(self.target.parent).free >> 10} kB"
        reason += self._state_saved()
        if self._work is not None:
            self._work.close()
        sys.stdout.flush()
        end_all(self._comm, f"failed: {self.target}: {reason}\n")

    def _state_saved(self) -> str:
        """Keep only the checkpoint, if there is one, and tell where it is (on any rank, not collective)."""
        if self._work is None or not self._saves_state or not (self.path / STATE).is_dir():
            return ""
        for _ in range(ATTEMPTS):
            with contextlib.suppress(OSError):
                for entry in self.path.iterdir():
                    if entry.name != STATE:
                        delete(entry)
                self._work.area.commit(FAILED)
                return f"; the state is in {failed_place(self.target)}, for export and --start-from"
            time.sleep(0.1)  # another rank may still write into what is deleted
        return ""


class _Work:
    """The work on one results folder, on rank 0.

    Attributes:
        area: The locked folder in which the run works until its results are in place.
        staging: The folder in it for the files of this process.
    """

    def __init__(self, wanted: Path):
        """Lock the area of a target, complete what a killed run has left there, and create the staging folder.

        Raises:
            InputError: If the target cannot be a results folder, or another run is writing into it.
        """
        with contextlib.ExitStack() as opened:
            try:
                self._open(wanted, opened)
            except BlockingIOError:
                raise InputError(
                    f"output {wanted}: another run is writing into it; wait for it, or choose another"
                ) from None
            except OSError as error:
                raise InputError(f"output {wanted}: cannot be written ({error.strerror})") from None
            except ValueError as error:  # a null byte
                raise InputError(f"output {wanted!r}: {error}") from None
            self._opened = opened.pop_all()

    def _open(self, wanted: Path, opened: contextlib.ExitStack) -> None:
        target = Path(os.path.realpath(wanted))  # unlike resolve, the same for loops in all versions
        if target.is_symlink():  # all others are resolved
            raise InputError(f"output {target}: is a symlink loop")
        if os.path.ismount(target):
            raise InputError(f"output {target}: is a mount point, so files cannot be moved to it; take one below")
        for parent in reversed([folder for folder in target.parents if not folder.exists()]):
            opened.callback(_remove_if_empty, parent)
        target.parent.mkdir(parents=True, exist_ok=True)
        self.area = Area(target)
        opened.callback(self._release)
        self.area.settle()
        self.area.tidy()
        self.staging = self.area.staging()

    def _release(self) -> None:
        with contextlib.suppress(OSError):  # the folder is gone
            self.area.close()

    def close(self) -> None:
        """Remove what is not complete and empty parents that were made for it, and release the lock."""
        self._opened.close()


def _remove_if_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):  # it is in use by now
        folder.rmdir()
