"""One condition per site: with these each step of every algorithm is a linear problem.

A site has one pair (p, σ·n). It is a facet of Γ_S or, for conforming P1, a vertex. With laws in Ω each cell is a site
as well, with u_T less a reference for p and −s_T, of an obstacle its force, for σ·n. In elastic contact a site is a
vertex of a facet of Γ_C, with the opening and the pressure; those with friction have one more for each tangent.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask

type Kinds = npt.NDArray[np.int8]
"""A `Condition` per site of this rank."""


class Condition(IntEnum):
    """What holds on a site: σ·n = v, p = v, or σ·n + βp = v; v is 0 but for laws with more than one corner."""

    NO_FLUX = 0
    ZERO_TRACE = 1
    ROBIN = 2


class Penalty(Enum):
    """The two penalty laws on Γ_S.

    Each is the Signorini condition with one quantity shifted, see `shift`:
    TRACE, σ·n = [p]_-/ε, means p + εσ·n ≥ 0 and σ·n ≥ 0, one of them being 0;
    FLUX, p = [σ·n]_-/ε, means p ≥ 0 and σ·n + εp ≥ 0, one of them being 0.
    """

    TRACE = "I"
    FLUX = "II"

    def slopes(self, eps: float) -> tuple[float, float]:
        """β before and beyond the corner of the law, ∞ on a vertical segment."""
        return (1 / eps, 0.0) if self is Penalty.TRACE else (np.inf, eps)

    def beta(self, eps: float) -> float:
        """β of σ·n + βp = 0 where the penalty acts."""
        return 1 / eps if self is Penalty.TRACE else eps

    def shift(self, p: Array, flux: Array, eps: float) -> tuple[Array, Array]:
        """The pair (p, σ·n), shifted so that a penalty solution satisfies the Signorini condition."""
        return (p + eps * flux, flux) if self is Penalty.TRACE else (p, flux + eps * p)


@dataclass(frozen=True)
class SiteConditions:
    """Conditions on the sites of this rank.

    Attributes:
        kind: A Condition per owned site, in the order of the backend's sites (for facets that of `Spaces.facets`).
        beta: β > 0 of the ROBIN sites: one number for all, or one per site.
        value: v, one per site; or the number 0.0 on all ranks.
    """

    kind: Kinds
    beta: float | Array = 1.0
    value: float | Array = 0.0

    @classmethod
    def everywhere(cls, kind: Condition, sites: int) -> SiteConditions:
        """One condition on all sites of this rank."""
        return cls(np.full(sites, kind, dtype=np.int8))

    @property
    def has_values(self) -> bool:
        """Whether there may be a v that is not 0; the same on all ranks."""
        return isinstance(self.value, np.ndarray)

    def __getitem__(self, sites: slice) -> SiteConditions:
        """The conditions of some sites."""
        beta, value = (x[sites] if isinstance(x, np.ndarray) else x for x in (self.beta, self.value))
        return SiteConditions(self.kind[sites], beta, value)

    def values_where(self, sites: Mask) -> Array:
        """Values v on some sites."""
        return np.broadcast_to(self.value, self.kind.shape)[sites]

    def beta_where(self, sites: Mask) -> Array:
        """Values of β on some sites."""
        return np.broadcast_to(self.beta, self.kind.shape)[sites]

    def clean(self, p: Array, flux: Array, conductance: float) -> tuple[Array, Array]:
        """Set prescribed values exactly, so that no rule decides by an error of the linear solver.

        Args:
            p: Trace per site.
            flux: σ·n per site.
            conductance: `Data.conductance`, with which β is compared.

        Returns:
            Trace and flux per site. On NO_FLUX and ZERO_TRACE sites one of them is exactly v. On ROBIN sites the
            smaller one has the larger relative error, so it is computed from the other.
        """
        robin, strong = self.kind == Condition.ROBIN, self.beta > conductance
        p = np.where(self.kind == Condition.ZERO_TRACE, self.value, p)
        flux = np.where(self.kind == Condition.NO_FLUX, self.value, flux)
        of_flux, of_trace = (self.value - flux) / self.beta, self.value - self.beta * p
        return np.where(robin & strong, of_flux, p), np.where(robin & ~np.asarray(strong), of_trace, flux)

    def counts(self, comm: MPI.Comm) -> dict[Condition, int]:
        """Number of sites under each condition over all ranks (collective)."""
        local = np.bincount(self.kind, minlength=len(Condition)).astype(np.int64)
        return dict(zip(Condition, comm.allreduce(local).tolist(), strict=True))

    def differ(self, other: SiteConditions) -> Mask:
        """The sites whose condition is not the other one."""
        robin = (self.kind == Condition.ROBIN) & (self.beta != other.beta)
        return (self.kind != other.kind) | robin | (self.value != other.value)

    def changes(self, earlier: list[SiteConditions], comm: MPI.Comm) -> npt.NDArray[np.int64]:
        """Over all ranks, the number of sites that differ from each of the earlier conditions (collective)."""
        local = [np.count_nonzero(self.differ(other)) for other in earlier]
        return comm.allreduce(np.array(local, dtype=np.int64))

    def same(self, other: SiteConditions | None, comm: MPI.Comm) -> bool:
        """Whether two sets of conditions are equal; False if the second one is None (collective)."""
        return other is not None and int(self.changes([other], comm)[0]) == 0
