"""What a law between opening and pressure on Γ_C adds to the gap of an elastic solution.

A law is −λ ∈ ∂φ(p) with the opening p = g − v_n, the pressure λ = −y_nn and φ convex. The gap identity has

    ∫ φ(g − v_n) + φ*(−λ) + λ(g − v_n)  ≥ 0

on its parts in the place of ∫ λ(g − v_n), which is that of contact. The proof is the same: −λ_u ∈ ∂φ(g − u_n) makes of
(v_n − u_n)(σ_nn − y_nn) this sum less two like it, of (v, σ) and of (u, y), which are not negative by the inequality of
Fenchel and Young.

*Its value, without a quadrature that kinks could deceive.* Let the graph be the same along a facet but for its place.
For a segment with σ-slope β let q be the parabola that φ is there, and φ̂ the convex function that is 0 on the segment
and whose curvature is that by which φ'' exceeds β: then φ ≤ q + φ̂. The integral of q is exact; v is a polynomial with
coefficients v_k in Bernstein's basis B_k, so ∫ φ̂(p) ≤ Σ φ̂(p_k) ∫ B_k. The least such sum over all segments is taken. It
is exact where p stays on one segment. φ* has the graph with its axes exchanged, and the pressure, linear on the facet,
is bounded in the same way. Where the data change the graph along a facet the integral is by quadrature.

*v.* Under the law of each facet v minimises the same with q of the segment on which σ_h is, exactly, with the bounds of
p, and with the kinks where the pressure jumps, at the coefficients.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.certificate.laws import LawPoints, gap, half_gap
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.discrete.datum import DEGREES, quadrature_degree
from signorini_fenicsx.discrete.part_laws import chains_of
from signorini_fenicsx.discrete.points import FacetPoints, facet_quadrature
from signorini_fenicsx.physics.elasticity.discrete.boundary_nodes import ContactCoefficients
from signorini_fenicsx.physics.elasticity.discrete.normal_laws import NormalLaw
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces

NONE = -1


@dataclass(frozen=True)
class LawOnFacets:
    """A law on those of its facets on which a displacement is, with the chain of each facet.

    Attributes:
        law: The law.
        rows: Which facets of the contact coefficients they are.
        chains: The graph of each facet, the mean of those of its vertices.
        at_points: The graph in each point of a quadrature.
        basis: Bernstein's basis there, shape (facets, points, coefficients).
        hats: The hats of the vertices there, shape (facets, points, d).
        weights: Of the quadrature, their sum is the measure of the facet, shape (facets, points).
        segment: The segment near which v is.
    """

    law: NormalLaw
    rows: Indices
    chains: Chains
    at_points: LawPoints[FacetPoints]
    basis: Array
    hats: Array
    weights: Array
    segment: Indices

    @classmethod
    def of(
        cls, spaces: ElasticSpaces, contact: ContactCoefficients, law: NormalLaw, chains: Chains, segment: Indices
    ) -> "LawOnFacets":
        """The law on its facets (collective).

        Args:
            spaces: The spaces.
            contact: The coefficients of displacements on Γ_C.
            law: The law.
            chains: The graph at each vertex of Γ_C.
            segment: The segment of each, shape (facets, d).
        """
        rows = np.flatnonzero(np.isin(contact.rows, law.rows))
        facets, dim = contact.facets.take(rows), spaces.dim
        degree = quadrature_degree(*law.data.values(), power=2)
        points = facet_quadrature(spaces.mesh, facets.facets, min(degree + 2 * contact.degree, DEGREES[1]))
        hats = np.column_stack([1 - points.points.sum(axis=1), points.points])
        lam = np.moveaxis(hats[:, facets.ranking], 0, 1)
        basis = contact.basis(lam[:, :, 1:].reshape(-1, dim - 1)).reshape(*lam.shape[:2], contact.nodes.shape[1])
        sites = dim * contact.rows[rows][:, None] + np.arange(dim)
        corners = law.graph(points)
        number = len(corners.corners)
        means = [getattr(chains, name)[sites].mean(axis=1) for name in ("p", "flux", "slope")]
        p, flux, slope = means[0][:, :number], means[1][:, :number], means[2][:, : number + 1]
        slopes = np.take_along_axis(chains.slope[sites], segment[contact.rows[rows]][:, :, None], axis=2)[:, :, 0]
        nearest = np.argmax(np.where(np.isinf(slopes), NONE, slopes), axis=1)
        return cls(
            law=law,
            rows=rows,
            chains=Chains.through(p, flux, slope[:, 0], slope[:, -1]),
            at_points=LawPoints(points, chains_of(corners, points.shape[0] * points.shape[1])),
            basis=basis,
            hats=lam,
            weights=facets.measure[:, None] * points.weights / points.weights.sum(),
            segment=np.take_along_axis(segment[contact.rows[rows]], nearest[:, None], axis=1)[:, 0],
        )

    def line(self) -> tuple[Array, Array]:
        """β and the pressure at p = 0 of the line on which v is, in the points; beside a vertical one a flat one."""
        slope, value = self.at_points.on(self.segment)
        upright = np.isinf(slope)  # beside it the flat line goes through one of its ends
        beside = self.at_points.flux_at(np.where(self.segment < self.chains.corners, self.segment, self.segment - 1))
        return np.where(upright, 0.0, slope), np.where(upright, beside, value)

    def kinks(self) -> list[tuple[Array, Array, Array]]:
        """The opening, the jump of the pressure and on which side of v's line it is (1 for smaller p), of each facet.

        The jump is infinite where the opening is bounded, and 0 where there is none.
        """
        kinks_of_segments = []
        for segment in range(self.chains.corners + 1):
            upright = np.isinf(self.chains.slope[:, segment])
            corner = min(segment, self.chains.corners - 1)
            if 0 < segment < self.chains.corners:
                jump = self.chains.flux[:, segment - 1] - self.chains.flux[:, segment]
            else:
                jump = np.full(len(upright), np.inf)
            smaller = (self.segment > segment) | ((self.segment == segment) & (segment < self.chains.corners))
            side = np.where(smaller, 1.0, -1.0)
            kinks_of_segments.append((self.chains.p[:, corner], np.where(upright, jump, 0.0), side))
        return kinks_of_segments

    def integrals(self, p: Array, pressure: Array, *, half: bool = False) -> Array:
        """The integral of φ(p) + φ*(−λ) + λp over each facet, or a bit more, measured from the references.

        Args:
            p: Coefficients of p in Bernstein's basis, shape (facets, coefficients).
            pressure: λ at the vertices, shape (facets, d).
            half: Whether half of it is taken where p and λ are on one slope, as for quantities, see `half_gap`.
        """
        at = np.einsum("fqk,fk->fq", self.basis, p), np.einsum("fqa,fa->fq", self.hats, pressure)
        if not self.law.moves_only():
            return np.asarray((self.weights * self.at_points.areas(half_gap if half else gap, *at)).sum(axis=1))
        total = (self.weights * at[0] * at[1]).sum(axis=1)
        exchanged = _exchanged(self.chains)
        for chains, values, basis, inside in (
            (self.chains, p, self.basis, at[0]),
            (exchanged, pressure, self.hats, at[1]),
        ):
            share = np.einsum("fq,fqk->fk", self.weights, basis)
            total += _least_above(chains, values, share, inside, self.weights)
        return np.maximum(total, 0.0) * (np.where(self._on_one_slope(p, pressure), 0.5, 1.0) if half else 1.0)

    def energies(self, p: Array) -> Array:
        """The integral of φ(p) over each facet, or as much more as in `integrals`; φ ≥ 0 is 0 at the reference.

        Args:
            p: As for `integrals`, shape (facets, coefficients).
        """
        at = np.einsum("fqk,fk->fq", self.basis, p)
        if not self.law.moves_only():
            return np.asarray((self.weights * self.at_points.areas(gap, at, np.zeros(at.shape))).sum(axis=1))
        share = np.einsum("fq,fqk->fk", self.weights, self.basis)
        return _least_above(self.chains, p, share, at, self.weights)

    def _on_one_slope(self, p: Array, pressure: Array) -> Array:
        """Mask of the facets on which all of p and λ are on one sloped segment."""
        chains, on_one = self.chains, np.zeros(len(p), dtype=bool)
        ends, fluxes = chains.ends
        for segment in range(chains.corners + 1):
            slope, (begin, end) = chains.slope[:, segment], (ends[:, [segment + k]] for k in (0, 1))
            high, low = (fluxes[:, [segment + k]] for k in (0, 1))
            inside = ((begin <= p) & (p <= end)).all(axis=1) & ((low <= pressure) & (pressure <= high)).all(axis=1)
            on_one |= inside & (slope > 0) & np.isfinite(slope)
        return on_one


def kinks_on(laws: Sequence[LawOnFacets], openings: Array) -> tuple[Indices, Indices, Array, Array, Array]:
    """The kinks of the gap in p: facet, coefficient, its side of the line of v, p there, and the largest force.

    For contact these are the bounds of p; see `LawOnFacets.kinks`.

    Args:
        laws: The laws on the facets, but for contact.
        openings: p of each coefficient, shape (facets, coefficients).
    """
    number = openings.shape[1]
    plain = np.setdiff1d(np.arange(len(openings)), np.concatenate([[], *(law.rows for law in laws)]))
    ones = np.ones(len(plain))
    kinks = [(plain.astype(np.int64), ones, 0 * ones, np.full((len(plain), number), np.inf))]
    for law in laws:
        share = np.einsum("fq,fqk->fk", law.weights, law.basis)
        for corner, jump, side in law.kinks():
            some = np.flatnonzero(jump > 0)
            kinks.append((law.rows[some], side[some], corner[some], jump[some, None] * share[some]))
    rows, sides, corners = (np.repeat(np.concatenate([each[k] for each in kinks]), number) for k in range(3))
    most = np.concatenate([each[3] for each in kinks]).ravel()
    return rows, np.tile(np.arange(number), len(rows) // max(number, 1)), sides, corners, most


def _exchanged(chains: Chains) -> Chains:
    """The graphs with their axes exchanged."""
    with np.errstate(divide="ignore"):
        before, beyond = 1 / chains.slope[:, -1], 1 / chains.slope[:, 0]
    return Chains.through(chains.flux[:, ::-1], chains.p[:, ::-1], before, beyond)


def _least_above(chains: Chains, coefficients: Array, share: Array, inside: Array, weights: Array) -> Array:
    """The least of the bounds of ∫ φ(t) by the parabolas of all segments, for a t of each facet.

    Args:
        chains: The graph of each facet.
        coefficients: Of t in a basis of functions ≥ 0 that add up to 1, shape (facets, coefficients).
        share: Their integrals.
        inside: t in the points of a quadrature that is exact for its square, shape (facets, points).
        weights: Of the quadrature.
    """
    least = np.full(len(coefficients), np.inf)
    low, high, *_ = chains.extent()
    t = np.clip(coefficients, low[:, None], high[:, None])  # but for rounding they are so
    upright = np.isinf(chains.slope).all(axis=1)  # t is at the only corner
    for segment in range(chains.corners + 1):
        slope, value = chains.slope[:, segment], chains.value[:, segment]
        finite = np.isfinite(slope)
        usable, slope, value = finite | upright, np.where(finite, slope, 0.0), np.where(finite, value, 0.0)
        corner = chains.p[:, min(segment, chains.corners - 1)]
        start = gap(chains, corner, np.zeros(len(corner))) + value * corner - slope * corner**2 / 2
        parabola = start[:, None] - value[:, None] * inside + slope[:, None] * inside**2 / 2
        total = (weights * parabola).sum(axis=1) + (share * _steeper(chains, segment, slope, t)).sum(axis=1)
        least = np.where(usable, np.minimum(least, total), least)
    return least


def _steeper(chains: Chains, segment: int, slope: Array, t: Array) -> Array:
    """φ̂ of a segment with these slopes at t, shape (facets, coefficients)."""
    conjugate = np.zeros_like(t)
    with np.errstate(invalid="ignore"):
        for other in range(chains.corners + 1):
            side = 1.0 if other > segment else -1.0
            if other == segment:
                continue
            begin = chains.p[:, [other - 1 if side > 0 else other]]  # the end of it that is nearer to the segment
            ends = (side > 0 and other == chains.corners) or (side < 0 and other == 0)
            far = side * np.inf if ends else chains.p[:, [other if side > 0 else other - 1]]
            upright = np.isinf(chains.slope[:, [other]])
            excess = np.where(upright, 0.0, np.maximum(chains.slope[:, [other]] - slope[:, None], 0.0))
            past, beyond = (np.maximum(side * (t - each), 0.0) for each in (begin, far))
            conjugate += excess / 2 * (past**2 - beyond**2)
            if not ends:
                corners = chains.flux[:, [other - 1]] - chains.flux[:, [other]]
                conjugate += np.where(upright, corners * past, 0.0)
    return conjugate
