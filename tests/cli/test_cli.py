"""The command line as a user types it, serial and under mpirun."""

import json
import math
import sys
from pathlib import Path
from typing import Any

import adios2
import h5py  # noqa: F401 - meshio reads XDMF heavy data with it
import meshio
import numpy as np
import pytest
import pyvista
from commands import launched, read_rows, run, signorini
from made_cases import petsc_options
from mpi4py import MPI

from signorini_fenicsx import load_solution
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import refuse_lone_copies


@pytest.mark.parallel(2)
def test_all_files(folder: Path):
    """What is in the files of a run on two ranks agrees; they are read on one of them."""
    done = signorini(folder, "solve", "example2", "--h", "1/8")
    assert done.returncode == 0, done.stderr
    assert "the facet sets repeat" in done.stdout
    assert done.stderr == ""
    if MPI.COMM_WORLD.rank == 0:
        found = folder / "results" / "example2"
        summary = check_summary(found)
        check_tables(found, summary)
        check_fields_for_paraview(found, summary)
    MPI.COMM_WORLD.Barrier()


def check_summary(found: Path) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((found / "summary.json").read_text())
    assert (summary["converged"], summary["ranks"]) == (True, 2)
    assert summary["command"].endswith("signorini solve example2 --h 1/8")
    assert set(summary["kkt"]) == {"primal", "dual", "complementarity", "stationarity", "mass_balance"}
    assert summary["certificate"]["guaranteed"] is True
    assert summary["certificate"]["relative"] < 0.25
    assert {"case", "algorithm", "backend", "cells", "dofs", "contact_facets", "iterations"} <= set(summary)
    assert {"timings", "versions", "reason", "contact_measure", "h"} <= set(summary)
    return summary


def check_tables(found: Path, summary: dict[str, Any]) -> None:
    rows = read_rows(found / "facets.csv")
    assert list(rows[0]) == ["part", "x", "y", "z", "measure", "p", "flux", "condition"]
    assert [row["part"] for row in rows] == sorted((row["part"] for row in rows), key=["bottom", "left"].index)
    bottom = [float(row["x"]) for row in rows if row["part"] == "bottom"]
    assert bottom == sorted(bottom)
    assert math.fsum(float(row["measure"]) for row in rows) == pytest.approx(4)
    assert sum(row["condition"] == "zero_trace" for row in rows) == summary["contact_facets"]
    history = read_rows(found / "history.csv")
    assert len(history) == summary["iterations"]
    assert all(int(row["no_flux"]) + int(row["zero_trace"]) == len(rows) for row in history)


def blocks(path: Path, name: str) -> np.ndarray:
    """All blocks of a variable of a VTX file, one after another."""
    with adios2.FileReader(str(path)) as reader:
        variable = reader.inquire_variable(name)
        count = len(reader.engine.blocks_info(name, 0))
        return np.concatenate([_read_block(reader, variable, block) for block in range(count)])


def _read_block(reader: adios2.FileReader, variable: adios2.Variable, block: int) -> np.ndarray:
    return np.asarray(reader.read(variable, block_id=block))


def check_fields_for_paraview(found: Path, summary: dict[str, Any]) -> None:
    """The values in .bp and .xdmf have the norms of the summary."""
    mesh = meshio.read(found / "solution.xdmf")
    corners = mesh.points[mesh.cells_dict["triangle"]]
    edges = corners[:, 1:, :2] - corners[:, :1, :2]
    area = np.abs(np.linalg.det(edges)) / 2
    u, sigma = mesh.cell_data["u"][0].ravel(), mesh.cell_data["sigma"][0]
    assert len(u) == summary["cells"]
    gap, oscillation = summary["certificate"]["gap"], summary["certificate"]["oscillation"]
    assert np.sum(mesh.cell_data["indicator"][0] ** 2) == pytest.approx(2 * gap + oscillation**2, rel=1e-10)
    assert np.sqrt(area @ u**2) == pytest.approx(summary["norms"]["u_L2"], rel=1e-10)
    np.testing.assert_allclose(mesh.cell_data["sigma_norm"][0].ravel(), np.linalg.norm(sigma, axis=1), atol=1e-12)

    in_vtk = pyvista.read(found / "solution.xdmf")
    np.testing.assert_allclose(in_vtk.points[:, :2], mesh.points[:, :2], atol=1e-6)  # VTK reads single precision
    for name in ("u", "sigma", "sigma_norm", "indicator"):
        np.testing.assert_allclose(in_vtk.cell_data[name].ravel(), mesh.cell_data[name][0].ravel(), 1e-6, 1e-12)

    # DG1 has three nodes per cell; ∫|σ|² of a linear field is |T|/12 (Σ|σ_i|² + |Σσ_i|²).
    points, vtx_u, vtx_sigma = (blocks(found / "solution.bp", name) for name in ("geometry", "u", "sigma"))
    corners = points.reshape(-1, 3, 3)
    edges = corners[:, 1:, :2] - corners[:, :1, :2]
    area = np.abs(np.linalg.det(edges)) / 2
    cell_sigma = vtx_sigma.reshape(-1, 3, 3)
    squares = (cell_sigma**2).sum(axis=(1, 2)) + (cell_sigma.sum(axis=1) ** 2).sum(axis=1)
    assert np.sqrt(area @ squares / 12) == pytest.approx(summary["norms"]["sigma_L2"], rel=1e-10)

    in_vertices = load_solution(found, MPI.COMM_SELF).potential.x.array.reshape(-1, 6)[:, :3]
    np.testing.assert_allclose(np.sort(vtx_u.ravel()), np.sort(in_vertices.ravel()), atol=1e-12)
    near = np.linalg.norm(points[:, None, :2] - mesh.points[:, :2], axis=2) < 1e-9
    np.testing.assert_allclose(mesh.point_data["u"], (near.T @ vtx_u).ravel() / near.sum(axis=0), atol=1e-12)

    rows = read_rows(found / "facets.csv")
    for name in ("p", "flux"):
        written = blocks(found / "multiplier.bp", name).ravel()
        np.testing.assert_allclose(np.sort(written), np.sort([float(row[name]) for row in rows]), atol=1e-12)


def test_copies_of_another_mpirun_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Separate copies would overwrite each other's results; a single task of a launcher is accepted."""
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    done = launched(tmp_path, "solve", "example1", "--h", "1/4")
    assert done.returncode == 2, done.stderr
    assert "OMPI_COMM_WORLD_SIZE = 2 says that this is one of 2 processes" in done.stderr
    assert list(tmp_path.iterdir()) == []
    for name, value in [("OMPI_COMM_WORLD_SIZE", "1"), ("SLURM_STEP_NUM_TASKS", "4"), ("SLURM_NTASKS", "4")]:
        monkeypatch.setenv(name, value)  # an allocation of four, and in it a launcher with one task
    refuse_lone_copies(MPI.COMM_WORLD)
    monkeypatch.delenv("OMPI_COMM_WORLD_SIZE")
    with pytest.raises(InputError, match="SLURM_STEP_NUM_TASKS = 4"):
        refuse_lone_copies(MPI.COMM_WORLD)


def test_a_mesh_without_a_free_vertex_on_the_contact_part(tmp_path: Path):
    done = signorini(tmp_path, "solve", "example1", "--h", "2^0.5", "--algorithm", "uzawa")
    assert done.returncode == 0, done.stderr


def test_an_iteration_that_diverges(tmp_path: Path):
    """The range of ρ in which it converges is told."""
    done = signorini(tmp_path, "solve", "example1", "--h", "1/4", "--algorithm", "mixed-uzawa2", "--rho", "10")
    assert done.returncode == 1
    assert "the iteration diverges; ρ = 10 is outside of its range (0, 0.1" in done.stderr


@pytest.mark.parallel(2)
def test_failed_run_keeps_its_state_and_earlier_results(folder: Path):
    good = signorini(folder, "solve", "example1", "--h", "1/4")
    assert good.returncode == 0, good.stderr
    before = (folder / "results" / "example1" / "summary.json").read_text()
    bad = signorini(folder, "solve", "example1", "--h", "1/8", "--set", "solve.max_iterations=1")
    assert bad.returncode == 1
    assert bad.stderr.count("facets still change after 1 iteration") == 1
    assert (folder / "results" / "example1" / "summary.json").read_text() == before
    failed = json.loads((folder / "results" / "example1.failed" / "summary.json").read_text())
    assert failed["converged"] is False
    assert "facets still change" in failed["reason"]
    assert sorted(path.name for path in (folder / "results").iterdir()) == ["example1", "example1.failed"]


def test_rerun_replaces_results_and_keeps_foreign_files(tmp_path: Path):
    results, again = tmp_path / "mine", ("solve", "example1", "--h", "1/2", "--output", "mine")
    assert signorini(tmp_path, *again, "--set", 'probe=[{name="a", points=[0.5, 0.5]}]').returncode == 0
    assert (results / "probes.csv").exists()
    (results / "notes.txt").write_text("mine")
    assert signorini(tmp_path, *again).returncode == 0
    assert (results / "notes.txt").read_text() == "mine"
    assert not (results / "probes.csv").exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine"]


def test_an_unexpected_error_on_one_rank_ends_all(tmp_path: Path):
    """No rank waits forever in a collective call, and the traceback is printed."""
    script = tmp_path / "broken.py"
    script.write_text(
        "import sys\n"
        "from mpi4py import MPI\n"
        "from signorini_fenicsx.cli import main as cli\n"
        "from signorini_fenicsx.solving import solver\n"
        "def broken(*arguments, **options):\n"
        "    if MPI.COMM_WORLD.rank == 1:\n"
        "        raise RuntimeError('broken on purpose')\n"
        "    MPI.COMM_WORLD.Barrier()\n"
        "solver.Solver.solve = broken\n"
        "sys.argv = ['signorini', 'solve', 'example1', '--h', '1/4']\n"
        "cli.main()\n"
    )
    done = run(tmp_path, sys.executable, str(script), ranks=2)
    assert done.returncode != 0
    assert "broken on purpose" in done.stderr


def test_markup_in_names_is_text(tmp_path: Path):
    arguments = ["--h", "1/4", "--set", "title=A [/] [red] x", "--output", "res[/x]"]
    done = signorini(tmp_path, "solve", "example1", *arguments)
    assert done.returncode == 0, done.stderr
    assert "A [/] [red] x" in done.stdout
    assert (tmp_path / "res[/x]" / "summary.json").exists()


def test_lists_can_be_set(tmp_path: Path):
    done = signorini(tmp_path, "solve", "example1", "--h", "1/4", "--set", 'boundary.signorini=["left"]')
    assert done.returncode == 0, done.stderr
    assert {row["part"] for row in read_rows(tmp_path / "results" / "example1" / "facets.csv")} == {"left"}


def test_state_with_nan_is_kept(tmp_path: Path):
    """After a solver has diverged its state is kept, with null for numbers that are not finite."""
    with petsc_options(snes_type="nrichardson", snes_max_it="2000", snes_linesearch_type="basic"):
        done = signorini(tmp_path, "solve", "example4", "--h", "1/8", "--algorithm", "snes1")
    assert done.returncode == 1
    failed = json.loads((tmp_path / "results" / "example4.failed" / "summary.json").read_text())
    assert failed["converged"] is False


ON_DEMAND = [pytest.param(name, marks=pytest.mark.slow) for name in ("alg3", "snes1", "vi")]


@pytest.mark.parametrize("algorithm", ["alg1", "snes2", *ON_DEMAND])
def test_no_load(tmp_path: Path, algorithm: str):
    done = signorini(tmp_path, "solve", "example1", "--h", "1/4", "--algorithm", algorithm, "--set", "problem.f=0")
    assert done.returncode == 0, done.stderr


def test_petsc_options_reach_petsc(tmp_path: Path):
    done = launched(tmp_path, "solve", "example1", "--h", "1/4", "--", "-ksp_view", "-mat_mumps_icntl_14", "50")
    assert done.returncode == 0
    assert "KSP Object" in done.stdout
    with petsc_options(ksp_type="gmres", pc_type="none", ksp_max_it="2"):
        done = signorini(tmp_path, "solve", "example1", "--h", "1/8", "--output", "b")
    assert done.returncode == 1
    assert "linear solver gmres+none stopped" in done.stderr


def test_convergence(folder: Path):
    done = signorini(folder, "convergence", "example1", "--levels", "2:3", "--reference", "4")
    assert done.returncode == 0, done.stderr
    rows = read_rows(folder / "results" / "example1-convergence" / "convergence.csv")
    assert [row["level"] for row in rows] == ["2", "3"]
    assert float(rows[0]["slides_sigma_V"]) == 1.65
    for name in ("sigma_V", "u_Q", "p_Lambda"):
        assert 0.9 < float(rows[1][f"{name}_order"]) < 1.4
    table = (folder / "results" / "example1-convergence" / "convergence.tex").read_text()
    first, second = (line.split(" & ") for line in table.splitlines()[4:6])
    assert table.splitlines()[2].startswith(r"$h$ & cells & iterations & $\|\sigma-\sigma_h\|_V$ & order &")
    assert first[1:3] == [rows[0]["cells"], rows[0]["iterations"]]
    assert second[4] == f"{float(rows[1]['sigma_V_order']):.2f}"
    assert (folder / "results" / "example1-convergence" / "convergence.png").stat().st_size > 10_000


@pytest.mark.parallel(2)
def test_methods_are_listed(folder: Path):
    done = signorini(folder, "methods")
    assert done.returncode == 0, done.stderr
    names = [line.split()[0] for line in done.stdout.splitlines()]
    assert names == list(dict.fromkeys(names))
    assert {"alg1", "vi", "uzawa", "mixed-uzawa-h12", "qp"} <= set(names)
    assert all("(19" in line or "(20" in line or "slides" in line for line in done.stdout.splitlines())
