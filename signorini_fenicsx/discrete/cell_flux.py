"""Fluxes of RT0 cell by cell, as NumPy arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import dolfinx.mesh
import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.small_matrices import determinants, squares_of
from signorini_fenicsx.discrete.cell_shapes import arms, mean_moments, some_at_a_time
from signorini_fenicsx.discrete.points import Points


@dataclass(frozen=True)
class CellFlux:
    """A flux of RT0 on the cells of this rank: σ(x) = σ(x_T) + s (x − x_T) with x_T the centroid of T.

    Attributes:
        mesh: The mesh.
        centroid: σ(x_T), shape (cells, dim).
        slope: s = ∇·σ/d, shape (cells,).
    """

    mesh: dolfinx.mesh.Mesh
    centroid: Array
    slope: Array

    @classmethod
    def of(cls, sigma: fem.Function) -> Self:
        """Read a function of RT0, with ghost values.

        The basis function of the facet opposite to the vertex x_e has the slope D/(d det J), where D is its divergence
        on the reference cell and J the Jacobian of T, and is 0 in x_e.
        """
        space, mesh = sigma.function_space, sigma.function_space.mesh
        dim = mesh.topology.dim
        slopes = sigma.x.array[space.dofmap.list]
        mesh.topology.create_entity_permutations()
        space.element.Tt_apply(slopes.reshape(-1), mesh.topology.get_cell_permutation_info(), 1)
        derivatives = space.element.basix_element.tabulate(1, np.zeros((1, dim)))[1:, 0]
        slopes *= np.einsum("iei->e", derivatives) / dim
        centroid, slope = np.empty((len(slopes), dim)), np.empty(len(slopes))
        for some in some_at_a_time(mesh):
            x = arms(mesh, some)
            of_basis = slopes[some] / determinants(x[:, 1:] - x[:, :1])[:, None]
            centroid[some] = -(of_basis[:, None] @ x)[:, 0]
            slope[some] = np.einsum("ce->c", of_basis)
        return cls(mesh, centroid, slope)

    @property
    def divergence(self) -> Array:
        """∇·σ, shape (cells,)."""
        divergence: Array = self.centroid.shape[1] * self.slope
        return divergence

    def squares(self, matrix: Array | None = None, moments: Array | None = None) -> Array:
        """Mean of σ·Bσ over each cell, shape (cells,).

        It is that of σ(x_T) plus that of s (x − x_T), which is orthogonal to constants.

        Args:
            matrix: B of each cell, or one for all; None for the identity.
            moments: `mean_moments` of B, if they are known.
        """
        if matrix is None:
            matrix = np.eye(self.centroid.shape[1])
        if moments is None:
            moments = mean_moments(self.mesh, matrix)
        squares = squares_of(self.centroid[:, None], matrix)[:, 0]
        squares += moments * self.slope**2
        return squares

    def in_vertices(self) -> Array:
        """σ in the vertices of each cell, shape (cells, dim + 1, dim)."""
        values = arms(self.mesh)
        values *= self.slope[:, None, None]
        values += self.centroid[:, None]
        return values

    def at(self, points: Points) -> Array:
        """σ in points, shape (n, points, dim)."""
        cells = points.cells
        values: Array = self.slope[cells, None, None] * points.arms
        values += self.centroid[cells, None]
        return values
