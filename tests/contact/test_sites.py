"""Kinds of sites: each sees its own part of the arrays of a problem."""

import numpy as np
import pytest

from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.contact.sites import SiteKind, Sites

NORMAL = SiteKind("normal", 3, np.arange(3), np.full(9, 0.5), (3,), np.arange(9), sign=-1.0)
SLIP = SiteKind("slip", 3, np.array([2, 0]), np.ones(12), (3, 2), np.arange(9, 21))


def test_kinds_see_their_part_of_arrays():
    """A view of an array is one of its memory; rows of all facets and back are the same values."""
    sites = Sites(NORMAL, SLIP)
    _, slip = sites
    values = np.arange(float(len(sites)))
    slip.of(values)[:] += 100
    assert values[:9].tolist() == list(range(9))
    assert (values[9:] > 100).all()
    assert slip.rows_of(values).shape == (2, 3, 2)
    rows = sites.spread(values)
    assert [row.shape for row in rows] == [(3, 3), (3, 3, 2)]
    assert (rows[1][1] == 0).all()
    np.testing.assert_array_equal(sites.gathered(*rows), values)
    assert sites.unknown.tolist() == list(range(21))
    assert sites.measure @ sites.sign == pytest.approx(12 - 4.5)


def test_chains_of_two_kinds_stand_behind_each_other():
    """Those with fewer corners get corners that no site reaches; a kind has its own again."""
    one = Chains.at_corner(9)
    other = Chains.through(np.tile([-1.0, 1.0], (12, 1)), np.tile([2.0, -2.0], (12, 1)), np.zeros(12), np.zeros(12))
    both = one.followed_by(other)
    normal, slip = Sites(NORMAL, SLIP)
    np.testing.assert_array_equal(normal.of(both).count, 1)
    np.testing.assert_array_equal(slip.of(both).slope, other.slope)
    assert not both.plain
