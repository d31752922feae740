"""Elastic contact by case files and on the command line, and Hertz' formula."""

import json
from pathlib import Path

import adios2
import numpy as np
import pytest
from commands import read_rows, signorini
from elastic import box, half
from mpi4py import MPI

from signorini_fenicsx import Contact, Dirichlet, Elasticity, Neumann
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import quantities_of, solve_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.comparing.comparison import compare, differences
from signorini_fenicsx.discrete.mesh_spaces import NEUMANN
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.elasticity.case import ElasticCase
from signorini_fenicsx.physics.elasticity.show.differences import ElasticDifferences
from signorini_fenicsx.physics.elasticity.show.shown import in_space
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.pictures.gather import PARTLY_FIXED
from signorini_fenicsx.pictures.scene import gathered_scene
from signorini_fenicsx.solving.fields import von_mises
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD

CASE = """
title = "A block on a foundation"
physics = "elasticity"

[geometry]
shape = "square"
mesh = "structured"

[boundary]
contact = ["bottom"]
neumann = ["right"]
fixed = {left = "n"}

[problem]
young = 1
poisson = "0.3"
f = [0, -0.1]
u_D = [0, "-0.2*y^2"]
gap = "0.1 + 0.1*x^2"

[solve]
h = "1/4"
"""


def write_case(folder: Path, old: str = "", new: str = "") -> Path:
    """The case, with a part of its text replaced (collective)."""
    path = folder / "block.toml"
    if COMM.rank == 0:
        assert old in CASE
        path.write_text(CASE.replace(old, new) if old else CASE, encoding="utf-8")
    COMM.Barrier()
    return path


@pytest.mark.parallel([1, 3])
def test_solve_writes_what_one_needs(folder: Path):
    """All files are there; the table has the pressure of the solution, and the fields are those of ParaView."""
    done = signorini(folder, "solve", str(write_case(folder)), "--output", "out", "--plot")
    assert done.returncode == 0, done.stderr
    assert COMM.rank != 0 or "the vertex sets repeat" in done.stdout
    summary = json.loads((folder / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["physics"] == "elasticity"
    assert summary["converged"] is True
    assert summary["certificate"]["guaranteed"] is True
    assert np.abs(summary["resultants"]["sum"]).max() < 1e-12
    assert summary["resultants"]["bottom"][1] == pytest.approx(summary["norms"]["contact_force"], rel=1e-10)
    rows = read_rows(folder / "out" / "contact.csv")
    assert len(rows) == 2 * summary["contact_facets"]
    force = np.mean([float(row["pressure"]) for row in rows])  # facets of equal length on an edge of length 1
    assert force == pytest.approx(summary["norms"]["contact_force"], rel=1e-9)
    assert {row["condition"] for row in rows} == {"contact", "open"}
    for name in ("deformed.png", "displacement.png", "pressure.png", "history.csv", "solution.xdmf", "contact.bp"):
        assert (folder / "out" / name).exists(), name
    if COMM.rank == 0:
        with adios2.FileReader(str(folder / "out" / "solution.bp")) as file:
            assert {"sigma", "u", "equilibrium"} <= set(file.available_variables())
            stress = file.read("sigma").reshape(-1, 9)
            np.testing.assert_array_equal(stress[:, 1], stress[:, 3])
            np.testing.assert_allclose(stress[:, 8], 0.3 * (stress[:, 0] + stress[:, 4]), atol=1e-12)
            assert COMM.size > 1 or len(stress) == 9 * summary["cells"]


LAW = '[[law]]\nkind = "friction"\nparts = ["bottom"]\nmuu = 0.3'


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"elasticity"', '"magic"', "physics: unknown 'magic'; use \"elasticity\""),
        ("young = 1\n", "", "missing key 'young' in [problem]"),
        ("young = 1", "young = 0", "[problem] young: must be positive and finite everywhere"),
        ('"0.3"', '"1/2"', "[problem] poisson: must be above -1 and below 1/2; it is 0.5"),
        (
            "young = 1\n",
            "young = true\n",
            "[problem] young: must be an expression, a list of three, or a table",
        ),
        ("[0, -0.1]", "[0]", "[problem] f: has 1 components, not 2"),
        ("[0, -0.1]", "1", "[problem] f: must be a list with an expression for each component, such as"),
        ("[0, -0.1]", "[0, [1]]", "[problem] f: must be a list with an expression for each component"),
        ("u_D", "g_N = {right = 1}\nu_D", "[problem] g_N: must be a list with an expression for each component"),
        ('gap = "', 'gap = true # "', "[problem] gap: must be an expression, not true"),
        ("[0, -0.1]", '[0, "z"]', "[problem] f: "),
        ("u_D", "pressure = {right = [0, 1]}\nu_D", "[problem] pressure: must be an expression, not [0, 1]"),
        ('gap = "', 'gap = "log(x - 2)" # "', "[problem] gap: not finite everywhere on part 'bottom'"),
        ('fixed = {left = "n"}', 'fixed = {left = "q"}', "fixed: part 'left' has 'q'"),
        ('fixed = {left = "n"}', 'fixed = {right = "n"}', "'right' is listed twice"),
        ('fixed = {left = "n"}', 'fixed = {left = "z"}', "part 'left' is fixed in z, which there is only in space"),
        ("young = 1\n", "young = 1e300\n", "young: its largest value, 1.0e+300, is outside 1e-100"),
        ("[0, -0.1]", '[0, "1/(x - x)"]', "[problem] f: not finite everywhere in the domain near (0."),
        (
            'h = "1/4"',
            f'h = "1/4"\n{LAW}',
            "unknown key 'muu' of the law 'friction'; known are kind, parts, gap, surface, force, moment, behind, g",
        ),
        ('["bottom"]', '["floor"]', "contact: unknown part 'floor' of square"),
        ('h = "1/4"', 'h = "1/4"\nalgorithm = "vi"', "[solve] algorithm: elastic contact is solved by alg1 or alg2"),
        ('h = "1/4"', 'h = "1/4"\neps = 1e-3', "[solve] eps: elastic contact has no such key"),
        ("u_D", "g_N = {top = [0, 1]}\nu_D", "g_N: part 'top' takes no traction, as it is not in neumann"),
        ("gap", "gip", "unknown key 'gip' in [problem]"),
        ("young", "yuong", "unknown key 'yuong' in [problem]; known are young, poisson, f"),
        ('physics = "elasticity"', "", "'young' is of elasticity, which needs physics = \"elasticity\""),
        ('h = "1/4"', 'h = "1/4"\n[time]\nend = 1', "missing key 'steps' in [time]"),
        ('neumann = ["right"]', 'neumann = ["right", "top"]', "the body can move rigidly"),
    ],
)
def test_bad_cases(tmp_path: Path, old: str, new: str, message: str):
    """One sentence, status 2."""
    if "rigidly" in message:
        new += "\n"
        old, new = old + '\nfixed = {left = "n"}', new + 'fixed = {left = "n"}'
    path = write_case(tmp_path, old, new)
    if "rigidly" in message:
        path.write_text(path.read_text(encoding="utf-8").replace("-0.1]", "0.1]"), encoding="utf-8")
    done = signorini(tmp_path, "solve", str(path))
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1


def test_von_mises_and_table():
    """A uniform compression in plane strain: σ_yy = −q, σ_zz = −νq."""
    solution = solve(box(COMM, 2, [0.0, 0.0], [1.0, 1.0]), half("0", -0.1))
    stresses = in_space(solution.spaces, solution.data, solution.stresses)
    np.testing.assert_allclose(von_mises(stresses), 0.1 * np.sqrt(1 - 0.3 + 0.3**2), rtol=1e-10)
    table = solution.table().gathered(COMM)
    assert table is not None
    np.testing.assert_allclose(table.pressure, 0.1)
    np.testing.assert_allclose(table.x[:, 0], [0, 0.5, 0.5, 1])
    assert table.touching.all()


def test_pictures_tell_fixed_parts_from_loaded_ones():
    """A plane of symmetry is not drawn as Γ_N."""
    problem = Elasticity(
        1.0,
        0.3,
        u_D=["0", "-0.1"],
        conditions=[Contact("y0"), Dirichlet("x0", ["0", "-0.1"], components="n"), Neumann("x1", 0)],
    )
    body = gathered_scene(solve(box(COMM, 2, [0.0, 0.0], [1.0, 1.0]), problem))
    assert body is not None
    middle = body.fields.points[body.boundary.vertices].mean(axis=1)
    for kind, x in ((PARTLY_FIXED, 0.0), (NEUMANN, 1.0)):
        assert (middle[body.boundary.kind == kind, 0] == x).tolist() == [True, True]


@pytest.mark.parallel([1, 2])
def test_commands_take_elastic_cases(folder: Path):
    """Inspection agrees with the mesh; refined meshes and levels have smaller errors."""
    path = str(write_case(folder))
    info, check = (signorini(folder, command, path) for command in ("info", "check"))
    assert (info.returncode, check.returncode) == (0, 0)
    assert COMM.rank != 0 or "part       left: fixed" in info.stdout
    assert COMM.rank != 0 or "72 cells; facets: 6 on Γ_C, 12 on Γ_N, 6 on Γ_D" in check.stdout
    adapt = ["--h", "1/2", "--max-cells", "100", "--plot", "--output", "a"]
    assert signorini(folder, "adapt", path, *adapt).returncode == 0
    rows = read_rows(folder / "a" / "adapt.csv")
    assert float(rows[-1]["bound"]) < 0.6 * float(rows[0]["bound"])
    for name in ("adapt.png", "mesh.png", "certificate.png", "deformed.png"):
        assert (folder / "a" / name).stat().st_size > 10_000, name
    done = signorini(folder, "convergence", path, "--levels", "1:2", "--reference", "3", "--output", "c")
    assert done.returncode == 0, done.stderr
    (coarse, fine) = read_rows(folder / "c" / "convergence.csv")
    assert coarse["energy_order"] == ""
    assert all(float(fine[f"{name}_order"]) > 1.2 for name in ("energy", "u_L2"))
    assert all(float(fine[name]) < float(coarse[name]) for name in ("pressure_L2", "gap_L2"))


def test_scalar_options_are_refused(tmp_path: Path):
    """A penalty, which elastic contact does not have, and a start of another physics."""
    path = str(write_case(tmp_path))
    done = signorini(tmp_path, "convergence", path, "--vary", "eps")
    assert (done.returncode, "alg1 has no ε" in done.stderr) == (2, True)
    case = load_case(path)
    assert isinstance(case, ElasticCase)
    with pytest.raises(InputError, match="start: example1 is of another physics"):
        solve_case(case, start=solve_case(load_case("example1").with_values({"solve.h": 0.5})))


def test_energy_difference_is_that_of_the_energies():
    """Without sets that change, ‖σ_fine − σ_coarse‖ by quadrature is what Galerkin's orthogonality gives."""
    u_D = ["0.1*y*x", "-0.2 + x*y^2"]
    problem = Elasticity("1 + x", 0.3, u_D=u_D, conditions=[Contact("x1", 10.0)])
    coarse, fine = (solve(box(COMM, n, [0.0, 0.0], [1.0, 1.0]), problem) for n in (2, 4))
    found = differences(coarse, fine)
    assert isinstance(found, ElasticDifferences)
    one, other = (solution.norms()["energy"] for solution in (coarse, fine))
    assert found.energy == pytest.approx(np.sqrt(abs(one**2 - other**2)), rel=0.05)
    assert compare(coarse, fine).relative["energy"] == pytest.approx(found.energy / other)
    assert differences(fine, fine).energy == 0.0


@pytest.mark.parallel([1, 3])
def test_saved_solutions(folder: Path):
    """Other ranks read the same; compare, export and a start from it need no solve; damage is told."""
    law = 'law = [{kind = "friction", parts = ["bottom"], mu = 0.2}]\n[geometry]'
    path = write_case(folder, "[geometry]", law)
    assert signorini(folder, "solve", str(path), "--h", "1/3", "--output", "a").returncode == 0
    done = signorini(folder, "solve", str(path), "--output", "b", "--start-from", "a")
    assert done.returncode == 0, done.stderr
    read, alone = load_solution(folder / "b", COMM), load_solution(folder / "b", MPI.COMM_SELF)
    assert isinstance(read, ElasticSolution)
    assert isinstance(alone, ElasticSolution)
    assert read.norms() == pytest.approx(alone.norms(), rel=1e-12)
    for state, found in read.friction_states().items():
        assert found == pytest.approx(alone.friction_states()[state])
    assert read.bound_changes == alone.bound_changes != ()
    saved = json.loads((folder / "b" / "summary.json").read_text(encoding="utf-8"))
    assert read.norms() == pytest.approx(saved["norms"], rel=1e-10)
    assert certify(read).bound == pytest.approx(saved["certificate"]["bound"], rel=1e-6)
    done = signorini(folder, "compare", "a", "b", "--json")
    assert done.returncode == 0, done.stderr
    if COMM.rank == 0:
        assert 0 < json.loads(done.stdout)["relative"]["energy"] < 0.2
    done = signorini(folder, "export", "b", "--output", "c", "--plot")
    assert done.returncode == 0, done.stderr
    assert (folder / "c" / "pressure.png").exists()
    again = json.loads((folder / "c" / "summary.json").read_text(encoding="utf-8"))
    assert again["friction"]["stick"] == pytest.approx(saved["friction"]["stick"])
    if COMM.rank == 0:
        stresses = np.load(folder / "b" / "checkpoint" / "sigma.npy")
        np.save(folder / "b" / "checkpoint" / "sigma.npy", 1.001 * stresses)
    COMM.Barrier()
    with pytest.raises(InputError, match="is damaged: its KKT residual"):
        load_solution(folder / "b", COMM)


@pytest.mark.parametrize(("name", "kind"), [("example1", Case), ("hertz", ElasticCase)])
def test_a_run_reads_and_sorts_its_problem_once(name: str, kind: type, monkeypatch: pytest.MonkeyPatch):
    """Also where it is measured: the texts of a case are not read again by checks, the bound and quantities."""
    case = load_case(name).with_values({"solve.h": 0.5, "quantity": [{"name": "mean", "kind": "energy"}]})
    posed, made = kind.posed, list[object]()
    monkeypatch.setattr(kind, "posed", lambda *given: made.append(posed(*given)) or made[-1])
    solution = solve_case(case, COMM)
    assert certify(solution).guaranteed
    assert quantities_of(solution)["mean"].guaranteed
    assert len(made) == 1
