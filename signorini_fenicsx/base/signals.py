"""Signals: a request to end (SIGINT, SIGTERM, SIGHUP), a closed reader of the output, a library that aborts."""

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

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that ask the program to end; the last one comes when its terminal is closed."""
AGAIN = 1.0
"""A second signal counts only after this many seconds, because mpirun may forward the first one once more."""


class Interruption(BaseException):
    """The program was told to end; raised on one rank, wherever it was."""

    def __init__(self, number: int):
        super().__init__(f"interrupted by {signal.Signals(number).name}")


class LoopInterruption(Interruption):
    """The program was told to end between two iterations; raised on all ranks.

    Attributes:
        state: The state of the loop: iterate, facet conditions and history.
    """

    state: tuple[Any, Any, Any]


class _Request:
    """The signal that was received, if any, and whether it has to wait for an orderly end of what is under way."""

    number = 0
    came = 0.0
    deferred = False


@contextlib.contextmanager
def listening() -> Iterator[None]:
    """At one of these signals end in order; at a second one end at once, whatever is under way.

    SIGHUP stays ignored where it is, as below `nohup`.
    """
    _Request.number, _Request.deferred = 0, False
    heard = [number for number in ENDING if (number, signal.getsignal(number)) != (signal.SIGHUP, signal.SIG_IGN)]
    before = {number: signal.signal(number, _take) for number in heard}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        _Request.number, _Request.deferred = 0, False  # a signal to this run is not for the next one


def listen_again() -> None:
    """Restore Python's handlers after PETSc or Gmsh has replaced them."""
    with contextlib.suppress(ValueError):  # in other threads than the main one there are no handlers
        for number in (*ENDING, signal.SIGPIPE):
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
    """Whether an exception raised here would be lost: in a destructor Python only prints it and goes on."""
    while frame is not None:
        if frame.f_code.co_name == "__del__":
            return True
        frame = frame.f_back
    return False


def end_if_told(comm: MPI.Comm) -> None:
    """After an iteration: end on all ranks if one of them received a signal (collective).

    After the first call there is a state to keep. So from then on signals end the program only here: not while the
    state is written, and not after the last iteration, when the results are nearly complete.

    Raises:
        LoopInterruption: On all ranks.
    """
    _Request.deferred = True
    number = comm.allreduce(_Request.number, MPI.MAX)
    if number != 0:
        raise LoopInterruption(number)


def pass_on(error: Exception) -> None:
    """Raise the interruption that caused a library's error, if there is one.

    It happens when a signal arrives in a Python function that the library called.
    """
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
    """Call a function when a library aborts the process, as HDF5 and ADIOS2 do on a full disk.

    A signal handler in Python would run only after the library returns, which never happens. This handler is called by
    the C library inside `abort`.

    Args:
        last_words: The function; it must end the process.
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
    """A file whose reader may close it, as `head` does; then the rest is dropped."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            with open(os.devnull, "wb") as nobody:
                os.dup2(nobody.fileno(), self.fileno())
            return memoryview(data).nbytes


def outlive_readers() -> None:
    """Let the program go on when the reader of its output ends; call this after PETSc has set its handlers."""
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is getattr(sys, f"__{name}__") and isinstance(stream, io.TextIOWrapper):
            stream.flush()
            pipe = io.BufferedWriter(_Pipe(stream.fileno(), "wb", closefd=False))
            setattr(sys, name, io.TextIOWrapper(pipe, stream.encoding, "replace", line_buffering=stream.line_buffering))
