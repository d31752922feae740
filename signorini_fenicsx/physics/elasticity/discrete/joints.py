"""Springs along joints: what they give way, and with friction in space both in one linear law.

u_t is what the springs give way and what slips: u_t = w − σ_t/k with the stiffness k. Friction is between w and σ_t. So
with s = u_t − w₀ after the slip w₀ of earlier steps the potential of the joint, and that of its shear, are

    φ(s) = min_w ½k|s − w|² + g|w|,   φ*(τ) = |τ|²/2k for |τ| ≤ g,   ∞ for others:

what `bound/friction.py` adds to the gap. σ_t is linear on a facet, so the means of σ_t/k by the hats of its vertices
are Cσ_t with a symmetric matrix C for each facet, and w of the vertices is u_t + Cσ_t. In the plane `VertexLaws` has
that.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.physics.elasticity.discrete.on_facets import facet_rule


@dataclass(frozen=True)
class SpringsAlong:
    """The springs along joints.

    Attributes:
        stiffness: k at the vertices of the facets with friction, ∞ where there are none, shape (facets, d).
        data: The k that are given, each with its name and the rows where it holds.
    """

    stiffness: Array
    data: Sequence[tuple[str, Datum, Indices]] = ()

    @cached_property
    def somewhere(self) -> Mask:
        """Mask of the facets with springs."""
        return np.asarray(np.isfinite(self.stiffness).all(axis=1))

    @cached_property
    def compliances(self) -> Array:
        """C for the vertices of each facet, 0 without springs, shape (facets, d, d)."""
        dim = self.stiffness.shape[1]
        points, weights = facet_rule(dim, 2)
        hats = np.column_stack([1 - points.sum(axis=1), points])
        means = dim * np.einsum("q,qi,qj,qa->ija", weights / weights.sum(), hats, hats, hats)
        return np.einsum("ija,na->nij", means, 1 / self.stiffness)

    def left(self, slip: Array, shear: Array) -> Array:
        """The w of vertices from u_t and σ_t there, shape (facets, d, d − 1); in the plane both are on the graph."""
        if slip.shape[1] == 2:
            return slip + shear / self.stiffness[:, :, None]
        return slip + np.einsum("nij,njk->nik", self.compliances, shear)

    def in_series(self, sticks: Mask, stiffness: Array, forces: Array, slopes: Array) -> tuple[Array, Array, Array]:
        """A linear law σ_t = f − Sw of vertices in space with these springs: S, f and what goes with it, of u_t then.

        Where vertices stick, w = 0 in the place of the law. On facets without springs all is as it was.

        Args:
            sticks: Mask of the vertices that stick, shape (facets, 3).
            stiffness: S, shape (facets, 6, 6).
            forces: F, shape (facets, 6, 1).
            slopes: Derivatives of f, shape (facets, 6, 3).
        """
        some, one = self.somewhere, np.eye(6)
        stuck, springs = np.repeat(sticks[some], 2, axis=1), np.repeat(self.stiffness[some], 2, axis=1)
        of_law, compliance = stiffness[some], np.kron(self.compliances[some], np.eye(2))
        size = 1 / (1 + np.einsum("nii->ni", of_law) / springs)  # of the equation of a row
        free, held = (np.where(stuck, *each)[:, :, None] for each in ((0.0, size), (springs, 0.0)))
        law = held * compliance + free * (one + of_law @ compliance)
        sprung = np.linalg.solve(law, held * one + free * of_law)
        results = stiffness.copy(), forces.copy(), slopes.copy()
        results[0][some] = (sprung + sprung.swapaxes(1, 2)) / 2
        for result, given in zip(results[1:], (forces, slopes), strict=True):
            result[some] = np.linalg.solve(law, free * given[some])
        return results
