"""Sets predicted on coarser meshes and by solves that stop early: fewer steps, the same result."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from signorini_fenicsx import Domain, load_case, solve_case
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.domains import mesh_case

COMM = MPI.COMM_WORLD
ALWAYS = Tuning(direct_up_to=0, predict_from=0, coarsen_from=1000)


@pytest.mark.parallel(2)
def test_prediction_changes_the_number_of_steps_only():
    """A start from the sets of a coarser mesh gives the sets and fields of a cold start, in fewer steps."""
    for name, algorithm in (("example2", "alg1"), ("example5", "alg4")):
        case = load_case(name).with_values({"solve.h": 1 / 16, "solve.algorithm": algorithm})
        cold = solve_case(case.with_values({"solve.predict": False}), COMM)
        warm = solve_case(case, COMM, tuning=Tuning(predict_from=100, coarsen_from=100))
        np.testing.assert_array_equal(cold.outcome.conditions.kind, warm.outcome.conditions.kind)
        for one, two in [(cold.sigma, warm.sigma), (cold.u, warm.u), (cold.p, warm.p)]:
            np.testing.assert_allclose(one.x.array, two.x.array, atol=1e-9)
        assert len(warm.outcome.history) - warm.outcome.rough_steps <= min(3, len(cold.outcome.history))


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("element", ["RT0", "RT1"])
def test_few_solves_at_any_size(element: str):
    """At most two solves with a coarser mesh, three without, where p and σ·n vanish together at the contact's edge."""
    tuning = replace(ALWAYS, patch_share=1.0)  # as on large meshes
    sizes = {"transition": (1 / 16, 1 / 32), "transition3d": (0.2, 0.15)}
    for (name, hs), most in zip(sizes.items(), (3, 4), strict=True):
        for h in hs[: 1 if element == "RT1" else 3 - COMM.size]:
            case = load_case(name).with_values({"geometry.mesh": "structured", "solve.h": h, "solve.element": element})
            solution = solve_case(case, COMM, tuning=tuning)
            assert "prediction" in solution.timings
            assert len(solution.outcome.history) < most  # the start has no row
            assert 0 < max(step.linear_iterations for step in solution.outcome.history) <= 18


SHEET = """
Point(1) = {0, 0, 0}; Point(2) = {1, 0, 0}; Point(3) = {1, 1, 0}; Point(4) = {0, 1, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1}; Mesh.MeshSizeMax = 0.12;
Physical Curve("bottom") = {1}; Physical Curve("rest") = {2, 3, 4}; Physical Surface("sheet") = {1};
"""


@pytest.mark.parallel([1, 2])
def test_meshes_of_an_own_geometry_are_coarser(folder: Path, monkeypatch):
    """Where a geometry has its own sizes, the meshes of a prediction are coarser than these, not than a default h."""
    if COMM.rank == 0:
        (folder / "sheet.geo").write_text(SHEET)
        (folder / "sheet.toml").write_text(
            '[geometry]\nfile = "sheet.geo"\n[boundary]\nsignorini = ["bottom"]\n[problem]\nf = "20*(x - 0.5)"\n'
        )
    COMM.barrier()
    made: list[int] = []

    def counted(*given: Any) -> Domain:
        domain = mesh_case(*given)
        made.append(domain.cells)
        return domain

    monkeypatch.setattr("signorini_fenicsx.cases.solving.mesh_case", counted)
    sizes = Tuning(predict_from=1, coarsen_from=100)
    assert solve_case(load_case(folder / "sheet.toml"), COMM, tuning=sizes, mesh=counted).converged
    assert len(made) == 2  # that of the problem and one for its prediction
    assert 4 * made[1] <= made[0]
