"""The set rules as pure functions."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.chains import Chains, Condition, Penalty, SiteConditions
from signorini_fenicsx.contact.set_rules import (
    ALGORITHM_1,
    ALGORITHM_2,
    SetRule,
    clip_3,
    rule_1,
    rule_2,
    rule_3,
    rule_4,
)

NO_FLUX, ZERO_TRACE, ROBIN = Condition

P = np.array([0.0, 1.0, -1.0, 0.0, 0.0])
FLUX = np.array([0.0, 0.0, 0.0, 1.0, -1.0])


@pytest.mark.parametrize(
    ("rule", "kinds"),
    [
        (rule_1, [ZERO_TRACE, NO_FLUX, ZERO_TRACE, ZERO_TRACE, NO_FLUX]),
        (rule_2, [NO_FLUX, NO_FLUX, ZERO_TRACE, ZERO_TRACE, NO_FLUX]),
        (rule_3, [ROBIN, NO_FLUX, ROBIN, ROBIN, ROBIN]),
        (rule_4, [ROBIN, ROBIN, ROBIN, ZERO_TRACE, ROBIN]),
    ],
)
def test_rules(rule: Callable[..., npt.NDArray], kinds: list[Condition]):
    """1: negative flux opens a facet, negative trace closes it, ties are in contact; 2: as 1, but ties are open.

    3: facets with p > 0 are open, 4: those with σ·n > 0 are in contact; in both ties are penalised.
    """
    np.testing.assert_array_equal(rule(P, FLUX, 1.0), kinds)


def test_the_clip_of_algorithm_3():
    """Only where the penalty acts."""
    kind = np.array([ROBIN, ROBIN, NO_FLUX, ROBIN, NO_FLUX], dtype=np.int8)
    np.testing.assert_array_equal(
        clip_3(kind, np.array([-1.0, 1.0, -1.0, 0.0, 1.0])), [True, False, False, False, False]
    )


@pytest.mark.parametrize("penalty", Penalty)
def test_a_penalty_solution_is_a_shifted_signorini_solution(penalty: Penalty):
    eps = 0.25
    contact, gap = (-eps * 2.0, 2.0) if penalty is Penalty.TRACE else (0.0, 2.0), (3.0, 0.0)
    if penalty is Penalty.FLUX:
        gap = (3.0, -eps * 3.0)
    p, flux = penalty.shift(*np.array([contact, gap]).T, eps)
    assert min(p.min(), flux.min()) >= 0
    np.testing.assert_array_equal(p * flux, [0, 0])
    assert penalty.beta(eps) * (contact if penalty is Penalty.TRACE else gap)[0] == pytest.approx(
        -(contact if penalty is Penalty.TRACE else gap)[1]
    )


@pytest.mark.parametrize("beta", [1e8, 1e-8])
def test_clean_computes_the_smaller_robin_value(beta: float):
    conditions = SiteConditions(np.array([ROBIN], dtype=np.int8), beta)
    p, flux = conditions.clean(np.array([-3.0]), np.array([-5.0]), 1.0)
    if beta > 1:
        assert (p[0], flux[0]) == (5.0 / beta, -5.0)
    else:
        assert (p[0], flux[0]) == (-3.0, 3.0 * beta)


@pytest.mark.parametrize("algorithm", [ALGORITHM_1, ALGORITHM_2])
def test_rho_does_not_matter_when_p_flux_vanishes(algorithm: SetRule):
    rule = algorithm.rule
    for rho in (1e-6, 0.1, 1e6):
        np.testing.assert_array_equal(rule(P, FLUX, rho), rule(P, FLUX, 1.0))


def test_clean_leaves_no_noise():
    conditions = SiteConditions(np.array([NO_FLUX, ZERO_TRACE], dtype=np.int8))
    p, flux = conditions.clean(np.array([2.0, 1e-17]), np.array([-1e-17, 3.0]), 1.0)
    np.testing.assert_array_equal(p, [2.0, 0.0])
    np.testing.assert_array_equal(flux, [0.0, 3.0])


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (None, "it returns NoneType"),
        ([0, 1, 1, 0, 0], "it returns list"),
        (np.zeros(3, dtype=np.int8), r"shape \(5,\); it returns int8 of shape \(3,\)"),
        (np.zeros((5, 1), dtype=np.int8), r"it returns int8 of shape \(5, 1\)"),
        (np.zeros(5), "it returns float64"),
    ],
)
def test_a_rule_that_gives_something_else(given: object, told: str):
    """A rule or a clip of a user is refused in a sentence if it gives no condition, or truth value, for each site."""
    mine = SetRule(start=NO_FLUX, rule=lambda p, flux, rho: given, clip=lambda kind, flux: given)
    with pytest.raises(InputError, match=f"rule: must return an array of whole numbers, .*{told}"):
        mine.following(Chains.at_corner(len(P)), P, FLUX, 1.0)
    with pytest.raises(InputError, match=f"clip: must return an array of truth values, .*{told}"):
        mine.clipped(np.zeros(5, dtype=np.int8), FLUX)
