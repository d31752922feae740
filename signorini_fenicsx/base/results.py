"""A results folder: written beside its target and put in its place as a whole; what comes after that is added."""

import contextlib
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Self

from mpi4py import MPI

from signorini_fenicsx.base.errors import EXIT_FAILED, EXIT_LATER, InputError, LaterFailure, in_words
from signorini_fenicsx.base.exchange import DONE, FAILED, Area, delete, failed_place
from signorini_fenicsx.base.parallel import end_all, first_words, on_root
from signorini_fenicsx.base.signals import on_abort, postponed

STATE = "checkpoint"
"""The folder that is published alone if there is no room for the others."""


class ResultsFolder:
    """Staging area of one results folder; a context manager whose methods are all collective.

    Write a solution into `path`, then call `publish` or `keep_failed`. If neither is called before the context ends,
    nothing stays: the staging area is removed, and parent folders made for it too. What comes after the solution is
    done by `attempt`. If something of it fails, the context ends with a `LaterFailure`.

    Attributes:
        comm: Communicator.
        target: The folder.
        path: The staging area, another one after each call of `publish`.
        failures: What failed and why in words, by what was attempted.
    """

    def __init__(self, comm: MPI.Comm, target: Path | str):
        """Check and lock the target and create the staging area beside it.

        Raises:
            InputError: If the target is a file, is not writable, is a folder with other files in it, or another run is
                writing into it.
        """
        self.comm = comm
        self._area: Area | None = None  # on rank 0
        self._opened = contextlib.ExitStack()
        self._ended: str | None = None
        self._cause: Exception | None = None
        self.failures: dict[str, str] = {}

        def begin() -> tuple[Path, Path]:
            self._area = _locked(Path(target), self._opened)
            return self._area.target, self._area.staging()

        self.target, self.path = on_root(comm, begin)
        self._on_abort = on_abort(lambda: self._give_up("a library has aborted the program"))

    def __enter__(self) -> Self:
        self._on_abort.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._ended == DONE and (error is None or isinstance(error, Exception)):
            self._note("", error)
        self._on_abort.__exit__(None, None, None)
        if isinstance(error, OSError) and Path(error.filename or self.path).is_relative_to(self.path):
            error.strerror = error.strerror or str(error)
            error.filename = str(self.target)  # the user does not know the staging area
        self._opened.close()
        if self._ended == DONE and self.failures:
            raise LaterFailure(f"{self.told()}; the solution is in {self.target}") from self._cause

    def publish(self, *, add: bool = False) -> None:
        """Move the files to their place.

        They replace the files of the run before; with `add`, only those with the same names. The folder of an earlier
        failure is removed. If there is no room for all of them, or a file of the user is in the way, a checkpoint is
        published alone.

        Raises:
            OSError: If there is none, or no room for it.
            InputError: If there is none, or a file of the user is in its way.
        """
        self._end(DONE, add=add)

    def add(self) -> None:
        """Add the files to those that are published, or kept as those of a failed run."""
        assert self._ended is not None
        self._end(self._ended, add=True)

    def keep_failed(self) -> None:
        """Keep the files as `<target>.failed` likewise, and leave the target unchanged."""
        self._end(FAILED)

    def attempt[T](self, what: str, action: Callable[[], T]) -> T | None:
        """Do something for whose failure no solution may be lost.

        The files that it writes are added to those that are published, if there are some yet. If it fails on a rank,
        with whatever error, they are removed, and the reason is in `failures`.

        Args:
            what: What it makes, in words.
            action: Does it.

        Returns:
            Its result; None on all ranks if it fails on one.
        """
        result, error, before = None, None, set(os.listdir(self.path)) if self._area is not None else set()
        try:
            result = action()
        except Exception as failure:
            error = failure
        if self._note(what, error):
            try:
                if self._ended is not None:
                    self.add()
                return result
            except Exception as failure:  # on all ranks
                self._note(what, failure)
        for name in (set(os.listdir(self.path)) if self._area is not None else set()) - before:
            delete(self.path / name)
        return None

    def told(self) -> str:
        """What failed and why, in words; empty if nothing did."""
        return "; ".join(self.failures.values())

    def last_state(self) -> str:
        """Where the last state of a failed run is, and what failed later, in words."""
        return "; ".join([f"the last state is in {failed_place(self.target)}", *self.failures.values()])

    def _note(self, what: str, error: BaseException | None) -> bool:
        """Whether no rank has an error; if one has, on all ranks the reason is noted, unless there is one already."""
        words = "" if error is None else in_words(error)
        words = first_words(self.comm, f"{what}: {words}" if what and words else words, self._give_up)
        if words:
            self.failures.setdefault(what, words)
            self._cause = self._cause or (error if isinstance(error, Exception) else None)
        return not words

    def _end(self, end: str, *, add: bool = False) -> None:
        self.comm.Barrier()  # all ranks have written
        with postponed():
            try:
                self.path = on_root(self.comm, lambda: self._commit(end, add=add))
            except (OSError, InputError) as error:
                if not on_root(self.comm, self._has_only_state):
                    raise
                self.path = on_root(self.comm, lambda: self._commit(end, add=add))
                self.failures["files"] = f"files: {in_words(error)}"
        self._ended = end

    def _commit(self, end: str, *, add: bool) -> Path:
        """Move the files, if there are some; return the next staging area (rank 0)."""
        assert self._area is not None
        if add and not os.listdir(self.path):
            return self.path
        self._area.commit(end, add=add)
        return self._area.staging()

    def _has_only_state(self) -> bool:
        """Remove all files but a checkpoint, if there is one (rank 0)."""
        if not (self.path / STATE).is_dir():
            return False
        for name in set(os.listdir(self.path)) - {STATE}:
            delete(self.path / name)
        return True

    def _give_up(self, reason: str) -> NoReturn:
        """End all ranks, whatever the others are doing (called by one rank)."""
        reason = "; ".join([*self.failures.values(), reason])
        with contextlib.suppress(OSError):
            reason += f"; free on the disk: {shutil.disk_usage(self.target.parent).free >> 10} kB"
        self._opened.close()
        sys.stdout.flush()
        if self._ended == DONE:
            end_all(self.comm, f"failed: {reason}; the solution is in {self.target}\n", EXIT_LATER)
        end_all(self.comm, f"failed: {self.target}: {reason}\n", EXIT_FAILED)


def _locked(wanted: Path, opened: contextlib.ExitStack) -> Area:
    """Lock the area of a target, and complete what a killed run has left there (rank 0).

    Args:
        wanted: The target.
        opened: Removes, when it is closed, what is not complete and empty parents that were made, and frees the lock.

    Raises:
        InputError: If the target cannot be a results folder, or another run is writing into it.
    """
    try:
        with contextlib.ExitStack() as begun:
            area = _opened(Path(os.path.realpath(wanted)), begun)  # unlike resolve, the same for loops in all versions
            opened.push(begun.pop_all())
            return area
    except BlockingIOError:
        raise InputError(f"output {wanted}: another run is writing into it; wait for it, or choose another") from None
    except OSError as error:
        raise InputError(f"output {wanted}: cannot be written ({error.strerror})") from None
    except ValueError as error:  # a null byte
        raise InputError(f"output {wanted!r}: {error}") from None


def _opened(target: Path, begun: contextlib.ExitStack) -> Area:
    if target.is_symlink():  # all others are resolved
        raise InputError(f"output {target}: is a symlink loop")
    if os.path.ismount(target):
        raise InputError(f"output {target}: is a mount point, so files cannot be moved to it; take one below")
    for parent in reversed([folder for folder in target.parents if not folder.exists()]):
        begun.callback(_remove_if_empty, parent)
    target.parent.mkdir(parents=True, exist_ok=True)
    area = Area(target)
    begun.callback(area.close)
    area.settle()
    area.tidy()
    return area


def _remove_if_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):  # it is in use by now
        folder.rmdir()
