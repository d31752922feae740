"""What engineers read off: exact in a uniform state, the width of Hertz's contact, the same on all ranks."""

from typing import Any

import numpy as np
import pytest
from elastic import block, box, half
from mpi4py import MPI

from signorini_fenicsx import Contact, Dirichlet, Elasticity, Neumann, Wall
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.solving.solver import solve


@pytest.mark.parallel([1, 3])
def test_uniform_pressure():
    """In a uniform state all numbers are exact; of equal values the first place is told."""
    found = block(MPI.COMM_WORLD).quantities()
    bottom = found["contact"]["z0"]
    assert found["von_mises"]["largest"] == pytest.approx(0.1)
    np.testing.assert_allclose(found["von_mises"]["at"], [0, 0, 0], atol=1e-12)
    assert found["displacement"]["largest"] == pytest.approx(np.linalg.norm([0.06, 0.09, 0.1]))
    np.testing.assert_allclose(found["displacement"]["at"], [2, 3, 1])
    assert bottom["peak_pressure"]["largest"] == pytest.approx(0.1)
    assert [bottom["area"], bottom["pressure_force"]] == pytest.approx([6, 0.6])
    np.testing.assert_allclose(bottom["center_of_pressure"], [1, 1.5, 0], atol=1e-12)
    assert found["balance"] < 1e-12


@pytest.mark.parametrize("unit", [1.0, 1e9])
def test_part_without_pressure(unit: float):
    """Springs that nothing reaches have no pressure: what the solver leaves there has no place, width nor center."""
    conditions = [Contact("y0", gap=0.005), Wall("x1", beta=unit, level=-1), Neumann("x0", [f"{0.01 * unit} * y", "0"])]
    problem = Elasticity(unit, 0.3, conditions=[*conditions, Dirichlet("y1", ["0", "-0.01"])])
    free = solve(box(MPI.COMM_SELF, 3, [0.0, 0.0], [2.0, 1.0]), problem).quantities()["contact"]["x1"]
    assert free.pop("peak_pressure") == {"largest": 0.0, "at": [2.0, 0.0]}
    assert free == {"area": 0.0, "pressure_force": 0.0, "width": 0.0}


def cylinder(comm: MPI.Comm, n: int) -> ElasticSolution:
    """Half a cylinder of radius 1 on a plane, pressed by 0.0172615: half the width of contact is 0.2034."""
    problem = half("x^2/2", -0.0172615)
    return solve(box(comm, n, [0.0, 0.0], [1.0, 1.0]), problem)


def test_width_is_between_vertices():
    """The width is right to 5 % where three to four facets are in contact."""
    widths = [cylinder(MPI.COMM_SELF, n).quantities()["contact"]["y0"]["width"] for n in (15, 18)]
    np.testing.assert_allclose(widths, 0.2034, rtol=0.05)


def test_width_of_a_punch_and_of_all():
    """A part that is pressed everywhere is as wide as it is long; of two runs both count."""
    problem = Elasticity(
        1.0,
        0.0,
        u_D=["0", "-0.1"],
        conditions=[Contact("y0", "0 if x < 0.5 else 0 if x > 1.5 else 1"), Neumann(["x0", "x1"], 0)],
    )
    found = solve(box(MPI.COMM_SELF, 8, [0.0, 0.0], [2.0, 1.0]), problem).quantities()
    assert found["contact"]["y0"]["width"] == pytest.approx(1.0)


@pytest.mark.parallel(2)
def test_same_on_ranks():
    """On several ranks the numbers are those of one."""
    together, alone = (cylinder(comm, 8).quantities() for comm in (MPI.COMM_WORLD, MPI.COMM_SELF))
    for found in (together, alone):
        assert found.pop("balance") < 1e-12
    np.testing.assert_allclose(flat(together), flat(alone), rtol=1e-9, atol=1e-11)


def flat(numbers: Any) -> list[float]:
    """All numbers of nested dictionaries and lists."""
    if isinstance(numbers, dict):
        return [x for each in numbers.values() for x in flat(each)]
    return [x for each in numbers for x in flat(each)] if isinstance(numbers, list) else [numbers]
