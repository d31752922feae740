"""Ends from outside: signals, full disks, readers of the output that close."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from commands import ended, limited_files, run, signorini
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.signals import Interruption, listening
from signorini_fenicsx.cli.solution_report import SolutionReport
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.linear.gmres import gmres
from signorini_fenicsx.output import field_files
from signorini_fenicsx.physics.diffusion import solving

SOLVE = ("solve", "example2", "--h", "1/8", "--output", "x")


def told_to_end(monkeypatch: pytest.MonkeyPatch, module: object, name: str, call: int, number: int) -> None:
    """Send the program a signal in a given call of a function."""
    function: Callable[..., object] = getattr(module, name)
    calls = [0]

    def signalled(*arguments: object, **options: object) -> object:
        calls[0] += 1
        if calls[0] == call:
            os.kill(os.getpid(), number)
        return function(*arguments, **options)

    monkeypatch.setattr(module, name, signalled)


def test_objects_at_the_end():
    """Python does not look through them when it ends."""
    text = "import atexit, gc, sys; atexit.register(lambda: print('frozen', gc.get_freeze_count() > 1000)); "
    text += "from signorini_fenicsx.cli.main import main; sys.argv = ['signorini', '--help']; main()"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("frozen True\n")


@pytest.mark.parametrize("algorithm", ["alg1", "snes2", "vi", "primal-pdas", "mixed-uzawa1"])
def test_a_signal_in_the_loop_keeps_its_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], algorithm: str
):
    monkeypatch.chdir(tmp_path)
    with monkeypatch.context() as during:
        told_to_end(during, SolutionReport, "step", 2, signal.SIGTERM)
        during.setattr(sys, "argv", ["signorini"])
        assert ended(during, *SOLVE, "--algorithm", algorithm) == 1
    assert "failed: interrupted by SIGTERM; the last state is in" in " ".join(capsys.readouterr().err.split())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x.failed"]
    if algorithm == "alg1":
        assert ended(monkeypatch, *SOLVE, "--start-from", "x.failed") == 0
        assert sorted(path.name for path in tmp_path.iterdir()) == ["x"]


def test_a_closed_terminal_ends_as_any_signal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """The state is kept at SIGHUP; below `nohup`, where it is ignored, the run goes on."""
    monkeypatch.chdir(tmp_path)
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # it is ignored if the tests run below `nohup`
    try:
        with monkeypatch.context() as during:
            told_to_end(during, SolutionReport, "step", 2, signal.SIGHUP)
            assert ended(during, *SOLVE) == 1
        assert "failed: interrupted by SIGHUP; the last state is in" in " ".join(capsys.readouterr().err.split())
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        told_to_end(monkeypatch, SolutionReport, "step", 2, signal.SIGHUP)
        assert ended(monkeypatch, *SOLVE) == 0
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_signal_to_one_rank_ends_all_in_order(tmp_path: Path):
    script = tmp_path / "told.py"
    script.write_text(
        "import os, signal, sys\n"
        "from mpi4py import MPI\n"
        "from signorini_fenicsx.cli import main as cli\n"
        "from signorini_fenicsx.cli.solution_report import SolutionReport\n"
        "step = SolutionReport.step\n"
        "def signalled(report, row):\n"
        "    step(report, row)\n"
        "    if row.iteration == 2 and MPI.COMM_WORLD.rank == 1:\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "SolutionReport.step = signalled\n"
        "cli.main()\n"
    )
    done = run(tmp_path, sys.executable, str(script), *SOLVE, ranks=2)
    assert done.returncode == 1
    assert done.stderr.count("interrupted by SIGINT; the last state is in") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["told.py", "x.failed"]


def test_a_signal_before_the_loop_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    told_to_end(monkeypatch, solving, "project_data", 1, signal.SIGTERM)  # after Gmsh, which sets its own handlers
    assert ended(monkeypatch, *SOLVE) == 1
    assert capsys.readouterr().err.strip() == "failed: interrupted by SIGTERM"
    assert list(tmp_path.iterdir()) == []


def test_a_signal_while_libraries_are_imported(tmp_path: Path):
    """It ends the program without a traceback."""
    script = tmp_path / "told.py"
    script.write_text(
        "import os, signal, sys\n"
        "from signorini_fenicsx.cli.start import main\n"
        "class Told:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'petsc4py':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Told())\n"
        "main()\n"
    )
    done = run(tmp_path, sys.executable, str(script), *SOLVE, ranks=1)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")


def test_a_signal_in_a_destructor_is_not_lost():
    class Dying:
        def __del__(self) -> None:
            os.kill(os.getpid(), signal.SIGTERM)

    def wait() -> None:
        Dying()
        time.sleep(30)

    with listening(), pytest.raises(Interruption, match="SIGTERM"):
        wait()


def test_a_signal_in_an_iterative_solve_is_no_failure_of_it():
    """It ends the program; no factorisation takes the place of CG."""
    matrix = PETSc.Mat().createAIJ((4, 4), nnz=1, comm=MPI.COMM_SELF)
    matrix.setDiagonal(matrix.createVecLeft())
    matrix.shift(2.0)
    solver = FacetSolver(matrix, "facet_", {}, lambda pc: pc.setType("none"), 100)
    x, b = matrix.createVecs()
    b.array_w[:] = np.arange(4)

    def told(*_: object) -> bool:
        os.kill(os.getpid(), signal.SIGTERM)
        return False

    with listening(), pytest.raises(Interruption, match="SIGTERM"), solver.stopping(told):
        solver.solve(b, x)
    with listening(), pytest.raises(Interruption, match="SIGTERM"):
        gmres(MPI.COMM_SELF, lambda values: values * (2.0 + told()), np.arange(4.0))


def test_a_signal_to_the_program(tmp_path: Path):
    """A signal as from a shell, although PETSc has its own handlers. Without it the sweeps would take long."""
    far = ("--algorithm", "psor", "--set", "problem.psi=-1e8")
    with subprocess.Popen(
        ["signorini", *SOLVE, *far], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as solve:
        assert solve.stdout is not None
        assert solve.stderr is not None
        while (line := solve.stdout.readline()) and not line.startswith("   2"):
            pass
        solve.terminate()
        said = solve.stderr.read()
    assert solve.returncode == 1
    assert (said.count("\n"), said.count("interrupted by SIGTERM; the last state is in")) == (1, 1)


def test_a_reader_that_goes_away(tmp_path: Path):
    """If the reader of the output closes it, the results are written and there is no message."""
    with subprocess.Popen(
        ["signorini", *SOLVE], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as solve:
        assert solve.stdout is not None
        assert solve.stderr is not None
        solve.stdout.readline()
        solve.stdout.close()
        assert solve.stderr.read() == ""
    assert solve.returncode == 0
    assert (tmp_path / "x" / "summary.json").exists()


FILLING = """
import os
from signorini_fenicsx.base import parallel
from signorini_fenicsx.cli import main as cli
from signorini_fenicsx.output import field_files as output

def fill(folder, sizes):
    room = os.statvfs("disk")
    with open("disk/others", "wb") as file:
        file.write(bytes(room.f_bavail * room.f_frsize - 60000))

output.check_room, parallel.PATIENCE = fill, 0.5
cli.main()
"""
A_SMALL_DISK = ("unshare", "-rm", "sh", "-c", 'mount -t tmpfs -o size=1500k none disk && "$0" "$@"')


@pytest.mark.slow
def test_a_disk_that_others_fill(tmp_path: Path):
    """The disk becomes full while the fields are written; one of two ranks writes."""
    (tmp_path / "filling.py").write_text(FILLING)
    (tmp_path / "disk").mkdir()
    if shutil.which("unshare") is None or run(tmp_path, *A_SMALL_DISK, "true", ranks=1).returncode != 0:
        pytest.skip("the system lets nobody mount a disk")
    command = ("mpirun", "-n", "2", sys.executable, "filling.py", "solve", "example1", "--h", "1/16", "-q")
    done = run(tmp_path, *A_SMALL_DISK, *command, "--output", "disk/x", ranks=1)
    assert done.returncode == 3, done.stderr
    assert "for ParaView cannot be written; free on the disk: 0 kB; the solution is in" in done.stderr


@pytest.mark.parametrize(("limit", "checked"), [(150000, True), (150000, False), (1000, True)])
def test_a_full_disk_keeps_the_solution(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: int, checked: bool):
    """With a limit on file sizes: reported before ADIOS2 begins, and also if ADIOS2 itself fails; 1 without room."""
    if not checked:
        monkeypatch.setattr(field_files, "check_room", lambda *arguments: None)
    with limited_files(limit):
        done = signorini(tmp_path, *SOLVE, "-q")
    assert done.returncode == (1 if limit == 1000 else 3), done.stderr
    assert ("File too large" in done.stderr) or not checked
    assert checked is False or done.stderr.count("\n") == 1
    if limit == 1000:
        assert not list(tmp_path.iterdir())
        return
    assert done.stderr.count("; the solution is in") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x"]
    assert {"checkpoint", "facets.csv", "summary.json"} < {path.name for path in (tmp_path / "x").iterdir()}
    assert not list((tmp_path / "x").glob("solution*"))
    done = signorini(tmp_path, "export", "x")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "x" / "solution.bp").is_dir()
