"""What elastic supports add to the gap of an elastic solution, ½∫ K(v − w)·(v − w); see `discrete/supports.py`."""

from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.facet_coefficients import FacetCoefficients
from signorini_fenicsx.discrete.linear_traces import linear_from_means
from signorini_fenicsx.discrete.matrices import OfCells
from signorini_fenicsx.physics.elasticity.bound.condensed import Nodes
from signorini_fenicsx.physics.elasticity.discrete.boundary_nodes import facet_coefficients
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.on_facets import facet_rule
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces, SplitMesh


@dataclass(frozen=True)
class SupportsOfDisplacement:
    """The supports on the facets on which a displacement is.

    Attributes:
        on: The coefficients of the displacement there.
        stiffness: K times the measure of each facet, shape (facets, d, d).
        rest: The coefficients of w, shape (facets, coefficients, d); on walls with slip their velocity is in it.
        wall: Those of the velocity of such walls, 0 elsewhere.
        mass: ∫ BB' over a facet of measure 1 for Bernstein's basis, shape (coefficients, coefficients).
    """

    on: FacetCoefficients
    stiffness: Array
    rest: Array
    wall: Array
    mass: Array

    @classmethod
    def of(
        cls,
        spaces: ElasticSpaces,
        data: ElasticData,
        split: SplitMesh,
        space: fem.FunctionSpace,
        stresses: Array,
        shear: Array,
    ) -> "SupportsOfDisplacement":
        """The supports for displacements in a space on the split mesh or a part of it, w from these stresses.

        On walls with slip friction has the shear, of shape (facets, d, d − 1), and the springs have the rest of σ_t.
        """
        supports = data.supports
        on = facet_coefficients(split, space, supports.facets)
        points, weights = facet_rule(spaces.dim, 2 * on.degree)
        basis = on.basis(points)
        on_walls = np.einsum("nak,nki->nai", shear, spaces.tangents) + data.pulled[spaces.rough_rows]
        w, wall = supports.moved(spaces, data.tractions, stresses, on_walls), np.zeros(supports.facets.vertices.shape)
        walls, rows = supports.walls(spaces)
        wall[walls] = linear_from_means(spaces.along(data.slip_before)[rows])
        w, wall = (on.hats @ each[on.rows] for each in (w + wall, wall))
        stiffness = on.facets.measure[:, None, None] * supports.stiffness[on.rows]
        return cls(on, stiffness, w, wall, basis.T * (weights / weights.sum()) @ basis)

    @property
    def forces(self) -> Array:
        """∫ Kw·B for the B of each coefficient, shape (facets, coefficients, d)."""
        return np.asarray(np.einsum("nij,kl,nlj->nki", self.stiffness, self.mass, self.rest))

    def gap(self, v: fem.Function | None = None) -> Array:
        """½∫ K(v − w)·(v − w) over each facet; without a v that of 0."""
        return self._squares(-self.rest if v is None else self._coefficients(v) - self.rest)

    def energy(self, v: fem.Function) -> Array:
        """½∫ Kv·v over each facet, on walls of what v is faster than these."""
        return self._squares(self._coefficients(v) - self.wall)

    def _coefficients(self, v: fem.Function) -> Array:
        return np.asarray(v.x.array.reshape(-1, self.rest.shape[2])[self.on.nodes])

    def _squares(self, off: Array) -> Array:
        return np.asarray(np.einsum("nij,kl,nki,nlj->n", self.stiffness, self.mass, off, off) / 2)

    def matrices(self, left: Nodes, frames: Array) -> OfCells:
        """∫ Kv·v' on each facet for the nodes that are left, in the frames of all nodes."""
        nodes = self.on.nodes
        frame = frames[nodes]
        values = np.einsum("nij,kl,nkia,nljb->nkalb", self.stiffness, self.mass, frame, frame, optimize=True)
        size = nodes.shape[1] * frames.shape[1]
        return left.number_of[nodes], values.reshape(len(nodes), size, size)
