"""Corrections by a solver that is wrong in some directions."""

import numpy as np
import pytest
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.linear import corrections
from signorini_fenicsx.linear.corrections import corrected


def test_a_solver_that_is_far_off_in_few_directions():
    """Four directions in which plain corrections grow 4- to 40-fold: nine corrections are enough."""
    rng, asked = np.random.default_rng(0), [0]
    matrix = np.diag(np.linspace(1, 3, 30)) + 0.1 * np.ones((30, 30))
    wrong, solution = np.linalg.inv(matrix), rng.normal(size=30)
    for factor in (5, -10, 20, -40):
        way = rng.normal(size=30)
        wrong += factor * np.outer(way, way) / (way @ matrix @ way)

    def correction(left: Array) -> list[Array]:
        asked[0] += 1
        return [wrong @ left]

    def left_by(fields: list[Array]) -> Array:
        return matrix @ (solution - fields[0])

    def found() -> Array:
        begin = [np.zeros(30)]
        return corrected(MPI.COMM_SELF, begin, left_by, correction, lambda left: bool(np.abs(left).max() < 1e-11))[0]

    assert found() == pytest.approx(solution, abs=1e-10)
    assert asked[0] <= 9


def test_what_cannot_be_corrected():
    """A solver that makes nothing of what is left is asked so often only."""
    asked = []

    def correction(left: Array) -> list[Array]:
        asked.append(left)
        return [np.array([1.0, 0.0]) * left]

    fields = corrected(
        MPI.COMM_SELF, [np.zeros(2)], lambda fields: np.ones(2) - fields[0], correction, lambda left: False
    )
    assert fields[0].tolist() == [1.0, 0.0]
    assert len(asked) == corrections.PATIENCE
