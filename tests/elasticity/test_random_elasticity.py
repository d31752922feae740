"""A few seeds of `scripts/random_runs.py elasticity`, which mixes all that elastic problems take."""

import pytest
from makers.bodies import examine


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, *range(2, 150)))])
def test_random_problem(seed: int):
    row = examine("elasticity", seed, cells={2: 500, 3: 500})
    assert not row.wrong, row
    assert not row.ratio > 3, row
