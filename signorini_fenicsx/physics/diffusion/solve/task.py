"""What a method gets of a diffusion problem."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Condition, Penalty, SiteConditions
from signorini_fenicsx.contact.floating import Floating
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.methods.task import Loop, Task
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.rt1_data import RT1Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces, Spaces
from signorini_fenicsx.physics.diffusion.solve.hybrid import PREDICT_FROM
from signorini_fenicsx.physics.diffusion.solve.quasilinear import QuasiLinear
from signorini_fenicsx.physics.diffusion.solve.residuals import KKTResiduals, kkt_residuals
from signorini_fenicsx.physics.diffusion.solve.rt1_residuals import RT1Iterate, rt1_kkt
from signorini_fenicsx.physics.diffusion.solve.solvability import floating_sites

COARSENING_IN_CELLS = 2.0
"""Mesh size of the coarser mesh of a prediction with laws in Ω, divided by that of the finer mesh."""


@dataclass
class LastRun:
    """What the last run has left where κ depends on u.

    Attributes:
        data: The data with its κ; None before there is one.
        failed: Of a step with soils how it has failed: half a step is better than a cold start. None if it has not.
    """

    data: Data | None = None
    failed: Outcome | None = None


@dataclass(frozen=True, kw_only=True)
class DiffusionTask(Task):
    """A discrete diffusion problem and the parameters of its method.

    Attributes:
        alone: Gives what runs a method that only diffusion has, by its name there.
        last_run: What the last run has left where κ depends on u.
    """

    spaces: Spaces
    data: Data
    alone: Callable[[str], Callable[..., Outcome]]
    start: Segments | None = None
    last_run: LastRun = field(default_factory=LastRun)

    @property
    def present(self) -> Data:
        """The data, where κ depends on u with the one that was found."""
        return self.last_run.data or self.data

    def solved(self, backend: Any, loop: Loop) -> Outcome:
        """Run the loop, once for each κ where it depends on u (collective)."""
        if self.data.quasilinear is None:
            return loop()
        if self.last_run.failed is not None:
            return self.last_run.failed
        u = None if self.start is None else self.start.u_on(self.spaces)
        outcome = QuasiLinear(backend, loop, u).solved()
        self.last_run.data = backend.data
        if self.data.stored is not None and not outcome.converged:
            self.last_run.failed = outcome
        return outcome

    def is_large(self, _backend: object) -> bool:
        """Whether the mesh has so many facets that a prediction saves more than it costs."""
        return self.tuning.predicts(self.spaces.facets_of_mesh, PREDICT_FROM)

    def coarsening(self, backend: object) -> float | None:
        """See `Task.coarsening`; None in space, where a mesh that coarse predicts too little for its cost.

        With laws in Ω the edge of a set of cells, such as those on an obstacle, moves by one cell per step from a cold
        start, so that the number of steps grows like 1/h. From the contact on a mesh that is coarser by 2 a few steps
        are left.
        """
        facets, tuning = self.spaces.facets_of_mesh, self.tuning
        if self.data.inside:
            return COARSENING_IN_CELLS if facets >= tuning.predict_in_cells_from else None
        fine = self.spaces.mesh.topology.dim == 2 and facets >= tuning.coarsen_from
        return tuning.coarsening if fine and self.is_large(backend) else None

    def begin(self, _backend: object, start: Segments) -> Indices:
        """The segments on another mesh: for a facet that at its midpoint, for a cell that of the cell there."""
        return start.on(self.spaces).segment

    def own_start(self, backend: Any) -> SiteConditions | None:
        """The steepest segments if there is no Γ_D: an algorithm's own start may be a Neumann problem.

        In a step with soils those that û of the last step is on: else dry soil would be wet at first (collective).
        """
        of_u = self.data.quasilinear
        if of_u is not None and of_u.storing is not None:
            backend.x.array_w[:] = backend.system.unknowns_of(of_u.storing.traces - of_u.constant)
            p, chains = backend.means(backend.x), backend.chains
            return chains.conditions(np.minimum((chains.p < p[:, None]).sum(axis=1), chains.count))
        return None if self.spaces.held else backend.chains.conditions(backend.chains.steepest())

    def found(self, _backend: object, segment: Indices) -> Segments:
        """The segments (collective)."""
        return Segments(self.spaces, segment)

    def floating(self) -> Floating | None:
        """The components that have neither facets of Γ_D nor cells with a term cu (collective)."""
        return floating_sites(self.spaces, self.data)

    def kkt(self, iterate: Iterate, penalty: Penalty | None) -> KKTResiduals:
        """KKT residuals of an iterate (collective)."""
        p = self.spaces.site_kinds["facet"].of(iterate.p) + self.data.psi_h
        return kkt_residuals(self.spaces, self.present, iterate.sigma, iterate.u, p, penalty, self.eps)


@dataclass(frozen=True, kw_only=True)
class RT1Task(DiffusionTask):
    """A discrete diffusion problem with RT1."""

    spaces: RT1Spaces
    data: RT1Data

    def kkt(self, iterate: Iterate, penalty: Penalty | None) -> KKTResiduals:
        """KKT residuals of an iterate (collective)."""
        assert isinstance(iterate, RT1Iterate)
        assert isinstance(self.present, RT1Data)
        return rt1_kkt(self.spaces, self.present, iterate, penalty, self.eps)


def nothing_yet(spaces: Spaces) -> tuple[Iterate, SiteConditions]:
    """σ = 0, u = 0, p = 0 and NO_FLUX everywhere: the start of the history of a method that has no start solve."""
    zero = np.zeros(len(spaces.facets))
    iterate = Iterate(p=zero, flux=zero, linear_iterations=0, sigma=fem.Function(spaces.V), u=fem.Function(spaces.Q))
    return iterate, SiteConditions.everywhere(Condition.NO_FLUX, len(zero))
