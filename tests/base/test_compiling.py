"""Compiled forms: files of killed processes and of living ones in the cache, and no compiler."""

import fcntl
from pathlib import Path

import dolfinx.mesh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.compiling import LOCK, PATIENCE, patiently
from signorini_fenicsx.base.fenicsx import compiled

COMM = MPI.COMM_WORLD


def small_form(comm: MPI.Comm) -> ufl.Form:
    return fem.Constant(dolfinx.mesh.create_unit_square(comm, 2, 2), 1.0) * ufl.dx


@pytest.mark.parallel([1, 2])
def test_a_form_left_by_a_killed_process_is_compiled_again(folder: Path, monkeypatch: pytest.MonkeyPatch):
    """Also one that is left between two others, whose files stay."""
    for form in (small_form(COMM), 3 * small_form(COMM)):
        compiled(COMM, form, jit_options={"cache_dir": folder})
    COMM.Barrier()
    if COMM.rank == 0:
        next(folder.glob("*.c.cached")).unlink()
    before = {path: path.stat().st_mtime_ns for path in folder.glob("*.c.cached")}
    COMM.Barrier()
    monkeypatch.setattr(fenicsx, "LOADED", {})  # as in another process
    for form in (small_form(COMM), 3 * small_form(COMM)):
        assert compiled(COMM, form, jit_options={"cache_dir": folder})[0] is not None
    assert len(list(folder.glob("*.c.cached"))) == 2
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_who_waits_compiles_when_nobody_else_does(tmp_path: Path):
    """Processes load and compile side by side; who had to wait is alone then, whatever DOLFINx says of its wait."""
    (tmp_path / "form.c").touch()
    shared = {1: True, PATIENCE: False}

    def work(timeout: int) -> str:
        with (tmp_path / LOCK).open() as lock:
            if shared.pop(timeout):
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
                raise TimeoutError("in other words")
            with pytest.raises(BlockingIOError):
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return "loaded"

    assert patiently(work, tmp_path) == "loaded"
    assert not shared
    assert not (tmp_path / "form.c").exists()


def test_without_locks_nothing_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def refused(*_: object) -> None:
        raise OSError

    (tmp_path / "form.c").touch()
    monkeypatch.setattr(fcntl, "flock", refused)
    assert patiently(lambda _: "loaded", tmp_path) == "loaded"
    with pytest.raises(OSError, match="waits; set XDG_CACHE_HOME"):
        patiently(lambda _: exec("raise TimeoutError('waits')"), tmp_path)
    assert (tmp_path / "form.c").exists()


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
