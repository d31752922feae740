"""The one condition per facet of Γ_S that makes each step of every algorithm a linear problem."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

type Array = npt.NDArray[np.float64]


class Condition(IntEnum):
    """What holds on a facet: σ·n = 0, p = 0, or σ·n + βp = 0."""

    NO_FLUX = 0
    ZERO_TRACE = 1
    ROBIN = 2


@dataclass(frozen=True)
class FacetConditions:
    """Conditions on the Γ_S facets of this rank.

    Attributes:
        kind: A Condition per owned facet, in the order of `Spaces.facets`.
        beta: β > 0 of all ROBIN facets.
    """

    kind: npt.NDArray[np.int8]
    beta: float = 1.0

    def clean(self, p: Array, flux: Array, stiffness: float) -> tuple[Array, Array]:
        """Replace what the conditions prescribe by its exact value, so that no rule decides on the solver's error.

        Args:
            p: Trace per facet.
            flux: σ·n per facet.
            stiffness: `Data.stiffness`, what β is large or small beside.

        Returns:
            Trace and flux; one of them is exactly 0 on each NO_FLUX or ZERO_TRACE facet, and on ROBIN facets the
            smaller one, which carries the larger relative error, is computed from the other.
        """
        robin = self.kind == Condition.ROBIN
        p = np.where(self.kind == Condition.ZERO_TRACE, 0.0, p)
        flux = np.where(self.kind == Condition.NO_FLUX, 0.0, flux)
        if self.beta > stiffness:
            return np.where(robin, -flux / self.beta, p), flux
        return p, np.where(robin, -self.beta * p, flux)

    def counts(self, comm: MPI.Comm) -> dict[Condition, int]:
        """Number of facets under each condition over all ranks (collective)."""
        local = np.bincount(self.kind, minlength=len(Condition)).astype(np.int64)
        return dict(zip(Condition, comm.allreduce(local).tolist(), strict=True))

    def changes(self, earlier: list[FacetConditions], comm: MPI.Comm) -> npt.NDArray[np.int64]:
        """Number of facets, over all ranks, that differ from each of the earlier conditions (collective)."""
        local = [np.count_nonzero(self.kind != other.kind) for other in earlier]
        return comm.allreduce(np.array(local, dtype=np.int64))
