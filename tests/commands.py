"""The command line in tests: inside the processes of the test, which saves time, or in new processes."""

import contextlib
import csv
import io
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import pytest
from mpi4py import MPI

from signorini_fenicsx.cli.main import main

COMM = MPI.COMM_WORLD

type Ended = subprocess.CompletedProcess[str]


def signorini(folder: Path, *arguments: str) -> Ended:
    """Run `signorini` on the ranks of the test, as if in a folder (collective).

    PETSc options are not possible, because PETSc is initialised already. The output of rank 0 is returned on all ranks.
    """
    out, err = io.StringIO(), io.StringIO()
    COMM.Barrier()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        mock.patch.object(sys, "argv", ["signorini", *arguments]),
        pytest.raises(SystemExit) as end,
    ):
        main()
    (status,) = set(COMM.allgather(end.value.code))
    assert isinstance(status, int)
    return subprocess.CompletedProcess(arguments, status, *COMM.bcast((out.getvalue(), err.getvalue())))


def ended(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> object:
    """Exit status of a command in this process, which prints as ever."""
    monkeypatch.setattr(sys, "argv", ["signorini", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code


def launched(folder: Path, *arguments: str, ranks: int = 1) -> Ended:
    """Run `signorini` in new processes."""
    return run(folder, "signorini", *arguments, ranks=ranks)


def run(folder: Path, *command: str, ranks: int, timeout: float = 120) -> Ended:
    """Run a command in a folder with a plain environment, as a shell would."""
    hidden = ("PMI", "HYDI", "MPI", "_PYTEST")  # a test may itself run under an mpiexec
    environment = {name: value for name, value in os.environ.items() if not name.startswith(hidden)}
    launcher = [] if ranks == 1 else ["mpirun", "-n", str(ranks)]
    return subprocess.run(
        [*launcher, *command],
        cwd=folder,
        env=environment | {"OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


@contextlib.contextmanager
def limited_files(most: int) -> Iterator[None]:
    """Let no file of this process grow beyond so many bytes for a while, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV file."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
