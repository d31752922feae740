"""A physics that the package does not know: a folder and a name, and all services have it."""

import json
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from springs import Springs
from springs.solving import Bed

from signorini_fenicsx import certify, compare, load_solution, solve
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cli.solution_report import SolutionReport
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.output.checkpoint_file import FOLDER
from signorini_fenicsx.output.writing import Found
from signorini_fenicsx.solving.physics import PHYSICS

COMM = MPI.COMM_WORLD


@pytest.mark.parallel(2)
def test_a_folder_and_a_name(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """It is solved, written, drawn, read again, compared and reported; there is no bound, which is said."""
    domain = build_domain(COMM, "square", 0.3, mesh="structured")
    with pytest.raises(InputError, match="must be a Diffusion or an Elasticity, not Edges"):
        solve(domain, Bed(2.0, -1.0, ["bottom"]))
    monkeypatch.setitem(PHYSICS, "springs", Springs())
    solution = solve(domain, Bed(2.0, -1.0, ["bottom"]), name="bed")
    certificate = certify(solution)
    assert certificate.if_none == "none is known for springs"
    solution.write(folder / "bed", certificate=certificate, plot=True)
    files = {path.name for path in (folder / "bed").iterdir()}
    assert {"solution.bp", "rests.bp", "solution.xdmf", "facets.csv", "overview.png", "summary.json"} <= files
    summary = json.loads((folder / "bed" / "summary.json").read_text(encoding="utf-8"))
    facets = solution.contact.facets
    assert summary["contact_facets"] == facets > 0
    read = load_solution(folder / "bed", COMM)
    assert read.problem == solution.problem
    assert compare(solution, read).relative == {"u_L2": 0.0}
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
