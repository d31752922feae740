"""What the laws on Γ_S add to the gap, and a flux η that stands for y·n there.

Where the data of a law vary within a facet, y·n is not in the range [s_lo, s_hi] of the graph in all points, and on a
sloped segment s(v) varies with v, see `certificate.laws`. Let η have y·n as its mean on each facet. Then r = η − y·n is
a load like f − f_h, see `oscillation`: for the problem with −σ·n ∈ ∂φ(u) + r on Γ_S, y and v have the gap of η, and the
solution of this problem differs from u by at most osc. With b = θs(v), but b = 0 on facets of vertical segments, and c
such that the mean is y·n,

    η = b + c, but at least s_lo and at most s_hi.

On a vertical segment s_lo and s_hi are its ends, if y·n is between their means: beyond an end the gap would grow with
the length of the next segment. θ = 1/(1 + βC_e²) with C_e of `local_fields` makes the sum of 2 gap and osc² least.

*Water-filling.* Under the Signorini law, s_lo = q_S and s_hi = ∞, of a flux with y·n ≥ the mean of q_S, r is 0 in
contact where y·n is larger than q_S, however much q_S varies; on a facet without contact r is q_S minus its mean.
On slaves of pairs η is y·n, as on masters r would have other means.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.certificate.laws import Area, LawPoints, gap, with_mean
from signorini_fenicsx.contact.chains import Chains, joined
from signorini_fenicsx.contact.law import Graph, Values
from signorini_fenicsx.contact.laws import Signorini
from signorini_fenicsx.discrete.datum import DEGREES, Datum, quadrature_degree
from signorini_fenicsx.discrete.part_laws import PartLaw
from signorini_fenicsx.discrete.points import FacetPoints, Points, in_facets
from signorini_fenicsx.physics.diffusion.bound.local_fields import CellMetric, FacetLoad, facet_constants
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solution import Solution


@dataclass(frozen=True)
class Penalised(Signorini):
    """The law of a penalty: with slopes on both sides of the corner."""

    before: float = np.inf
    beyond: float = 0.0

    def graph(self, values: Values) -> Graph:
        """The corner is that of the Signorini law."""
        return replace(super().graph(values), before=self.before, beyond=self.beyond)


@dataclass(frozen=True)
class Goal:
    """The problem to whose solution a certificate bounds the distance.

    Attributes:
        parts: Each law and where it holds.
        chains: The law of each facet by means, measured from `Data.psi_h` and `Data.q_Sh`.
        flux_h: `Data.q_Sh`.
        plain: Whether that is the Signorini problem of ψ and q_S.
        of_penalty: Whether that is the problem of a penalty.
    """

    parts: tuple[PartLaw, ...]
    chains: Chains
    flux_h: Array
    plain: bool
    of_penalty: bool = False

    @classmethod
    def of(cls, solution: Solution, *, for_signorini: bool) -> Goal:
        """The problem that a solution approximates, or the Signorini problem also for a penalty."""
        laws, flux_h, penalty = solution.data.laws, solution.data.q_Sh, solution.method.penalty
        if penalty is None or for_signorini:
            return cls(laws.of_parts, laws.chains, flux_h, plain=not laws.listed)
        slopes = penalty.slopes(solution.options.eps)
        kept = np.isinf(slopes[0])  # ψ is still a bound
        parts = tuple(
            replace(
                part,
                law=Penalised(part.law.parts, 0.0, 0.0, *slopes),
                bounds=part.bounds if kept else (None, None),
            )
            for part in laws.of_parts
        )
        chains = laws.chains.with_penalty(penalty, solution.options.eps)
        return cls(parts, chains, flux_h, plain=False, of_penalty=True)

    def at(
        self, spaces: Spaces, points: Array, weights: Array | None = None, corners: tuple[PartLaw, Array] | None = None
    ) -> LawPoints[FacetPoints]:
        """Points in all facets of Γ_S with the law in each (collective).

        `corners` has a part of Signorini's law and what stands for its q_S in the points, shape (facets, points).
        """
        of_parts, number = [], len(points)
        for part in self.parts:
            some = in_facets(spaces.mesh, spaces.facets[part.rows], points, weights)
            rows = (number * part.rows[:, None] + np.arange(number)).ravel()
            if corners is not None and part is corners[0]:
                psi, ends = part.data["psi"].values(some).reshape(-1, 1), np.zeros(len(rows))
                chains = Chains.through(psi, corners[1].reshape(-1, 1), ends + np.inf, ends)
            else:
                chains = part.chains(some, None if weights is None else self.flux_h[part.rows])
            of_parts.append((rows, chains))
        everywhere = in_facets(spaces.mesh, spaces.facets, points, weights)
        return LawPoints(everywhere, joined(of_parts, number * len(spaces.facets)))

    def degree(self) -> int:
        """Degree of a quadrature on Γ_S."""
        return max(quadrature_degree(*part.data.values(), power=2) for part in self.parts)

    def degree_of_gap(self, u_D: Datum) -> int:
        """Degree of a quadrature on Γ_S for the gap, where v may contain u_D."""
        return max(
            max(quadrature_degree(part.data["q_S"], power=2), quadrature_degree(part.data["psi"], u_D))
            if type(part.law) is Signorini
            else quadrature_degree(*part.data.values(), power=2)
            for part in self.parts
        )

    @property
    def keeps_flux(self) -> bool:
        """Whether y·n stays as it is: under Signorini's law alone with numbers q_S."""
        return all(type(part.law) is Signorini and part.data["q_S"].number is not None for part in self.parts)

    def enclosed(self, spaces: Spaces) -> PartLaw | None:
        """The part whose data can be enclosed: with Signorini's law, if the data of all others are polynomials.

        None if there are more, or facets inside the domain or opposite to others, where v would have to be a jump.
        """
        rough = [part for part in self.parts if any(map(is_rough, part.data.values()))]
        alone = len(rough) == 1 and type(rough[0].law) is Signorini and not spaces.inner.present
        slaves = {name for pair in spaces.pairs for name in pair.parts.slave}
        return rough[0] if alone and slaves.isdisjoint(rough[0].law.parts) else None


def trace_on(slope: Array, value: Array, flux: Array) -> Array:
    """The u of lines at which they have this σ·n: on vertical ones what they hold, 0 on flat ones."""
    sloped = (slope > 0) & np.isfinite(slope)
    return np.where(np.isinf(slope), value, np.divide(value - flux, slope, out=np.zeros(slope.shape), where=sloped))


def pieces_beside(law: Chains, segment: Indices, flux: Array, rigid: Mask) -> Indices:
    """The segment near which v is at each site: its own, or that beside a rigid one which σ·n is nearer to."""
    rows = np.arange(len(segment))
    left, right = np.maximum(segment - 1, 0), np.minimum(segment, law.corners - 1)
    above, below = law.flux[rows, left] - flux, flux - law.flux[rows, right]
    before = (segment > 0) & ((segment == law.count) | (above < below))
    beside = np.where(before, segment - 1, np.minimum(segment + 1, law.count))
    return np.where(rigid[rows, segment], beside, segment)


def held_beyond(piece: Indices, held: Mask) -> tuple[Indices, Indices]:
    """The nearest held segment before the piece of each site, −1 if none is, and beyond it, their number if none is."""
    column, number = np.arange(held.shape[1]), held.shape[1]
    before, beyond = held & (column < piece[:, None]), held & (column > piece[:, None])
    return np.where(before, column, -1).max(axis=1), np.where(beyond, column, number).min(axis=1)


def ends_beside(
    at: LawPoints, segment: Indices, piece: Indices, holding: Mask, held: Mask, only: Mask, value: Array
) -> tuple[Array, Array]:
    """Between which u v should be for the sake of its piece, in points of facets or cells, infinite where it is free.

    It is between the nearest segments that hold v before and beyond the piece: to their corners, or where that is the
    segment of a facet or cell that is held to where it holds v.

    Args:
        at: The points.
        segment: The segment of each facet or cell.
        piece: The one that v is near.
        holding: The segments that hold v, shape (n, segments).
        held: Where v is held by its segment.
        only: Where no other segment is beside.
        value: At which it is held, shape (n, points).
    """
    last, (before, beyond) = holding.shape[1] - 1, held_beyond(piece, holding)
    sides = (
        (before >= 0, piece > segment, at.traces(np.maximum(before, 0))[1], -np.inf),
        (beyond <= last, piece < segment, at.traces(np.minimum(beyond, last))[0], np.inf),
    )
    low, high = (
        np.where((near | only)[:, None], np.where((held & (past | only))[:, None], value, corner), free)
        for near, past, corner, free in sides
    )
    return low, high


@dataclass(frozen=True)
class LawGap:
    """What the laws add to the gap and to the oscillation.

    Attributes:
        points: Points of a quadrature in the facets of Γ_S.
        density: φ(v) + φ*(−η) + ηv there, shape (facets, points).
        load: η − y·n.
    """

    points: FacetPoints
    density: Array
    load: FacetLoad

    @classmethod
    def of(
        cls,
        spaces: Spaces,
        metric: CellMetric,
        at: LawPoints[FacetPoints],
        v: Array,
        flux: Array,
        tilt: Array,
        ends: tuple[Array, Array],
        piece: tuple[Array, Array],
        missed: Array,
        area: Area = gap,
    ) -> LawGap:
        """Choose the flux η for these laws.

        Args:
            spaces: The discrete spaces.
            metric: Metric of the owned cells.
            at: Points of a quadrature in all facets of Γ_S.
            v: v there, shape (facets, points).
            flux: Mean of y·n per facet.
            tilt: y·n less this in the points.
            ends: The least and the largest η in the points.
            piece: β and s(v) on the segment near which v is, in the points; 0 for vertical ones.
            missed: What the laws in the points do not show of η, see `FacetLoad`.
            area: The density.
        """
        points = at.points
        constant = facet_constants(metric, points.cells, spaces.facet_measure)
        slope, wanted = piece
        theta = 1 / (1 + slope.mean(axis=1) * constant**2)
        kept = np.where(slope > 0, 1 - theta[:, None], 1.0) * tilt
        eta = with_mean(theta[:, None] * wanted + kept, *ends, flux, points.weights)
        density = at.areas(area, v, eta)
        rest = eta - flux[:, None] - tilt
        rest[spaces.slave_rows] = 0.0  # but for rounding, see `OnGammaS.beyond`
        return cls(points, density, FacetLoad(points, rest, missed))

    def loads(self, spaces: Spaces) -> list[FacetLoad]:
        """The load, and the opposite one on the other sides of facets inside the domain (collective)."""
        if not spaces.inner.present:
            return [self.load]
        across, order = self.points.across(spaces.inner.rows, spaces.inner.facets)
        values = -np.take_along_axis(self.load.values[spaces.inner.rows], np.argsort(order, axis=1), axis=1)
        return [self.load, FacetLoad(across, values, np.zeros(len(values)))]

    def per_cell(self, number: int) -> Array:
        """Twice its integral, per owned cell of so many."""
        return self.points.per_cell(2 * self.points.integrals(self.density), number)


def energies(part: PartLaw, points: Points, u: Array, flux_h: Array | None = None) -> Array:
    """φ(u) in points of a law, for u that it allows but for rounding; −κ∇u·n, in regions s, is the slope of φ.

    φ is −σu at the reference (u, σ) of the graph, and for this σ nowhere less than −σu. So it is −q_S u under the law
    of Signorini, g|u| of friction, and 0 where a wall is not touched.

    Args:
        part: The law.
        points: Points of its facets or cells, as for `PartLaw.chains`.
        u: Shape (n, points).
        flux_h: As for `PartLaw.chains`.
    """
    flux = np.reshape(part.falling(points, flux_h).reference[1], points.shape)
    return LawPoints(points, part.chains(points, flux_h)).areas(gap, u, flux) - flux * u


def is_rough(datum: Datum) -> bool:
    """Whether the square of a datum is not integrated exactly."""
    return datum.polynomial is None or 2 * datum.polynomial > DEGREES[1]


def not_polynomial(parts: Iterable[PartLaw]) -> set[str]:
    """The data of the laws whose integrals are by quadrature only."""
    return {part.key(name) for part in parts for name, datum in part.data.items() if is_rough(datum)}
