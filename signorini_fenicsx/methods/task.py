"""The input of every method."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.parallel import Stopwatch
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.backend import BackendFactory, Iterate
from signorini_fenicsx.contact.conditions import Condition, Penalty, SiteConditions
from signorini_fenicsx.contact.history import OnStep
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.physics.diffusion.data import Data
from signorini_fenicsx.physics.diffusion.residuals import KKTResiduals, kkt_residuals
from signorini_fenicsx.physics.diffusion.spaces import Spaces

type Coarser = Callable[[float], tuple[Spaces, Data]]
"""Maps a factor > 1 to the same problem on a mesh that is coarser by this factor (collective). Raises InputError if
there is no such mesh."""


@dataclass(frozen=True)
class Task:
    """A discrete problem and the parameters of its method.

    Attributes:
        spaces: The discrete spaces.
        data: The data and their means over cells and facets.
        rho: ρ or step length; None for the default of the method.
        eps: ε of the penalty and of the stabilisation.
        max_iterations: Iterations allowed.
        on_step: Called on all ranks after each iteration.
        backend: Makes the backend of the set rules.
        start: Segments to start from, on any mesh of the domain, or None.
        predict: Whether the sets of large problems are predicted.
        coarser: Makes coarser meshes for the prediction; None if there are none.
        tuning: Sizes from which the program works differently.
        watch: Measures the phases of the method.
    """

    spaces: Spaces
    data: Data
    rho: float | None
    eps: float
    max_iterations: int
    on_step: OnStep
    backend: BackendFactory
    start: Segments | None = None
    predict: bool = True
    coarser: Coarser | None = None
    tuning: Tuning = field(default_factory=Tuning)
    watch: Stopwatch = field(default_factory=Stopwatch)

    def kkt(self, iterate: Iterate, penalty: Penalty | None) -> KKTResiduals:
        """KKT residuals of an iterate (collective)."""
        p = self.spaces.multiplier(iterate.p + self.data.psi_h)
        return kkt_residuals(self.spaces, self.data, iterate.sigma, iterate.u, p, penalty, self.eps)


def nothing_yet(spaces: Spaces) -> tuple[Iterate, SiteConditions]:
    """σ = 0, u = 0, p = 0 and NO_FLUX everywhere: the start of the history of a method that has no start solve."""
    zero = np.zeros(len(spaces.facets))
    iterate = Iterate(p=zero, flux=zero, linear_iterations=0, sigma=fem.Function(spaces.V), u=fem.Function(spaces.Q))
    return iterate, SiteConditions.everywhere(Condition.NO_FLUX, len(zero))
