"""Which rigid motions nothing prevents, against one linear programme with all rows."""

import numpy as np
import pytest
from mpi4py import MPI
from scipy.optimize import linprog

from signorini_fenicsx.physics.elasticity.rigid_motions import Limits, _in_words

COMM = MPI.COMM_WORLD


def is_prevented(work: np.ndarray, into: np.ndarray, slips: np.ndarray, shears: np.ndarray) -> bool:
    """Whether no r ≠ 0 has into·r ≤ 0 and Σ shears |slips·r| ≤ work·r, with the |…| as variables."""
    size, own = len(work), np.eye(len(shears))
    rows = np.block(
        [[into, np.zeros((len(into), len(own)))], [slips, -own], [-slips, -own], [-work[None], shears[None]]]
    )
    for objective in np.concatenate([np.eye(size), -np.eye(size)]):
        cost = np.append(-objective, np.zeros(len(own)))
        bounds = [(-1, 1)] * size + [(0, None)] * len(own)
        if -linprog(cost, A_ub=rows, b_ub=np.zeros(len(rows)), bounds=bounds).fun > 0.5:
            return False
    return True


@pytest.mark.parallel(3)
def test_cutting_planes_find_what_one_programme_finds():
    """For random rows of 1 to 6 motions, spread over the ranks, some with none; and the motion is one of those."""
    rng, held = np.random.default_rng(3), 0
    for number in range(24):
        size = 1 + number % 6
        into, slips = rng.normal(size=(rng.integers(1, 30), size)), rng.normal(size=(rng.integers(0, 9), size))
        work = -rng.uniform(0, 1, len(into)) @ into if number % 2 else rng.normal(size=size)
        shears = rng.uniform(0, 0.1, len(slips))
        mine = [np.arange(len(rows)) % min(COMM.size, 2) == COMM.rank for rows in (into, slips)]
        limits = Limits(COMM, work, into[mine[0]], slips[mine[1]][:, None], shears[mine[1]])
        motion = limits.unprevented()
        assert (motion is None) == is_prevented(work, into, slips, shears)
        held += motion is None
        if motion is not None:
            assert np.abs(motion).max() == pytest.approx(1.0)
            assert (into @ motion).max() < 1e-8
            assert shears @ np.abs(slips @ motion) <= work @ motion + 1e-8
    assert 4 < held < 20


def test_motions_are_told_without_rounding():
    """What is rounding beside the motion, or beside the size of the body, is told as 0."""
    assert _in_words(np.array([0, 7e-17, 1, 0, 0, 3e-16]), np.zeros(3), 1.0)[0] == "along (0, 0, 1)"
    turn = _in_words(np.array([1e-15, 0.5, 0, -2e-17, 3e-15, 1]), np.array([0.5, 0, 0]), 1.0)[0]
    assert turn == "about an axis along (0, 0, 1) through (0, 0, 0)"
