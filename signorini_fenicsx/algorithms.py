"""The active/inactive-set algorithms: each is a start and a rule, a pure function of the facet values p and σ·n.

| algorithm | formulation | rule, per facet of Γ_S                         |
|-----------|-------------|------------------------------------------------|
| alg1      | (MLM-I)_h   | σ·n = 0 where σ·n − ρp < 0, else p = 0         |
| alg2      | (MLM-II)_h  | p = 0 where p − ρσ·n < 0, else σ·n = 0         |

Both start from the solution with σ·n = 0 on Γ_S, whose trace is then set to 0. After one step one of p and σ·n is 0
on each facet, so only signs matter and ρ changes no iterate.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from signorini_fenicsx.conditions import Condition

type Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Algorithm:
    """An active/inactive-set algorithm.

    Attributes:
        title: What it solves and where it is defined.
        start: Condition of all Γ_S facets in the start solve (Step 1).
        rule: From p, σ·n and ρ per facet to the next conditions (Step 2).
    """

    title: str
    start: Condition
    rule: Callable[[Array, Array, float], npt.NDArray[np.int8]]


def mlm1_rule(p: Array, flux: Array, rho: float) -> npt.NDArray[np.int8]:
    """Algorithm 1, Step 2: the active set, where σ·n − ρp < 0, gets σ·n = 0 (11a)."""
    return np.where(flux - rho * p < 0, Condition.NO_FLUX, Condition.ZERO_TRACE).astype(np.int8)


def mlm2_rule(p: Array, flux: Array, rho: float) -> npt.NDArray[np.int8]:
    """Algorithm 2, Step 2: the active set, where p − ρσ·n < 0, gets p = 0; the rest gets σ·n = 0 (13a)."""
    return np.where(p - rho * flux < 0, Condition.ZERO_TRACE, Condition.NO_FLUX).astype(np.int8)


ALGORITHMS: Mapping[str, Algorithm] = {
    "alg1": Algorithm("Algorithm 1 for (MLM-I)_h", Condition.NO_FLUX, mlm1_rule),
    "alg2": Algorithm("Algorithm 2 for (MLM-II)_h", Condition.NO_FLUX, mlm2_rule),
}
