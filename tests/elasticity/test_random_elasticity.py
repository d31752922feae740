"""A few seeds of `scripts/random_elasticity.py`, which mixes all that elastic problems take."""

import pytest
from random_elasticity import examine


@pytest.mark.parametrize("seed", [*range(5), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(5, 150))])
def test_random_problem(seed: int):
    result = examine(seed)
    assert result.good, result
