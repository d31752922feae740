"""A confined process: forbidden actions, the messages of its limits, and its end with its parent."""

import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from signorini_fenicsx.base import confined
from signorini_fenicsx.base.errors import InputError

SEALED = sys.platform == "linux" and platform.machine() in confined.MACHINES


@pytest.mark.skipif(not SEALED or platform.machine() != "x86_64", reason="the numbers of calls are those of x86-64")
def test_a_sealed_process_touches_nothing(tmp_path: Path):
    (tmp_path / "there").write_text("kept")
    os.utime(tmp_path / "there", (1, 1))
    with tempfile.TemporaryFile() as result:
        confined.run("confined_probe", ["seal", str(tmp_path)], result)
        result.seek(0)
        assert result.read() == b""
    assert [path.name for path in tmp_path.iterdir()] == ["there"]
    assert (tmp_path / "there").read_text() == "kept"
    assert (tmp_path / "there").stat().st_mtime == 1


def test_what_killed_processes_left_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Their folders, once they are older than any process may be; links, younger ones and the user's stay."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    long_ago = time.time() - 3 * confined.SECONDS
    old, new, link = (f"{confined.FOLDER}{name}" for name in ("old", "new", "link"))
    users = ("signorini-results", "signorini_fenicsx", "others")
    for name, when in ({old: long_ago, new: time.time()} | dict.fromkeys(users, long_ago)).items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").touch()
        os.utime(tmp_path / name, (when, when))
    (tmp_path / link).symlink_to("others")
    os.utime(tmp_path / link, (long_ago, long_ago), follow_symlinks=False)
    confined._tidy()
    assert {path.name for path in tmp_path.iterdir()} == {new, link, *users}
    assert all((tmp_path / name / "file").exists() for name in users)


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("sleep", "takes more than 600 s"),
        ("memory", "GB of memory that it may have"),
        ("crash", "reader crash .SIGSEGV"),
    ],
)
def test_limits_are_said(monkeypatch: pytest.MonkeyPatch, what: str, message: str):
    if what == "sleep":
        monkeypatch.setattr(confined, "SECONDS", 1)
    with tempfile.TemporaryFile() as result, pytest.raises(InputError, match=message):
        confined.run("confined_probe", [what, "/"], result)


PARENT = """
import sys, tempfile
from signorini_fenicsx.base import confined
confined.run("confined_probe", ["sleep", "/"], tempfile.TemporaryFile())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends children with their parent")
def test_it_dies_with_its_parent():
    paths = os.pathsep.join(os.path.abspath(path) for path in sys.path)
    parent = subprocess.Popen([sys.executable, "-c", PARENT], env=os.environ | {"PYTHONPATH": paths})
    child = None
    while child is None and parent.poll() is None:
        child = next(iter(children(parent.pid)), None)
    assert child is not None
    while b"confined_probe" not in Path(f"/proc/{child}/cmdline").read_bytes():  # it has not started the module yet
        time.sleep(0.01)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    assert gone(child)


def children(parent: int) -> list[int]:
    """Processes that a process has started."""
    return [int(word) for word in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]


def gone(process: int) -> bool:
    """Whether a process ends within ten seconds, even if its parent has not waited for it."""
    for _ in range(1000):
        stat = Path(f"/proc/{process}/stat")
        if not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] == "Z":
            return True
        time.sleep(0.01)
    return False
