"""Runs all parallel tests in one mpirun for each number of ranks, because a launch costs as much as a test."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from mpi4py import MPI
from pytest_mpi.plugin import CHILD_PROCESS_FLAG

from signorini_fenicsx.base.parallel import FORWARDING

PASSED = "SIGNORINI_PASSED_TESTS"
"""File to which rank 0 of a launch adds the tests that pass."""
YIELD = {"MPIR_CVAR_CH4_PROGRESS_THROTTLE": "1"}
"""Settings with which waiting ranks of MPICH leave the core to others; there may be more ranks than cores."""
IS_CHILD = CHILD_PROCESS_FLAG in os.environ


def number_of_ranks(item: pytest.Item) -> int:
    """The number of ranks of a test, by the marker `parallel[N]` that mpi-pytest gives to each."""
    return next(int(marker.name[9:-1]) for marker in item.iter_markers() if marker.name.startswith("parallel["))


def name(item: pytest.Item) -> str:
    """The name by which a test can be called: a worker of pytest-xdist adds @ and the group of the test."""
    return item.nodeid.removesuffix(f"@{item.get_closest_marker('xdist_group').args[0]}")


class Launches:
    """The launches of a run; each starts when the first of its tests is due."""

    def __init__(self, items: list[pytest.Item]):
        """Register the chosen tests."""
        self._items = items
        self._ended: dict[int, tuple[set[str], str]] = {}

    def check(self, item: pytest.Item) -> None:
        """Fail if the test did not pass on all ranks."""
        ranks = number_of_ranks(item)
        if ranks not in self._ended:
            tests = [name(other) for other in self._items if number_of_ranks(other) == ranks]
            self._ended[ranks] = launch(item.config.rootpath, ranks, tests)
        passed, output = self._ended[ranks]
        if name(item) not in passed:
            pytest.fail(f"{name(item)} did not pass in this mpirun -n {ranks}:\n{output}", pytrace=False)


def launch(folder: Path, ranks: int, tests: list[str]) -> tuple[set[str], str]:
    """Run tests under mpirun; return those that passed and the end of the output."""
    with tempfile.NamedTemporaryFile("r", encoding="utf-8") as file:
        done = subprocess.run(
            ["mpirun", "-n", str(ranks), sys.executable, "-m", "pytest", "-n", "0", "-q", "-s", *tests],
            cwd=folder,
            env=os.environ | {CHILD_PROCESS_FLAG: "1", PASSED: file.name} | YIELD,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        return set(file.read().splitlines()), done.stdout[-5000:]


def tell_parent(report: pytest.TestReport) -> None:
    """End a launch when a test fails on one rank, because the other ranks may wait for it forever."""
    if report.failed:
        print(f"\nFAILED on rank {MPI.COMM_WORLD.rank}: {report.nodeid}\n{report.longreprtext}", flush=True)
        time.sleep(FORWARDING)
        MPI.COMM_WORLD.Abort(1)
    if report.when == "teardown" and MPI.COMM_WORLD.rank == 0:  # after mpi-pytest's barrier
        with Path(os.environ[PASSED]).open("a", encoding="utf-8") as file:
            print(report.nodeid, file=file)
