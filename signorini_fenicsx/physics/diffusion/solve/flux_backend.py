"""What the hybrid backends of RT0 and RT1 have in common: laws in cells, and Newton's steps where κ depends on u."""

from typing import Any

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import SiteConditions
from signorini_fenicsx.discrete.posed import Posed, State
from signorini_fenicsx.discrete.trace_backend import TraceBackend
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.sources import mean_moments
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solve.tangent import Tangent, off_chains


class FluxBackend(TraceBackend):
    """A hybrid backend of diffusion: cells may have laws, whose conditions change the matrix, and κ may depend on u.

    Attributes:
        tangent: Where κ depends on u, whose steps take the place of solves; None for solves with the present κ.
        solves: How many linear systems it has been asked to solve.
    """

    name: str
    system: Any
    data: Any
    tangent: Tangent | None = None
    solves: int = 0
    _in_cells: SiteConditions | None = None

    def __init__(self, system: Any, spaces: Spaces, data: Data, fixed: npt.NDArray[np.int32], near: Any, choose: Any):
        """Choose the solver, see `TraceBackend` (collective)."""
        super().__init__(system, spaces, fixed, near, choose)
        self._cells = spaces.site_kinds["cell"]
        if not data.inside:
            self.sites, self.measure = len(self._unknowns), self._trace_measures

    @property
    def by_traces(self) -> bool:
        """Whether there are no laws in Ω."""
        return not self.data.inside

    def solve(self, conditions: SiteConditions) -> Iterate:
        """Solve, see `TraceBackend.solve`, or make a step of `tangent` (collective)."""
        if self.tangent is not None:
            self.tangent.step(conditions)
            return self.recovered(conditions, refine=False)
        self.solves += 1
        return super().solve(conditions)

    def take_kappa(self, data: Any) -> None:
        """Go on with the same data but for κ (collective)."""
        self.system.take_kappa(data)
        self._take_natural()
        self._take(data)

    def _take_natural(self) -> None:
        """Take over other entries of the matrix."""
        self._operator.take_natural()
        self._factors.take_natural()
        self._state, self._in_cells = State.START, None

    @property
    def x(self) -> PETSc.Vec:
        """The owned unknowns."""
        return self._x

    @property
    def natural(self) -> PETSc.Mat:
        """The matrix without conditions."""
        return self.system.matrix

    def new_tangent(self) -> Tangent:
        """Newton's method from the last solution."""
        return Tangent(self, self._solver)

    def imposed(self, conditions: SiteConditions) -> tuple[PETSc.Mat, npt.NDArray[np.int32], Array, Array]:
        """The matrix under conditions, the unknowns that they fix, their values, and the right side (collective)."""
        posed = self.posed(conditions)
        load, _ = self._loads(posed)
        fixed = self._factors.impose(posed.imposed)
        self._state = State.START
        return self._operator.matrix, fixed, self._held.array_r.copy(), load

    def off_laws(self, conditions: SiteConditions) -> Array:
        """How far the sites are off their laws, as a p, where x need not be a solution (collective)."""
        p, flux = self._site_pairs(self._x, conditions)
        unit = self.natural.getDiagonal().array_r[self._unknowns] / self._trace_measures
        if not self.by_traces:
            moments = mean_moments(self.spaces, self.data)
            unit = np.append(unit, 1 / np.repeat(moments, len(self._cells) // len(moments)))
        return off_chains(self.data.chains, p, flux, unit)

    def posed(self, conditions: SiteConditions, *, held: bool = False) -> Posed:
        """The problem under these conditions, which the cells with laws get (collective)."""
        cells = self._cells.of(conditions)
        if not self.by_traces and not cells.same(self._in_cells, self.comm):
            self.system.impose_in_cells(cells)
            self._take_natural()
            self._in_cells = cells
        return super().posed(conditions, held=held)

    def _is_last(self, conditions: SiteConditions) -> bool:
        """Whether the last problem is that under these conditions, also in the cells (collective)."""
        cells = self._cells.of(conditions)
        return super()._is_last(conditions) and (self.by_traces or cells.same(self._in_cells, self.comm))

    def _site_pairs(self, x: PETSc.Vec, conditions: SiteConditions) -> tuple[Array, Array]:
        """See `TraceBackend._site_pairs`; those of cells with laws follow (collective)."""
        return self._with_cells(x, conditions, self.flux(x, self.system.load))

    def _with_cells(self, x: PETSc.Vec, conditions: SiteConditions, flux: Array) -> tuple[Array, Array]:
        """`SitePairs.p` and `SitePairs.flux` with this flux on Γ_S; those of cells with laws follow (collective)."""
        p = self.means(x)
        if not self.by_traces:
            of_p, of_flux = self.system.in_cells(x)
            p, flux = np.append(p, of_p), np.append(flux, of_flux)
        return self.cleaned(conditions, p, flux)
