"""What every classical algorithm is given."""

from collections.abc import Callable
from dataclasses import dataclass

import ufl
from dolfinx import fem

from signorini_fenicsx.active_set import Step
from signorini_fenicsx.data import Data
from signorini_fenicsx.spaces import Spaces

TOLERANCE = 1e-10
"""Scale-free size of the step at which an iteration stops: 100 times below what its result is judged by."""


def domain_length(spaces: Spaces) -> float:
    """L = |Ω|^(1/d) (collective)."""
    return spaces.integrate(fem.Constant(spaces.mesh, 1.0) * ufl.dx) ** (1 / spaces.mesh.topology.dim)


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
