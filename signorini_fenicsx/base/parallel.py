"""Tools for MPI: sharing results of rank 0, ending all ranks together, time and memory over all ranks."""

import contextlib
import ctypes
import functools
import gc
import os
import pickle
import resource
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import NoReturn

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.base.text import printable_lines

FORWARDING = 0.5
"""Seconds in which mpirun can forward the last message of a rank; it loses the message when the rank aborts at once."""
PATIENCE = 10.0
"""Seconds in which the other ranks have to come to where one of them has failed."""


def on_root[T](comm: MPI.Comm, action: Callable[[], T]) -> T:
    """Run an action on rank 0 and give its result to all ranks (collective).

    Raises:
        Exception: On all ranks, what the action raised on rank 0, see `on_root_only`.
    """
    return comm.bcast(on_root_only(comm, action))


def on_root_only[T](comm: MPI.Comm, action: Callable[[], T]) -> T | None:
    """Run an action on rank 0; the others wait and get None (collective).

    Raises:
        Exception: On all ranks, what the action raised on rank 0, of whatever kind: otherwise the others would wait
            for ever. An error that cannot be sent is a RuntimeError with its words there.
    """
    result: T | None = None
    failure: Exception | None = None
    if comm.rank == 0:
        try:
            result = action()
        except Exception as error:
            failure = error
    told = comm.bcast(None if failure is None else _sendable(failure))
    if failure is not None or told is not None:
        raise failure or told
    return result


def _sendable(failure: Exception) -> Exception:
    """The error as other ranks can read it: without a state that is only here."""
    try:
        copy = pickle.loads(pickle.dumps(failure))
    except Exception:
        copy = RuntimeError(f"{type(failure).__name__}: {failure}")
    return copy if isinstance(copy, Exception) else RuntimeError(str(failure))


def passed_on[T](comm: MPI.Comm, block: T) -> T:
    """Give a block to the next rank and take that of the rank before; after as many times as ranks it is back.

    So each rank sees the blocks of all, one after the other, and never holds more than two (collective).
    """
    return comm.sendrecv(block, (comm.rank + 1) % comm.size, source=(comm.rank - 1) % comm.size)


def first_words(comm: MPI.Comm, words: str, otherwise: Callable[[str], NoReturn]) -> str:
    """The words of the first rank that has some, on all ranks; empty if none has (collective).

    A rank with words waits a while only: other ranks may be in a collective call in which they wait for it.

    Args:
        comm: Communicator.
        words: Why this rank could not go on with the others; empty if it could.
        otherwise: Called with these words where the others do not come; it ends the program on all ranks.
    """
    mine, first = np.array([comm.rank if words else comm.size]), np.empty(1, dtype=np.int64)
    request, until = comm.Iallreduce(mine, first, MPI.MIN), time.monotonic() + PATIENCE
    while words and not request.Test():
        if time.monotonic() > until:
            otherwise(words)
        time.sleep(0.01)
    request.Wait()
    return "" if first[0] == comm.size else comm.bcast(words, root=int(first[0]))


def gather_rows(comm: MPI.Comm, rows: npt.NDArray) -> npt.NDArray | None:
    """Concatenate the rows of all ranks on rank 0, in rank order; None elsewhere (collective)."""
    parts = comm.gather(rows)
    return None if parts is None else np.concatenate(parts)


LAUNCHED = ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "MV2_COMM_WORLD_SIZE", "SLURM_STEP_NUM_TASKS")
"""Variables in which launchers give the number of ranks; the first one that is set is the innermost launcher's."""


def is_launched() -> bool:
    """Whether a launcher such as mpirun has started this process."""
    return any(os.environ.get(name) for name in LAUNCHED)


def refuse_lone_copies(comm: MPI.Comm) -> None:
    """Refuse to run as one of several separate copies, as the mpirun of another MPI starts them.

    A single task of an allocation or of `mpirun -n 1` is accepted: there the launcher gives 1 or nothing.

    Raises:
        InputError: If a launcher has started several processes, but MPI has one rank here.
    """
    told = next((name for name in LAUNCHED if os.environ.get(name)), None)
    size = os.environ[told] if told else "1"
    if comm.size == 1 and size.isdecimal() and int(size) > 1:
        library = MPI.Get_library_version().splitlines()[0].strip("\0 ")
        raise InputError(
            f"{told} = {size} says that this is one of {size} processes, but they are not connected: the launcher must "
            f"belong to the MPI of this program, {library}; without mpirun, unset {told}"
        )


def abort_all_on_exception(comm: MPI.Comm) -> None:
    """Let an uncaught exception on one rank end all ranks, which otherwise wait forever in a collective call."""
    if comm.size == 1:
        return

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        text = "".join(traceback.format_exception(kind, error, trace))
        end_all(comm, f"error on rank {comm.rank}:\n{text}")

    sys.excepthook = hook


def end_all(comm: MPI.Comm, last_words: str, status: int = 1) -> NoReturn:
    """Print the last words and end all ranks, whatever the others are doing (called by one rank)."""
    if sys.__stderr__ is not None:  # sys.stderr may be silenced on this rank
        sys.__stderr__.write(printable_lines(last_words))
        sys.__stderr__.flush()
    if comm.size > 1:
        time.sleep(FORWARDING)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # MPI would say that it was told to abort
        comm.Abort(status)
    os._exit(status)


class Stopwatch:
    """Wall time per phase. Each phase is also a stage of PETSc's log, so `-log_view` shows the parts of the program.

    Attributes:
        seconds: Time of each phase that has ended, without the phases inside it.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._within = 0.0

    @contextlib.contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Measure the time inside this context; an inner phase interrupts the outer one."""
        from petsc4py import PETSc  # not before the command line has given PETSc its options

        stage, began, before = PETSc.Log.Stage(name), time.perf_counter(), self._within
        self._within = 0.0
        stage.push()
        try:
            with doing(name):
                yield
        finally:
            stage.pop()
            seconds = time.perf_counter() - began
            self.seconds[name] = self.seconds.get(name, 0.0) + seconds - self._within
            self._within = before + seconds

    def longest(self, comm: MPI.Comm) -> dict[str, float]:
        """Each phase's longest time over the ranks (collective)."""
        values = np.array(list(self.seconds.values()))
        comm.Allreduce(MPI.IN_PLACE, values, op=MPI.MAX)
        return dict(zip(self.seconds, values.tolist(), strict=True))


def peak_memory(comm: MPI.Comm, over_ranks: MPI.Op = MPI.SUM) -> int:
    """Peak memory of the processes since their start in bytes, summed over ranks (collective)."""
    return int(comm.allreduce(1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, over_ranks))


def give_back_memory() -> None:
    """Give memory that is free back to the system, where the C library can; otherwise it keeps that of small objects.

    After a solve this is a third of the process, and large new arrays would be put beside it.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def collect_garbage(comm: MPI.Comm) -> None:
    """Free the unused objects of Python and PETSc, on all ranks at the same point (collective).

    When a mesh is freed, it frees its communicator, for which mpi4py takes a lock. If Python's automatic collector runs
    while mpi4py holds this lock, there is a deadlock. So programs switch the automatic collector off and call this
    between solves.
    """
    from petsc4py import PETSc  # not before the command line has given PETSc its options

    gc.collect()
    PETSc.garbage_cleanup(comm)


@contextlib.contextmanager
def collector_off() -> Iterator[None]:
    """Switch Python's automatic collector off inside this context, see `collect_garbage`."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def collector_off_in_steps[**P, T](steps: Callable[P, Iterator[T]]) -> Callable[P, Iterator[T]]:
    """Switch the collector off in each step of a generator, as `collector_off` does in a function."""

    @functools.wraps(steps)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> Iterator[T]:
        results = steps(*args, **kwargs)
        while True:
            with collector_off():
                item = next(results, None)
            if item is None:
                return
            yield item

    return wrapped
