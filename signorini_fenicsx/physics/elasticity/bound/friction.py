"""What friction, and springs along joints, add to the gap of an elastic solution: ∫ φ(s) + φ*(y_t) + y_t·s ≥ 0.

s = v_t − w₀ is the slip of v after that of the last step, |y_t| ≤ g, φ(s) = g|s| without springs, and φ* = 0. With
springs of stiffness k it is φ(s) = min_w ½k|s − w|² + g|w|, φ*(y) = |y|²/2k, see `discrete/joints.py`, and the proof is
that of a law in `laws`. So ∫ φ(s) is at most ∫ ½k|s − w|² + g|w| for any w. Here w is a polynomial as s is, and the
first term is exact; the second is bounded as friction is, see `FacetCoefficients.lengths`. The w of a facet is found by
a few steps of a proximal gradient method, in which ∫ ½k|a|² ≤ Σ ½k_B|a_B|² with k_B = ∫ kB for Bernstein's basis. k is
linear on the facet, and 1/k at most the linear function with its values at the vertices.

*v.* With z = −y_t/k the sum of φ*(y_t), y_t·s and the first term is ∫ ½k|s − w − z|² + y_t·w. The same bound by
coefficients depends on each of them alone. With f_B = ∫ y_tB it is f_B·s_B + h(s_B − z_B − f_B/k_B), but for constants,
where h(t) is the least of ½k_B|t − w|² + ∫gB |w|: a term of `active_terms` that gives way.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.discrete.linear_traces import linear_from_means
from signorini_fenicsx.physics.elasticity.discrete.boundary_nodes import ContactCoefficients
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.friction import shortened
from signorini_fenicsx.physics.elasticity.discrete.on_facets import facet_rule
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces

STEPS = 30
"""Of the proximal gradient method; where a facet slips or sticks as a whole it begins at its end."""


def moments_of(contact: ContactCoefficients) -> Array:
    """∫ φ_a B over a facet of measure 1 for the hats of its vertices and the B of each of its nodes, (d, nodes)."""
    points, weights = facet_rule(contact.facets.vertices.shape[2], contact.degree)
    hats = np.column_stack([1 - points.sum(axis=1), points])
    return np.einsum("q,qa,qk->ak", weights / weights.sum(), hats, contact.basis(points))


@dataclass(frozen=True)
class FrictionOfDisplacement:
    """Friction on the facets on which a displacement is.

    Attributes:
        contact: The coefficients of the displacement on Γ_C.
        rows: The facets with friction among them,
        in_rough: and in `ElasticSpaces.rough`.
        tangents: See `ElasticSpaces.tangents`.
        bound: G at their corners, shape (facets, d).
        shear: y_t there, shape (facets, d, d − 1).
        before: The coefficients of the slip of the last step and of tools, linear on each facet, (facets, nodes, d).
        springs: The springs along joints.
    """

    contact: ContactCoefficients
    rows: Indices
    in_rough: Indices
    tangents: Array
    bound: Array
    shear: Array
    before: Array
    springs: "SpringsOfDisplacement"

    @classmethod
    def of(
        cls, spaces: ElasticSpaces, data: ElasticData, contact: ContactCoefficients, shear: Array
    ) -> "FrictionOfDisplacement":
        """The friction beside a stress with this shear on the facets of `ElasticSpaces.rough`."""
        rows = np.flatnonzero(np.isin(contact.rows, spaces.rough_rows))
        in_rough, friction = np.searchsorted(spaces.rough_rows, contact.rows[rows]), data.friction
        before = linear_from_means(spaces.along(data.slip_before)[in_rough])
        stiffness = np.full((len(spaces.rough_rows), spaces.dim), np.inf)
        if friction.springs is not None:
            stiffness = friction.springs.stiffness
        bound, of_y = (contact.at_corners(each[in_rough], rows) for each in (friction.bound, shear))
        return cls(
            contact=contact,
            rows=rows,
            in_rough=in_rough,
            tangents=spaces.tangents[in_rough],
            bound=bound,
            shear=of_y,
            before=np.asarray(contact.hats @ contact.at_corners(before, rows)),
            springs=SpringsOfDisplacement.of(contact, rows, stiffness[in_rough], bound, of_y),
        )

    @property
    def measure(self) -> Array:
        """The measure of each facet."""
        return np.asarray(self.contact.facets.measure[self.rows])

    @cached_property
    def weights(self) -> Array:
        """∫ gB for the B of each coefficient, shape (facets, nodes)."""
        return self.measure[:, None] * (self.bound @ moments_of(self.contact))

    @cached_property
    def forces(self) -> Array:
        """−∫ y_tB likewise, shape (facets, nodes, d)."""
        shear = np.einsum("nak,nki->nai", self.shear, self.tangents)
        return -np.einsum("n,nai,ak->nki", self.measure, shear, moments_of(self.contact))

    def slips(self, v: fem.Function) -> Array:
        """The coefficients of s, shape (facets, nodes, d − 1)."""
        slips = self.contact.jump(v.x.array.reshape(-1, self.tangents.shape[2]))[self.rows] - self.before
        return np.einsum("nki,nmi->nkm", slips, self.tangents)

    def rubbed(self, slips: Array) -> Array:
        """A bound of ∫ φ(s) over each facet, from the coefficients of s."""
        slipped = self.springs.slipped(slips)
        means = self.contact.lengths(slipped, self.bound, moments_of(self.contact))
        return np.asarray(self.measure * means + self.springs.sprung(slips - slipped))

    def gap(self, v: fem.Function, *, half: bool) -> Array:
        """The gap of each facet, or a bit more; `half` as in `LawOnFacets.integrals`."""
        slips = self.slips(v)
        works = np.einsum("n,ak,nam,nkm->n", self.measure, moments_of(self.contact), self.shear, slips, optimize=True)
        whole = self.rubbed(slips) + self.springs.stored + works
        if not half:
            return whole
        on_springs = self.springs.somewhere & ~self.springs.slipped(slips).any(axis=(1, 2))
        return np.where(on_springs, 0.5, 1.0) * whole

    def lengths(self, v: fem.Function, facets: int) -> Array:
        """‖s‖ on so many facets of `ElasticSpaces.rough`; 0 where v is not."""
        norms, (points, weights) = np.zeros(facets), facet_rule(self.tangents.shape[2], 2 * self.contact.degree)
        slips = np.einsum("qk,nkm->nqm", self.contact.basis(points), self.slips(v))
        squares = np.einsum("q,nqm->n", weights / weights.sum(), slips**2)
        np.add.at(norms, self.in_rough, self.measure * squares)
        return np.sqrt(norms)


@dataclass(frozen=True)
class SpringsOfDisplacement:
    """The springs along joints on facets with friction.

    Attributes:
        somewhere: Mask of the facets with springs; on others the stiffness is ∞, and what is not for it is 0.
        mass: ∫ kBB' for Bernstein's basis, shape (facets, nodes, nodes).
        stiffness: k_B, shape (facets, nodes).
        shift: z_B + f_B/k_B, shape (facets, nodes, d − 1).
        apart: The part of the gap without v that goes with it, of each facet.
        stored: ∫ φ*(y_t), of each facet.
        reach: The coefficients of g/k, shape (facets, nodes).
        most: ∫gB/k_B likewise.
    """

    somewhere: Mask
    mass: Array
    stiffness: Array
    shift: Array
    apart: Array
    stored: Array
    reach: Array
    most: Array

    @classmethod
    def of(
        cls, contact: ContactCoefficients, rows: Indices, stiffness: Array, bound: Array, shear: Array
    ) -> "SpringsOfDisplacement":
        """The springs on these rows of facets, of this stiffness at the vertices of whole facets; g, y_t at corners."""
        some, (points, weights) = np.isfinite(stiffness).all(axis=1), facet_rule(shear.shape[1], 2 * contact.degree + 1)
        springs = contact.at_corners(np.where(some[:, None], stiffness, 1.0), rows)
        basis, hats = contact.basis(points), np.column_stack([1 - points.sum(axis=1), points])
        weights = np.where(some, contact.facets.measure[rows], 0.0)[:, None] * weights / weights.sum()
        mass = np.einsum("nq,nq,qk,ql->nkl", weights, springs @ hats.T, basis, basis, optimize=True)
        lumped, sizes = np.where(some[:, None], mass.sum(axis=2), np.inf), np.where(some[:, None], weights @ basis, 1.0)
        moments = np.einsum("nq,nqm,qk->nkm", weights, hats @ shear, basis, optimize=True)
        stored = np.einsum("nq,nq,nqm->n", weights, (1 / springs) @ hats.T, (hats @ shear) ** 2, optimize=True) / 2
        middle = springs.mean(axis=1)[:, None]
        away = (moments / sizes[:, :, None] - contact.hats @ shear) / middle[:, :, None]
        return cls(
            somewhere=some,
            mass=mass,
            stiffness=lumped,
            shift=np.where(some[:, None, None], away, 0.0),
            apart=2 * stored - ((moments**2).sum(axis=2) / (2 * lumped)).sum(axis=1),
            stored=stored,
            reach=bound @ contact.hats.T / middle,
            most=np.einsum("nq,nq,qk->nk", weights, bound @ hats.T, basis, optimize=True) / lumped,
        )

    def slipped(self, slips: Array) -> Array:
        """The coefficients of w near the best one, from those of s, shape (facets, nodes, d − 1)."""
        if not self.somewhere.any():
            return slips
        w = slips - shortened(slips, self.reach)
        for _ in range(STEPS):
            ahead = w + self.mass @ (slips - w) / self.stiffness[:, :, None]
            w = ahead - shortened(ahead, self.most)
        return np.where(self.somewhere[:, None, None], w, slips)

    def sprung(self, given: Array) -> Array:
        """½∫ k|a|² over each facet, from the coefficients of a."""
        return np.asarray(np.einsum("nkl,nkm,nlm->n", self.mass, given, given, optimize=True) / 2)
