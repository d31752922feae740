"""The results of cases in time: tables, series, pictures; a restart after a kill; bounds of steps; refusals."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import h5py  # noqa: F401 - meshio reads XDMF heavy data with it
import meshio
import numpy as np
import pytest
from commands import read_rows
from in_time import run, run_in_two
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.owned import owned_values
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.inspection import check
from signorini_fenicsx.cases.solving import evolve_case, solve_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.certificate.step_bounds import StepBounds
from signorini_fenicsx.cli.solutions import export
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.output.steps import StepFolder
from signorini_fenicsx.physics.diffusion.case import Case

COMM = MPI.COMM_WORLD
SMALL = {"solve.h": 1 / 4, "time.steps": 5, "time.scheme": "bdf2"}
KILLED = """
import os, signal
from signorini_fenicsx.cli import main as cli
from signorini_fenicsx.output.steps import StepFolder
save = StepFolder.save
def killed(steps, instant, row):
    save(steps, instant, row)
    steps._comm.Barrier()
    if instant.step == 3:
        os.kill(os.getpid(), signal.SIGKILL)
StepFolder.save = killed
cli.main()
"""


def case(**values: object) -> Case:
    return load_case("moving_transition").with_values(SMALL | values)


def series(folder: Path) -> dict[str, np.ndarray]:
    """The last step of the fields, without what depends on the order of the cells."""
    import adios2  # after DOLFINx, which brings its own

    with adios2.FileReader(str(folder / "solution.bp")) as file:
        steps = file.num_steps()
        last = {name: file.read(name, step_selection=[steps - 1, 1]) for name in ("u", "sigma")}
        times = [float(file.read("step", step_selection=[i, 1]).ravel()[0]) for i in range(steps)]
    with meshio.xdmf.TimeSeriesReader(folder / "solution.xdmf") as reader:
        _, cells = reader.read_points_cells()
        shown = [reader.read_data(step) for step in range(reader.num_steps)]
    assert [t for t, _, _ in shown] == times
    means = {f"mean of {name}": values[0] for name, values in shown[-1][2].items()}
    assert all(len(values) == len(cells[0].data) for values in means.values())
    return {name: np.sort(values.ravel()) for name, values in (last | means).items()} | {"times": np.array(times)}


def assert_same_results(one: Path, other: Path) -> None:
    for name in ("steps.csv", "facets.csv"):
        rows, others = read_rows(one / name), read_rows(other / name)
        assert len(rows) == len(others)
        for row, same in zip(rows, others, strict=True):
            assert list(row) == list(same)
            for key in set(row) - {"seconds", "linear_iterations", "kkt"}:
                if row[key] != same[key]:
                    assert float(row[key]) == pytest.approx(float(same[key]), rel=1e-9, abs=1e-12), (name, key)
    fields, others = series(one), series(other)
    for name, values in fields.items():
        np.testing.assert_allclose(values, others[name], atol=1e-12)


@pytest.mark.parametrize("restart", [False, True])
def test_steps_are_written_through_no_link(tmp_path: Path, restart: bool):
    (tmp_path / "mine").mkdir()
    (tmp_path / "x.steps").symlink_to("mine")
    with pytest.raises(InputError, match=r"x\.steps is a link or has one"):
        run(case(), tmp_path / "x", restart=restart)
    (tmp_path / "x.steps").unlink()
    (tmp_path / "x.steps").mkdir()
    (tmp_path / "x.steps" / "000001").symlink_to("../mine")
    with pytest.raises(InputError, match=r"x\.steps is a link or has one"):
        run(case(), tmp_path / "x", restart=restart)
    assert list((tmp_path / "mine").iterdir()) == []


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_killed_run_goes_on(tmp_path: Path, ranks: int):
    """After SIGKILL one rank goes on after the last complete step; all results are as without a kill."""
    script = tmp_path / "killed.py"
    script.write_text(KILLED)
    settings = [word for key, value in SMALL.items() for word in ("--set", f"{key}={value}")]
    command = ["solve", "moving_transition", *settings, "--certify-steps", "--output", str(tmp_path / "x")]
    launcher = ["mpirun", "-n", "2"] if ranks > 1 else []
    subprocess.run([*launcher, sys.executable, str(script), *command], env=os.environ, capture_output=True, check=False)
    assert sorted(path.name for path in (tmp_path / "x.steps").glob("0*")) == ["000001", "000002", "000003"]
    (tmp_path / "x.steps" / "000004.part").mkdir()
    for name in ("case.json", "000001/field_u.npy", "000002/table_part.npy"):
        shutil.copytree(tmp_path / "x.steps", tmp_path / "y.steps")
        damaged = tmp_path / "y.steps" / name
        damaged.write_bytes(damaged.read_bytes()[:-9])
        with pytest.raises(InputError, match=r"y\.steps: cannot be read \(.*\); remove it and begin again"):
            run(case(), tmp_path / "y", restart=True)
        shutil.rmtree(tmp_path / "y.steps")
    with pytest.raises(
        InputError, match=r"x\.steps has steps of a run that was ended; go on with --restart, or remove"
    ):
        run(case(), tmp_path / "x")
    with pytest.raises(InputError, match=r"is of a case with another \[solve\]; take the same case"):
        run(case(**{"solve.h": 1 / 3}), tmp_path / "x", restart=True)
    run(case(), tmp_path / "x", restart=True)
    assert not (tmp_path / "x.steps").exists()
    run(case(), tmp_path / "whole")
    assert_same_results(tmp_path / "x", tmp_path / "whole")
    check_files(tmp_path / "whole")


def test_a_run_with_linear_u_goes_on(tmp_path: Path):
    """A run that was ended goes on with its u at vertices, RT1, and all its files are as those of a whole run."""
    law = {"region": "all", "kind": "graph", "corners": [[-0.1, -1], [0.1, 1]]}
    about = case(**{"solve.element": "RT1", "law": [law], "time.steps": 3})
    run_in_two(about, tmp_path / "x", 2)
    run(about, tmp_path / "whole", certify_steps=False)
    assert_same_results(tmp_path / "x", tmp_path / "whole")


def test_all_steps_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A run that ends while it writes its results goes on too, also twice; and while it removes its steps."""
    short = case(**{"time.steps": 2})

    def full(*given: object, **more: object) -> None:
        raise OSError("disk full")

    with monkeypatch.context() as broken:
        broken.setattr("signorini_fenicsx.output.steps.delete", full)
        with pytest.raises((OSError, NumericalFailure), match="disk full"):
            run(short, tmp_path / "x", certify_steps=False)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x"]
    with monkeypatch.context() as broken:
        broken.setattr("signorini_fenicsx.output.evolution.write_evolution", full)
        for restart in (False, True):
            with pytest.raises((OSError, NumericalFailure), match="disk full"):
                run(short, tmp_path / "x", restart=restart, certify_steps=False)
    run(short, tmp_path / "x", restart=True, certify_steps=False)
    assert len(read_rows(tmp_path / "x" / "steps.csv")) == 2
    assert not (tmp_path / "x.steps").exists()


def check_files(folder: Path) -> None:
    """Each step has a row, each facet a row for each step; the series ends at the end; the summary has the largest."""
    rows, facets = read_rows(folder / "steps.csv"), read_rows(folder / "facets.csv")
    assert [float(row["t"]) for row in rows] == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])
    number = len(facets) // 5
    for row in rows:
        mine = [facet for facet in facets if facet["step"] == row["step"]]
        assert len(mine) == number
        assert sum(facet["condition"] == "zero_trace" for facet in mine) == int(row["contact_facets"])
        assert 0.5 * float(row["sigma_L2"]) < float(row["sigma_bound"])
    np.testing.assert_allclose(series(folder)["times"], [0.2, 0.4, 0.6, 0.8, 1.0])
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["time"]["steps"] == 5
    assert summary["time"]["largest"]["bound"] == max(float(row["bound"]) for row in rows)
    assert summary["errors"]["sigma_L2"] == float(rows[-1]["sigma_L2"])


def test_bounds_of_steps():
    """Against the exact solution of one step: steady data from their own solution make u_old exact, and all bounds."""
    steady = {"problem.f": "-6*(max(x - 0.4, 0) - y*max(0.4 - x, 0))", "solve.h": 1 / 16, "time.steps": 2}
    steady |= dict.fromkeys(("problem.u_D", "exact.u", "time.initial"), "max(x - 0.4, 0)^3 - y*max(0.4 - x, 0)^3")
    bounds = StepBounds()
    for instant in evolve_case(case(**steady, **{"time.scheme": "implicit-euler"}), COMM):
        bound, plain = bounds.certify(instant), certify(instant.solution)
        error = instant.solution.errors()["sigma_L2"]
        assert 1 < bound.sigma_bound / error < 1.02
        assert bound.sigma_bound < 1.01 * plain.sigma_bound
        assert bound.guaranteed


def test_steps_without_a_bound(tmp_path: Path):
    """Where ψ is above u_D no v is admissible; the run ends like others, and its summary has no bound."""
    run(case(**{"problem.psi": "0.5 + x", "solve.h": 1 / 2, "time.steps": 1}), tmp_path / "x")
    assert json.loads((tmp_path / "x" / "summary.json").read_text())["time"]["largest"]["bound"] is None


def test_a_step_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The message tells the step and how to go on; the steps before are kept, and a fresh failure leaves nothing."""
    growing = case(**{"problem.c": "0 if t < 0.7 else -99"})
    with pytest.raises(InputError, match=r"step 4, t = 0\.8: .*negative"):
        check(growing, COMM)
    told = r"step 4, t = 0\.8: .*negative.*`--restart` goes on after the 3 steps in .*; with `--set time.steps=3 --set "
    with pytest.raises(InputError, match=told + r"time.end=0\.6\d*` it ends with them$"):
        run(growing, tmp_path / "x", certify_steps=False)
    assert len(list((tmp_path / "x.steps").glob("0*"))) == 3
    with pytest.raises(InputError, match=r"is of a case with another \[time\]; take the same case"):
        run(growing.with_values({"time.steps": 3}), tmp_path / "x", restart=True)
    shorter = growing.with_values({"time.steps": 3, "time.end": 0.6})
    about = tmp_path / "x.steps" / "case.json"
    now = about.read_text()
    about.write_text(now.replace('"format": 4', '"format": 3'))
    with pytest.raises(InputError, match="is of another version of the program; remove it"):
        run(shorter, tmp_path / "x", restart=True)
    about.write_text(now)
    run(shorter, tmp_path / "x", restart=True, certify_steps=False)
    assert [row["step"] for row in read_rows(tmp_path / "x" / "steps.csv")] == ["1", "2", "3"]
    shutil.rmtree(tmp_path / "x")
    with pytest.raises(
        NumericalFailure,
        match=r"step 1, t = 0\.2: .* still change after 1 iteration; solve.max_iterations allows more$",
    ):
        run(case(**{"solve.max_iterations": 1}), tmp_path / "x", certify_steps=False)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match=r"--restart: there is no .*x\.steps with steps to go on with"):
        run(case(), tmp_path / "x", restart=True)


@pytest.mark.parallel([1, 2])
def test_the_last_state(folder: Path):
    """It is read again with what it takes from the steps before, is exported, and another run begins with it."""
    steady = dict.fromkeys(("problem.u_D", "exact.u", "time.initial"), "max(x - 0.4, 0)^3 - y*max(0.4 - x, 0)^3")
    steady |= {"problem.f": "20*(x - 0.6)", "time.scheme": "implicit-euler"}
    whole, half = case(**steady, **{"time.steps": 4}), case(**steady, **{"time.steps": 2, "time.end": 0.5})
    *_, last = evolve_case(whole, COMM)
    run(whole, folder / "whole", certify_steps=False)
    found = load_solution(folder / "whole", COMM)
    assert found.step == 4
    assert found.kkt.violation() is None
    assert found.errors() == pytest.approx(last.solution.errors(), rel=1e-9)
    with pytest.raises(InputError, match="is a run in time, whose last step would replace it; give --output"):
        export(folder / "whole", quiet=True)
    export(folder / "whole", output=folder / "end", quiet=True)
    assert load_solution(folder / "end", COMM).step == 4
    means = owned_values(found.u)
    in_vertices = found.potential.x.array.reshape(-1, 6)[: len(means), :3].ravel()
    for name, values in (("mean of u", means), ("u", in_vertices)):
        everywhere = np.sort(np.concatenate(COMM.allgather(values)))
        np.testing.assert_allclose(series(folder / "whole")[name], everywhere, atol=1e-12)
    run(half, folder / "half", certify_steps=False)
    run(half, folder / "on", start_from=folder / "half", certify_steps=False)
    again = load_solution(folder / "on", COMM)
    assert again.norms() == pytest.approx(found.norms(), rel=1e-11)
    assert again.contact[0] == found.contact[0]


def test_refusals_and_case_files():
    """T is known where there is [time], and only there; what takes no problem in time says so."""
    assert StepFolder(COMM, Path("x")).path == Path("x.steps")
    assert check(case(), COMM).counts["cells"] > 0
    with pytest.raises(InputError, match=r"moving_transition: is a problem in time, by its section \[time\]"):
        solve_case(case())
    with pytest.raises(InputError, match=r"example1: has no \[time\]"):
        evolve_case(load_case("example1"))
    for values, message in [
        ({"time.initial": "t"}, r"\[time\] initial: .*unknown name 't'"),
        ({"time.end": 0}, r"\[time\] end: "),
        ({"time.scheme": "euler"}, "unknown scheme 'euler'; use one of implicit-euler, bdf2"),
        ({"time.step": 3}, r"unknown key 'step' in \[time\]; known are end, steps, .*did you mean 'steps'"),
    ]:
        with pytest.raises(InputError, match=message):
            case(**values)
    with pytest.raises(InputError, match=r"\[time\] initial: its largest value, 9.*e\+199, is outside"):
        check(case(**{"time.initial": "1e200*x"}), COMM)
    with pytest.raises(InputError, match="unknown name 't'"):
        load_case("example1").with_values({"problem.f": "t"})


OBSTACLE = """
[geometry]
shape = "square"
[boundary]
signorini = []
[problem]
f = "-30*t*(1 + x)"
obstacle = "-0.2"
[time]
end = 1
steps = 4
[solve]
h = "1/6"
"""


def test_an_obstacle_in_time(tmp_path: Path):
    """Its cells are in the table and in the picture, and a restart goes on from them."""
    (tmp_path / "falling.toml").write_text(OBSTACLE)
    falling = load_case(str(tmp_path / "falling.toml"))
    run(falling, tmp_path / "whole", plot=True)
    rows = read_rows(tmp_path / "whole" / "steps.csv")
    cells = [int(row["contact_cells"]) for row in rows]
    assert 0 < cells[0] < cells[-2] < cells[-1]
    last = json.loads((tmp_path / "whole" / "summary.json").read_text(encoding="utf-8"))["obstacle"]
    assert last["contact_cells"] == cells[-1]
    assert float(rows[-1]["cells_measure"]) == pytest.approx(last["contact_measure"])
    assert all(float(row["bound"]) < 10 for row in rows)
    for name in ("contact.png", "animation.gif"):
        assert (tmp_path / "whole" / name).stat().st_size > 1000
    run_in_two(falling, tmp_path / "x", 3)
    again = read_rows(tmp_path / "x" / "steps.csv")
    assert [row["contact_cells"] for row in again] == [row["contact_cells"] for row in rows]
