"""The scripts for Slurm: `signorini` from .venv, from a module or from PATH, times in the log, its status."""

import os
import re
import signal
import subprocess
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"


def put(path: Path, text: str) -> None:
    """Write a program."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/usr/bin/env bash\n{text}\n", encoding="utf-8")
    path.chmod(0o755)


@pytest.mark.parametrize(("place", "modules"), [(".venv/bin", ""), ("modules", "signorini/0.5 mpi"), ("bin", "")])
def test_where_it_is(tmp_path: Path, place: str, modules: str):
    """The job runs what it finds on all ranks, and ends with the status of the run."""
    put(tmp_path / place / "signorini", 'echo "$(dirname "$0") $OMP_NUM_THREADS $*"; exit 3')
    put(tmp_path / "bin" / "mpirun", 'echo "on $2"; shift 2; exec "$@"')
    put(tmp_path / "bin" / "module", "exit 1")
    module = f'() {{ PATH="{tmp_path}/modules:$PATH"; [[ "$*" == "load {modules}" ]]; }}'
    about = {"SLURM_NTASKS": "4", "SLURM_SUBMIT_DIR": str(tmp_path), "SIGNORINI_SCRIPTS": str(SCRIPTS)}
    path = f"{tmp_path}/bin:/usr/bin:/bin"
    of_modules = {"SIGNORINI_MODULES": modules, "BASH_FUNC_module%%": module} if modules else {}
    ended = subprocess.run(
        [SCRIPTS / "slurm_solve.sh", "dam", "--h", "1/8"],
        env={"PATH": path, "HOME": os.environ["HOME"]} | about | of_modules,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 3, ended.stderr
    first, second = ended.stdout.splitlines()
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d  on 4", first)
    assert second.endswith(f"{tmp_path / place} 1 solve dam --h 1/8")


def test_nowhere(tmp_path: Path):
    """Without a `signorini` the job ends with a sentence."""
    env = {"PATH": "/usr/bin:/bin", "SLURM_NTASKS": "1", "SLURM_SUBMIT_DIR": str(tmp_path)}
    ended = subprocess.run(
        [SCRIPTS / "slurm_study.sh", "x.toml"],
        env=env | {"SIGNORINI_SCRIPTS": str(SCRIPTS)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 2
    assert "set SIGNORINI_MODULES" in ended.stderr


def test_time_limit(tmp_path: Path):
    """At the time limit Slurm sends SIGTERM to all of the job; what the run says then is in the log."""
    put(tmp_path / "bin" / "mpirun", 'shift 2; exec "$@"')
    put(tmp_path / "bin" / "signorini", "trap 'echo saved; exit 1' TERM; echo solving; sleep 9 & wait")
    about = {"SLURM_NTASKS": "1", "SLURM_SUBMIT_DIR": str(tmp_path), "SIGNORINI_SCRIPTS": str(SCRIPTS)}
    job = subprocess.Popen(
        [SCRIPTS / "slurm_solve.sh", "dam"],
        env={"PATH": f"{tmp_path}/bin:/usr/bin:/bin"} | about,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert job.stdout is not None
    assert "solving" in job.stdout.readline()
    os.killpg(job.pid, signal.SIGTERM)
    assert "saved" in job.stdout.readline()
    assert job.wait() == 1
