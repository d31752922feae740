"""Items that groups join: the same sets as SciPy finds, for any groups."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from signorini_fenicsx.base.rows import joined


@pytest.mark.parametrize(("number", "groups", "width"), [(0, 0, 3), (5, 0, 2), (60, 25, 2), (90, 60, 3), (99, 95, 2)])
def test_joined(number: int, groups: int, width: int):
    """Also for no items and for no groups; the sets are numbered by their first items."""
    rng = np.random.default_rng(number + groups)
    for _ in range(5):
        members = rng.integers(0, max(number, 1), (groups, width))
        links = np.repeat(members[:, 0], width), members.ravel()
        graph = coo_array((np.ones(members.size, dtype=np.int8), links), shape=(number, number))
        np.testing.assert_array_equal(joined(number, members), connected_components(graph, directed=False)[1])


def test_joined_along_a_line():
    """A chain in an order that makes each item meet a larger one before a smaller one is one set."""
    order = np.random.default_rng(1).permutation(2000)
    assert (joined(2000, np.column_stack([order[:-1], order[1:]])) == 0).all()
