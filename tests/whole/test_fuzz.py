"""Broken inputs of all kinds on the command line, by `scripts/fuzz.py`, where the requirements are explained."""

import json
import sys
from pathlib import Path

import pytest
from commands import run
from fuzzing import Broken
from fuzzing.judge import BAD, Ending, judged, put_files_of_the_user, snapshot

SCRIPT = str(Path(__file__).parents[2] / "scripts" / "fuzz.py")


@pytest.mark.parametrize(
    "options",
    [
        "--count 4 --seed 9",
        pytest.param("--count 600 --seed 2", marks=pytest.mark.slow),
        pytest.param("--count 50 --seed 3 --ranks 2", marks=pytest.mark.slow),
    ],
)
def test_nothing_bad_comes_out(tmp_path: Path, options: str):
    done = run(tmp_path, sys.executable, SCRIPT, *options.split(), ranks=1, timeout=3600)
    assert done.returncode == 0, done.stdout + done.stderr


def ended(status: int, said: str = "", *, late: bool = False, orphans: bool = False, memory: float = 0) -> Ending:
    return Ending(status, said, late, orphans, memory)


@pytest.mark.parametrize(
    ("ending", "bad"),
    [
        (ended(2 << 8, "error: no\n"), set()),
        (ended(1 << 8, "failed: not yet\n"), set()),
        (ended(2 << 8), {"wordy"}),
        (ended(2 << 8, "error: no\nmore\n"), {"wordy"}),
        (ended(1 << 8, "Traceback (most recent call last):\n"), {"traceback"}),
        (ended(2 << 8, "error: no", late=True), {"hang"}),
        (ended(2 << 8, "error: no", orphans=True), {"orphan"}),
        (ended(2 << 8, "error: no", memory=1e10), {"memory"}),
        (ended(3 << 8, "what?"), {"status"}),
        (ended(3 << 8, "failed: fields: no; the solution is in out\n"), set()),
        (ended(11), {"signal"}),
        (ended(0), {"untrue"}),
    ],
)
def test_verdicts_on_processes(tmp_path: Path, ending: Ending, bad: set[str]):
    broken = Broken(["solve", "case.toml", "--output", "out"], "")
    assert judged(broken, ending, {}, {}, tmp_path).bad == bad <= set(BAD)
    broken.refused = True
    accepted = {"accepted"} if ending.status in (0, 1 << 8) else set()
    assert judged(broken, ending, {}, {}, tmp_path).bad == bad | accepted


def test_verdicts_on_files(tmp_path: Path):
    """New files outside the output, and files that are gone or changed, except results that new ones replace."""
    broken, out = Broken(["check", "case.toml"], ""), tmp_path / "work" / "out"
    out.mkdir(parents=True)
    (out / "summary.json").touch()
    put_files_of_the_user(out)
    before = snapshot(tmp_path)

    def bad(code: int) -> set[str]:
        said = {0: "", 1: "failed: no", 2: "error: no"}[code]
        return judged(broken, ended(code << 8, said), before, snapshot(tmp_path), tmp_path).bad

    assert [bad(code) for code in (0, 1, 2)] == [set(), set(), set()]
    (out / "summary.json").write_text("new", encoding="utf-8")
    (out / "history.csv").touch()
    assert [bad(code) for code in (0, 1, 2)] == [set(), {"lost"}, {"lost", "outside"}]
    (out / "raw.bp" / "data.0").unlink()
    (tmp_path / "work" / "notes.txt").touch()
    assert bad(0) == {"lost", "outside"}


def test_verdicts_on_solutions(tmp_path: Path):
    """A residual that is too large, and a run that should have been solved."""
    out = tmp_path / "work" / "out"
    (out / "checkpoint").mkdir(parents=True)
    (out / "checkpoint" / "about.json").touch()
    broken = Broken(["solve", "case.toml", "--output", "out"], "", solved=True)

    def bad(residual: float, *, status: int = 0) -> set[str]:
        summary = {"algorithm": "alg1", "converged": True, "kkt": {"dual": residual}, "norms": {"sigma_L2": 1.0}}
        (out / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
        said = "failed: no" if status else ""
        return judged(broken, ended(status << 8, said), {}, {}, tmp_path).bad - {"outside"}

    assert [bad(0.0), bad(1e-3), bad(0.0, status=1)] == [set(), {"untrue"}, {"untrue"}]
