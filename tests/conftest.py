"""Fixtures and hooks of all tests: cases on coarse meshes, a folder that is the same on all ranks."""

import gc
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import pytest
from mpi4py import MPI
from under_mpirun import IS_CHILD, Launches, number_of_ranks, share_folder, tell_parent

import signorini_fenicsx.api  # noqa: F401 - with DOLFINx, before a test loads adios2, which brings the same libraries
from signorini_fenicsx.base import confined
from signorini_fenicsx.base.parallel import collect_garbage
from signorini_fenicsx.meshes import file_worker
from signorini_fenicsx.meshes.contents import OF_GMSH

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # else each of many processes compiles the package: half a second

LAUNCHES = pytest.StashKey[Launches]()
COLLECTED = pytest.StashKey[float]()
MODULES = pytest.StashKey[int]()
READ: dict[tuple[object, ...], bytes] = {}
"""What was read of mesh files, by their endings, the wishes for their meshes, and their bytes."""


def pytest_configure(config: pytest.Config) -> None:
    """Let the processes of a launch run the tests that their parent has chosen, slow or not."""
    share_folder(config)
    if IS_CHILD:
        config.option.markexpr = ""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests for several numbers of ranks as slow, except with one of them.

    A test for one rank as well runs on one: that ranks do not matter is proved by `test_capabilities.py`. Others run on
    the smallest number: three ranks on two cores wait for one another in each reduction.
    """
    for item in items:
        marker = item.get_closest_marker("parallel")
        if isinstance(item, pytest.Function) and marker is not None and hasattr(item, "callspec"):
            ranks = item.callspec.params.get("_nprocs")
            if ranks is not None and ranks != min(marker.args[0]):
                item.add_marker(pytest.mark.slow)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    """Freeze modules, so that the collector skips them between tests."""
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtestloop(session: pytest.Session) -> Iterator[None]:
    """Run the tests of several ranks first, one launch for each number of ranks."""
    session.stash[LAUNCHES] = launches = Launches(session.items)
    if not (IS_CHILD or MPI.COMM_WORLD.size > 1 or session.config.option.collectonly):
        launches.run()
    return (yield)


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
def collect_between_tests(request: pytest.FixtureRequest) -> Iterator[None]:
    """Free meshes between tests only, as commands do (see `parallel.collect_garbage`), once a second.

    Modules that tests have imported are frozen, as those before.
    """
    gc.disable()
    yield
    stash, now = request.config.stash, MPI.COMM_WORLD.bcast(time.monotonic())
    if now > stash.get(COLLECTED, 0.0) + 1:
        collect_garbage(MPI.COMM_WORLD)
        stash[COLLECTED] = now
        if (modules := MPI.COMM_WORLD.bcast(len(sys.modules))) > stash.get(MODULES, 0):
            gc.freeze()
            stash[MODULES] = modules


@pytest.fixture(autouse=True)
def disk_in_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not wait for the disk: only a machine that loses its power needs that."""
    monkeypatch.setattr(os, "fsync", lambda file: None)


@pytest.fixture(autouse=True)
def files_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the process that reads a file of Gmsh's formats start only if no test before had the same one."""
    run = confined.run

    def remembered(module: str, arguments: list[str], result: BinaryIO) -> None:
        path, *others = arguments
        if module != file_worker.__name__ or not path.lower().endswith(OF_GMSH):
            return run(module, arguments, result)
        key = Path(path).suffix, *others, Path(path).read_bytes()
        if key not in READ:
            run(module, arguments, result)
            result.seek(0)
            READ[key] = result.read()
            return None
        result.write(READ[key])
        return None

    monkeypatch.setattr(confined, "run", remembered)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A temporary folder, the same on all ranks."""
    return MPI.COMM_WORLD.bcast(tmp_path)
