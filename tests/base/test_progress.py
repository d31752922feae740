"""What is shown while something is under way."""

import contextlib
import io
import os
import pty
import re
import subprocess
import time
from pathlib import Path

import pytest
from commands import signorini
from rich.console import Console

from signorini_fenicsx.base import progress
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cli.live import Live
from signorini_fenicsx.cli.report import Report


class Terminal(io.StringIO):
    """Takes what is written to it for a terminal."""

    def isatty(self) -> bool:
        """Say so."""
        return True


def test_a_terminal_shows_what_is_under_way(monkeypatch: pytest.MonkeyPatch):
    clock = iter(range(1000))
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    terminal = Terminal()
    live = Live(Console(file=terminal, force_terminal=True, force_interactive=True, width=60))
    progress.follow(live)
    with progress.doing("solve"):
        progress.detail("iteration", 2)
        with progress.doing("prediction"):
            progress.detail("set update", 1)
            progress.detail("linear iterations", 40)
        with live.above():
            terminal.write("a row\n")
    progress.follow(None)
    with progress.doing("nobody looks"):
        progress.detail("iteration", 1)
    shown = [text.strip("\r") for text in terminal.getvalue().split("\r\x1b[2K")]
    assert shown == [
        "",
        "solving …",
        "solving: iteration 2 …",
        "solving: iteration 2 · predicting the contact set …",
        "solving: iteration 2 · predicting the contact set: set upda",  # as wide as the terminal
        "solving: iteration 2 · predicting the contact set: set upda",
        "solving: iteration 2 …",
        "\ra row\n".strip("\r"),
        "solving: iteration 2 …",
        "",
    ]


def test_a_log_mentions_what_took_long(monkeypatch: pytest.MonkeyPatch):
    """Times are those of each activity alone; compiling is told once for what it was part of."""
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    log = io.StringIO()
    progress.follow(Live(Console(file=log, width=100)))
    with progress.doing("mesh"):
        now[0] += 1.9
    with progress.doing("assembly"):
        for _ in range(3):
            with progress.doing(progress.COMPILING):
                now[0] += 1.5
        now[0] += 0.5
        with progress.doing("refining the mesh"):
            now[0] += 3.0
    with contextlib.suppress(InputError), progress.doing("solve"):
        now[0] += 7.25
        raise InputError("lost")
    progress.follow(None)
    assert log.getvalue().splitlines() == [
        "compiling forms (kept for later runs) took 4.5 s",
        "refining the mesh took 3.0 s",
        "solving took 7.2 s",
    ]


def test_nothing_is_mentioned_inside_a_table(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    """The names of the columns stand right above the first row; what took long is told before and after the table."""
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    report = Report()
    report.table("n  changed")
    for row in ("1  2", "2  0"):
        with progress.doing("solve"):
            now[0] += 3.0
        report.row(row)
    with progress.doing("kkt"):
        now[0] += 2.5
    report.line("done")
    progress.follow(None)
    expected = ["solving took 3.0 s", "n  changed", "1  2", "2  0", "checking the solution took 2.5 s"]
    assert capsys.readouterr().out.splitlines() == [*expected[:4], "solving took 3.0 s", *expected[4:], "done"]


def test_ranks_of_a_launcher_write_a_log(monkeypatch: pytest.MonkeyPatch):
    """Open MPI gives them terminals, whose output it may write into a file."""
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    terminal = Terminal()
    progress.follow(Live(Console(file=terminal, force_terminal=True, force_interactive=True)))
    with progress.doing("solve"):
        progress.detail("iteration", 1)
    progress.follow(None)
    assert terminal.getvalue() == ""


def test_commands_tell_a_terminal(tmp_path: Path):
    """The line goes before anything that stays, so that a screen looks as without it."""
    ours, theirs = pty.openpty()
    command = ["signorini", "solve", "example1", "--h", "1/8", "--output", str(tmp_path / "run")]
    with subprocess.Popen(command, stdout=theirs, stderr=theirs, env=os.environ | {"TERM": "xterm"}) as process:
        os.close(theirs)
        pieces = []
        while piece := _read(ours):
            pieces.append(piece)
    os.close(ours)
    assert process.returncode == 0
    shown = b"".join(pieces).decode()
    for words in ("making the mesh …", "solving: iteration ", "bounding the error …", "writing the results …"):
        assert words in shown
    screen = [re.sub(r".*\r(?!\n)", "", line).strip() for line in shown.split("\r\n")]
    left = [line for line in screen if "…" in line]
    assert not left


def _read(terminal: int) -> bytes:
    try:
        return os.read(terminal, 4096)
    except OSError:  # how Linux says that the other side has closed it
        return b""


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("option", ["--quiet", "--json"])
def test_nothing_is_said_where_nothing_is_wanted(folder: Path, option: str):
    done = signorini(folder, "check", "example1", "--quiet") if option == "--quiet" else None
    done = done or signorini(folder, "info", "example1", option)
    assert done.stdout.strip().startswith("{" if option == "--json" else "")
    assert "…" not in done.stdout + done.stderr
