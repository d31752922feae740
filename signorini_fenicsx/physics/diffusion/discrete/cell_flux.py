"""A flux of RT0 cell by cell, without quadrature.

On a cell T with vertices x_i and centroid x_T let ξ = x − x_T and y_i = x_i − x_T. The basis function of the facet
opposite to x_i is (a_i / d|T|) (ξ − y_i), where a_i = ∫_T ∇·φ_i is its flux out of T. So

    σ = c + sξ,   s = Σ_i a_i σ_i / d|T| = ∇·σ/d,   c = −Σ_i a_i σ_i y_i / d|T| = σ(x_T),

and as ∫_T ξ = 0, for a symmetric matrix B, with m = (1/|T|) ∫_T ξ·Bξ = Σ_i y_i·By_i / ((d + 1)(d + 2)),

    (Bσ, σ)_T = |T| (c·Bc + s²m),   (Bσ, φ_i)_T = a_i (sm − c·By_i) / d,   (Bφ_i, φ_i)_T = a_i² (y_i·By_i + m) / d²|T|.

The components of a flux of RT1 are quadratic on each cell. There c and s are parts of it only.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self, cast

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, gathered, squares_of, times
from signorini_fenicsx.base.owned import cell_dofs, sums_at
from signorini_fenicsx.base.reference_cells import positive_quadrature
from signorini_fenicsx.discrete.bernstein import basis, coefficients_of, jet
from signorini_fenicsx.discrete.cell_shapes import arms, hat_gradients, mean_moments, some_at_a_time, squared_arms
from signorini_fenicsx.discrete.points import FacetPoints, Points
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces, Spaces

type Weight = Array | float
"""B: a matrix per cell, or one for all, an array of shape (…, dim, dim); or a number times the identity."""


@dataclass(frozen=True)
class CellFlux:
    """A flux of RT0 on the owned cells.

    Attributes:
        spaces: The discrete spaces.
        centroid: σ(x_T), shape (cells, dim).
        slope: s = ∇·σ/d, shape (cells,).
    """

    spaces: Spaces
    centroid: Array
    slope: Array

    @classmethod
    def of(cls, spaces: Spaces, sigma: fem.Function) -> Self:
        """The flux on cells of a function with up-to-date ghost values; of RT1 a `RT1Flux` (collective)."""
        if spaces.degree and sigma.function_space is not spaces.V and not issubclass(cls, RT1Flux):
            return cast(Self, RT1Flux.of(spaces, sigma))
        mesh, dofs = spaces.mesh, cell_dofs(spaces.V)
        outflow, volumes = spaces.outflow, spaces.cell_measures  # first of all: a rank may have no cells
        dim, cells = mesh.topology.dim, len(dofs)
        centroid, slope = np.empty((cells, dim), order="F"), np.empty(cells)
        for some in some_at_a_time(mesh):
            through = outflow[some] * gathered(sigma.x.array, dofs[some])
            through /= dim * volumes[some, None]
            slope[some] = np.einsum("ce->c", through)
            centroid[some] = -np.einsum("ce,cei->ci", through, arms(mesh, some))
        return cls(spaces, centroid, slope)

    def function(self) -> fem.Function:
        """The flux in RT0: −d|T|∇λ_i · (c − s y_i/d) goes through the facet opposite to x_i (collective)."""
        return self.spaces.out_of_cells(self.leaving)

    @property
    def divergence(self) -> Array:
        """∇·σ, shape (cells,)."""
        return self.centroid.shape[1] * self.slope

    def in_vertices(self) -> Array:
        """σ in the vertices of the cells, shape (cells, dim + 1, dim)."""
        values = arms(self.spaces.mesh)
        values *= self.slope[:, None, None]
        values += self.centroid[:, None]
        return values

    def at(self, points: Points) -> Array:
        """σ in points, shape (n, points, dim)."""
        values: Array = self.slope[points.rows, None, None] * points.arms
        values += self.centroid[points.rows, None]
        return values

    def divergence_at(self, points: Points) -> Array:
        """∇·σ in points, shape (n, 1)."""
        return self.divergence[points.cells, None]

    @property
    def leaving(self) -> Array:
        """∫ σ·n over each facet of each cell, n pointing outwards, shape (cells, dim + 1)."""
        mesh, dim = self.spaces.mesh, self.centroid.shape[1]
        normals = -dim * self.spaces.cell_measures[:, None, None] * hat_gradients(mesh)
        on_facets = self.centroid[:, None] - self.slope[:, None, None] * arms(mesh) / dim
        return np.asarray((on_facets * normals).sum(axis=2))

    def squares(self, weight: Weight, moments: Array | None = None) -> Array:
        """(Bσ, σ)_T of each cell.

        Args:
            weight: B.
            moments: m, if it is known.
        """
        if moments is None:
            moments = mean_moments(_squared_arms(self.spaces, weight))
        squares: Array = squares_of(self.centroid[:, None], _as_matrix(weight, self.centroid.shape[1]))[:, 0]
        squares += moments * self.slope**2
        squares *= self.spaces.cell_measures
        return squares

    def tested(self, weight: Weight) -> Array:
        """(Bσ, φ_i)_T / a_i of each cell, shape (cells, dim + 1)."""
        mesh, dim = self.spaces.mesh, self.centroid.shape[1]
        images = times(self.centroid[:, None], _as_matrix(weight, dim))[:, 0]
        tested = np.empty(self.spaces.outflow.shape, order="F")
        for some in some_at_a_time(mesh):
            tested[some] = -np.einsum("ci,cvi->cv", images[some], arms(mesh, some))
        tested += (mean_moments(_squared_arms(self.spaces, weight)) * self.slope)[:, None]
        tested /= dim
        return tested


def mass_diagonal(spaces: Spaces, weight: Weight) -> Array:
    """(Bφ, φ) for each basis function φ of RT0; complete for owned entries (collective)."""
    dim = spaces.mesh.topology.dim
    squares = _squared_arms(spaces, weight)
    squares = squares + mean_moments(squares)[:, None]
    squares *= spaces.outflow**2
    squares /= dim**2 * spaces.cell_measures[:, None]
    return joined(spaces, squares)


def _as_matrix(weight: Weight, dim: int) -> Array:
    return weight * np.eye(dim) if isinstance(weight, float) else weight


def _squared_arms(spaces: Spaces, weight: Weight) -> Array:
    """The products y_i·By_i."""
    return weight * spaces.squared_arms if isinstance(weight, float) else squared_arms(spaces.mesh, weight)


def joined(spaces: Spaces, of_cells: Array) -> Array:
    """The sum over the cells, of shape (cells, dim + 1), for each basis function of RT0; complete for owned entries.

    Collective.
    """
    return sums_at(spaces.V.dofmap.index_map, cell_dofs(spaces.V), of_cells)


@dataclass(frozen=True)
class RT1Flux(CellFlux):
    """A flux of RT1 on the owned cells.

    Attributes:
        components: The Bernstein coefficients of each component, shape (dim, cells, nodes of quadratics).
    """

    components: Array

    @classmethod
    def of(cls, spaces: Spaces, sigma: fem.Function) -> Self:
        """The flux on cells of a function with up-to-date ghost values (collective)."""
        assert isinstance(spaces, RT1Spaces)
        cell = spaces.mesh.basix_cell()
        components = np.stack([coefficients_of(each, cell) for each in np.moveaxis(spaces.by_dolfinx(sigma), 2, 0)])
        return cls.by_components(spaces, components)

    @classmethod
    def by_components(cls, spaces: Spaces, components: Array) -> Self:
        """The quadratic flux with these components."""
        dim, middle = len(components), np.full((1, 1, len(components) + 1), 1 / (len(components) + 1))
        jets = [jet(each, middle, hat_gradients(spaces.mesh))[:, 0] for each in components]
        slope = sum(each[:, 1 + i] for i, each in enumerate(jets)) / dim
        return cls(spaces, np.stack([each[:, 0] for each in jets], axis=1), np.asarray(slope), components)

    @cached_property
    def divergence(self) -> Array:
        """∇·σ in the vertices of the cells, shape (cells, dim + 1)."""
        slopes, vertices = hat_gradients(self.spaces.mesh), np.eye(len(self.components) + 1)[None]
        jets = (jet(component, vertices, slopes)[:, :, 1 + i] for i, component in enumerate(self.components))
        return np.asarray(sum(jets))

    def divergence_at(self, points: Points) -> Array:
        """∇·σ in points, shape (n, points)."""
        return linear_in(points, self.divergence)

    @property
    def leaving(self) -> Array:
        """∫ σ·n over each facet of each cell, n pointing outwards, shape (cells, dim + 1)."""
        mesh, dim = self.spaces.mesh, len(self.components)
        normals = -dim * self.spaces.cell_measures[:, None, None] * hat_gradients(mesh)
        at_vertices = self.in_vertices()
        on_facets = (at_vertices.sum(axis=1, keepdims=True) - at_vertices) / dim
        return np.asarray((on_facets * normals).sum(axis=2))

    def in_vertices(self) -> Array:
        """σ in the vertices of the cells, shape (cells, dim + 1, dim)."""
        return np.moveaxis(self.components[:, :, : len(self.components) + 1], 0, 2)

    def at(self, points: Points) -> Array:
        """σ in points, shape (n, points, dim)."""
        return np.concatenate([jet(of[points.rows], points.barycentric) for of in self.components], axis=2)

    def squares(self, weight: Array | float, moments: Array | None = None) -> Array:
        """(Bσ, σ)_T of each cell, B as in `cell_flux`; `moments` are of no use here."""
        cell, dim = self.spaces.mesh.basix_cell(), len(self.components)
        points, weights = positive_quadrature(cell, 4)
        matrix = weight * np.eye(dim)[None] if isinstance(weight, float) else weight
        squares = np.empty(self.components.shape[1])
        of_cells, hats = np.broadcast_to(matrix, (len(squares), dim, dim)), basis(cell, 2, points).T
        for some in some_at_a_time(self.spaces.mesh):
            values = self.components[:, some] @ hats
            of_points = np.einsum("icq,cij,jcq->cq", values, of_cells[some], values, optimize=True)
            squares[some] = of_points @ (weights / weights.sum())
        squares *= self.spaces.cell_measures
        return squares


def normal_flux(flux: CellFlux, points: FacetPoints) -> Array:
    """σ·n in points of boundary facets, shape (facets, points)."""
    return np.asarray(np.einsum("fpi,fi->fp", flux.at(points), points.normals))


def cell_values(function: fem.Function) -> Array:
    """The values of a function of P0 in the owned cells, or of DG1 in their vertices, shape (cells,) or (cells, …)."""
    values = function.x.array[cell_dofs(function.function_space)]
    return values if values.shape[1] > 1 else values[:, 0]


def means_in_cells(function: fem.Function) -> Array:
    """The means of such a function over the owned cells."""
    values = cell_values(function)
    return values if values.ndim == 1 else np.asarray(values.mean(axis=1))


def in_points(function: fem.Function, points: Points) -> Array:
    """Such a function in points, shape (n, points), of P0 (n, 1)."""
    values = cell_values(function)
    return values[points.rows, None] if values.ndim == 1 else linear_in(points, values)


def linear_in(points: Points, values: Array) -> Array:
    """The functions that are linear on the owned cells in points, from their values in the vertices."""
    return np.asarray(np.einsum("nqv,nv->nq", points.barycentric, values[points.rows]))
