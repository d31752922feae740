"""Groups of ranks within one mpirun, each of which gets the next task when it is free."""

import os
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.parallel import collect_garbage, on_root

STOP = "stop"
"""A claim with this name tells all groups to take no further task."""
PAUSE = 0.02
"""Seconds between two checks whether the others are done; between the checks a waiting rank leaves its core free."""


def hand_out(
    comm: MPI.Comm,
    names: Sequence[str],
    ranks_per_task: int,
    claims: Path,
    work: Callable[[str, MPI.Comm], None],
    forget: Callable[[], None] = lambda: None,
) -> None:
    """Run `work` for each name once, on the group of ranks that is free next (collective).

    A group claims a task by creating a file, which only one group can do, so no rank is needed to distribute the tasks.
    Ranks that do not fill a group stay idle. If there are fewer ranks than a task wants, all ranks are one group.

    Args:
        comm: Communicator to split.
        names: Names of the tasks, in the order in which they are begun.
        ranks_per_task: Ranks of a group.
        claims: An empty folder that all ranks see.
        work: Called with a name and the group's communicator, on all ranks of the group.
        forget: Called at the end, to drop what was kept from task to task before the group's communicator is freed.

    Raises:
        InputError: If `work` raised it in a group; all groups end after their current task.
        NumericalFailure: Likewise.
        OSError: Likewise, for example on a full disk.
    """
    size = min(ranks_per_task, comm.size)
    index = comm.rank // size
    group = comm.Split(index if index < comm.size // size else MPI.UNDEFINED, comm.rank)
    failure: InputError | NumericalFailure | OSError | None = None
    if group != MPI.COMM_NULL:
        try:
            for name in names:
                if on_root(group, partial(_claimed, claims, name)):
                    work(name, group)
                    collect_garbage(group)  # otherwise the number of communicators grows from run to run
        except (InputError, NumericalFailure, OSError) as error:
            failure = error
            (claims / STOP).touch()
        forget()
        collect_garbage(group)
        group.Free()
    everybody = comm.Ibarrier()
    while not everybody.Test():
        time.sleep(PAUSE)
    failures = [error for error in comm.allgather(failure) if error is not None]
    if failures:
        raise failures[0]


def _claimed(claims: Path, name: str) -> bool:
    """Whether a group of ranks is the first to claim a task (on the first rank of the group)."""
    if (claims / STOP).exists():
        return False
    try:
        os.close(os.open(claims / name, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
    except FileExistsError:
        return False
    return True
