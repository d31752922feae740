"""What every classical algorithm is given."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from signorini_fenicsx.backends.contract import Iterate
from signorini_fenicsx.discrete.conditions import Condition, FacetConditions
from signorini_fenicsx.discrete.data import Data
from signorini_fenicsx.discrete.spaces import Spaces
from signorini_fenicsx.methods.loop import Step

TOLERANCE = 1e-10
"""Scale-free size of the step at which an iteration stops: 100 times below what its result is judged by."""


@dataclass(frozen=True)
class Task:
    """A discrete problem and the parameters of its algorithm.

    Attributes:
        spaces: The discrete spaces.
        data: Its load and Dirichlet data, and their means over cells and facets.
        rho: Step length ρ, or None for an automatic one.
        eps: ε of the penalty and of the stabilisation.
        max_iterations: Iterations allowed.
        on_step: Called on all ranks after each iteration.
    """

    spaces: Spaces
    data: Data
    rho: float | None
    eps: float
    max_iterations: int
    on_step: Callable[[Step], None]


def nothing_yet(spaces: Spaces) -> tuple[Iterate, FacetConditions]:
    """σ = 0, u = 0, p = 0 and NO_FLUX everywhere: the start of a history whose method has no start of its own."""
    zero = np.zeros(len(spaces.facets))
    iterate = Iterate(fem.Function(spaces.V), fem.Function(spaces.Q), zero, zero, 0)
    return iterate, FacetConditions(np.full(len(zero), Condition.NO_FLUX, dtype=np.int8))
