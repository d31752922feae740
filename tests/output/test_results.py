"""Results folders: files of the user stay, and whenever a run is killed, the old or the new result is there."""

import contextlib
import json
import os
import re
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from mpi4py import MPI

from signorini_fenicsx.base import exchange
from signorini_fenicsx.base.errors import InputError, LaterFailure
from signorini_fenicsx.base.exchange import area_of, complete, refuse_incomplete
from signorini_fenicsx.base.results import ResultsFolder

FIRST = {"summary.json": "1", "u.png": "1", "solution.bp/data.0": "1", "solution.bp/md.0": "1", "run.json": "1"}
SECOND = {"summary.json": "2", "facets.csv": "2", "solution.bp/data.0": "2"}
MINE = ("photo.png", "notes.json", "raw.bp/data.0", "measured.bp", "solution.bp/mine", ".hidden")


def put(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def publish(target: Path, files: dict[str, str], *, failed: bool = False, add: bool = False) -> None:
    with ResultsFolder(MPI.COMM_SELF, target) as results:
        put(results.path, files)
        if failed:
            results.keep_failed()
        else:
            results.publish(add=add)


def found(folder: Path) -> dict[str, str]:
    """All files of a folder, except the program's list."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != exchange.MANIFEST)
    return {path.relative_to(folder).as_posix(): path.read_text() for path in files}


def test_only_what_the_program_wrote_is_replaced(tmp_path: Path):
    """Files of an earlier run and of an earlier failure are replaced, and a folder with only these; others stay."""
    target, failed = tmp_path / "x", tmp_path / "x.failed"
    mine = dict.fromkeys(MINE, "mine")
    publish(target, FIRST)
    publish(target, FIRST, failed=True)
    put(target, mine)
    put(failed, mine)
    inodes = {name: (target / name).stat().st_ino for name in MINE}
    publish(target, SECOND)
    assert found(target) == SECOND | mine
    assert found(failed) == mine
    assert {name: (target / name).stat().st_ino for name in MINE} == inodes
    publish(target, FIRST, failed=True)
    assert found(failed) == FIRST | mine
    publish(target, {"summary.json": "3"}, add=True)
    assert found(target) == SECOND | mine | {"summary.json": "3"}
    publish(tmp_path / "y", FIRST, failed=True)
    publish(tmp_path / "y", FIRST)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x", "x.failed", "y"]


def test_files_of_the_user_with_names_of_results_stay(tmp_path: Path):
    """Where files get their names only after the solution is there, it is kept, and so is what does not hit them."""
    target, mine, state = tmp_path / "x", {"table.txt": "mine"}, {"checkpoint/about.json": "1"}
    publish(target, FIRST)
    put(target, mine)
    with pytest.raises(InputError, match=r"table\.txt: is in the way, as no earlier run wrote it"):
        publish(target, {"table.txt": "2"})
    assert found(target) == FIRST | mine
    with pytest.raises(LaterFailure, match=r"files: .*table\.txt: is in the way"):
        publish(target, state | {"table.txt": "2"})
    assert found(target) == state | mine

    def with_more() -> None:
        with ResultsFolder(MPI.COMM_SELF, target) as results:
            put(results.path, state)
            results.publish()
            results.attempt("pictures", lambda: put(results.path, {"table.txt": "2", "u.png": "2"}))
            results.attempt("fields", lambda: put(results.path, {"solution.xdmf": "2"}))

    with pytest.raises(LaterFailure, match=r"pictures: .*table\.txt: is in the way"):
        with_more()
    assert found(target) == state | mine | {"solution.xdmf": "2"}
    forged = {"files.json": FORGED.replace("home/.bashrc", "table.txt"), "table.txt": "theirs"}
    put(area_of(target), {"lock": ""} | {f"done/{name}": text for name, text in forged.items()})
    with pytest.raises(InputError, match=r"table\.txt: is in the way"):
        complete(target)
    assert found(target) == state | mine | {"solution.xdmf": "2"}


def test_names_of_results_are_known_before_a_run():
    """All names in the tables of the pages: what of the user has one is told of before anything is solved."""
    pages = Path(__file__).parents[2] / "docs" / "guide"
    lines = [line for name in ("results", "time") for line in (pages / f"{name}.md").read_text().splitlines()]
    first = [line.split("|")[1] for line in lines if line.startswith("| `")]
    names = {name for cell in first for name in re.findall(r"`(\w+\.\w+)`", cell)} - {exchange.MANIFEST}
    assert len(names) > 30
    assert names <= {name.split("/")[0] for name in exchange.OWN}


def test_a_folder_without_a_list_is_no_results_folder(tmp_path: Path):
    mine = {"photo.png": "mine", "summary.json": "mine"}
    put(tmp_path / "x", mine)
    with pytest.raises(InputError, match=r"is not empty and holds no files\.json"):
        publish(tmp_path / "x", SECOND)
    assert found(tmp_path / "x") == mine


def begun(action: Callable[[], None]) -> int:
    """Start an action in a forked process; its status is 0 if it succeeds."""
    pid = os.fork()
    if pid == 0:
        try:
            action()
            os._exit(0)
        except BaseException as error:
            print(repr(error), file=sys.__stderr__, flush=True)
        finally:
            os._exit(1)
    return pid


def killed_at(step: int, action: Callable[[], None]) -> bool:
    """Whether an action, in a new process, is killed before a given change of a file or folder."""
    left = [step]

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        writes = event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_CREAT)
        if writes or event in ("os.rename", "os.remove", "os.rmdir", "os.mkdir", "shutil.rmtree", "fcntl.flock"):
            left[0] -= 1
            if left[0] < 0:
                os.kill(os.getpid(), signal.SIGKILL)

    def body() -> None:
        sys.addaudithook(hook)
        action()

    status = os.waitpid(begun(body), 0)[1]
    assert status in (0, signal.SIGKILL)
    return status != 0


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded")
@pytest.mark.parametrize(
    ("there", "failed", "stride"),
    [(True, False, 3), (True, True, 7), (False, False, 7), (None, False, 7)]
    + [pytest.param(*way, 1, marks=pytest.mark.slow) for way in ((True, False), (True, True), (False, False))],
)
def test_killed_at_any_step_of_a_publish(tmp_path: Path, there: bool | None, failed: bool, stride: int):
    """After a kill the next call finds the old or the new result complete, all files of the user, and nothing else."""
    mine = dict.fromkeys(MINE, "mine") if there else {}
    ends = set()
    for step in range(0, 1000, stride):  # all ways move their files alike
        target = tmp_path / str(step)
        place = target.with_name(f"{step}.failed") if failed else target
        if there:
            publish(target, FIRST, failed=failed)
            put(place, mine)
        elif there is None:  # an empty folder
            place.mkdir()
        if not killed_at(step, lambda target=target: publish(target, SECOND, failed=failed)):
            break
        assert not there or mine.items() <= found(place).items()
        killed_at(step % 9, lambda target=target: complete(target))  # the repair as well
        complete(target)
        left = found(place) if place.exists() else {}
        old = FIRST | mine if there else {}
        assert left in (old, SECOND | mine), step
        ends.add(left == old)
        assert {path.name for path in tmp_path.glob(f"*{step}*")} <= {place.name}
    assert step > 15
    assert ends == {True, False}


FORGED = json.dumps({"written_by": "signorini_fenicsx.base", "files": ["home/.bashrc", "summary.json"]})


def forge(results: Path, victim: Path) -> None:
    """A results folder whose unfinished files would go through a link in it to a folder of the user."""
    put(victim, {".bashrc": "mine", "photo.png": "mine"})
    put(results, {"files.json": FORGED, "summary.json": "1"})
    (results / "home").symlink_to(victim)
    put(area_of(results), {"lock": "", "done/files.json": FORGED, "done/home/.bashrc": "theirs"})


def test_a_reader_changes_nothing_and_a_writer_follows_no_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A forged folder of unfinished results reaches no file outside, whether it is read or written."""
    monkeypatch.setattr(exchange, "PATIENCE", 0.1)
    results, victim = tmp_path / "x", tmp_path / "victim"
    forge(results, victim)
    before = {path: path.is_file() and path.read_text() for path in tmp_path.rglob("*")}
    with pytest.raises(InputError, match="a run was ended while it moved its files here"):
        refuse_incomplete(results)
    assert {path: path.is_file() and path.read_text() for path in tmp_path.rglob("*")} == before
    with pytest.raises(InputError, match="home: is in the way, as it is not a folder"):
        complete(results)
    with pytest.raises(InputError, match="home: is in the way, as it is not a folder"):
        publish(results, SECOND)
    assert found(victim) == {".bashrc": "mine", "photo.png": "mine"}


@pytest.mark.parametrize("name", [".x.partial", ".x.partial/done", ".x.partial/lock", ".x.partial/7", "x.failed"])
def test_links_in_the_place_of_own_folders(tmp_path: Path, name: str):
    """Whatever of the folders around a run is a link, nothing that it leads to is changed."""
    victim = tmp_path / "victim"
    put(victim, {"lock": "", "7/photo.png": "mine", "done/files.json": FORGED, "summary.json": "1"})
    before = found(victim)
    (tmp_path / name).parent.mkdir(exist_ok=True)
    if name != ".x.partial/lock":
        put(tmp_path / ".x.partial", {"lock": ""} if name.startswith(".x.partial/") else {})
    (tmp_path / name).symlink_to(victim)
    with contextlib.suppress(InputError):
        publish(tmp_path / "x", SECOND)
    assert found(victim) == before


@pytest.mark.parametrize(
    "make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero"), lambda p: p.write_text("[" * 9**5)]
)
def test_a_list_that_is_no_small_file(tmp_path: Path, make: Callable[[Path], object]):
    """A pipe is not waited for, a device not read to its end, and broken JSON told in a sentence."""
    put(tmp_path / "x", {"summary.json": "1"})
    make(tmp_path / "x" / "files.json")
    with pytest.raises(InputError, match=r"is not the list that an earlier run wrote|no earlier run wrote it"):
        publish(tmp_path / "x", SECOND)


def test_one_run_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A second run is refused at its start; after a run has died its lock is free and its files are removed."""
    monkeypatch.setattr(exchange.Area.__init__, "__defaults__", (0.1,))  # its patience
    with ResultsFolder(MPI.COMM_SELF, tmp_path / "x") as first:
        put(first.path, FIRST)
        with pytest.raises(InputError, match="another run is writing into it"):
            ResultsFolder(MPI.COMM_SELF, tmp_path / "x")
        publish(tmp_path / "y", SECOND)
        first.publish()
    assert found(tmp_path / "x") == FIRST
    put(tmp_path / ".x.partial", {"lock": "", "123/checkpoint.npz": "half"})
    publish(tmp_path / "x", SECOND)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x", "y"]


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded")
def test_many_publishes_at_once_lose_nothing(tmp_path: Path):
    mine = dict.fromkeys(MINE, "mine")
    publish(tmp_path / "x", FIRST)
    put(tmp_path / "x", mine)

    def work() -> None:
        for i in range(25):
            with contextlib.suppress(InputError):  # another process repairs it
                publish(tmp_path / "x", (FIRST, SECOND)[i % 2])

    children = [begun(work) for _ in range(4)]
    assert [os.waitpid(pid, 0)[1] for pid in children] == [0] * 4
    assert found(tmp_path / "x") in (FIRST | mine, SECOND | mine)
    assert [path.name for path in tmp_path.iterdir()] == ["x"]


@pytest.mark.parametrize(
    ("prepare", "message"),
    [
        (lambda x: put(x, {"u.png": "mine"}), "u.png: is in the way"),
        (lambda x: (x / "multiplier.bp").symlink_to(x.parent), "multiplier.bp: is in the way"),
        (lambda x: put(x, {"facets.csv/mine": "mine"}), "facets.csv: is in the way"),
        (lambda x: put(x, {exchange.MANIFEST: '["../photo.png"]'}), "is not the list"),
        (lambda x: put(x, {exchange.MANIFEST: FORGED.replace("home", "..")}), "is not the list"),
        (lambda x: put(x, {exchange.MANIFEST: "[" * 100000}), "is not the list"),
        (lambda x: x.with_name("x.failed").symlink_to(x), "is a link"),
    ],
)
def test_what_is_in_the_way_is_refused(tmp_path: Path, prepare: Callable[[Path], object], message: str):
    publish(tmp_path / "x", {"summary.json": "1"})
    prepare(tmp_path / "x")
    before = {path: path.lstat().st_ino for path in tmp_path.rglob("*")}
    with pytest.raises(InputError, match=message):
        publish(tmp_path / "x", SECOND)
    assert {path: path.lstat().st_ino for path in tmp_path.rglob("*")} == before
