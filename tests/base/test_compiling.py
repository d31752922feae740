"""Compiled forms: files of killed processes and of living ones in the cache, and no compiler."""

import fcntl
import os
import time
from pathlib import Path

import dolfinx.mesh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.compiling import LOCK, QUIET, clear_if_left, patiently
from signorini_fenicsx.base.fenicsx import compiled

COMM = MPI.COMM_WORLD


def small_form(comm: MPI.Comm) -> ufl.Form:
    return fem.Constant(dolfinx.mesh.create_unit_square(comm, 2, 2), 1.0) * ufl.dx


def as_killed(cache: Path, age: float) -> Path:
    """Leave the cache like a process that is killed while it compiles its only form."""
    (ready,) = cache.glob("*.c.cached")
    ready.unlink()
    for path in cache.iterdir():
        os.utime(path, (time.time() - age,) * 2)
    return ready.with_suffix("")


@pytest.mark.parallel([1, 2])
def test_a_form_left_by_a_killed_process_is_compiled_again(folder: Path, monkeypatch: pytest.MonkeyPatch):
    form = small_form(COMM)
    compiled(COMM, form, jit_options={"cache_dir": folder})
    COMM.Barrier()
    if COMM.rank == 0:
        as_killed(folder, 2 * QUIET)
    monkeypatch.setattr(fenicsx, "LOADED", {})  # as in another process
    assert compiled(COMM, form, jit_options={"cache_dir": folder})[0] is not None
    assert len(list(folder.glob("*.c.cached"))) == 1


def test_whatever_dolfinx_says_of_its_wait(tmp_path: Path):
    """The form is not read from the words of the error."""
    form, times = tmp_path / "form.c", iter([TimeoutError("in other words"), None])
    form.touch()
    os.utime(form, (time.time() - 2 * QUIET,) * 2)

    def work() -> str:
        if (failure := next(times)) is not None:
            raise failure
        return "loaded"

    assert patiently(work, tmp_path, compiling=True) == "loaded"
    assert not form.exists()


def test_a_form_that_may_be_alive_is_left_alone(tmp_path: Path):
    compiled(MPI.COMM_SELF, small_form(MPI.COMM_SELF), jit_options={"cache_dir": tmp_path})
    form = as_killed(tmp_path, 0)
    assert not clear_if_left(form)
    for path in tmp_path.iterdir():
        os.utime(path, (time.time() - 2 * QUIET,) * 2)
    with (tmp_path / LOCK).open() as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)  # as any process that compiles does
        assert not clear_if_left(form)
    assert form.exists()
    assert clear_if_left(form)
    assert not form.exists()


def test_forms_have_a_folder_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The forms of other programs in the cache are not listed each time a form is looked up."""
    options = dolfinx.jit.get_options({"cache_dir": tmp_path})
    monkeypatch.setattr(dolfinx.jit, "get_options", lambda given: options | (given or {}))
    compiled(MPI.COMM_SELF, 7 * small_form(MPI.COMM_SELF))
    assert [path.name for path in tmp_path.iterdir()] == ["signorini_fenicsx"]


@pytest.mark.parallel(2)
def test_a_form_is_loaded_once(folder: Path):
    """A form is kept also if only some ranks have it already, but not for other options."""
    if COMM.rank == 0:
        compiled(MPI.COMM_SELF, small_form(MPI.COMM_SELF), jit_options={"cache_dir": folder})
    COMM.Barrier()
    first = compiled(COMM, small_form(COMM), jit_options={"cache_dir": folder})
    COMM.Barrier()
    if COMM.rank == 0:
        for file in folder.iterdir():
            file.unlink()
    COMM.Barrier()
    assert compiled(COMM, small_form(COMM), jit_options={"cache_dir": folder}) is first
    assert not list(folder.glob("*.c"))
    assert compiled(COMM, small_form(COMM), {"scalar_type": np.float32}, {"cache_dir": folder}) is not first


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("compiler", ["/nowhere/cc", "gcc -include nowhere.h"])
def test_no_compiler(folder: Path, monkeypatch: pytest.MonkeyPatch, compiler: str):
    monkeypatch.setenv("CC", compiler)
    with pytest.raises(OSError, match=r"cannot compile the forms .*; install one and Python's headers") as caught:
        compiled(COMM, small_form(COMM), jit_options={"cache_dir": folder})
    assert "-Wall" not in str(caught.value)
