"""What the system tells the program: end (SIGINT, SIGTERM), nobody reads your output, a library has aborted."""

import contextlib
import ctypes
import io
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

from mpi4py import MPI

AGAIN = 1.0
"""Seconds after which a second signal is meant as one; mpirun may pass on the first that the process has already."""


class Interruption(BaseException):
    """The program was told to end; raised on one rank, wherever it was."""

    def __init__(self, number: int):
        super().__init__(f"interrupted by {signal.Signals(number).name}")


class LoopInterruption(Interruption):
    """The same between two iterations, raised on all ranks.

    Attributes:
        state: What the loop had reached: iterate, facet conditions and history.
    """

    state: tuple[Any, Any, Any]


class _Request:
    """The signal that came, if any, and whether something is under way that has an orderly end of its own."""

    number = 0
    came = 0.0
    deferred = False


@contextlib.contextmanager
def listening() -> Iterator[None]:
    """End in order at SIGINT and SIGTERM; at a second one at once, whatever is under way."""
    _Request.number, _Request.deferred = 0, False
    before = {number: signal.signal(number, _take) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        _Request.number, _Request.deferred = 0, False  # what this run was told is not for the next one


def listen_again() -> None:
    """Put the handlers that Python knows of back, when PETSc or Gmsh has replaced them."""
    with contextlib.suppress(ValueError):  # not in the main thread, where no handler is set
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGPIPE):
            signal.signal(number, signal.getsignal(number) or signal.SIG_DFL)


def _take(number: int, frame: FrameType | None) -> None:
    if _swallows(frame):
        threading.Timer(0.01, os.kill, (os.getpid(), number)).start()
        return
    now = time.monotonic()
    if _Request.number == 0:
        _Request.number, _Request.came = number, now
        if not _Request.deferred:
            raise Interruption(number)
    elif now - _Request.came > AGAIN:
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)


def _swallows(frame: FrameType | None) -> bool:
    """Whether Python would print an exception raised here and go on: in a destructor."""
    while frame is not None:
        if frame.f_code.co_name == "__del__":
            return True
        frame = frame.f_back
    return False


def end_if_told(comm: MPI.Comm) -> None:
    """After an iteration: end on all ranks if one of them was told to (collective).

    From the first call on there is something to keep. So no signal ends the program elsewhere any more: not while
    that is written, and not after the last iteration, when the results are as good as there.

    Raises:
        LoopInterruption: On all ranks.
    """
    _Request.deferred = True
    number = comm.allreduce(_Request.number, MPI.MAX)
    if number != 0:
        raise LoopInterruption(number)


def pass_on(error: Exception) -> None:
    """Raise the interruption that is behind a library's error, if there is one: it came in a function it called."""
    if isinstance(error.__cause__, Interruption):
        raise error.__cause__


@contextlib.contextmanager
def postponed() -> Iterator[None]:
    """Let signals wait until the context ends."""
    before, _Request.deferred = _Request.deferred, True
    try:
        yield
    finally:
        _Request.deferred = before
    if _Request.number != 0 and not before:
        raise Interruption(_Request.number)


@contextlib.contextmanager
def on_abort(last_words: Callable[[], None]) -> Iterator[None]:
    """Call something when a library aborts the process, as HDF5 and ADIOS2 do on a full disk.

    A handler of Python's own would wait for the library to return, which it never does; this one is called by the C
    library, in `abort` itself.

    Args:
        last_words: Must end the process.
    """
    libc_signal = ctypes.CDLL(None).signal
    libc_signal.argtypes, libc_signal.restype = [ctypes.c_int, ctypes.c_void_p], ctypes.c_void_p
    handler = ctypes.CFUNCTYPE(None, ctypes.c_int)(lambda number: last_words())
    before = libc_signal(signal.SIGABRT, ctypes.cast(handler, ctypes.c_void_p))
    try:
        yield
    finally:
        libc_signal(signal.SIGABRT, before)


class _Pipe(io.FileIO):
    """A file whose reader may go away, as `head` does: then the rest is for nobody."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            with open(os.devnull, "wb") as nobody:
                os.dup2(nobody.fileno(), self.fileno())
            return memoryview(data).nbytes


def outlive_readers() -> None:
    """Let the program go on when the reader of its output ends; to be called when PETSc has set its handlers."""
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is getattr(sys, f"__{name}__") and isinstance(stream, io.TextIOWrapper):
            stream.flush()
            pipe = io.BufferedWriter(_Pipe(stream.fileno(), "wb", closefd=False))
            setattr(sys, name, io.TextIOWrapper(pipe, stream.encoding, "replace", line_buffering=stream.line_buffering))
