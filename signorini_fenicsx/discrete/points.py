"""Points in cells and boundary facets, and what functions are there, as NumPy arrays.

A *jet* is the value of a function and, where it is wanted, its gradient: an array whose last axis has 1 or 1 + dim
entries. Jets are added as arrays are.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import basix
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.algorithms.analysis import extract_type
from ufl.core.expr import Expr

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Mask, determinants, gathered, times
from signorini_fenicsx.base.owned import cells_of_facets
from signorini_fenicsx.discrete.bernstein import jet
from signorini_fenicsx.discrete.cell_shapes import Entities, arms, corners, hat_gradients, nearest
from signorini_fenicsx.meshes.domain import rounding

AT_ONCE = 100_000
"""Number of points in cells that are in memory at the same time."""
BESIDE = 1e-9
"""The sides of a facet inside the domain are that share of the way from it to the centroids of its cells, or more where
the coordinates are far from 0, see `beside`."""


ROUNDINGS = 16
"""And at least so many roundings of the coordinates."""


@dataclass(frozen=True)
class Points(ABC):
    """Points of the reference cell or facet, used in some cells or boundary facets of this rank.

    Attributes:
        mesh: The mesh.
        cells: Each of these cells, or the cell behind each facet.
        points: Points in the reference cell or facet, shape (points, its dimension).
        weights: Weights of a quadrature there; empty for other points.
    """

    mesh: dolfinx.mesh.Mesh
    cells: Entities
    points: Array
    weights: Array

    @property
    @abstractmethod
    def vertices(self) -> Array:
        """Vertices of each cell or facet, in the order of the reference one, shape (n, its vertices, dim)."""

    @property
    @abstractmethod
    def barycentric(self) -> Array:
        """Barycentric coordinates of the points in their cells, shape (n or 1, points, dim + 1)."""

    @abstractmethod
    def among(self, cells: Mask) -> Self:
        """The points that lie in some of the cells; `cells` is a mask."""

    def of_ufl(self, value: Expr) -> Array:
        """Values of UFL, shape (n, points, *its shape) (collective)."""
        is_zero = isinstance(value, ufl.constantvalue.Zero)  # the gradient of a constant, without a mesh
        return np.zeros((*self.shape, *value.ufl_shape)) if is_zero else self._of_ufl(value)

    @abstractmethod
    def _of_ufl(self, value: Expr) -> Array:
        """The values of UFL that is not 0 (collective)."""

    @property
    def rows(self) -> Entities | slice:
        """The cells, to take what arrays have for them; nothing is copied where they follow one another."""
        return self.cells

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells or facets, and of the points in each."""
        return len(self.cells), len(self.points)

    @cached_property
    def x(self) -> Array:
        """The points, shape (n, points, dim)."""
        return np.asarray(np.einsum("pv,nvi->npi", _barycentric(self.points), self.vertices))

    @cached_property
    def corners(self) -> Array:
        """Vertices of the cells, shape (n, dim + 1, dim)."""
        return corners(self.mesh, self.rows)

    @cached_property
    def arms(self) -> Array:
        """The points less the centroids of their cells, shape (n, points, dim)."""
        return np.asarray(np.einsum("npv,nvi->npi", self.barycentric, arms(self.mesh, self.rows)))

    @cached_property
    def slopes(self) -> Array:
        """Gradients of the barycentric coordinates of the cells, shape (n, dim + 1, dim)."""
        return hat_gradients(self.mesh, self.rows)

    @cached_property
    def scale(self) -> Array:
        """Measure of each cell or facet, divided by that of the reference one."""
        edges = self.vertices[:, 1:] - self.vertices[:, :1]
        if edges.shape[1] == edges.shape[2]:
            return np.abs(determinants(edges))
        return np.sqrt(determinants(edges @ edges.transpose(0, 2, 1)))

    def means(self, values: Array) -> Array:
        """Means over each cell or facet of values of shape (n, points, …)."""
        return np.asarray(np.tensordot(values, self.weights / self.weights.sum(), (1, 0)))

    def integrals(self, values: Array) -> Array:
        """Integrals over each cell or facet of values of shape (n, points)."""
        return self.scale * (values @ self.weights)

    def linear(self, function: fem.Function, *, gradient: bool = False) -> Array:
        """Jet of a function that is linear on each cell by its values in the vertices, shape (n, points, …)."""
        nodes = gathered(function.x.array, function.function_space.dofmap.list[self.rows])
        value = np.einsum("npv,nv->np", self.barycentric, nodes)[:, :, None]
        if not gradient:
            return value
        slope = times(nodes[:, None], self.slopes)
        return np.concatenate([value, np.broadcast_to(slope, (*self.shape, slope.shape[2]))], axis=2)

    def bernstein(self, function: fem.Function, *, gradient: bool = False) -> Array:
        """Jet of a function that is a polynomial on each cell by its Bernstein coefficients, shape (n, points, …)."""
        nodes = gathered(function.x.array, function.function_space.dofmap.list[self.rows])
        return jet(nodes, self.barycentric, self.slopes if gradient else None)


@dataclass(frozen=True)
class CellPoints(Points):
    """Points of the reference cell, used in some owned cells."""

    @property
    def vertices(self) -> Array:
        """Vertices of each cell, shape (cells, dim + 1, dim)."""
        return self.corners

    @cached_property
    def rows(self) -> Entities | slice:
        """The cells, to take what arrays have for them; nothing is copied where they follow one another."""
        consecutive = len(self.cells) > 0 and bool((np.diff(self.cells) == 1).all())
        return slice(int(self.cells[0]), int(self.cells[-1]) + 1) if consecutive else self.cells

    @property
    def first(self) -> Self:
        """The first point of each cell."""
        return replace(self, points=self.points[:1], weights=self.weights[:1])

    @cached_property
    def barycentric(self) -> Array:
        """Barycentric coordinates of the points, shape (1, points, dim + 1)."""
        return _barycentric(self.points)[None]

    def among(self, cells: Mask) -> Self:
        """The points in some of the cells; `cells` is a mask."""
        return replace(self, cells=self.cells[cells[self.cells]])

    def _of_ufl(self, value: Expr) -> Array:
        expression = fenicsx.expression(_on_mesh(self.mesh, value), self.points)
        values = np.asarray(expression.eval(self.mesh, self.cells), dtype=np.float64)
        return values.reshape(*self.shape, *value.ufl_shape)


@dataclass(frozen=True)
class PartPoints(Points):
    """Points in parts of owned cells; data in UFL have no values there.

    Attributes:
        ends: Vertices of each part, shape (parts, dim + 1, dim).
    """

    ends: Array

    @property
    def vertices(self) -> Array:
        """Vertices of each part, shape (parts, dim + 1, dim)."""
        return self.ends

    @cached_property
    def barycentric(self) -> Array:
        """Barycentric coordinates of the points in the cells of their parts, shape (parts, points, dim + 1)."""
        arms = self.x - self.corners.mean(axis=1)[:, None]
        return np.asarray(1 / self.corners.shape[1] + arms @ self.slopes.transpose(0, 2, 1))

    def among(self, cells: Mask) -> Self:
        """The points in parts of some of the cells; `cells` is a mask."""
        chosen = cells[self.cells]
        return replace(self, cells=self.cells[chosen], ends=self.ends[chosen])

    def _of_ufl(self, value: Expr) -> Array:
        raise NotImplementedError


@dataclass(frozen=True)
class FacetPoints(Points):
    """Points of the reference facet, used in some boundary facets of this rank, which lie in owned cells.

    Attributes:
        facets: Mesh facets.
        local: Index of each facet in its cell.
    """

    facets: Entities
    local: Entities

    @cached_property
    def vertices(self) -> Array:
        """Vertices of each facet, shape (facets, dim, dim)."""
        local = np.array(basix.topology(self.mesh.basix_cell())[-2])[self.local]
        return np.take_along_axis(self.corners, local[:, :, None], axis=1)

    @cached_property
    def barycentric(self) -> Array:
        """Barycentric coordinates of the points in their cells, shape (facets, points, dim + 1)."""
        return _barycentric(self._in_cell)[self.local]

    @property
    def normals(self) -> Array:
        """Outer unit normals of the cells, shape (facets, dim)."""
        inward = self.slopes[np.arange(len(self.local)), self.local]
        return np.asarray(-inward / np.linalg.norm(inward, axis=1, keepdims=True))

    @cached_property
    def _in_cell(self) -> Array:
        """The points in each facet of the reference cell, shape (its facets, points, dim)."""
        return self._on_facets()

    def _on_facets(self) -> Array:
        cell = self.mesh.basix_cell()
        reference = [basix.geometry(cell)[vertices] for vertices in basix.topology(cell)[-2]]
        return np.stack([x[0] + self.points @ (x[1:] - x[0]) for x in reference])

    def _of_ufl(self, value: Expr) -> Array:
        """The value may have the normal in it.

        As points of the cells: where DOLFINx has the points of a facet depends on the numbers of its vertices.
        """
        per_facet = ufl.as_tensor([ufl.replace(value, normals) for normals in self._normals(value)])
        expression = fenicsx.expression(
            _on_mesh(self.mesh, per_facet), self._in_cell.reshape(-1, self._in_cell.shape[2])
        )
        if len(self.cells) == 0:
            return np.empty((*self.shape, *value.ufl_shape))
        values = np.asarray(expression.eval(self.mesh, self.cells), dtype=np.float64)
        values = values.reshape(len(self.cells), len(self._in_cell), len(self.points), *per_facet.ufl_shape)
        which = self.local if per_facet.ufl_shape[0] > 1 else 0
        return np.moveaxis(values, 3, 2)[np.arange(len(self.cells)), self.local, which]

    def _normals(self, value: Expr) -> list[dict[Expr, Expr]]:
        """The normal of each facet of a cell, if there is a normal in the value; else one empty table."""
        normals_in_value = extract_type(value, ufl.classes.FacetNormal)
        if not normals_in_value:
            return [{}]
        inverse = ufl.JacobianInverse(self.mesh.ufl_domain())
        reference = basix.cell.facet_outward_normals(self.mesh.basix_cell()).tolist()
        normals = [ufl.dot(ufl.as_vector(normal), inverse) for normal in reference]
        return [dict.fromkeys(normals_in_value, normal / ufl.sqrt(ufl.inner(normal, normal))) for normal in normals]

    def among(self, cells: Mask) -> Self:
        """The facets of some of the cells; `cells` is a mask."""
        return self.take(cells[self.cells])

    def take(self, chosen: Mask) -> Self:
        """Some of the facets, by a mask."""
        return replace(self, facets=self.facets[chosen], cells=self.cells[chosen], local=self.local[chosen])

    def across(self, rows: npt.NDArray[np.intp], facets: Entities) -> "tuple[FacetPoints, npt.NDArray[np.intp]]":
        """The points of some rows in facets of the other side that lie on them, and the number of each there."""
        other = in_facets(self.mesh, facets, self.points, self.weights)
        return other, nearest(self.x[rows], other.x)

    def per_cell(self, values: Array, number: int) -> Array:
        """Sums of values per facet over the facets of each owned cell; `number` is that of the cells."""
        return np.bincount(self.cells, values, number)[:number]


@dataclass(frozen=True)
class BesideFacets(FacetPoints):
    """Points of facets, moved by a small share of the way to the centroids of the cells, or away from it if it is < 0.

    At facets inside the domain this gives the values of a function on either side.
    """

    share: float

    @cached_property
    def x(self) -> Array:
        """The points, shape (n, points, dim)."""
        return np.asarray(np.einsum("npv,nvi->npi", self.barycentric, self.corners))

    @cached_property
    def _in_cell(self) -> Array:
        """The points beside each facet of the reference cell, shape (its facets, points, dim)."""
        on_facets = self._on_facets()
        return on_facets + self.share * (basix.geometry(self.mesh.basix_cell()).mean(axis=0) - on_facets)

    @classmethod
    def of(cls, points: FacetPoints, share: float) -> Self:
        """The points beside some points of facets."""
        return cls(points.mesh, points.cells, points.points, points.weights, points.facets, points.local, share)


def beside(mesh: dolfinx.mesh.Mesh) -> float:
    """The share for `BesideFacets` of points that floats tell from the facets: BESIDE, or a power of 2 (collective)."""
    return max(BESIDE, 2.0 ** np.ceil(np.log2(ROUNDINGS * rounding(mesh))))


def from_inside(values: Callable[[FacetPoints], Array], points: FacetPoints) -> Array:
    """Values in points of facets as limits from inside their cells, by two points beside each (collective).

    Data that jump on a cut through the domain have the value of one side on the cut itself.
    """
    step = beside(points.mesh)
    near, far = (values(BesideFacets.of(points, share)) for share in (step, 2 * step))
    return 2 * near - far


def from_within[P: Points](values: Callable[[P], Array], points: P) -> Array:
    """The values as limits from inside the facets, or cells: data may jump where two of them meet (collective)."""
    at, dim = points.points, points.points.shape[1] + 1
    step = beside(points.mesh)
    moved = np.concatenate([at + share * (1 / dim - at) for share in (step, 2 * step)])
    near, far = np.split(values(replace(points, points=moved)), 2, axis=1)
    return np.asarray(2 * near - far)


def _barycentric(points: Array) -> Array:
    """Barycentric coordinates of points of the reference cell."""
    return np.concatenate([1 - points.sum(axis=-1, keepdims=True), points], axis=-1)


def _on_mesh(mesh: dolfinx.mesh.Mesh, value: Expr) -> Expr:
    """The value as an expression that knows a mesh, which a number does not."""
    return fem.Constant(mesh, 1.0) * value


def quadratic_nodes(cell: basix.CellType) -> Array:
    """The vertices of the reference cell or facet, then the midpoints of its edges."""
    return basix.create_element(basix.ElementFamily.P, cell, 2, basix.LagrangeVariant.gll_warped).points


def facet_type(dim: int) -> basix.CellType:
    """The reference facet of a simplex."""
    return basix.CellType.interval if dim == 2 else basix.CellType.triangle


def in_cells(
    mesh: dolfinx.mesh.Mesh, cells: Entities, points: Array, weights: Array | None = None
) -> Iterator[CellPoints]:
    """Points in owned cells, some cells at a time and equally often on all ranks (collective)."""
    parts = mesh.comm.allreduce(-(-len(cells) * len(points) // AT_ONCE), MPI.MAX)
    for some in np.array_split(cells, max(parts, 1)):
        yield CellPoints(mesh, some, points, np.empty(0) if weights is None else weights)


def cell_quadrature(mesh: dolfinx.mesh.Mesh, cells: Entities, degree: int) -> Iterator[CellPoints]:
    """The points of a quadrature in owned cells, some cells at a time (collective)."""
    return in_cells(mesh, cells, *basix.make_quadrature(mesh.basix_cell(), degree))


def in_facets(mesh: dolfinx.mesh.Mesh, facets: Entities, points: Array, weights: Array | None = None) -> FacetPoints:
    """Points in boundary facets of this rank (collective)."""
    cells, local = cells_of_facets(mesh, facets)
    return FacetPoints(mesh, cells, points, np.empty(0) if weights is None else weights, facets, local)


def facet_quadrature(mesh: dolfinx.mesh.Mesh, facets: Entities, degree: int) -> FacetPoints:
    """The points of a quadrature in boundary facets of this rank (collective)."""
    return in_facets(mesh, facets, *basix.make_quadrature(facet_type(mesh.topology.dim), degree))


def facet_lattice(mesh: dolfinx.mesh.Mesh, facets: Entities, parts: int) -> FacetPoints:
    """A grid in boundary facets of this rank whose edges are cut into equal parts (collective)."""
    return in_facets(
        mesh,
        facets,
        basix.create_lattice(facet_type(mesh.topology.dim), parts, basix.LatticeType.equispaced, True),
    )
