"""Polynomials on boundary facets by Bernstein coefficients, facet by facet."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import basix
import dolfinx.mesh
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.discrete.bernstein import exponents, nodes, renumbered
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets
from signorini_fenicsx.discrete.points import from_within, in_facets

NOTHING, HALVINGS = 1e-13, 3
"""The weight of a node that is rounding, as which nodes a condition has must not depend on their numbers; how often the
edges of facets in space are halved where lengths of vectors are integrated."""


@dataclass(frozen=True)
class FacetCoefficients:
    """Facets, and the nodes of a function on each; of a displacement they are on the split mesh or a part of it.

    Attributes:
        facets: The facets.
        rows: Where they are among those asked for.
        cells: The cell behind each, on the split mesh that which is opposite to its last vertex.
        nodes: Shape (facets, coefficients).
        degree: Of the function.
    """

    facets: BoundaryFacets
    rows: Indices
    cells: Indices
    nodes: npt.NDArray[np.int32]
    degree: int

    @cached_property
    def _element(self) -> basix.finite_element.FiniteElement:
        facet = SIMPLEX[self.facets.vertices.shape[2] - 1]
        return basix.create_element(basix.ElementFamily.P, facet, self.degree, basix.LagrangeVariant.bernstein)

    def basis(self, points: Array) -> Array:
        """Bernstein's basis in points of the reference facet, shape (points, coefficients)."""
        return self._element.tabulate(0, points)[0, :, :, 0]

    def slopes(self, points: Array) -> Array:
        """The derivatives by the coordinates of the reference facet, shape (d − 1, points, coefficients)."""
        return self._element.tabulate(1, points)[1:, :, :, 0]

    def lengths(self, vectors: Array, bound: Array, moments: Array) -> Array:
        """Bounds of the means of g|v| over facets: |v| is at most a mean of the lengths of its coefficients.

        In space these are the coefficients on parts of a facet, on which v turns less.

        Args:
            vectors: The coefficients of v, shape (facets, coefficients, components).
            bound: G ≥ 0 at the vertices, linear between them, shape (facets, d).
            moments: ∫ φ_a B for the hats and the basis, the facet being of measure 1, shape (d, coefficients).
        """
        hats, on_parts = self._parts
        lengths = np.linalg.norm(np.einsum("pkl,nlm->npkm", on_parts, vectors), axis=3)
        weights = np.einsum("pab,nb->npa", hats, bound) @ moments
        return np.asarray((weights * lengths).sum(axis=(1, 2)) / len(hats))

    @cached_property
    def _parts(self) -> tuple[Array, Array]:
        """The hats at the vertices of the parts of a facet, and the coefficients on each from those on the facet.

        Shapes (parts, d, d) and (parts, coefficients, coefficients). An edge is one part.
        """
        corners = parts_of_facet(self.facets.vertices.shape[2])
        return corners, self.restricted(corners)

    def restricted(self, corners: Array) -> Array:
        """The coefficients on parts of a facet from those on the facet, shape (parts, coefficients, coefficients).

        Each is a mean of these with weights ≥ 0.

        Args:
            corners: Of the parts, by barycentric coordinates, shape (parts, d, d).
        """
        points = nodes(self._element.cell_type, self.degree)
        places = (self.hats @ corners)[:, :, 1:]
        values = self.basis(places.reshape(-1, places.shape[2])).reshape(len(corners), len(points), len(points))
        return np.linalg.inv(self.basis(points)) @ values

    @property
    def hats(self) -> Array:
        """The hats of the vertices in the points of the coefficients, shape (coefficients, d).

        A linear function has the coefficients that are its values in these points.
        """
        points = nodes(self._element.cell_type, self.degree)
        return np.column_stack([1 - points.sum(axis=1), points])

    def places(self) -> Array:
        """The points of the coefficients, equidistant on each facet, shape (facets, coefficients, d)."""
        return np.asarray(self.hats @ self.facets.vertices)

    def with_means(self, vectors: Array, directions: Array, means: Array) -> Array:
        """Coefficients of vectors, shape (facets, coefficients, d), with other means along a direction of each facet.

        Those inside facets are changed, if there are any: a fluid flows through a facet by the mean.
        """
        inside = (self.hats > 0).all(axis=1)
        share = inside / max(inside.mean(), 1 / len(inside))
        added = means - np.einsum("nki,ni->nk", vectors, directions).mean(axis=1)
        return np.asarray(vectors + np.einsum("n,k,ni->nki", added, share, directions))

    def of(self, mesh: dolfinx.mesh.Mesh, datum: Any) -> Array:
        """Coefficients of the polynomials that interpolate a datum at equidistant points (collective).

        What is not a polynomial may jump where a punch ends, so the values are limits from inside the facets.
        """
        points = nodes(self._element.cell_type, self.degree)
        at = in_facets(mesh, self.facets.facets, points)
        values = from_within(datum.values, at) if datum.polynomial is None else datum.values(at)
        where = in_order(self.facets.ranking, self.degree)
        at_points = np.take_along_axis(values, where.reshape(*where.shape, *[1] * (values.ndim - 2)), axis=1)
        return np.einsum("kp,np...->nk...", np.linalg.inv(self.basis(points)), at_points)


def parts_of_facet(dim: int) -> Array:
    """The corners of the parts of a facet by barycentric coordinates, which are exact; an edge is one part."""
    corners = np.eye(dim)[None]
    for _ in range(HALVINGS if dim == 3 else 0):
        a, b, c = (corners[:, i] for i in range(3))
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        quarters = (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)
        corners = np.concatenate([np.stack(each, axis=1) for each in quarters])
    return corners


def in_order(ranking: Indices, degree: int) -> Indices:
    """Which of the points `nodes` that DOLFINx has on a facet each point is that has them in the order of `Hats`.

    Args:
        ranking: See `Hats`, shape (facets, d).
        degree: Of the points.
    """
    cell = SIMPLEX[ranking.shape[1] - 1]
    return renumbered(cell, degree, ranking, exponents(cell, degree))
