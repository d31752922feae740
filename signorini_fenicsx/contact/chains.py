"""Monotone laws between p and σ·n as chains of segments, one chain per site.

A law is a graph in the plane of p and σ·n that falls from small p and large σ·n to large p and small σ·n: corners, and
straight segments before, between and beyond them. A segment is vertical, p = a, or has a slope β ≥ 0, σ·n + βp = q;
either is one of the conditions of a linear problem.

*One condition per site*: with these each step of every algorithm is a linear problem.

A site has one pair (p, σ·n). It is a facet of Γ_S or, for conforming P1, a vertex. With laws in Ω each cell is a site
as well, with u_T less a reference for p and −s_T, of an obstacle its force, for σ·n. In elastic contact a site is a
vertex of a facet of Γ_C, with the opening and the pressure; those with friction have one more for each tangent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum, IntEnum

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask

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


@dataclass(frozen=True)
class Chains:
    """A chain per site of this rank; p and σ·n are measured from a point of it, the reference.

    Sites with fewer corners than others have corners at p = ∞, σ·n = −∞, and no site is ever beyond these.

    Attributes:
        p: Trace at each corner, ascending, shape (sites, corners).
        flux: σ·n there, descending.
        slope: β of each segment, ∞ if it is vertical, shape (sites, corners + 1).
        value: p on a vertical segment, σ·n + βp on another.
        plain: Whether all chains, on all ranks, have one corner, and that at the reference: then all values are 0.
    """

    p: Array
    flux: Array
    slope: Array
    value: Array
    plain: bool = False

    @classmethod
    def at_corner(cls, sites: int, before: float = np.inf, beyond: float = 0.0) -> Chains:
        """Chains with one corner at the reference, by default those of Signorini: p ≥ 0, σ·n ≥ 0, one of them 0."""
        corner = np.zeros((sites, 1))
        return cls(corner, corner, np.tile([before, beyond], (sites, 1)), np.zeros((sites, 2)), plain=True)

    @classmethod
    def through(cls, p: Array, flux: Array, before: Array, beyond: Array) -> Chains:
        """Chains through these corners.

        Args:
            p: Ascending, shape (sites, corners), ∞ for corners that a site does not have.
            flux: Descending, shape (sites, corners), −∞ there.
            before: β of the first segment, ∞ if it is vertical, shape (sites,).
            beyond: β of the last one.
        """
        is_corner = np.isfinite(p)
        at, fallen = np.where(is_corner, p, 0.0), np.where(is_corner, flux, 0.0)
        run, fall = np.diff(at, axis=1), -np.diff(fallen, axis=1)
        between = np.divide(fall, run, out=np.full_like(fall + run, np.inf), where=run.real > 0)
        slope = np.column_stack([before, np.where(is_corner[:, 1:], between, 0.0), np.zeros_like(beyond)])
        slope[np.arange(len(p)), is_corner.sum(axis=1)] = beyond
        left = np.maximum(np.arange(slope.shape[1]) - 1, 0)
        vertical = np.isinf(slope)
        value = np.where(vertical, at[:, left], fallen[:, left] + np.where(vertical, 0.0, slope) * at[:, left])
        return cls(p, flux, slope, value)

    def with_penalty(self, penalty: Penalty | None, eps: float) -> Chains:
        """The law of a penalty in the place of that of Signorini."""
        return self if penalty is None else Chains.at_corner(len(self.p), *penalty.slopes(eps))

    @property
    def corners(self) -> int:
        """The largest number of corners of a chain."""
        return self.p.shape[1]

    @property
    def count(self) -> Indices:
        """The number of corners of each chain."""
        return np.isfinite(self.p).sum(axis=1)

    @property
    def ends(self) -> tuple[Array, Array]:
        """The ends of the segments, each in its column and the next one: p and σ·n, shape (sites, corners + 2)."""
        infinite = np.full((len(self.p), 1), np.inf)
        return np.hstack([-infinite, self.p, infinite]), np.hstack([infinite, self.flux, -infinite])

    @property
    def kinds(self) -> Kinds:
        """A `Condition` per segment, shape (sites, corners + 1)."""
        flat = np.where(self.slope == 0, Condition.NO_FLUX, Condition.ROBIN)
        return np.where(np.isinf(self.slope), Condition.ZERO_TRACE, flat).astype(np.int8)

    def conditions(self, segment: Indices) -> SiteConditions:
        """The conditions of one segment of each chain."""
        kind, slope, value = (_chosen(values, segment) for values in (self.kinds, self.slope, self.value))
        beta = np.where(kind == Condition.ROBIN, slope, 1.0)
        return SiteConditions(kind, beta, 0.0 if self.plain else value)

    def segments(self, conditions: SiteConditions, pair: tuple[Array, Array] | None = None) -> Indices:
        """The segment of each chain whose condition this is; the first of its kind if none is quite the same.

        Of several on one line it is the first, or with p and σ·n given that on which p is, on a vertical line σ·n.
        """
        exists = np.insert(np.isfinite(self.p), 0, True, axis=1)  # others have more corners
        same = exists & (self.kinds == conditions.kind[:, None])
        value, beta = (np.broadcast_to(x, conditions.kind.shape)[:, None] for x in (conditions.value, conditions.beta))
        robin = self.kinds == Condition.ROBIN
        alike = same & (self.value == value) & (~robin | (self.slope == beta))
        first = np.argmax(2 * alike + same, axis=1)
        if pair is None:
            return first
        p, flux = (each[:, None] for each in pair)
        of_p, of_flux = (self.p < p).sum(axis=1), (self.flux > flux).sum(axis=1)
        passed = np.where(conditions.kind == Condition.ZERO_TRACE, of_flux, of_p)
        return np.where(_chosen(alike, passed), passed, first)

    def nearest(self, kind: Kinds, p: Array, flux: Array) -> Indices:
        """The segment of each chain that has this kind and whose line is nearest to p and σ·n."""
        off = np.abs(self.residuals(p, flux, np.ones(len(p))))
        return np.argmin(np.where(self.kinds == kind[:, None], off, np.inf), axis=1)

    def beside_reference(self, *, steep: bool) -> Indices:
        """The segment that the reference is on; of two the steeper or the flatter one."""
        before = (self.p < 0) | (self.flux > 0)
        at = (self.p == 0) & (self.flux == 0)
        return (before if steep else before | at).sum(axis=1)

    def towards(self, present: Indices, wanted: Indices) -> Indices:
        """The next segment of each chain on the way from one to another.

        Segments on the line of the first one, and segments that are only a point, are skipped: on one of them the rule
        would send the site back.
        """
        step = np.sign(wanted - present)
        following = present + step
        length = np.ones_like(self.slope, dtype=bool)
        with np.errstate(invalid="ignore"):  # ∞ − ∞ beyond the last corner
            length[:, 1:-1] = (np.diff(self.p, axis=1) != 0) | (np.diff(self.flux, axis=1) != 0)
        for _ in range(self.corners - 1):
            alike = [_chosen(values, following) == _chosen(values, present) for values in (self.slope, self.value)]
            skipped = (alike[0] & alike[1]) | ~_chosen(length, following)
            following = following + step * (skipped & (following != wanted))
        return following

    def steepest(self) -> Indices:
        """The steepest segment of each chain, the first of them."""
        inside = np.arange(self.corners + 1) <= self.count[:, None]
        return np.argmax(np.where(inside, self.slope, -1.0), axis=1)

    def residuals(self, p: Array, flux: Array, unit: Array) -> Array:
        """How far p and σ·n are off the line of each segment, as a flux; one unit of p is so many of σ·n."""
        vertical = np.isinf(self.slope)
        slope = np.where(vertical, 0.0, self.slope)
        of_trace = unit[:, None] * (p[:, None] - self.value)
        of_flux = (flux[:, None] + slope * p[:, None] - self.value) / (1 + slope / unit[:, None])
        return np.where(vertical, of_trace, of_flux)

    def beside(self, present: Indices, p: Array, flux: Array, scales: tuple[Array, Array], tolerance: float) -> Indices:
        """The direction, −1 or 1, in which sites on a corner have a second segment; 0 at sites off corners.

        Args:
            present: The segment that each site is on.
            p: Its trace.
            flux: Its σ·n.
            scales: Sizes > 0 of both.
            tolerance: What is less than this share of them is 0.
        """
        of_p, of_flux = (scale[:, None] for scale in scales)
        off = np.maximum(np.abs(p[:, None] - self.p) / of_p, np.abs(flux[:, None] - self.flux) / of_flux)
        near = np.pad(off <= tolerance, ((0, 0), (1, 1)))  # no corner is before the first segment nor after the last
        direction = np.zeros_like(present)
        for step, corner in ((-1, present), (1, present + 1)):
            other = np.clip(present + step, 0, self.corners)
            same = [_chosen(values, other) == _chosen(values, present) for values in (self.slope, self.value)]
            direction[_chosen(near, corner) & ~(same[0] & same[1])] = step  # a corner may have no bend
        return direction

    def extent(self) -> tuple[Array, Array, Array, Array]:
        """The least and the largest p and the least and the largest σ·n of each chain, infinite ones among them."""
        last = self.count - 1
        beyond = _chosen(self.slope, self.count)
        return (
            np.where(np.isinf(self.slope[:, 0]), self.p[:, 0], -np.inf),
            np.where(np.isinf(beyond), _chosen(self.p, last), np.inf),
            np.where(beyond == 0, _chosen(self.flux, last), -np.inf),
            np.where(self.slope[:, 0] == 0, self.flux[:, 0], np.inf),
        )

    def distances(self, p: Array, flux: Array, unit: Array) -> tuple[Array, Array, Array]:
        """How far p and σ·n are off the chains, in each site.

        Returns:
            By how much p is outside of what any σ·n allows; by how much σ·n is outside of what any p allows; and the
            distance to the graph, as a flux, but for what these two say. One unit of p is so many of σ·n.
        """
        low_p, high_p, low, high = self.extent()
        inner = np.clip(p, low_p, high_p), np.clip(flux, low, high)
        return p - inner[0], flux - inner[1], self.off_segments((p, flux), inner, unit).min(axis=1)

    def off_segments(self, pair: tuple[Array, Array], inner: tuple[Array, Array], unit: Array) -> Array:
        """How far pairs (p, σ·n) are off each segment, shape (sites, corners + 1).

        It is as `residuals` says off its line, or as far as `inner`, which may be another pair, is beyond its ends.
        """
        p, flux = (each[:, None] for each in inner)
        off = np.abs(self.residuals(*pair, unit))
        with np.errstate(invalid="ignore"):
            past = np.maximum(unit[:, None] * (p - self.p), self.flux - flux)
            short = np.maximum(unit[:, None] * (self.p - p), flux - self.flux)
        off[:, :-1] = np.maximum(off[:, :-1], past)
        off[:, 1:] = np.maximum(off[:, 1:], short)
        return off

    def ends_at(self, p: Array) -> tuple[Array, Array]:
        """The largest and the least σ·n at a p per site: they differ on vertical segments; outside those of the ends.

        Corners at p = ∞, which there are on chains with fewer corners than others, do not count.
        """
        rows, last = np.arange(len(p)), np.maximum(self.count - 1, 0)
        ends = []
        for passed in ((self.p < p[:, None]).sum(axis=1), (self.p <= p[:, None]).sum(axis=1)):
            passed = np.minimum(passed, self.count)
            corner = np.clip(passed - 1, 0, last)
            slope = self.slope[rows, passed]
            steep = np.isinf(slope)
            beside = np.where(passed == 0, 0, corner)
            fallen = np.where(steep, 0.0, slope) * np.where(steep, 0.0, p - self.p[rows, beside])
            ends.append(self.flux[rows, beside] - fallen)
        return ends[0], ends[1]

    def plus(self, other: Chains) -> Chains:
        """The chains whose σ·n is the sum of both at equal p, with the corners of both.

        Where p of a corner is outside of what the other chain allows, the corner is moved to the end of it.

        Raises:
            ValueError: If no p is allowed by both chains of a site.
        """
        low, high = (
            np.maximum(self.extent()[0], other.extent()[0]),
            np.minimum(self.extent()[1], other.extent()[1]),
        )
        if np.any(low > high):
            raise ValueError("no p is allowed by both")
        p = np.hstack([self.p, other.p])
        of_self = np.repeat([True, False], [self.corners, other.corners])
        # Corners of this chain come first at equal p: there the other one has not fallen yet, at its own this one has.
        with np.errstate(invalid="ignore"):
            inside = np.where(np.isinf(p), p, np.clip(p, low[:, None], high[:, None]))
        flux = np.empty_like(p)
        for column in range(p.shape[1]):
            at_p = np.where(np.isinf(p[:, column]), 0.0, inside[:, column])
            ends, others = self.ends_at(at_p), other.ends_at(at_p)
            at = self.flux[:, column] if of_self[column] else other.flux[:, column - self.corners]
            moved = at_p != p[:, column]
            at = np.where(moved, (ends if of_self[column] else others)[int(column >= self.corners)], at)
            flux[:, column] = at + (others[0] if of_self[column] else ends[1])
        flux = np.where(np.isinf(p), -np.inf, flux)
        order = np.lexsort((np.broadcast_to(~of_self, p.shape), inside), axis=1)
        inside, flux = (np.take_along_axis(values, order, axis=1) for values in (inside, flux))
        finite = np.isfinite(inside)
        flux = np.where(finite, np.minimum.accumulate(np.where(finite, flux, np.inf), axis=1), -np.inf)
        rows = np.arange(len(p))
        before = self.slope[:, 0] + other.slope[:, 0]
        beyond = self.slope[rows, self.count] + other.slope[rows, other.count]
        return Chains.through(inside, flux, before, beyond)

    def __getitem__(self, sites: slice | np.ndarray) -> Chains:
        """The chains of some sites."""
        return replace(self, p=self.p[sites], flux=self.flux[sites], slope=self.slope[sites], value=self.value[sites])

    def followed_by(self, others: Chains) -> Chains:
        """These chains, and behind them others, of sites of another kind."""
        number = len(self.p) + len(others.p)
        first, behind = np.split(np.arange(number), [len(self.p)])
        return joined([(first, self), (behind, others)], number)


def joined(parts: Sequence[tuple[np.ndarray, Chains]], sites: int) -> Chains:
    """Chains of some sites each, put together.

    Args:
        parts: Which sites, and their chains; all ranks have the same number of them, with the same numbers of corners.
        sites: How many there are on this rank.
    """
    corners = max(chains.corners for _, chains in parts)
    all_of_them = Chains(
        p=np.full((sites, corners), np.inf),
        flux=np.full((sites, corners), -np.inf),
        slope=np.zeros((sites, corners + 1)),
        value=np.zeros((sites, corners + 1)),
        plain=all(chains.plain for _, chains in parts),
    )
    for rows, chains in parts:
        for name in ("p", "flux", "slope", "value"):
            values = getattr(chains, name)
            getattr(all_of_them, name)[rows, : values.shape[1]] = values
    return all_of_them


def _chosen[T: np.generic](values: np.ndarray[tuple[int, int], np.dtype[T]], column: Indices) -> np.ndarray:
    """The entry of each row in a column of its own."""
    return np.take_along_axis(values, column[:, None], axis=1)[:, 0]
