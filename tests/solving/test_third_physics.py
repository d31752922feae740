"""A physics that the package does not know: a folder and a name, and it has case files, steps, quantities, pictures."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from commands import read_rows
from in_time import run, run_in_two
from mpi4py import MPI
from springs import Springs
from springs.solving import Bed, Edges

from signorini_fenicsx import InputError, certify, compare, load_solution, solve
from signorini_fenicsx.cases.case import case_of
from signorini_fenicsx.cases.first_case import Place, case_text
from signorini_fenicsx.cli.solution_report import SolutionReport
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.output.checkpoint_file import FOLDER
from signorini_fenicsx.output.writing import Found
from signorini_fenicsx.quantities import Energy, Flux
from signorini_fenicsx.solving.physics import PHYSICS

COMM = MPI.COMM_WORLD


@pytest.mark.parallel(2)
def test_a_folder_and_a_name(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """It is solved, measured, written, drawn, read again, compared and reported; no bound is known, which is said."""
    domain = build_domain(COMM, "square", 0.3, mesh="structured")
    with pytest.raises(InputError, match="must be a Diffusion, an Elasticity or a Stokes, not Bed"):
        solve(domain, Bed(2.0, -1.0, Edges(["bottom"])))
    monkeypatch.setitem(PHYSICS, "springs", Springs())
    solution = solve(domain, Bed(2.0, -1.0, Edges(["bottom"])), name="bed")
    certificate = certify(solution)
    assert certificate.if_none == "none is known for springs"
    solution.write(folder / "bed", certificate=certificate, plot=True)
    files = {path.name for path in (folder / "bed").iterdir()}
    assert {"solution.bp", "rests.bp", "solution.xdmf", "facets.csv", "bed.png", "summary.json"} <= files
    summary = json.loads((folder / "bed" / "summary.json").read_text(encoding="utf-8"))
    facets = solution.contact.facets
    assert summary["contact_facets"] == facets > 0
    read = load_solution(folder / "bed", COMM)
    assert read.problem == solution.problem
    assert compare(solution, read).relative == {"u_L2": 0.0}
    energy = read.quantity(Energy())
    free = 1 - facets * solution.spaces.cell_measures[0]
    assert energy.guaranteed
    assert energy.lower == pytest.approx(-free / 4)
    with pytest.raises(InputError, match="Flux: a bed has Integral and Energy"):
        read.quantity(Flux("bottom"))
    SolutionReport().solution(solution, Found(certificate=certificate))
    told = capsys.readouterr().out
    if COMM.rank == 0:
        assert f"{facets} Γ_R facets" in told
        assert "no error bound: none is known for springs" in told
    with pytest.raises(InputError, match="is the solution of a problem of Springs, not of str"):
        load_solution(folder / "bed", COMM, problem="another")
    COMM.Barrier()
    if COMM.rank == 0:
        place = folder / "bed" / FOLDER / "u.npy"
        np.save(place, np.load(place) + 1)
    COMM.Barrier()
    with pytest.raises(InputError, match="is damaged: its KKT residual balance"):
        load_solution(folder / "bed", COMM)
    in_time(folder)


def in_time(folder: Path) -> None:
    """Its first case, with [time] and a quantity, is run, drawn, ended, gone on with and read."""
    text = case_text("a bed", Place.of("square", folder), "springs", {"bottom": "rests"})
    more = {"time.end": 3, "time.steps": 3, "quantity": [{"name": "mean", "kind": "mean"}], "solve.h": 0.3}
    case = case_of(tomllib.loads(text), Path("settling.toml")).with_values(more)
    run(case, folder / "whole", plot=True)
    run_in_two(case, folder / "two", 2)
    last = load_solution(folder / "two", COMM)
    assert last.step == 3
    assert float(last.u.x.array.min()) == pytest.approx(-3.0)  # f = −1, −2, −3 are added, and k = 2
    whole, two = (read_rows(folder / name / "steps.csv") for name in ("whole", "two"))
    assert [row["quantities.mean.lower"] for row in whole] == [row["quantities.mean.lower"] for row in two]
    assert {"settling.png", "quantities.png", "solution.bp"} <= {path.name for path in (folder / "whole").iterdir()}
