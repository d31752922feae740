"""What a method gets of a diffusion problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.conditions import Condition, Penalty, SiteConditions
from signorini_fenicsx.contact.floating import Floating
from signorini_fenicsx.methods.task import Task
from signorini_fenicsx.physics.diffusion.data import Data
from signorini_fenicsx.physics.diffusion.residuals import KKTResiduals, kkt_residuals
from signorini_fenicsx.physics.diffusion.solvability import floating_sites
from signorini_fenicsx.physics.diffusion.spaces import Spaces


@dataclass(frozen=True)
class DiffusionTask(Task):
    """A discrete diffusion problem and the parameters of its method."""

    spaces: Spaces
    data: Data

    @property
    def in_cells(self) -> bool:
        """Whether there are laws in Ω."""
        return self.data.inside is not None

    def floating(self) -> Floating | None:
        """The components that have neither facets of Γ_D nor cells with a term cu (collective)."""
        return floating_sites(self.spaces, self.data)

    def kkt(self, iterate: Iterate, penalty: Penalty | None) -> KKTResiduals:
        """KKT residuals of an iterate (collective)."""
        p = self.spaces.multiplier(iterate.p + self.data.psi_h)
        return kkt_residuals(self.spaces, self.data, iterate.sigma, iterate.u, p, penalty, self.eps)


def nothing_yet(spaces: Spaces) -> tuple[Iterate, SiteConditions]:
    """σ = 0, u = 0, p = 0 and NO_FLUX everywhere: the start of the history of a method that has no start solve."""
    zero = np.zeros(len(spaces.facets))
    iterate = Iterate(p=zero, flux=zero, linear_iterations=0, sigma=fem.Function(spaces.V), u=fem.Function(spaces.Q))
    return iterate, SiteConditions.everywhere(Condition.NO_FLUX, len(zero))
