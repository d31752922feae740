"""Fixtures and hooks of all tests: cases on coarse meshes, a folder that is the same on all ranks."""

import gc
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from mpi4py import MPI
from under_mpirun import IS_CHILD, Launches, OneProcessForLaunches, number_of_ranks, share_folder, tell_parent

import signorini_fenicsx.api  # noqa: F401 - with DOLFINx, before a test loads adios2, which brings the same libraries
from signorini_fenicsx.base.parallel import collect_garbage

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # else each of many processes compiles the package: half a second

USUAL_RANKS = 3
LAUNCHES = pytest.StashKey[Launches]()


def pytest_configure(config: pytest.Config) -> None:
    """Let the processes of a launch run the tests that their parent has chosen, slow or not."""
    share_folder(config)
    if IS_CHILD:
        config.option.markexpr = ""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests for several numbers of ranks as slow, except with one of them.

    A test for one rank as well runs on one: that ranks do not matter is proved by `test_capabilities.py`. Others run
    with the largest number up to USUAL_RANKS.
    """
    for item in items:
        marker = item.get_closest_marker("parallel")
        if isinstance(item, pytest.Function) and marker is not None and hasattr(item, "callspec"):
            ranks = item.callspec.params.get("_nprocs")
            if ranks is not None and ranks != usual_ranks(marker.args[0]):
                item.add_marker(pytest.mark.slow)


def usual_ranks(numbers: Sequence[int]) -> int:
    """The number of ranks, of several, with which a test is not slow."""
    return 1 if 1 in numbers else max(number for number in numbers if number <= USUAL_RANKS)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    """Plan one launch for each number of ranks, and freeze modules, so that the collector skips them between tests."""
    OneProcessForLaunches.note(session.items)
    session.stash[LAUNCHES] = Launches(session.items)
    gc.freeze()


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> OneProcessForLaunches:
    """Spread tests over processes by files, but for parallel ones."""
    return OneProcessForLaunches(config, log)


@pytest.hookimpl(trylast=True)
def pytest_runtest_setup(item: pytest.Function) -> None:
    """Use the result of the common launch where mpi-pytest would launch mpirun for a single test."""
    if not IS_CHILD and MPI.COMM_WORLD.size == 1 and number_of_ranks(item) > 1:
        item.obj = lambda **fixtures: item.session.stash[LAUNCHES].check(item)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """In a launch, report results to the parent process."""
    if IS_CHILD:
        tell_parent(report)


@pytest.fixture(autouse=True)
def collect_between_tests() -> Iterator[None]:
    """Free meshes between tests only, as the command line does (see `parallel.collect_garbage`)."""
    gc.disable()
    yield
    collect_garbage(MPI.COMM_WORLD)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A temporary folder, the same on all ranks."""
    return MPI.COMM_WORLD.bcast(tmp_path)
