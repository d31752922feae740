"""A few seeds of `scripts/random_runs.py problems`, and objects that a launch of many runs might leave behind."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from commands import run
from makers.quantities import of_random
from makers.scalar import examine, random_problem

from signorini_fenicsx.solving.solver import solve

MANY_RUNS = """
from mpi4py import MPI
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.base.parallel import collect_garbage
from signorini_fenicsx.cases.solving import solve_case
from petsc4py import PETSc
PETSc.Log.begin()
for _ in range(3):
    solve_case(load_case("example1").with_values({"solve.h": 0.25, "solve.algorithm": "vi"}))
    collect_garbage(MPI.COMM_WORLD)
PETSc.Log.view()
"""


@pytest.mark.parametrize("seed", [*range(3), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 12))])
def test_random_problem(seed: int):
    result = examine(seed)
    assert result.good, result


def test_rounding_in_the_facet_system():
    """κ from 1 to 5e5 on bad cells: the flux of the facet system is too inaccurate, that of the saddle point is not."""
    result = examine(65)
    assert result.good, result
    words = "by the saddle point, because the facet system left KKT residuals above 1e-08: "
    assert f"{words}stationarity" in result.ending
    domain, problem, options, _ = random_problem(65)
    solution = solve(domain, replace(problem, obstacle=-0.01), options)
    assert words in solution.outcome.reason


def test_snesvi_leaves_nothing_behind(tmp_path: Path):
    """On two ranks all vectors are freed, in any phase, and with the last one the communicator of the mesh."""
    done = run(tmp_path, sys.executable, "-c", MANY_RUNS, ranks=2)
    assert done.returncode == 0, done.stderr
    rows = [line.split() for line in done.stdout.splitlines() if line.split()[:1] == ["Vector"]]
    made, freed = (sum(int(row[column]) for row in rows) for column in (1, 2))
    assert made == freed > 0


def test_a_body_that_is_refused():
    """Nothing is told beside the count, as where a mesh is freed while an error is on its way."""
    (found,) = of_random(41202, body=True)
    assert found.counts == ["not guaranteed"]
