"""A solution that exists is kept, whatever comes after it fails: one sentence, and exit status 3."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import pytest
from commands import Ended, read_rows, run, signorini
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Dirichlet, Domain, InputError, Signorini, adapt, solve
from signorini_fenicsx.cases import solving
from signorini_fenicsx.certificate import adaptive
from signorini_fenicsx.certificate import certify as certifying
from signorini_fenicsx.certificate.step_bounds import StepBounds
from signorini_fenicsx.extend import LaterFailure
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.output import curves, evolution, writing
from signorini_fenicsx.physics.diffusion.bound import certify as bound
from signorini_fenicsx.pictures import drawing
from signorini_fenicsx.pictures.style import STYLE
from signorini_fenicsx.solving.physics import PHYSICS
from signorini_fenicsx.studies import picture

SOLVE = ("example1", "--h", "1/4", "--output", "x", "-q")
TIMES = ("moving_transition", "--h", "1/4", "--output", "x", "-q")
THREE = ("--set", "time.steps=3", "--set", "time.end=0.3")
FIELDS = {"solution.bp", "solution.xdmf", "solution.h5", "multiplier.bp", "multiplier.xdmf", "boundary.xdmf", "show.py"}
TABLES = {"checkpoint", "facets.csv", "files.json", "history.csv"}
BROKEN = "ValueError: it is broken"

type Breaking = Callable[..., Ended]


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Save time where pictures are not looked at."""
    monkeypatch.setitem(STYLE, "figure.dpi", 30)


@pytest.fixture
def breaking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Breaking:
    """Runs a command while functions of modules fail."""
    assert PHYSICS["diffusion"].bound  # imported with all its names, before some of them fail

    def failing(*_: object, **_options: object) -> object:
        raise ValueError("it is broken")

    def done(of: dict[str, Any], *arguments: str) -> Ended:
        with monkeypatch.context() as during:
            for name, place in of.items():
                during.setattr(place, name, failing)
            return signorini(tmp_path, *arguments)

    return done


def told(done: Ended) -> str:
    """What a command says that has kept its solution, without the place."""
    assert done.returncode == 3, done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    words, found, _ = done.stderr.partition("; the solution is in ")
    assert found, done.stderr
    return words.removeprefix("failed: ")


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_everything_fails(breaking: Breaking, tmp_path: Path):
    """The checkpoint and the summary are there alone, and nothing of an earlier result; export does the rest."""
    (tmp_path / "x").mkdir()
    earlier = {"written_by": "signorini_fenicsx.base", "files": ["old.csv"]}
    (tmp_path / "x" / "files.json").write_text(json.dumps(earlier))
    (tmp_path / "x" / "old.csv").touch()
    of = {"gap_parts": bound, "quantities_of": solving, "write_sites": writing, "write_fields": writing}
    done = breaking(of | {"draw_all": drawing, "write_page": drawing}, "solve", *SOLVE, "--plot", "--html")
    failed = ("tables", "error bound", "quantities", "pictures", "solution.html", "fields")
    assert told(done) == "; ".join(f"{what}: {BROKEN}" for what in failed)
    assert names(tmp_path / "x") == {"checkpoint", "files.json", "summary.json"}
    assert json.loads((tmp_path / "x" / "summary.json").read_text())["converged"]
    assert signorini(tmp_path, "export", "x", "-q").returncode == 0
    assert names(tmp_path / "x") == FIELDS | TABLES | {"summary.json"}
    assert names(tmp_path) == {"x"}


def test_the_others_are_written(breaking: Breaking, tmp_path: Path):
    done = breaking({"gap_parts": bound, "draw_all": drawing}, "solve", *SOLVE, "--plot", "--html")
    assert told(done) == f"error bound: {BROKEN}; pictures: {BROKEN}"
    assert names(tmp_path / "x") == FIELDS | TABLES | {"solution.html", "summary.json"}


def test_export_and_certify_and_convergence(breaking: Breaking, tmp_path: Path):
    assert signorini(tmp_path, "solve", *SOLVE).returncode == 0
    assert told(breaking({"gap_parts": bound}, "export", "x", "-q", "--html")) == f"error bound: {BROKEN}"
    assert names(tmp_path / "x") >= {"solution.html", *FIELDS}
    convergence = ("convergence", "example1", "--levels", "0:1", "--reference", "2", "--output", "y", "-q")
    assert told(breaking({"draw_errors": curves}, *convergence)) == f"picture: {BROKEN}"
    assert names(tmp_path / "y") == {"convergence.csv", "convergence.tex", "files.json", "summary.json"}
    points, cells = [[0, 0], [1, 0], [1, 1], [0, 1]], [("triangle", [[0, 1, 2], [0, 2, 3]])]
    meshio.Mesh(points, cells, point_data={"u": [0.0] * 4}).write(tmp_path / "mine.vtu")
    certify = ("certify", "example1", "--field", "mine.vtu", "--h", "1/4", "--output", "z", "-q")
    assert told(breaking({"bound_field": certifying}, *certify)) == f"error bound: {BROKEN}"
    assert names(tmp_path / "z") >= FIELDS | TABLES


def test_adapt(breaking: Breaking, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The uniform meshes for comparison, and pictures, come after; a bound that fails on a mesh leaves its solution."""
    adapt = ("adapt", "example1", "--max-cells", "50", "--h", "1/2", "--output", "x", "-q")
    assert told(breaking({"draw_bounds": curves}, *adapt)) == f"pictures of the refinement: {BROKEN}"
    assert names(tmp_path / "x") >= {"adapt.csv", "summary.json", *FIELDS}
    assert told(breaking({"gap_parts": bound}, *adapt)) == BROKEN
    assert names(tmp_path / "x") == FIELDS | TABLES | {"summary.json", "vertices.csv"}
    dorfler = adaptive.dorfler

    def adaptive_only(values: Any, theta: float, comm: Any) -> Any:
        assert theta < 1, "it is broken"
        return dorfler(values, theta, comm)

    with monkeypatch.context() as during:
        during.setattr(adaptive, "dorfler", adaptive_only)
        done = signorini(tmp_path, *adapt, "--uniform", "--plot")
    assert told(done).startswith("uniform refinement: cannot refine further: AssertionError: it is broken")
    assert {row["refinement"] for row in read_rows(tmp_path / "x" / "adapt.csv")} == {"adaptive", "uniform"}
    assert names(tmp_path / "x") >= {"adapt.png", "mesh.png", "overview.png"}


@pytest.mark.parametrize("case", [pytest.param("example1", marks=pytest.mark.parallel([2])), "hertz"])
def test_adapt_whose_next_mesh_is_not_solved(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The solution before, its bound, quantity and rows are kept, and beside it the last state of the failed solve."""
    whole, place = solving.solve_case, MPI.COMM_WORLD.bcast(tmp_path)

    def in_time(case: Any, *, domain: Any, start: Any, **options: Any) -> Any:
        short = {"solve.max_iterations": 1, "solve.predict": False}
        case, start = (case, start) if domain.cells < 20 else (case.with_values(short), None)
        return whole(case, domain=domain, start=start, **options)

    monkeypatch.setattr(solving, "solve_case", in_time)
    table = ("--set", 'quantity=[{name="q", kind="energy"}]', "--quantity", "q", "--width", "1e-9")
    done = signorini(place, "adapt", case, "--h", "1", *table, "--output", "x", "-q")
    words = told(done)
    assert words.startswith("on the next mesh, with ")
    assert words.endswith(f"solve.max_iterations allows more; its last state is in {place / 'x.failed'}")
    rows, summary = read_rows(place / "x" / "adapt.csv"), json.loads((place / "x" / "summary.json").read_text())
    assert summary["converged"]
    assert summary["cells"] == int(rows[-1]["cells"]) < 20
    assert summary["certificate"]["bound"] == float(rows[-1]["bound"])
    assert summary["quantities"]["q"]["upper"] == float(rows[-1]["quantities.q.upper"])
    failed = json.loads((place / "x.failed" / "summary.json").read_text())
    assert (failed["converged"], failed["cells"] > 20) == (False, True)
    assert names(place) == {"x", "x.failed"}


@pytest.mark.parametrize("error", [InputError, ValueError])
def test_adapt_in_python_keeps_what_it_has(error: type[Exception]):
    """Whatever fails on a mesh after the first, the exception has the solution before and its bound."""

    def solve_on(domain: Domain, start: Any) -> Any:
        if domain.cells > 18:
            raise error("it is broken")
        return solve(domain, Diffusion(f=-1, conditions=[Dirichlet("top"), Signorini("bottom", psi=-0.1)]))

    with pytest.raises(LaterFailure, match=r"on the next mesh, with .* cells: .*it is broken") as failure:
        adapt(build_domain(MPI.COMM_SELF, "square", 0.5, mesh="structured"), solve_on)
    assert failure.value.solution.converged
    assert failure.value.certificate.v.function_space.mesh is failure.value.solution.spaces.mesh
    assert failure.value.state is None


def test_times(breaking: Breaking, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Bounds that fail in a step do not end the steps; if the fields fail, the steps stay, and a restart has them."""
    certify = StepBounds.certify

    def second_fails(bounds: StepBounds, instant: Any) -> object:
        if instant.step == 2:
            raise ValueError("it is broken")
        return certify(bounds, instant)

    with monkeypatch.context() as during:
        during.setattr(StepBounds, "certify", second_fails)
        done = signorini(tmp_path, "solve", *TIMES, *THREE, "--certify-steps")
    assert told(done) == f"error bounds: {BROKEN}"
    bounds = [float(row["bound"]) for row in read_rows(tmp_path / "x" / "steps.csv")]
    assert [value < 1e9 for value in bounds] == [True, False, True]
    largest = json.loads((tmp_path / "x" / "summary.json").read_text())["time"]["largest"]
    assert (largest["bound"], largest["guaranteed"]) == (None, False)
    assert names(tmp_path) == {"x"}
    mean = ("--set", 'quantity=[{name="mean",kind="mean"}]')
    asked = ("solve", *TIMES, *THREE, *mean)
    words = told(breaking({"write_fields": evolution, "quantities_of": solving}, *asked, "--plot"))
    assert words.startswith(
        f"quantities: {BROKEN}; fields: {BROKEN}; `--restart` writes again what is made of the steps"
    )
    assert names(tmp_path / "x") >= {"checkpoint", "contact.png", "facets.csv", "steps.csv", "summary.json"}
    assert json.loads((tmp_path / "x" / "summary.json").read_text())["quantities"]["mean"]["value"] is None
    assert names(tmp_path) == {"x", "x.steps"}
    assert signorini(tmp_path, *asked, "--restart").returncode == 0
    assert names(tmp_path) == {"x"}
    assert names(tmp_path / "x") >= FIELDS


def test_study(breaking: Breaking, tmp_path: Path):
    """A run whose bound fails is done, and its row says what failed; the picture comes last; both can be done again."""
    (tmp_path / "s.toml").write_text('case = "example1"\n[vary]\nh = ["1/2", "1/4"]')
    study = ("study", "s.toml", "--output", "s", "-q")
    done = breaking({"gap_parts": bound}, *study)
    assert done.returncode == 3
    assert f"2 of 2 runs are solved, but not complete, the first one with h = 0.5: error bound: {BROKEN}" in done.stderr
    rows = read_rows(tmp_path / "s" / "table.csv")
    assert [(row["status"], row["reason"]) for row in rows] == 2 * [("done", f"error bound: {BROKEN}")]
    assert all(float(row["contact_measure"]) >= 0 for row in rows)
    done = breaking({"draw_study": picture}, *study, "--retry-failed")
    assert done.returncode == 3
    assert f"study.png: {BROKEN}; the tables are in" in done.stderr
    rows = read_rows(tmp_path / "s" / "table.csv")
    assert all(float(row["certificate.bound"]) > 0 for row in rows)
    assert signorini(tmp_path, *study).returncode == 0
    assert names(tmp_path / "s") >= {"study.png", "table.csv", "table.parquet", "versions.json"}


def test_failed_runs_keep_their_state_without_pictures(breaking: Breaking, tmp_path: Path):
    few = ("--set", "solve.max_iterations=1", "--no-predict", "--plot")
    done = breaking({"draw_all": drawing}, "solve", *SOLVE, *few)
    assert done.returncode == 1
    assert f"the last state is in {tmp_path}/x.failed; pictures: {BROKEN}" in done.stderr
    assert names(tmp_path / "x.failed") >= FIELDS | TABLES


NO_PARTS = 'SetFactory("OpenCASCADE"); Disk(1) = {0, 0, 0, 1}; Physical Surface("all") = {1}; Mesh.MeshSizeMin = 0.5;'
OPEN = '[geometry]\nfile = "disk.geo"\n[problem]\nf = -1\nobstacle = -0.1\n'


def test_a_mesh_without_parts(tmp_path: Path):
    """Without names of parts all files are there."""
    (tmp_path / "disk.geo").write_text(NO_PARTS)
    (tmp_path / "open.toml").write_text(OPEN)
    done = signorini(tmp_path, "solve", "open.toml", "-q", "--output", "x")
    assert done.returncode == 0, done.stderr
    assert names(tmp_path / "x") >= {"boundary.xdmf", "solution.bp", "solution.xdmf"}
    assert set(meshio.read(tmp_path / "x" / "boundary.xdmf").cell_data["part"][0]) == {-1}


def test_fields_come_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The solution, its bound and its pictures are there already when fields are written: a kill leaves them."""
    before = list[tuple[set[str], float]]()

    def seen(*_: object) -> None:
        summary = json.loads((tmp_path / "x" / "summary.json").read_text())
        before.append((names(tmp_path / "x"), summary["certificate"]["bound"]))

    monkeypatch.setattr(writing, "write_fields", seen)
    monkeypatch.setattr(drawing, "draw_all", lambda folder, _: (folder / "overview.png").touch())
    assert signorini(tmp_path, "solve", *SOLVE, "--plot").returncode == 0
    ((found, bound),) = before
    assert found >= TABLES | {"overview.png"}
    assert bound > 0


ONE_RANK = """
from mpi4py import MPI
from signorini_fenicsx.base import parallel
from signorini_fenicsx.cli import main as cli
from signorini_fenicsx.output import writing
from signorini_fenicsx.certificate import certify
parallel.PATIENCE, whole, fields = 0.5, certify.certify, writing.write_fields
def fail():
    if MPI.COMM_WORLD.rank == 1:
        raise ValueError("it is broken")
certify.certify = lambda *arguments, **options: (whole(*arguments, **options), fail())[0]
writing.write_fields = lambda *arguments: (fail(), fields(*arguments))
cli.main()
"""


def test_a_failure_on_one_rank(tmp_path: Path):
    """All ranks go on without the bound that one of them does not have, and end if one of them waits in vain."""
    (tmp_path / "failing.py").write_text(ONE_RANK)
    done = run(tmp_path, sys.executable, "failing.py", "solve", *SOLVE, ranks=2)
    assert done.returncode == 3, done.stderr
    assert done.stderr.count(f"failed: error bound: {BROKEN}; fields: {BROKEN}; free on the disk: ") == 1
    assert done.stderr.count("\n") == 1
    assert names(tmp_path / "x") == TABLES | {"summary.json"}


DROPPED = """
import gc
import signorini_fenicsx
import dolfinx.mesh
from mpi4py import MPI
from signorini_fenicsx import Diffusion, domain_of, solve
from signorini_fenicsx.extend import LaterFailure
from signorini_fenicsx.output.xdmf import Xdmf
def failing(*arguments):
    raise ValueError("it is broken")
Xdmf.write = failing
solution = solve(domain_of(dolfinx.mesh.create_unit_square(MPI.COMM_SELF, 2, 2), {}), Diffusion(f=1))
try:
    solution.write("x")
except LaterFailure as failure:
    print(failure)
del solution
gc.collect()
print("alive")
"""


def test_an_open_file_that_is_dropped(tmp_path: Path):
    """In Python a failure while a file for ParaView is open is an exception; the process lives on, and ends well."""
    done = subprocess.run([sys.executable, "-c", DROPPED], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[0].startswith(f"fields: {BROKEN}; the solution is in")
    assert done.stdout.splitlines()[1] == "alive"
    assert names(tmp_path / "x") >= TABLES
