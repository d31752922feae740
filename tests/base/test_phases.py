"""The phases of a run, by the clock and in PETSc's log."""

import json
from pathlib import Path

import pytest
from commands import launched

from signorini_fenicsx.base import parallel, progress
from signorini_fenicsx.base.parallel import Stopwatch


def test_a_phase_interrupts_the_one_around_it(monkeypatch: pytest.MonkeyPatch):
    ticks = iter([0.0, 1.0, 3.0, 4.0, 8.0, 16.0])
    monkeypatch.setattr(parallel.time, "perf_counter", lambda: next(ticks))
    progress.follow(None)  # whatever other tests have left asks for the time
    watch = Stopwatch()
    with watch.phase("solve"):  # 0 to 16
        with watch.phase("assembly"):  # 1 to 3
            pass
        with pytest.raises(ValueError, match="lost"), watch.phase("assembly"):  # 4 to 8
            raise ValueError("lost")
    assert list(watch.seconds.items()) == [("assembly", 6.0), ("solve", 10.0)]


def test_log_view_reads_like_the_program(tmp_path: Path):
    """And --json prints one object, the summary, on two ranks too."""
    done = launched(tmp_path, "solve", "example2", "--h", "1/4", "--json", "--", "-log_view", ":log", ranks=2)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout) == json.loads((tmp_path / "results" / "example2" / "summary.json").read_text())
    table = (tmp_path / "log").read_text().partition("Summary of Stages:")[2].partition("\n---")[0]
    stages = [line.split(":")[1].strip() for line in table.splitlines() if line[:2].strip().isdigit()]
    assert stages == ["Main Stage", "mesh", "assembly", "solve", "kkt", "output", "certificate"]
