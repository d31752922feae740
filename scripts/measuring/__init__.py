"""What `measure.py` measures, and how it is timed and told."""

import sys
import time
from collections.abc import Callable, Iterable, Sequence

from mpi4py import MPI

COMM = MPI.COMM_WORLD


def say(line: str = "") -> None:
    """Print a line once."""
    if COMM.rank == 0:
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()


def show(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table as it is in the documentation, row by row."""
    for row in (columns, ["---"] * len(columns)):
        say(f"| {' | '.join(row)} |")
    for row in rows:
        say(f"| {' | '.join(f'{each:.3g}' if isinstance(each, float) else str(each) for each in row)} |")
    say()


def timed[T](run: Callable[[], T], times: int = 1) -> tuple[T, float]:
    """What it returns, and the processor seconds of all ranks, the least of some runs (collective)."""
    seconds = []
    for _ in range(times):
        COMM.Barrier()
        began = time.process_time()
        result = run()
        seconds.append(COMM.allreduce(time.process_time() - began))
    return result, min(seconds)
