"""What every classical algorithm is given."""

from collections.abc import Callable
from dataclasses import dataclass

from dolfinx import fem

from signorini_fenicsx.active_set import Step
from signorini_fenicsx.spaces import Spaces

TOLERANCE = 1e-10
"""Scale-free size of the step at which an iteration stops: 100 times below what its result is judged by."""


@dataclass(frozen=True)
class Task:
    """A discrete problem and the parameters of its algorithm.

    Attributes:
        spaces: The discrete spaces.
        f_h: P0 projection of the load.
        rho: Step length ρ, or None for an automatic one.
        eps: ε of the penalty and of the stabilisation.
        max_iterations: Iterations allowed.
        on_step: Called on all ranks after each iteration.
    """

    spaces: Spaces
    f_h: fem.Function
    rho: float | None
    eps: float
    max_iterations: int
    on_step: Callable[[Step], None]
