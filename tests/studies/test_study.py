"""Studies: their expansion, the same table on any number of ranks, nothing lost or repeated after a kill."""

import fcntl
import os
import re
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as parquet
import pytest
import pyvista
from commands import limited_files, read_rows, signorini
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.farm import hand_out
from signorini_fenicsx.base.shipped import data_folder, study_names
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.pictures.sheet import Sheet
from signorini_fenicsx.studies.folder import StudyFolder
from signorini_fenicsx.studies.picture import draw_study, numbers, plan
from signorini_fenicsx.studies.study import Convergence, load_study, make_run

STUDY = """
title = "A small study"
case = "example4"

[set]
eps = 1e-6

[vary]
h = ["1/4", "1/8"]
algorithm = ["alg3", "alg4"]

[[together]]
"problem.f" = ["100*(1/2 - x)*(1/2 - y)", "x"]
"boundary.signorini" = [["top"], ["top", "left"]]
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_expansion(tmp_path: Path):
    study, runs = load_study(write(tmp_path, STUDY))
    assert study.title == "A small study"
    found = [(run.case.solve.h, run.case.solve.algorithm, run.case.boundary.signorini) for run in runs]
    assert found[:3] == [(0.25, "alg3", ["top"]), (0.25, "alg3", ["top", "left"]), (0.25, "alg4", ["top"])]
    assert len(runs) == len({run.name for run in runs}) == 8
    assert {run.case.solve.eps for run in runs} == {1e-6}
    _, same = load_study(write(tmp_path, STUDY.replace('"1/8"', '0.25, "2^-2", "1/16"').replace("small", "larger")))
    assert len(same) == 8
    assert {run.name for run in same[:4]} == {run.name for run in runs[:4]}
    assert not {run.name for run in same[4:]} & {run.name for run in runs}


def test_tables_vary(tmp_path: Path):
    """Tables by part or region are values as others are; they were taken for the keys of each other."""
    loads = '[{washer = ["0", "-50"]}, {washer = ["0", "-25"]}]'
    _, runs = load_study(
        write(tmp_path, f'case = "clamp"\nvary = {{"problem.g_N" = {loads}, "law.0.mu" = [0.1, 0.3]}}')
    )
    found = [(run.parameters["problem.g_N.washer"][1], run.parameters["law.0.mu"]) for run in runs]
    assert found == [("-50", "0.1"), ("-50", "0.3"), ("-25", "0.1"), ("-25", "0.3")]


def test_cases_beside_the_study(tmp_path: Path):
    case = '[geometry]\nshape = "square"\n[boundary]\nsignorini = ["top"]\n[problem]\nf = "{}"\n'
    (tmp_path / "mine.toml").write_text(case.format("x"))
    _, runs = load_study(write(tmp_path, 'case = "mine.toml"'))
    (tmp_path / "mine.toml").write_text(case.format("y"))
    _, changed = load_study(write(tmp_path, 'case = "mine.toml"'))
    assert [run.case.name for run in runs] == ["mine"]
    assert runs[0].name != changed[0].name


def test_keys_at_their_default_do_not_make_another_run(tmp_path: Path):
    """If a later version has a new key, older runs stay valid; another value of the key makes another run."""

    class LaterCase(Case):
        gravity: str = "down"

    case = load_case("example1")
    later = LaterCase.model_validate(case.model_dump() | {"name": case.name})
    assert make_run(later).name == make_run(case).name
    assert make_run(later.model_copy(update={"gravity": "up"})).name != make_run(case).name
    defaults = {"solve.eps": "1e-8", "solve.predict": True, "problem.psi": "0", "geometry.mesh": "unstructured"}
    assert make_run(case.with_values(defaults)).name == make_run(case).name
    task = Convergence(levels=[2, 3])
    assert make_run(case, task).name == make_run(case, Convergence(levels=[2, 3], reference=8)).name
    assert make_run(case, task).name != make_run(case, Convergence(levels=[2, 3], reference=7)).name


def test_the_default_h_of_a_geometry_is_not_its_own():
    """A `.geo` file uses its own sizes, except if h is given, with any value."""
    own = load_case("dam").with_values({"geometry": {"file": str(data_folder("meshes") / "dam.geo")}})
    assert make_run(own).name != make_run(own.with_values({"solve.h": 2**-5})).name


def test_eps_varies_wherever_there_is_one(tmp_path: Path):
    text = 'case = "example1"\n[vary]\nalgorithm = ["alg3", "slimane"]\n[convergence]\nlevels = [2]\nvary = "eps"'
    assert len(load_study(write(tmp_path, text))[1]) == 2


def test_shipped_studies_are_valid():
    for name in study_names():
        assert load_study(name)[1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "case: must be"),
        ('case = "example7"', "unknown case 'example7'"),
        ('case = "example1"\nvarry = 1', "did you mean 'vary'"),
        ('case = "example1"\n[vary]\nh = []', r"\[vary\] solve.h: must be a list"),
        ('case = "example1"\n[vary]\nh = 0.5', r"\[vary\] solve.h: must be a list"),
        ('case = "example1"\n[vary]\nh = [0.5, 0]', "greater than 0"),
        ('case = "example1"\n[vary]\n"solve.hh" = [0.5]', "did you mean 'h'"),
        ('case = "example1"\n[[together]]\nh = [0.5]\nrho = [1, 2]', "equally long"),
        ('case = "example1"\n[convergence]\nlevels = [2, 8]', "finer than the last level"),
        ('case = "example1"\n[convergence]\nlevels = [2]\nvary = "eps"', "alg1 has no ε"),
        ('case = "example1"\nranks_per_run = 0', "ranks_per_run"),
        ('case = "example1"\n[vary]\n' + "\n".join(f'"a.b{i}" = {[0] * 10}' for i in range(9)), "1000000000 runs"),
        ("case = ", "not a TOML file"),
        ('name = "x"\ncase = "example1"', "unknown key 'name'"),
        ('case = "example1"\n[convergence]\nlevels = [2]\nreferenze = 3', "did you mean 'reference'"),
        ('case = "example1"\n[convergence]\nlevels = [2, 2]', "must ascend"),
        ('case = "example1"\n[convergence]\nlevels = [true]', "valid integer"),
        ('case = "example4"\n[set]\nalgorithm = "alg3"\n[convergence]\nvary = "eps"\nlevels = [20]', "eps: must be"),
        ('case = "example1"\n[set]\nh = 0.5\n"solve.h" = 0.25', "is given twice"),
        ('case = "example1"\n[vary]\nh = [0.5]\n[[together]]\nh = [0.25]', "varies in two places"),
        ('case = "example1"\n[set]\n' + ".".join("a" * 400) + " = 1", "unknown key 'a"),
        ('case = "example1"\n[set]\n' + ".".join("a" * 90000) + " = 1", "nested too deeply"),
        ("x = [" + "1," * 2**22 + "]", "has more than"),
    ],
)
def test_bad_studies(tmp_path: Path, text: str, message: str):
    with pytest.raises(InputError, match=message):
        load_study(write(tmp_path, text))


def test_a_damaged_run_is_told(tmp_path: Path):
    (run,) = load_study(write(tmp_path, 'case = "example1"'))[1]
    folder = StudyFolder(MPI.COMM_SELF, tmp_path / "results")
    folder.place(run).mkdir(parents=True)
    for summary in ("", "[]", "{" * 10**5, "{}"):
        (folder.place(run) / "summary.json").write_text(summary)
        with pytest.raises(InputError, match="is damaged; delete it"):
            folder.record(run)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a study that was run on one rank, without mpirun."""
    folder = tmp_path_factory.mktemp("study")
    write(folder, STUDY)
    done = signorini(folder, "study", "study.toml")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("done ") == 8
    assert re.search(r"(?m)^1/8 done   algorithm = alg3  h = 0.125  signorini = .*  f = .* s left$", done.stdout)
    assert re.search(r"(?m)^8/8 done   .*  f = x  \d+\.\d s$", done.stdout)
    return folder / "results" / "study-study"


def test_table(finished: Path):
    rows = read_rows(finished / "table.csv")
    assert len(rows) == 8
    assert [row["solve.h"] for row in rows] == ["0.25"] * 4 + ["0.125"] * 4
    assert {row["status"] for row in rows} == {"done"}
    assert {"norms.sigma_L2", "contact_measure", "iterations", "violation.trace", "solve.eps"} <= set(rows[0])
    assert not {"ranks", "timings.solve", "command"} & set(rows[0])
    names = list(rows[0])
    assert names[:6] == ["solve.algorithm", "solve.h", "boundary.signorini", "problem.f", "status", "reason"]
    assert names.index("contact_measure") < names.index("run") < names.index("solve.eps")
    assert pyvista.read(finished / "study.png").n_points > 0
    columns = parquet.read_table(finished / "table.parquet").to_pydict()
    assert list(columns) == list(rows[0])
    assert [str(value) for value in columns["norms.u_L2"]] == [row["norms.u_L2"] for row in rows]
    assert [float(row["seconds"]) > 0 for row in read_rows(finished / "timings.csv")] == [True] * 8

    lines = (finished / "table.tex").read_text(encoding="utf-8").splitlines()
    assert lines[0] == r"\begin{tabular}{rrrrrrr}"
    assert lines[2].startswith(r"algorithm & h & signorini & f & ")
    assert lines[4].startswith('alg3 & $0.25$ & ["top"] & 100*(1/2 - x)*(1/2 - y) & ')
    assert len(lines) == 4 + 8 + 2


def test_the_status_is_told_at_any_time(tmp_path: Path):
    """While a launch is under way, after it was killed, and of a study that has no folder yet; nothing is written."""
    path = write(tmp_path, 'case = "example1"\n[vary]\nh = ["1/4", "1/8"]')
    shown = signorini(tmp_path, "study", "study.toml", "--status").stdout
    assert "to do   h = 0.25\nto do   h = 0.125\n0/2: 2 to do; no launch is under way\n" in shown
    assert list(tmp_path.iterdir()) == [path]
    runs, folder = load_study(path)[1], StudyFolder(MPI.COMM_SELF, tmp_path / "results" / "study-study")
    with folder:
        (folder.claims / runs[1].name).touch()
        shown = signorini(tmp_path, "study", "study.toml", "--status").stdout
        assert "running h = 0.125\n0/2: 1 to do, 1 running; a launch is under way\n" in shown
    folder.claims.mkdir()
    (folder.claims / runs[1].name).touch()
    assert "0/2: 2 to do; no launch" in signorini(tmp_path, "study", "study.toml", "--status").stdout
    assert signorini(tmp_path, "study", "study.toml").returncode == 0
    shown = signorini(tmp_path, "study", "study.toml", "--status").stdout
    assert re.search(r"done    h = 0.25  \d+\.\d s\ndone    h = 0.125  .*\n2/2: 2 done; no launch", shown)


NUMBERS = [{"status": "done", "a.x": x, "a.y": str(y), "iterations": x * y} for x in (1, 2, 3) for y in (1.0, 2.0, 3.0)]
WORDS = [{"status": "done", "x": x, "word": word, "iterations": x} for x in (1, 2) for word in ("one", "two")]


def test_a_picture_shows_the_quantities_that_were_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """They come first, with their intervals; other entries of `quantities` have no interval and are not drawn."""
    asked = {"quantities.flow.value": 2.0, "quantities.flow.lower": 1.5, "quantities.flow.upper": 2.5}
    rows = [row | asked | {"quantities.balance.value": 0.0} for row in WORDS]
    assert list(plan(rows, ["word", "x"]).panels.items()) == [("quantities.flow.value", "flow"), ("iterations",) * 2]
    drawn = []
    monkeypatch.setattr(Sheet, "save", lambda sheet, path: drawn.append(sheet))
    without = {"status": "done", "word": "idle", "x": 1}  # has no curve, and so no entry of the legend
    assert draw_study(tmp_path / "study.png", [*rows, without], ["word", "x"], "A study")
    assert {text.get_text() for text in drawn[0].legends[0].get_texts()} == {"word = one", "word = two"}
    bars = [path.vertices[:, 1] for each in drawn[0].axes[0].collections for path in each.get_paths()]
    np.testing.assert_array_equal(bars, [[1.5, 2.5]] * 4)
    assert not drawn[0].axes[1].collections


@pytest.mark.parametrize(
    ("rows", "keys", "found"),
    [
        (NUMBERS, ["a.x", "a.y"], ("a.x", "a.y", [])),
        (NUMBERS[:-1] + NUMBERS[:1], ["a.x", "a.y"], ("a.x", None, ["a.y"])),
        (WORDS, ["word", "x"], ("x", None, ["word"])),
        ([row | {"same": row["x"]} for row in WORDS], ["x", "same", "word"], ("x", None, ["word"])),
        ([row | {"h": 0.1 * row["x"], "sigma_V": 1.0} for row in WORDS], ["word"], ("h", None, ["word"])),
        (WORDS[:2], ["word"], ("word", None, [])),
    ],
)
def test_what_a_picture_shows(tmp_path: Path, rows: list[dict], keys: list[str], found: tuple):
    """Maps over two numbers, curves over one, and words where nothing is a number; what follows from x is left out."""
    wanted = plan([numbers(row, keys) for row in rows], keys)
    assert wanted is not None
    assert (wanted.x, wanted.y, wanted.curves) == found
    assert draw_study(tmp_path / "study.png", [*rows, {"status": "failed"}], keys, "A study")
    assert pyvista.read(tmp_path / "study.png").n_points > 0
    assert not draw_study(tmp_path / "none.png", rows[:1], keys, "A study")


@pytest.mark.parallel(2)
def test_nothing_is_written(folder: Path):
    """A dry run writes nothing; if the folder cannot be written, this is reported once."""
    if MPI.COMM_WORLD.rank == 0:
        write(folder, STUDY)
    done = signorini(folder, "study", "study.toml", "--dry-run")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("to do ") == 8
    assert "algorithm = alg4  h = 0.125" in done.stdout
    done = signorini(folder, "study", "study.toml", "--output", "/proc/mine")
    assert (done.returncode, done.stderr.count("cannot be written")) == (2, 1)
    assert [path.name for path in folder.iterdir()] == ["study.toml"]


def stamps(results: Path) -> dict[str, tuple[int, int]]:
    """Data of a finished run that change if it is repeated."""
    files = {path.parent.name: path.stat() for path in results.glob("runs/[!.]*/run.json")}
    return {name: (stat.st_ino, stat.st_mtime_ns) for name, stat in files.items()}


def descendants(pid: int) -> list[int]:
    """A process that the test started, and all its descendants."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [pid, *(process for child in children for process in descendants(int(child)))]


def test_a_large_study_has_to_be_meant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("signorini_fenicsx.cli.study_report.MANY", 8)
    write(tmp_path, STUDY)
    done = signorini(tmp_path, "study", "study.toml")
    assert done.returncode == 2
    assert "study study: has 8 runs; look at them by --dry-run, and begin by --yes" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["study.toml"]
    assert signorini(tmp_path, "study", "study.toml", "--dry-run").returncode == 0


def test_killed_and_continued(tmp_path: Path, finished: Path):
    """Kill -9 on two ranks loses nothing finished; the end is the table of a run in one piece."""
    write(tmp_path, STUDY)
    results = tmp_path / "results" / "study-study"
    launch = subprocess.Popen(
        ["mpirun", "-n", "2", "signorini", "study", "study.toml"],
        cwd=tmp_path,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    while len(stamps(results)) < 2 and launch.poll() is None:
        time.sleep(0.01)
    for process in descendants(launch.pid):
        os.kill(process, signal.SIGKILL)
    launch.wait()
    known = stamps(results)
    assert len(known) >= 2
    (results / "runs" / f".{next(iter(known))}.left.partial").mkdir()
    done = signorini(tmp_path, "study", "study.toml")
    assert done.returncode == 0, done.stderr
    assert "runs were finished before" in done.stdout
    assert known.items() <= stamps(results).items()
    assert (results / "table.csv").read_bytes() == (finished / "table.csv").read_bytes()
    assert not list(results.glob("runs/.*"))


FAILING = """
case = "example2"
ranks_per_run = 2

[vary]
h = ["1/4"]
max_iterations = [1, 50]
algorithm = ["alg1", "alg2"]
"""


@pytest.mark.parallel(2)
def test_failed_runs_are_recorded_and_do_not_stop_the_others(folder: Path):
    """Failures are in the table and in the exit status; they are repeated only on request."""
    if MPI.COMM_WORLD.rank == 0:
        write(folder, FAILING)
    results = folder / "results" / "study-study"
    for arguments, again in [([], True), ([], False), (["--retry-failed"], True)]:
        before = stamps(results)
        done = signorini(folder, "study", "study.toml", *arguments)
        assert done.returncode == 1
        assert done.stderr.count("2 of 4 runs") == 1
        assert "facets still change after 1 iteration" in done.stderr
        changed = stamps(results).items() - before.items()
        assert bool(changed) is again
        rows = read_rows(results / "table.csv")
        assert [row["status"] for row in rows] == ["failed", "failed", "done", "done"]
        assert "facets still change" in rows[0]["reason"]
        assert float(rows[0]["norms.sigma_L2"]) > 0
        assert {row["ranks"] for row in read_rows(results / "timings.csv")} == {"2"}


def test_data_that_cannot_be_solved_are_a_failed_run(tmp_path: Path):
    """Errors that are found only when a run begins, such as a load that is not finite, do not stop the other runs."""
    write(tmp_path, 'case = "example1"\n[vary]\nh = ["1/4"]\n"problem.f" = ["sqrt(x - 0.5)", "x - 0.5"]')
    done = signorini(tmp_path, "study", "study.toml")
    assert done.returncode == 1
    rows = read_rows(tmp_path / "results" / "study-study" / "table.csv")
    assert [row["status"] for row in rows] == ["failed", "done"]
    assert "not finite" in rows[0]["reason"]
    assert rows[0]["norms.u_L2"] == ""


def test_errors_as_runs(tmp_path: Path):
    """If a run measures errors, the table has a row per level."""
    write(tmp_path, 'case = "example1"\n[convergence]\nlevels = [1, 2]\nreference = 3')
    done = signorini(tmp_path, "study", "study.toml")
    assert done.returncode == 0, done.stderr
    results = tmp_path / "results" / "study-study"
    rows = read_rows(results / "table.csv")
    assert [row["level"] for row in rows] == ["1", "2"]
    assert float(rows[1]["slides_sigma_V"]) == 1.65
    (run,) = stamps(results)
    kept = read_rows(results / "runs" / run / "convergence.csv")
    assert [row["sigma_V"] for row in rows] == [row["sigma_V"] for row in kept]


def test_a_full_disk_loses_nothing(tmp_path: Path, finished: Path):
    """With a limit on file sizes, like a full disk: one sentence, and the study continues when there is space."""
    write(tmp_path, STUDY)
    with limited_files(6000):
        done = signorini(tmp_path, "study", "study.toml")
    assert done.returncode == 1
    assert "File too large" in done.stderr
    results = tmp_path / "results" / "study-study"
    assert len(stamps(results)) < 8
    assert not list(results.glob("runs/.*.partial"))
    done = signorini(tmp_path, "study", "study.toml")
    assert done.returncode == 0, done.stderr
    assert (results / "table.csv").read_bytes() == (finished / "table.csv").read_bytes()


def test_one_launch_at_a_time_and_only_in_its_own_folder(tmp_path: Path):
    write(tmp_path, 'case = "example1"\n[vary]\nh = ["1/4"]')
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").write_text("mine")
    done = signorini(tmp_path, "study", "study.toml", "--output", "full")
    assert (done.returncode, "is not empty and not the folder of a study" in done.stderr) == (2, True)
    for place, name in (("one", "runs"), ("two", ".claims")):
        (tmp_path / place).mkdir()
        for file in {".lock", name}:
            (tmp_path / place / file).write_text("mine")
        done = signorini(tmp_path, "study", "study.toml", "--output", place)
        assert (done.returncode, f"{name}: is in the way" in done.stderr) == (2, True)
        assert {path.name for path in (tmp_path / place).iterdir()} == {".lock", name}
    (tmp_path / "busy").mkdir()
    with (tmp_path / "busy" / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = signorini(tmp_path, "study", "study.toml", "--output", "busy")
    assert (done.returncode, "another launch" in done.stderr) == (2, True)


def test_nothing_is_written_through_links(tmp_path: Path):
    """In a folder that came from elsewhere the names of tables, and of files that become tables, may be links."""
    write(tmp_path, 'case = "example1"\n[vary]\nh = ["1/2", "1/3"]')
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / ".lock").touch()
    names = ("table.csv", "timings.csv", "table.parquet", "table.tex", "versions.json", "study.png")
    for name in (Path(name) for name in names):
        for link in (name, name.with_stem(f"{name.stem}.part"), Path(f"{name}.part")):
            (tmp_path / "x" / link).symlink_to("../mine")
    assert signorini(tmp_path, "study", "study.toml", "--output", "x").returncode == 0
    assert (tmp_path / "mine").read_text() == "mine"
    assert not any((tmp_path / "x" / name).is_symlink() for name in names)


@pytest.mark.parallel(3)
def test_each_task_once_by_any_grouping(folder: Path):
    """Each task is done once, for any groups; a failure in one group ends all groups, and all ranks raise it."""
    comm = MPI.COMM_WORLD
    names = [f"task{i}" for i in range(7)]
    for ranks in (1, 2, 5):
        claims = folder / f"claims{ranks}"
        if comm.rank == 0:
            claims.mkdir()
        comm.Barrier()
        mine: list[str] = []
        hand_out(comm, names, ranks, claims, lambda name, group, mine=mine: mine.append((name, group.size)))
        done = sorted(task for part in comm.allgather(mine) for task in part)
        size = min(ranks, comm.size)
        assert done == sorted((name, size) for name in names for _ in range(size))
    claims = folder / "failing"
    if comm.rank == 0:
        claims.mkdir()
    comm.Barrier()

    def work(name: str, group: MPI.Comm) -> None:
        if name == "task3":
            raise OSError("no space")

    with pytest.raises(OSError, match="no space"):
        hand_out(comm, names, 1, claims, work)
