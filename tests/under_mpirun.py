"""Runs all parallel tests in one mpirun for each number of ranks, because a launch costs as much as a test."""

import fcntl
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from mpi4py import MPI
from pytest_mpi.plugin import CHILD_PROCESS_FLAG

from signorini_fenicsx.base.parallel import FORWARDING

PASSED = "SIGNORINI_PASSED_TESTS"
"""File to which rank 0 of a launch adds the tests that pass."""
SHARED = "SIGNORINI_LAUNCHES"
"""Folder with the results of launches, for all processes of pytest-xdist."""
IS_CHILD = CHILD_PROCESS_FLAG in os.environ


def number_of_ranks(item: pytest.Item) -> int:
    """The number of ranks of a test, by the marker `parallel[N]` that mpi-pytest gives to each."""
    return next((int(marker.name[9:-1]) for marker in item.iter_markers() if marker.name.startswith("parallel[")), 1)


class Launches:
    """The launches of a run of pytest, which come first: beside another process their ranks would wait for cores."""

    def __init__(self, items: list[pytest.Item]):
        """Register the chosen tests."""
        self._items = items
        self._ended: dict[int, tuple[set[str], str]] = {}

    def run(self) -> None:
        """Run the parallel tests: the first process of pytest-xdist runs them, the others wait for it."""
        for ranks in sorted({number_of_ranks(item) for item in self._items} - {1}):
            tests = [item for item in self._items if number_of_ranks(item) == ranks]
            with in_turn(f"{ranks}.json") as file:
                if file.stat().st_size == 0:
                    ended = launch(tests[0].config.rootpath, ranks, [item.nodeid for item in tests])
                    file.write_text(json.dumps(ended), encoding="utf-8")
                passed, output = json.loads(file.read_text(encoding="utf-8"))
            self._ended[ranks] = set(passed), output

    def check(self, item: pytest.Item) -> None:
        """Fail if the test did not pass on all ranks."""
        ranks = number_of_ranks(item)
        passed, output = self._ended[ranks]
        if item.nodeid not in passed:
            pytest.fail(f"{item.nodeid} did not pass in this mpirun -n {ranks}:\n{output}", pytrace=False)


@contextmanager
def in_turn(name: str) -> Iterator[Path]:
    """A file that the processes of one run of pytest share, for one of them at a time."""
    path = Path(os.environ[SHARED], name)
    with path.open("a", encoding="utf-8") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield path


def share_folder(config: pytest.Config) -> None:
    """Make a folder that all processes of this run of pytest find, until it ends."""
    if SHARED not in os.environ:
        folder = tempfile.TemporaryDirectory()
        config.add_cleanup(folder.cleanup)
        os.environ[SHARED] = folder.name


def launch(folder: Path, ranks: int, tests: list[str]) -> tuple[list[str], str]:
    """Run tests under mpirun; return those that passed and the end of the output."""
    with tempfile.NamedTemporaryFile("r", encoding="utf-8") as file:
        done = subprocess.run(
            ["mpirun", "-n", str(ranks), sys.executable, "-m", "pytest", "-n", "0", "-q", "-s", *tests],
            cwd=folder,
            env=os.environ | {CHILD_PROCESS_FLAG: "1", PASSED: file.name},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        return file.read().splitlines(), done.stdout[-5000:]


def tell_parent(report: pytest.TestReport) -> None:
    """End a launch when a test fails on one rank, because the other ranks may wait for it forever."""
    if report.failed:
        print(f"\nFAILED on rank {MPI.COMM_WORLD.rank}: {report.nodeid}\n{report.longreprtext}", flush=True)
        time.sleep(FORWARDING)
        MPI.COMM_WORLD.Abort(1)
    if report.when == "teardown" and MPI.COMM_WORLD.rank == 0:  # after mpi-pytest's barrier
        with Path(os.environ[PASSED]).open("a", encoding="utf-8") as file:
            print(report.nodeid, file=file)
