"""What changes above a size: tables by rank, pictures and methods that are refused; with small sizes instead."""

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


@pytest.mark.parallel(2)
@pytest.mark.parametrize(("name", "table", "column"), [("example1", "facets", "p"), ("hertz", "contact", "gap")])
def test_a_table_of_many_rows_is_the_table(folder: Path, name: str, table: str, column: str):
    """It is Parquet, and has the same rows in the same order."""
    case = load_case(name).with_values({"solve.h": {"facets": 0.2, "contact": 0.25}[table]})
    write_solution(solve_case(case, COMM), folder / "few", fields=False)
    many = solve_case(case, COMM, tuning=Tuning(one_table_up_to=3))
    write_solution(many, folder / "many", fields=False)
    COMM.Barrier()
    assert not (folder / "many" / f"{table}.csv").exists()
    found = pyarrow.parquet.read_table(folder / "many" / f"{table}.parquet").to_pylist()
    for row, other in zip(found, read_rows(folder / "few" / f"{table}.csv"), strict=True):
        assert (row["part"], row["condition"]) == (other["part"], other["condition"])
        assert [row["x"], row[column]] == pytest.approx([float(other["x"]), float(other[column])], abs=1e-9)


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
