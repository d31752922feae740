"""Configuration files of libraries in the current folder: read only if asked for, and refused in a sentence if odd."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from commands import launched

SOLVE = ("solve", "example2", "--h", "1/8", "--output", "x")


def test_files_in_the_current_folder_are_ignored(tmp_path: Path):
    """Gmsh's own PETSc, which would end the program here, does not see them either."""
    (tmp_path / ".petscrc").write_text("-ksp_type nonsense\n-help intro\n")
    for name in ("ffcx_options.json", "dolfinx_jit_options.json"):
        (tmp_path / name).write_text("[")
    assert launched(tmp_path, *SOLVE).returncode == 0
    assert (tmp_path / "x" / "summary.json").is_file()


def test_files_in_the_current_folder_are_read_if_asked_for(tmp_path: Path):
    (tmp_path / ".petscrc").write_text("-ksp_type nonsense\n")
    done = launched(tmp_path, *SOLVE, "--local-options")
    assert done.returncode == 2
    assert "KSP type nonsense" in done.stderr


@pytest.mark.parametrize(
    ("name", "make", "message"),
    [
        (".petscrc", os.mkfifo, "is not a regular file"),
        ("ffcx_options.json", lambda path: path.write_text("["), "is not a JSON object"),
    ],
)
def test_odd_files(tmp_path: Path, name: str, make: Callable[[Path], object], message: str):
    make(tmp_path / name)
    done = launched(tmp_path, *SOLVE, "--local-options")
    assert (done.returncode, done.stderr) == (2, f"error: {name}: {message}\n")
