"""Solutions that are written and read on another number of ranks, and runs that start from them."""

import json
from pathlib import Path

import numpy as np
import pytest
from commands import signorini
from made_cases import case_of
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import shared_domain, solve_case
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.output.writing import write_solution
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.pictures.scene import Scene, gathered_scene

COMM = MPI.COMM_WORLD

CUBE = {"geometry.shape": "cube", "boundary.signorini": ["bottom", "left"], "problem.f": "40*(x - 0.5)", "solve.h": 0.5}


def kept(case: Case, comm: MPI.Comm, folder: Path) -> Solution:
    """Solve and write on some ranks."""
    solution = solve_case(case, comm)
    write_solution(solution, folder, fields=False)
    comm.Barrier()
    return solution


@pytest.mark.parallel([2, 3])
def test_read_on_any_number_of_ranks(folder: Path):
    """One rank reads what all ranks write, and the reverse: equal up to rounding and with the same residuals."""
    for name, values in [
        ("example2", {"solve.algorithm": "alg1"}),
        ("example1", CUBE | {"solve.algorithm": "alg4", "solve.eps": 0.5}),
    ]:
        case = load_case(name).with_values({"solve.h": 2**-3} | values)
        together, alone = folder / "all", folder / str(COMM.rank)
        for original, read in [
            (kept(case, COMM, together), load_solution(together, MPI.COMM_SELF)),
            (kept(case, MPI.COMM_SELF, alone), load_solution(COMM.bcast(alone), COMM)),
        ]:
            assert case_of(read) == case_of(original)
            assert len(read.outcome.history) == len(original.outcome.history)
            assert read.norms() == pytest.approx(original.norms(), rel=1e-12)
            assert read.contact == pytest.approx(original.contact, rel=1e-12)
            assert max(vars(read.kkt).values()) < 1e-11
            mine, theirs = gathered_scene(read), gathered_scene(original)
            if mine is not None and theirs is not None:
                for one, other in zip(_arrays(mine), _arrays(theirs), strict=True):
                    np.testing.assert_allclose(one, other, atol=1e-12)
            COMM.Barrier()


def _arrays(scene: Scene) -> list[np.ndarray]:
    """All arrays of a scene."""
    fields = [scene.fields.points, *scene.fields.at_points.values(), *scene.fields.in_cells.values()]
    return [*fields, *vars(scene.facets).values(), *vars(scene.sites).values()]


@pytest.mark.parallel([1, 2])
def test_start_from_another_solution(folder: Path):
    """A start from the solution takes one step, one from a coarser solution fewer than a cold start; same result."""
    cold_case = load_case("example2").with_values({"solve.h": 2**-4, "solve.predict": False})
    cold = solve_case(cold_case, COMM)
    kept(cold_case.with_values({"solve.h": 2**-3}), COMM, folder)
    start = load_solution(folder, COMM)
    assert shared_domain(start, cold_case) is None
    for algorithm in ("alg1", "alg2", "alg3", "alg4"):
        case = cold_case.with_values({"solve.algorithm": algorithm, "solve.eps": 1e-10})
        warm = solve_case(case, COMM, domain=cold.spaces.domain, start=start)
        assert len(warm.outcome.history) <= 2 < len(cold.outcome.history)
        assert warm.contact == cold.contact
        assert warm.norms() == pytest.approx(cold.norms(), rel=1e-8)
    same = solve_case(case_of(start), COMM, domain=shared_domain(start, case_of(start)), start=start)
    assert same.spaces.domain is start.spaces.domain
    assert [step.changed for step in same.outcome.history] == [0]
    assert same.norms() == pytest.approx(start.norms(), rel=1e-12)
    with pytest.raises(InputError, match="'lshape', not on 'square'"):
        solve_case(load_case("example1").with_values({"solve.h": 0.25}), COMM, start=start)
    with pytest.raises(InputError, match="no facet sets to start from"):
        solve_case(cold_case.with_values({"solve.algorithm": "vi", "solve.h": 0.25}), COMM, start=start)


@pytest.mark.parallel(2)
def test_a_failed_run_is_continued_and_exported(folder: Path):
    few = ["solve", "example2", "--h", "1/16", "--output", "r", "--set", "solve.predict=false"]
    assert signorini(folder, *few, "--set", "solve.max_iterations=1").returncode == 1
    done = signorini(folder, *few, "--start-from", "r.failed")
    assert done.returncode == 0, done.stderr
    summary = json.loads((folder / "r" / "summary.json").read_text())
    assert summary["iterations"] == 3
    done = signorini(folder, "export", "r", "--output", "out")
    assert done.returncode == 0, done.stderr
    assert {"solution.bp", "multiplier.bp", "facets.csv", "history.csv"} <= {p.name for p in (folder / "out").iterdir()}
    exported = json.loads((folder / "out" / "summary.json").read_text())
    assert exported["norms"] == pytest.approx(summary["norms"], rel=1e-12)
    assert exported["iterations"] == 3


@pytest.mark.parallel([1, 2])
def test_nothing_to_start_from(folder: Path):
    if COMM.rank == 0:
        (folder / "broken" / "checkpoint").mkdir(parents=True)
        (folder / "broken" / "checkpoint" / "about.json").write_bytes(b"{")
    for start, message in [("none", "holds no checkpoint"), ("broken", "not a readable solution")]:
        done = signorini(folder, "solve", "example1", "--h", "1/4", "--start-from", start)
        assert (done.returncode, done.stderr.count(message)) == (2, 1), done.stderr
    assert [path.name for path in folder.iterdir()] == ["broken"]
