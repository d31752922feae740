"""The set rules as pure functions."""

import numpy as np
import pytest

from signorini_fenicsx.algorithms import ALGORITHMS, mlm1_rule, mlm2_rule
from signorini_fenicsx.conditions import Condition, FacetConditions

NO_FLUX, ZERO_TRACE = Condition.NO_FLUX, Condition.ZERO_TRACE

P = np.array([0.0, 1.0, -1.0, 0.0, 0.0])
FLUX = np.array([0.0, 0.0, 0.0, 1.0, -1.0])


def test_algorithm_1():
    """Negative flux opens a facet, negative trace closes it, ties are in contact."""
    np.testing.assert_array_equal(mlm1_rule(P, FLUX, 1.0), [ZERO_TRACE, NO_FLUX, ZERO_TRACE, ZERO_TRACE, NO_FLUX])


def test_algorithm_2():
    """The same but for ties, which are open."""
    np.testing.assert_array_equal(mlm2_rule(P, FLUX, 1.0), [NO_FLUX, NO_FLUX, ZERO_TRACE, ZERO_TRACE, NO_FLUX])


@pytest.mark.parametrize("name", ["alg1", "alg2"])
def test_rho_does_not_matter_when_p_flux_vanishes(name: str):
    rule = ALGORITHMS[name].rule
    for rho in (1e-6, 0.1, 1e6):
        np.testing.assert_array_equal(rule(P, FLUX, rho), rule(P, FLUX, 1.0))


def test_clean_leaves_no_noise():
    conditions = FacetConditions(np.array([NO_FLUX, ZERO_TRACE], dtype=np.int8))
    p, flux = conditions.clean(np.array([2.0, 1e-17]), np.array([-1e-17, 3.0]))
    np.testing.assert_array_equal(p, [2.0, 0.0])
    np.testing.assert_array_equal(flux, [0.0, 3.0])
