"""A few seeds of `scripts/random_runs.py elasticity`, which mixes all that elastic problems take."""

import pytest
from makers.bodies import mixture


@pytest.mark.parametrize(
    "seed", [1, 3, 4, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 2, *range(5, 150)))]
)
def test_random_problem(seed: int):
    (found,) = mixture(seed)
    assert not found.wrong, found
