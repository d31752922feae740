"""The load that RT0 does not balance, measured by a separate flux in each cell.

In a cell T let r be a load with mean 0, let r_e be a load with mean 0 on each facet e, and let Πr, Π_e r_e be their
projections to polynomials. Take τ ∈ RT on T, of a degree that is high enough, with

    −∇·τ = Πr,   τ·n = Π_e r_e on each facet e of T.

Then for w ∈ H¹(T), with κ ≥ c κ_h on T, c ≤ 1, |w|² = (κ∇w, ∇w)_T and all norms those of L²,

    (r, w)_T + Σ_e (r_e, w)_e ≤ c^-½ (‖κ_h^-½ τ‖_T + (δ_T/π)‖r − Πr‖_T + Σ_e C_e‖r_e − Π_e r_e‖_e) |w|,
    C_e² = δ_T² |e|/|T| (1/π² + 2/(πd)),   δ_T the diameter of T measured in κ_h⁻¹.

Proof. Integration by parts turns (Πr, w) + Σ (Π_e r_e, w)_e into (τ, ∇w). The remainders r − Πr and r_e − Π_e r_e have
mean 0, so w may be replaced by w − w_T with w_T its mean over T. For this ‖w − w_T‖_T ≤ (δ_T/π)‖κ_h^½ ∇w‖_T (Payne,
Weinberger; Bebendorf), because T is convex also in the coordinates κ_h^-½ x. On e, with x_e the vertex opposite to it,
the divergence theorem for (x − x_e)w² gives d|T|/|e| ‖w‖²_e = d‖w‖²_T + 2(w(x − x_e), ∇w)_T ≤ d‖w‖²_T +
2δ_T‖w‖_T‖κ_h^½ ∇w‖_T. Finally κ_h ≤ κ/c.

τ exists because the means are 0. It is computed for all cells at once, because in the coordinates of the reference cell
the conditions are the same for all cells.

*Geometry of the cells in the metric of κ*.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property

import basix
import dolfinx.mesh
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array, Mask, determinants, inverses, squares_of, times
from signorini_fenicsx.base.owned import number_of_cells, owned_cells
from signorini_fenicsx.base.reference_cells import orthonormal
from signorini_fenicsx.discrete.cell_shapes import corners, mean_moments, some_at_a_time, squared_arms
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.points import FacetPoints, facet_type, in_cells, quadratic_nodes
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces


@dataclass(frozen=True)
class CellMetric:
    """Geometry of the owned cells in the metric of κ. Arrays have one entry per cell.

    Attributes:
        jacobian: Jacobian of the map from the reference cell, shape (cells, dim, dim).
        volume: |T|.
        inverse: κ_h⁻¹, shape (cells, dim, dim).
        diameter: Square root of max (x − y)·κ_h⁻¹(x − y) over T: the diameter of T measured in κ_h⁻¹.
        moment: Mean of (x − x_T)·κ_h⁻¹(x − x_T) over T, x_T the centroid.
        low: The largest number ≤ 1 with κ ≥ low κ_h in the nodes of P2 on T.
        high: The smallest number ≥ 1 with κ ≤ high κ_h there.
        kappa_min: low times the smallest eigenvalue of κ_h.
        rho: On T, κ is within ρ of a polynomial of degree K, infinite if nothing is known; 0 before it is enclosed.
    """

    jacobian: Array
    volume: Array
    inverse: Array
    diameter: Array
    moment: Array
    low: Array
    high: Array
    kappa_min: Array
    rho: Array

    @cached_property
    def kappa_max(self) -> Array:
        """The largest eigenvalue of κ_h, times `high`."""
        return np.asarray(self.high / np.linalg.eigvalsh(self.inverse)[:, 0])

    def squares(self, flux: CellFlux) -> Array:
        """∫_T σ·κ_h⁻¹σ of a flux."""
        return flux.squares(self.inverse, self.moment)


def cell_metric(spaces: Spaces, data: Data) -> CellMetric:
    """Measure the owned cells (collective)."""
    mesh = spaces.mesh
    dim = mesh.topology.dim
    number = number_of_cells(mesh)
    jacobian, longest = np.empty((number, dim, dim), order="F"), np.empty(number)
    first, second = np.triu_indices(dim + 1, 1)
    kappa_h = data.matrices(spaces)
    inverse = np.broadcast_to(inverses(kappa_h), (number, dim, dim))
    for some in some_at_a_time(mesh):
        x = corners(mesh, some)
        jacobian[some] = (x[:, 1:] - x[:, :1]).transpose(0, 2, 1)
        longest[some] = squares_of(x[:, first] - x[:, second], inverse[some]).max(axis=1)
    low, high = _ratios(mesh, data.kappa, inverse)
    return CellMetric(
        jacobian=jacobian,
        volume=np.abs(determinants(jacobian)) / math.factorial(dim),
        inverse=inverse,
        diameter=np.sqrt(longest),
        moment=mean_moments(squared_arms(mesh, inverse)),
        low=low,
        high=high,
        kappa_min=low * np.linalg.eigvalsh(kappa_h)[:, 0],
        rho=np.zeros(number),
    )


def _ratios(mesh: dolfinx.mesh.Mesh, kappa: Datum, inverse: Array) -> tuple[Array, Array]:
    """The extreme eigenvalues of κ_h^-½ κ κ_h^-½ in the nodes of P2 on each cell, and 1 (collective)."""
    low, high = np.ones(len(inverse)), np.ones(len(inverse))
    if kappa.number is not None:
        return low, high
    dim = inverse.shape[1]
    for points in in_cells(mesh, owned_cells(mesh), quadratic_nodes(mesh.basix_cell())):
        values, cells = kappa.values(points), points.cells
        matrices = values if kappa.shape else values[:, :, None, None] * np.eye(dim)
        root = np.linalg.cholesky(inverse[cells])[:, None]
        ratios = np.linalg.eigvalsh(root.transpose(0, 1, 3, 2) @ matrices @ root)
        low[cells] = np.minimum(low[cells], ratios[:, :, 0].min(axis=1))
        high[cells] = np.maximum(high[cells], ratios[:, :, -1].max(axis=1))
    return low, high


OF_LOAD, OF_LAW, OF_FLUX = 1, 2, 2
"""Degrees of Π, of what laws in Ω take of a load, and of all Π_e. τ has degree 2 in cells at Γ_N and
Γ_S; in all other cells degree 1 is enough."""
SINGULAR = 1e-10
HIGH = {2: 5, 3: 3}
"""Degree of Π by dimension where a load is known and the rest after OF_LOAD is a large part of what a cell adds,"""
WORTH = 0.1
"""which it is from this share on."""
AT_ONCE = 20_000_000
"""Entries of the matrices of cells that are in memory at the same time."""


@dataclass(frozen=True)
class Projection:
    """A load with mean 0, as its projection and the norm of the remainder, per cell or facet.

    Attributes:
        coefficients: Coefficients of the projection in an orthonormal basis on the reference cell or facet without the
            constant, those of lower degree first, shape (n, basis).
        rest: Squared L² norm of the remainder, divided by the measure of the reference cell or facet.
    """

    coefficients: Array
    rest: Array

    def plus(self, other: Projection) -> Projection:
        """The sum of two loads, of any degrees; the norm of its remainder is at most that of both."""
        rest = (np.sqrt(self.rest) + np.sqrt(other.rest)) ** 2
        size = max(self.coefficients.shape[1], other.coefficients.shape[1])
        return Projection(self.padded(size).coefficients + other.padded(size).coefficients, rest)

    def padded(self, size: int) -> Projection:
        """The same with so many coefficients, of which those of higher degrees are 0."""
        return Projection(np.pad(self.coefficients, ((0, 0), (0, size - self.coefficients.shape[1]))), self.rest.copy())

    def of(self, rows: Mask) -> Projection:
        """The same of a selection of the cells."""
        return Projection(self.coefficients[rows], self.rest[rows])

    def without(self, rows: Mask) -> Projection:
        """0 in a selection of the cells."""
        return Projection(np.where(rows[:, None], 0.0, self.coefficients), np.where(rows, 0.0, self.rest))

    def with_rows(self, rows: npt.NDArray[np.intp], other: Projection) -> Projection:
        """With others, of the same degree or a higher one, in these rows."""
        changed = self.padded(other.coefficients.shape[1])
        changed.coefficients[rows], changed.rest[rows] = other.coefficients, other.rest
        return changed

    def norms(self, scale: Array) -> Array:
        """L² norm per cell or facet; `scale` is its measure, divided by that of the reference one."""
        return np.sqrt(scale * ((self.coefficients**2).sum(axis=1) + self.rest))


def projected(values: Array, cell: basix.CellType, degree: int, points: Array, weights: Array) -> Projection:
    """Project functions with mean 0, given by values in the points of a quadrature, shape (n, points)."""
    basis = orthonormal(cell, degree).tabulate(0, points)[0][:, 1:, 0]
    coefficients = np.asfortranarray(values @ (weights[:, None] * basis))
    rest = values - np.asfortranarray(coefficients @ basis.T)
    return Projection(coefficients, rest**2 @ weights)


def at_points(projection: Projection, cell: basix.CellType, degree: int, points: Array) -> Array:
    """The projections in points of the reference cell or facet, shape (n, points)."""
    return projection.coefficients @ orthonormal(cell, degree).tabulate(0, points)[0][:, 1:, 0].T


@dataclass(frozen=True)
class _Reference:
    """Fluxes on the reference cell: one for each moment of the loads, and those that belong to no load.

    Attributes:
        products: ∫ τ_a,i τ_b,j, shape (dim, dim, n, n). The first fluxes belong to one moment each: moments of the load
            up to a degree and then, for cells with facets that carry a load, moments on each facet. The other
            fluxes have neither divergence nor normal component.
        moments: Number of the first fluxes.
    """

    products: Array
    moments: int


@cache
def _reference(cell: basix.CellType, of_load: int, *, at_facets: bool) -> _Reference:
    degree = max(OF_FLUX, of_load) if at_facets else of_load
    element = basix.create_element(
        basix.ElementFamily.RT, cell, degree + 1, basix.LagrangeVariant.legendre, basix.DPCVariant.unset
    )
    topology, geometry = basix.topology(cell), basix.geometry(cell)
    dim = len(topology) - 1
    points, weights = basix.make_quadrature(cell, 2 * degree + 2)
    values, *derivatives = element.tabulate(1, points)
    divergence = sum(derivatives[i][:, :, i] for i in range(dim))
    basis = orthonormal(cell, degree).tabulate(0, points)[0][:, :, 0]
    conditions = [basis.T @ (weights[:, None] * divergence)]
    for facet, normal in zip(topology[dim - 1], basix.cell.facet_outward_normals(cell), strict=True):
        x = geometry[facet]
        on_facet, facet_weights = basix.make_quadrature(facet_type(dim), 2 * degree + 2)
        edges = x[1:] - x[:1]
        area = np.sqrt(np.linalg.det(edges @ edges.T))
        flux = element.tabulate(0, x[0] + on_facet @ edges)[0] @ normal
        facet_basis = orthonormal(facet_type(dim), degree).tabulate(0, on_facet)[0][:, :, 0]
        conditions.append(area * facet_basis.T @ (facet_weights[:, None] * flux))
    numbers = [orthonormal(cell, of_load).dim, *[orthonormal(facet_type(dim), OF_FLUX).dim * at_facets] * (dim + 1)]
    wanted = [
        (np.arange(len(rows)) > 0) & (np.arange(len(rows)) < number)
        for rows, number in zip(conditions, numbers, strict=True)
    ]
    matrix = np.concatenate(conditions)
    _, values_of, right = np.linalg.svd(matrix)
    free = right[np.count_nonzero(values_of > SINGULAR * values_of[0]) :]
    answers = np.linalg.pinv(matrix, rcond=SINGULAR)[:, np.concatenate(wanted)].T
    fluxes = np.einsum("na,qai->nqi", np.concatenate([answers, free]), values)
    return _Reference(np.einsum("q,aqi,bqj->ijab", weights, fluxes, fluxes), len(answers))


def _local_norms(reference: _Reference, metric: CellMetric, cells: npt.NDArray[np.intp], moments: Array) -> Array:
    """Smallest ‖κ_h^-½ τ‖ on some cells, for moments of shape (cells, moments) on the reference cell."""
    jacobian = metric.jacobian[cells]
    dim, number = jacobian.shape[1], moments.shape[1]
    pulled = times(times(jacobian.transpose(0, 2, 1), metric.inverse[cells]), jacobian)
    pulled /= (math.factorial(dim) * metric.volume[cells])[:, None, None]
    size = reference.products.shape[-1]
    entries = reference.products.reshape(dim * dim, -1).T @ pulled.T.reshape(dim * dim, -1)
    energy = entries.reshape(size, size, -1).T  # symmetric, as `pulled` is
    force = np.einsum("cab,cb->ca", energy[:, :, :number], moments)
    squares = np.einsum("ca,ca->c", force[:, :number], moments)
    if size > number:
        answer = np.linalg.solve(energy[:, number:, number:], force[:, number:, None])[:, :, 0]
        squares -= np.einsum("ca,ca->c", force[:, number:], answer)
    return np.sqrt(np.maximum(squares, 0.0))


@dataclass(frozen=True)
class FacetLoad:
    """A load on some facets, with mean 0 on each.

    Attributes:
        points: Points of a quadrature in the facets.
        values: Values of the load there, shape (facets, points).
        missed: L² norm per facet of the part of the load that these values do not show.
    """

    points: FacetPoints
    values: Array
    missed: Array


def facet_constants(metric: CellMetric, cells: npt.NDArray[np.int32], area: Array) -> Array:
    """C_e of facets e of these cells; `area` is |e|."""
    dim = metric.jacobian.shape[1]
    return metric.diameter[cells] * np.sqrt(area / metric.volume[cells] * (1 / np.pi**2 + 2 / (np.pi * dim)))


def load_norms(
    cell: basix.CellType,
    metric: CellMetric,
    load: Projection | None,
    on_facets: list[FacetLoad],
    enough: float = 0.0,
) -> Array:
    """The factor of |w| in the module's estimate, per owned cell.

    Args:
        cell: Cell type of the mesh.
        metric: Metric of the owned cells.
        load: r per owned cell; None for 0.
        on_facets: r_e, each facet at most once.
        enough: In cells with less than this no more of a load is projected.
    """
    dim, number = metric.jacobian.shape[1], len(metric.volume)
    determinant = math.factorial(dim) * metric.volume
    within, after, higher = np.zeros((number, dim)), np.zeros(number), np.zeros(number)
    if load is not None:
        within = -determinant[:, None] * load.coefficients
        after = metric.diameter / np.pi * np.sqrt(determinant * load.rest)
        squares = (load.coefficients[:, dim:] ** 2).sum(axis=1)
        higher = metric.diameter / np.pi * np.sqrt(determinant * (load.rest + squares)) - after
    of_facets = np.zeros((number, (dim + 1) * (orthonormal(facet_type(dim), OF_FLUX).dim - 1)))
    for each in on_facets:
        points, scale = each.points, each.points.scale
        projection = projected(each.values, facet_type(dim), OF_FLUX, points.points, points.weights)
        of_facet = projection.coefficients.shape[1]
        columns = of_facet * points.local[:, None] + np.arange(of_facet)
        of_facets[points.cells[:, None], columns] = scale[:, None] * projection.coefficients
        constant = facet_constants(metric, points.cells, scale / math.factorial(dim - 1))
        after = after + points.per_cell(constant * (np.sqrt(scale * projection.rest) + each.missed), number)
    loaded = np.isin(np.arange(number), [cell for each in on_facets for cell in np.unique(each.points.cells)])
    norms, better = np.zeros((2, number))
    if load is not None:
        _add_norms(norms, cell, metric, ~loaded, within[:, :dim])
    _add_norms(norms, cell, metric, loaded, within[:, :dim], of_facets)
    norms += higher
    rough = (higher > WORTH * (norms + after)) & (higher > enough)
    _add_norms(better, cell, metric, rough & ~loaded, within)
    _add_norms(better, cell, metric, rough & loaded, within, of_facets)
    norms[rough] = np.minimum(norms, better)[rough]
    return (norms + after) / np.sqrt(metric.low)


def _add_norms(
    norms: Array, cell: basix.CellType, metric: CellMetric, chosen: Mask, within: Array, of_facets: Array | None = None
) -> None:
    """Add the smallest ‖κ_h^-½ τ‖ on chosen cells, by moments of loads in the cells and on their facets."""
    dim, cells = metric.jacobian.shape[1], np.flatnonzero(chosen)
    if len(cells) == 0:
        return
    degree = OF_LOAD if within.shape[1] == dim else HIGH[dim]
    reference = _reference(cell, degree, at_facets=of_facets is not None)
    moments = within if of_facets is None else np.hstack([within, of_facets])
    for some in np.array_split(cells, len(cells) * reference.products.shape[-1] ** 2 // AT_ONCE + 1):
        norms[some] += _local_norms(reference, metric, some, moments[some])
