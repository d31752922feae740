"""What changes above a size: tables by rank, pictures and methods that are refused; with small sizes instead."""

import itertools
import os
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from commands import read_rows
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.output.checkpoint import load_solution
from signorini_fenicsx.output.writing import write_solution
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.pictures import sample
from signorini_fenicsx.pictures.cuts import outward
from signorini_fenicsx.pictures.scene import gathered_scene

COMM = MPI.COMM_WORLD


@pytest.mark.parallel([2, 3])
@pytest.mark.parametrize(("name", "table", "column"), [("example1", "facets", "p"), ("hertz", "contact", "gap")])
def test_tables_of_the_ranks_are_the_table(folder: Path, name: str, table: str, column: str):
    """With a table per rank they have together the rows of the one table."""
    case = load_case(name).with_values({"solve.h": {"facets": 0.2, "contact": 0.25}[table]})
    write_solution(solve_case(case, COMM), folder, fields=False)
    (folder / "by_rank").mkdir(exist_ok=True)
    small = solve_case(case, COMM, tuning=Tuning(one_table_up_to=3))
    write_solution(small, folder / "by_rank", fields=False)
    COMM.Barrier()
    assert not (folder / "by_rank" / f"{table}.csv").exists()
    names = sorted(path.name for path in (folder / "by_rank" / table).iterdir())
    assert names == [f"{rank:05}.parquet" for rank in range(COMM.size)]
    tables = [pyarrow.parquet.read_table(folder / "by_rank" / table / name).to_pylist() for name in names]
    found, wanted = (
        sorted((row["part"], round(float(row["x"]), 9), round(float(row[column]), 9), row["condition"]) for row in rows)
        for rows in (itertools.chain(*tables), read_rows(folder / f"{table}.csv"))
    )
    assert found == wanted


def test_methods_of_one_rank_are_refused():
    case = load_case("example1").with_values({"solve.h": 0.25})
    small = Tuning(on_one_rank_up_to=10, dense_up_to=5)
    for algorithm, most in (("psor", "10 cells"), ("qp", "10 cells"), ("mixed-uzawa-h12", "5 facets of Γ_S")):
        with pytest.raises(InputError, match=f"{algorithm} works on one rank, with at most {most}"):
            solve_case(case.with_values({"solve.algorithm": algorithm}), COMM, tuning=small)


@pytest.mark.parallel([2])
def test_normals_where_few_cells_are_drawn(monkeypatch: pytest.MonkeyPatch):
    """All facets of a cube have their outer normal, although the cells behind most of them are not in the sample."""
    monkeypatch.setattr(sample, "MOST_CELLS", {2: 0, 3: 500})
    cube = gathered_scene(solve_case(load_case("cube").with_values({"solve.h": 0.25}), COMM))
    if cube is not None:
        triangles = cube.boundary.vertices
        away = cube.fields.points[triangles].mean(axis=1) - 0.5
        np.testing.assert_allclose(np.sum(outward(cube, triangles) * away, axis=1), 0.5, atol=1e-12)


def checkpoints() -> tuple[Solution, Solution]:
    """Two different solutions."""
    case = load_case("example1").with_values({"solve.h": 0.25})
    one, other = (solve_case(case.with_values({"problem.psi": psi}), COMM) for psi in (0, 0.1))
    return one, other


def is_read(folder: Path, solution: Solution) -> None:
    COMM.Barrier()
    assert load_solution(folder, COMM).norms() == pytest.approx(solution.norms())


@pytest.mark.parallel(2)
def test_a_full_disk_leaves_the_old_checkpoint(folder: Path, monkeypatch: pytest.MonkeyPatch):
    old, new = checkpoints()
    write_solution(old, folder, fields=False)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr(os, "posix_fallocate", full)
        with pytest.raises(OSError, match="No space left"):
            write_solution(new, folder, fields=False)
    is_read(folder, old)
    write_solution(new, folder, fields=False)
    is_read(folder, new)
