"""Cases in time have their quantities after each step, in tables, summaries and pictures, also after a restart."""

import json
from pathlib import Path

import numpy as np
import pytest
from commands import read_rows, signorini
from in_time import run_in_two
from made_cases import SQUARE_BODY
from mpi4py import MPI

from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import evolve_case
from signorini_fenicsx.discrete.known import Kept
from signorini_fenicsx.physics.diffusion.bound.resolution import Resolution
from signorini_fenicsx.quantities import Mean
from signorini_fenicsx.quantities.beside import Beside
from signorini_fenicsx.solving.solver import Solver

COMM = MPI.COMM_WORLD
FALLING = """
[geometry]
shape = "square"
mesh = "structured"

[boundary]
signorini = ["bottom"]
neumann = ["left", "right", "top"]

[problem]
f = -1
psi = -0.25

[time]
end = 0.3
steps = 3

[solve]
h = 1

[[quantity]]
name = "mean"
kind = "mean"

[[quantity]]
name = "held"
kind = "flux"
parts = "bottom"

[[quantity]]
name = "energy"
kind = "energy"
"""
"""u = −t in all of the square, until it reaches the bound of the bottom."""
SLIDING = f"""{SQUARE_BODY}
[[law]]
parts = ["bottom"]
kind = "friction"
g = 0.02

[problem]
young = 1
poisson = 0
u_D = ["0.09*(1 + t)", "-0.1"]
g_N = {{right = ["0", "0.02"], left = ["0", "-0.02"]}}

[time]
end = 3
steps = 3

[solve]
h = 1

[[quantity]]
name = "slip"
kind = "mean"
parts = "bottom"
direction = [1, 0]
"""
"""A body that slides on: u = (0.05 + 0.09t + 0.04y, −0.1y)."""


def ends(row: dict[str, str], name: str) -> tuple[float, float]:
    """The interval of a quantity in a row."""
    return float(row[f"quantities.{name}.lower"]), float(row[f"quantities.{name}.upper"])


@pytest.fixture(scope="module")
def falling(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`falling.toml`, solved in the folder `found`."""
    folder = tmp_path_factory.mktemp("falling")
    (folder / "falling.toml").write_text(FALLING, encoding="utf-8")
    ended = signorini(folder, "solve", "falling.toml", "--output", "found", "--plot")
    assert ended.returncode == 0, ended.stderr
    assert "at the end" in ended.stdout
    return folder


def test_each_step(falling: Path):
    """`solve` has an interval for each step, around the known mean; the last ones are in the summary."""
    rows = read_rows(falling / "found" / "steps.csv")
    for name, known in (("mean", (-0.1, -0.2)), ("energy", (-0.05, -0.2))):  # of 5u² + u − 10u₀u
        for row, value in zip(rows[:2], known, strict=True):
            lower, upper = ends(row, name)
            assert lower - 1e-9 <= value <= upper + 1e-9
            assert upper - lower < 1e-6
    assert ends(rows[0], "held") == pytest.approx((0.0, 0.0), abs=1e-8)
    lower, upper = ends(rows[2], "held")
    assert 0 < lower < upper < 2
    found = json.loads((falling / "found" / "summary.json").read_text(encoding="utf-8"))["quantities"]
    assert list(found) == ["mean", "held", "energy"]
    assert (found["held"]["lower"], found["held"]["upper"]) == (lower, upper)
    assert found["held"]["guaranteed"] is False
    assert found["held"]["guaranteed_for"] == rows[2]["quantities.held.guaranteed_for"] != ""
    assert (falling / "found" / "quantities.png").exists()
    for change, words in (
        ('quantity.1.parts="nowhere"', "unknown part 'nowhere'"),
        ('quantity.0.weight="1 + t"', "quantity.0.weight: "),
    ):
        for command in ("solve", "check"):
            refused = signorini(falling, command, "falling.toml", "--set", change)
            assert refused.returncode == 2, refused.stdout
            assert words in refused.stderr
    assert not (falling / "results").exists()


def test_what_changes_alone_is_solved_again(folder: Path, monkeypatch: pytest.MonkeyPatch):
    """A step on whose sets the last one has ended takes its τ, the matrix of the step, and what is proved of data."""
    (folder / "case.toml").write_text(FALLING.replace("h = 1\n", 'h = "1/4"\n'), encoding="utf-8")
    solved, made, enclosed, found = list[float](), list[object](), list[object](), None
    counts, news = list[int](), list[int]()
    of_tau, set_up, enclose = Beside.solved, Solver.__init__, Resolution._newly_enclosed
    monkeypatch.setattr(Beside, "solved", lambda self, tau: (solved.append(tau), of_tau(self, tau))[1])
    monkeypatch.setattr(Solver, "__init__", lambda self, *given: (made.append(self), set_up(self, *given))[1])
    counted = lambda self, *given: (enclosed.append(self), enclose(self, *given))[1]  # noqa: E731
    monkeypatch.setattr(Resolution, "_newly_enclosed", counted)
    kind = Mean("1 if x < 0.3 else 0.5")
    for instant in evolve_case(load_case(folder / "case.toml").with_values({"time.end": 1.4, "time.steps": 7})):
        solved.clear()
        enclosed.clear()
        before, found = found, instant.solution.quantity(kind, found)
        assert found.proved
        counts.append(len(solved))
        news.append(len(enclosed))
        if instant.step == 7:
            assert min(news) == 0
            instant.solution.spaces.kept_results._found.clear()
            anew, whole = instant.solution.quantity(kind, before), instant.solution.quantity(kind)
            assert (anew.lower, anew.upper) == pytest.approx((found.lower, found.upper), abs=1e-12)
            assert 0.8 * whole.width < found.width < 1.2 * whole.width
            assert max(found.lower, whole.lower) < min(found.upper, whole.upper)
    assert counts[0] > 2
    assert counts[-1] == 2
    assert len(made) == 1


@pytest.mark.parallel(2)
def test_what_is_kept_is_that_of_all_ranks():
    """What is kept by arrays of which one rank has the same for all is that of the arrays of the others."""
    kept, made = Kept(), list[float]()
    for number in (1.0, 2.0, 1.0):
        of_rank = np.array([number if COMM.rank == 0 else 0.0])
        found = kept.get(COMM, "sum", None, [of_rank], lambda x=of_rank: (made.append(1.0), COMM.allreduce(x[0]))[1])
        assert found == number
    assert len(made) == 2


def test_after_a_restart(falling: Path):
    """Intervals after a restart are those of a run in one piece."""
    run_in_two(load_case(falling / "falling.toml"), falling / "two", step=2)
    for one, other in zip(
        read_rows(falling / "found" / "steps.csv"), read_rows(falling / "two" / "steps.csv"), strict=True
    ):
        for name in ("mean", "held"):
            assert ends(one, name) == pytest.approx(ends(other, name), abs=1e-9)


@pytest.mark.parallel(2)
def test_slip_after_a_restart(folder: Path):
    """The slip of each step is around the known one, on several ranks and after a restart."""
    file = folder / "case.toml"
    on_root(COMM, lambda: file.write_text(SLIDING, encoding="utf-8"))
    run_in_two(load_case(file), folder / "two", step=2)

    def compare() -> None:
        for row in read_rows(folder / "two" / "steps.csv"):
            lower, upper = ends(row, "slip")
            assert lower - 1e-9 <= 0.05 + 0.09 * float(row["t"]) <= upper + 1e-9
            assert upper - lower < 1e-3

    on_root(COMM, compare)
