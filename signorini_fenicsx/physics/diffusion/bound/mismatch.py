"""‖κ^½∇v − κ^-½y‖² on cells, with what quadrature may miss of it: κ⁻¹ is no polynomial, even where κ is one.

A quadrature Q has positive weights and is exact for polynomials up to its degree; ‖·‖_Q is a norm by it. On a simplex
let κ be within ρ of a polynomial of degree K, in the norm of matrices, and κ ≥ k > 0. For a polynomial w and r = y − κw

    |κ^½∇v − κ^-½y|² = (∇v − w)·κ(∇v + w) − 2y·(∇v − w) + r·κ⁻¹r.

Let ∇v be a polynomial. Q errs in the first term by at most e = 2ρ‖∇v − w‖‖∇v + w‖, and not in the second one. Of the
third, 0 ≤ ∫ r·κ⁻¹r ≤ ‖r‖²/k ≤ (‖r‖_Q + 2ρ‖w‖)²/k. So what Q gives of the whole is too small by at most

    e + (‖r‖_Q + 2ρ‖w‖)²/k − Q(r·κ⁻¹r),   and too large by at most   e + Q(r·κ⁻¹r).

w is κ⁻¹y in points near the vertices, for RT1 near the nodes of quadratics. Where κ hardly varies r is small, and both
are of second order in it. Other cells are cut into parts, at places where κ is the geometric mean of its values at the
ends of an edge: so also a κ of 1e-8 at a vertex needs few parts.

On cells where v contains data themselves, v = P + χd as in `hidden`. Then e belongs to P, and ‖∇P‖_Q is at most
‖∇v‖_Q + ‖∇(χd)‖_Q, for which `hidden` has the factor 1 + (2ρ/k)^½. Where such a cell is cut, the quadratic v stands for
v, and κ_max^½ times the norm of the gradient of their difference is added.

*κ as it was given, on whole cells and on parts of them*: its bounds, and how far it is from polynomials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Indices, Mask, inverted, scaled
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.base.reference_cells import SIMPLEX, positive_quadrature
from signorini_fenicsx.discrete.bernstein import coefficients_of, exponents, interpolation, jet, nodes
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.points import CellPoints, Points, in_cells
from signorini_fenicsx.expressions import TREES, Tree, is_polynomial, values
from signorini_fenicsx.expressions.cutting import in_parts
from signorini_fenicsx.expressions.enclosures import BESIDE, distances, ranges
from signorini_fenicsx.expressions.series import DEGREE, Remainder
from signorini_fenicsx.expressions.simplices import INSIDE, Parts, barycentric_gradients, bernstein, interpolated
from signorini_fenicsx.physics.diffusion.bound.admissible_trace import Trace
from signorini_fenicsx.physics.diffusion.bound.hidden import degree_near
from signorini_fenicsx.physics.diffusion.bound.local_fields import CellMetric
from signorini_fenicsx.physics.diffusion.bound.resolution import SHARE, SMALLEST, Resolution
from signorini_fenicsx.physics.diffusion.discrete.added_flux import DEGREE as DEGREE_OF_B
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux
from signorini_fenicsx.physics.diffusion.discrete.quasilinear import OnCells

ROUGH, SMALL = 4.0, 1e-3
"""A lower bound of κ on a part of a cell may be smaller than κ by this factor, on parts of this share by any."""
RESOLVED = 1 / 16
"""ρ need not be smaller than this share of what may be missed of κ itself."""


@dataclass(frozen=True)
class Conductivity:
    """κ on some owned cells: a text, or a matrix of them by rows.

    Attributes:
        trees: The entries.
        cells: The cells, ascending.
        is_matrix: Whether it is a matrix.
    """

    trees: list[Tree]
    cells: Indices
    is_matrix: bool

    def at(self, x: Array) -> Array:
        """Values in points, shape (n, points), of a matrix (n, points, dim, dim)."""
        return self._joined([np.broadcast_to(values(tree, x), x.shape[:-1]) for tree in self.trees])

    def smallest(self, x: Array) -> Array:
        """The smallest eigenvalues in points, shape (n, points)."""
        return _eigenvalues(self.at(x))[0]

    def distance(self, remainders: Sequence[Remainder], degree: int) -> Array:
        """The distance on parts of cells to polynomials of a degree, in the norm of matrices."""
        known = zip(self.trees, remainders, strict=True)
        return self.norm([rho.distance(degree) * (not is_polynomial(tree, degree)) for tree, rho in known])

    def norm(self, of_entries: Sequence[Array] | Array) -> Array:
        """The norm of a matrix with such entries at most."""
        return np.asarray(np.sqrt(np.sum(np.square(of_entries), axis=0)))

    def least(self, parts: Array, remainders: Sequence[Remainder]) -> Array:
        """Lower bounds on parts of cells, given by their vertices."""
        least = _eigenvalues(self.quadratic(parts))[0].min(axis=1) - BESIDE * self.distance(remainders, 2)
        return least if self.is_matrix else np.fmax(least, remainders[0].value.lo)

    def quadratic(self, vertices: Array) -> Array:
        """The Bernstein coefficients of quadratics near it on simplices, shape (n, nodes), or of matrices."""
        return self._joined([bernstein(interpolated(tree, vertices), vertices) for tree in self.trees])

    def _joined(self, entries: list[Array]) -> Array:
        """One array of the entries."""
        dim = round(len(entries) ** 0.5)
        return np.stack(entries, axis=-1).reshape(*entries[0].shape, dim, dim) if self.is_matrix else entries[0]


def _eigenvalues(matrices: Array) -> tuple[Array, Array]:
    """The smallest and the largest eigenvalues of numbers, shape (n, points), or matrices; NaN where there are none."""
    if matrices.ndim == 2:
        return matrices, matrices
    known = np.isfinite(matrices).all(axis=(2, 3))
    eigenvalues = np.linalg.eigvalsh(np.where(known[..., None, None], matrices, 0.0))
    least, most = (np.where(known, eigenvalues[..., end], np.nan) for end in (0, -1))
    return least, most


def conductivities(resolution: Resolution, kappa: Datum) -> list[Conductivity]:
    """The pieces of κ; none if it was given in Python, which is recorded."""
    pieces = []
    for given, cells in resolution.pieces("kappa", kappa):
        trees = [given] if isinstance(given, TREES) else [entry for row in given for entry in row]
        pieces.append(Conductivity(trees, cells, is_matrix=not isinstance(given, TREES)))
    return pieces


def enclosed(resolution: Resolution, metric: CellMetric, kappa: Datum, size: float) -> CellMetric:
    """The metric with low κ_h ≤ κ ≤ high κ_h on whole cells, and ρ (collective).

    With κ = κ̃ + δ and a quadratic κ̃, κ_h^-½κ̃κ_h^-½ is in each point a weighted mean of κ_h^-½κ_iκ_h^-½ for the
    Bernstein coefficients κ_i of κ̃.

    Args:
        resolution: Encloses data.
        metric: The metric, with `low` and `high` from the nodes of P2 only.
        kappa: κ.
        size: ‖σ_h‖.
    """
    if kappa.number is not None or isinstance(kappa, OnCells):  # constant or linear: its ends are at vertices
        return metric
    number, frame = len(metric.volume), resolution.spaces.frame
    low, high, kappa_min = metric.low.copy(), metric.high.copy(), metric.kappa_min.copy()
    rho = np.zeros(number)
    inverse = metric.inverse
    for piece in conductivities(resolution, kappa):
        cells = piece.cells
        vertices, tolerance = resolution.vertices[cells], SHARE * np.maximum(metric.kappa_min[cells], SMALLEST)
        beyond = np.zeros((2, len(piece.trees), len(cells)))
        for row, tree in enumerate(piece.trees):
            if not is_polynomial(tree, 2):
                p = interpolated(tree, vertices)
                beyond[0, row] = ranges(tree, vertices, p, frame, -tolerance, tolerance).sup
            if not is_polynomial(tree, DEGREE):
                enough = RESOLVED * tolerance * resolution.error / max(size, SMALLEST)
                beyond[1, row] = distances(tree, vertices, frame, enough)
        beside, rho[cells] = (piece.norm(each) for each in beyond)
        root, coefficients = np.linalg.cholesky(inverse[cells])[:, None], piece.quadratic(vertices)
        if piece.is_matrix:
            coefficients = root.transpose(0, 1, 3, 2) @ coefficients @ root
        else:
            coefficients = coefficients * inverse[cells, 0, 0][:, None]
        least, most = _eigenvalues(coefficients)
        beside = beside * np.linalg.norm(inverse[cells], ord=2, axis=(1, 2))
        least, most = least.min(axis=1, initial=1.0) - beside, most.max(axis=1, initial=1.0) + beside
        lost = ~(least > 0)
        lowest = _lowest(resolution, piece, vertices[lost])
        least[lost] = lowest * np.linalg.eigvalsh(inverse[cells[lost]])[:, 0]
        known = (least > 0) & np.isfinite(most)
        resolution.note("kappa", vertices[~known].mean(axis=1), cells[~known])
        low[cells[known]], high[cells[known]] = least[known], most[known]
        kappa_min[cells[known]] *= (least / metric.low[cells])[known]
        kappa_min[cells[lost & known]] = lowest[known[lost]]
    return replace(metric, low=low, high=high, kappa_min=kappa_min, rho=rho)


def _lowest(resolution: Resolution, piece: Conductivity, vertices: Array) -> Array:
    """Lower bounds of eigenvalues of κ on cells by their parts, ≤ 0 where none is found (collective)."""

    def look(parts: Parts, *remainders: Remainder) -> Array:
        seen = piece.smallest(parts.vertices).min(axis=1)
        return np.stack([piece.least(parts.vertices, remainders), seen], axis=1)

    def need(parts: Parts, of_parts: Array) -> Array:
        least, seen = of_parts.T
        return np.where((least < seen / ROUGH) & (parts.share > SMALL), 1.0, 0.0)

    parts, of_parts = in_parts(piece.trees, vertices, resolution.spaces.frame, look, need, piece.smallest)
    lowest = np.full(len(vertices), np.inf)
    np.minimum.at(lowest, parts.simplex, np.nan_to_num(of_parts[:, 0], nan=-np.inf))
    return lowest


CLOSE = 0.01
"""A share of a square that may be missed."""


@dataclass(frozen=True)
class Squares:
    """Squares per owned cell: by quadrature, and by how much they may be too small and too large."""

    seen: Array
    small: Array
    large: Array

    @property
    def most(self) -> Array:
        """Upper bounds."""
        return np.maximum(self.seen, 0.0) + self.small

    @property
    def least(self) -> Array:
        """Lower bounds."""
        return np.maximum(self.seen - self.large, 0.0)


@dataclass(frozen=True)
class Energies:
    """Squares of energy norms for one κ.

    Attributes:
        resolution: Encloses κ.
        metric: Metric of the owned cells.
        kappa: κ.
    """

    resolution: Resolution
    metric: CellMetric
    kappa: Datum

    @property
    def _order(self) -> int:
        """The degree of y, of ∇v and of w; with b that of the polynomials near it."""
        return _order(self.resolution)

    @property
    def _degree(self) -> int:
        """The degree of κ, K at most."""
        return DEGREE if self.kappa.polynomial is None else min(self.kappa.polynomial, DEGREE)

    def squares(self, flux: CellFlux | None, trace: Trace | None = None, less: fem.Function | None = None) -> Squares:
        """‖κ^½∇(v − w) − κ^-½y‖² (collective).

        Args:
            flux: y; None for 0.
            trace: Has v; None for 0.
            less: w, quadratic, by its Bernstein coefficients; None for 0.
        """
        field = _Field(flux, trace, less)
        mesh, varies = self.resolution.spaces.mesh, self.kappa.number is None
        near_cells = np.empty(0, dtype=np.int32) if trace is None else trace.cells
        far = np.delete(owned_cells(mesh), near_cells)
        of_kappa = max(quadrature_degree(self.kappa), 2 * (self._degree + self._order)) if varies else 2 * self._order
        near_degree = 2 * self._order
        if trace is not None:
            near_degree = max(near_degree, degree_near(trace)) + self._degree
        squares = Squares(*np.zeros((3, len(self.metric.volume))))
        for near, cells, degree in ((False, far, of_kappa), (True, near_cells, near_degree)):
            for points in in_cells(mesh, cells, *positive_quadrature(mesh.basix_cell(), degree)):
                self._look(points, field, squares, near=near)
        if varies and self.kappa.pieces is not None:
            self._cut(field, squares, near_cells)
        return squares

    def _look(self, points: CellPoints, field: _Field, squares: Squares, *, near: bool) -> None:
        """Look at the squares in the points of a quadrature (collective)."""
        rows, slope, y = points.rows, field.slope(points, near=near), field.flux_at(points)
        kappa = self.kappa.values(points)
        off = scaled(kappa, slope) - y
        squares.seen[rows] = points.integrals(_product(off, scaled(inverted(kappa), off)))
        if self.kappa.number is not None or (self.kappa.pieces is None and self.kappa.polynomial is None):
            return
        cell = points.mesh.basix_cell()
        ends = CellPoints(points.mesh, points.cells, _nearer(nodes(cell, self._order), INSIDE), np.empty(0))
        of_ends = interpolation(cell, self._order, _nearer(points.points, 1 / INSIDE))
        w = of_ends @ scaled(inverted(self.kappa.values(ends)), field.flux_at(ends))
        rule, known = points.weights / points.weights.sum(), (self.metric.rho[rows], self.metric.kappa_min[rows])
        missed = _missed(kappa, slope, y, w, rule, *known)
        squares.small[rows], squares.large[rows] = (self.metric.volume[rows] * each for each in missed)

    def _cut(self, field: _Field, squares: Squares, near_cells: npt.NDArray[np.int32]) -> None:
        """Cut the cells where too much may be missed (collective)."""
        resolution, volume, mesh = self.resolution, self.metric.volume, self.resolution.spaces.mesh
        total, missed = (SHARE * resolution.error) ** 2, squares.small
        if field.trace is None:  # of ‖κ^-½y‖ a lower bound is wanted
            total, missed = SHARE**2 * resolution.spaces.mesh.comm.allreduce(squares.seen.sum()), squares.large
        rough = ~(missed <= np.maximum(total * volume / resolution.volume, CLOSE * squares.seen))
        extra = self._of_data(field, rough[near_cells], near_cells)
        for piece in conductivities(resolution, self.kappa):
            cells = piece.cells[rough[piece.cells]]
            ends = CellPoints(mesh, cells.astype(np.int32), nodes(mesh.basix_cell(), self._order), np.empty(0))
            local = field.slope(ends, near=False), field.flux_at(ends)
            of_cells = _in_parts(resolution, piece, cells, *local, volume[cells], total)
            bounded = np.isfinite(of_cells.small)
            resolution.note("kappa", resolution.vertices[cells[~bounded]].mean(axis=1), cells[~bounded])
            squares.small[cells[~bounded]] = squares.large[cells[~bounded]] = 0.0
            chosen = cells[bounded]
            squares.seen[chosen] = (np.sqrt(of_cells.seen[bounded]) + extra[chosen]) ** 2
            squares.large[chosen] = (of_cells.large + of_cells.small)[bounded]
            most = (np.sqrt(of_cells.most[bounded]) + extra[chosen]) ** 2
            squares.small[chosen] = most - squares.seen[chosen]
            resolution.record_missed("kappa", chosen, squares.small[chosen])

    def _of_data(self, field: _Field, rough: Mask, near_cells: npt.NDArray[np.int32]) -> Array:
        """κ_max^½‖∇(v − its quadratic)‖ on the rough cells of those near data, else 0 (collective)."""
        extra, mesh, trace = np.zeros(len(self.metric.volume)), self.resolution.spaces.mesh, field.trace
        if trace is None:
            return extra
        rule = positive_quadrature(mesh.basix_cell(), degree_near(trace) + self._degree)
        for points in in_cells(mesh, near_cells[rough], *rule):
            change = field.slope(points, near=True) - field.slope(points, near=False)
            squares = self.metric.kappa_max[points.cells] * points.integrals(_product(change, change))
            extra[points.cells] = np.sqrt(squares)
        return extra


@dataclass(frozen=True)
class _Field:
    """∇(v − w) and y, see `Energies.squares`."""

    flux: CellFlux | None
    trace: Trace | None
    less: fem.Function | None

    def slope(self, points: Points, *, near: bool) -> Array:
        """∇(v − w) in points, with the data that v contains themselves, or of its quadratic (collective)."""
        dim = points.mesh.geometry.dim
        if self.trace is None:
            return np.zeros((*points.shape, dim))
        slope = self.trace.jet(points, near=near, gradient=True)[:, :, 1:]
        return slope if self.less is None else slope - points.bernstein(self.less, gradient=True)[:, :, 1:]

    def flux_at(self, points: Points) -> Array:
        """Y in points."""
        return np.zeros((*points.shape, points.mesh.geometry.dim)) if self.flux is None else self.flux.at(points)


def _in_parts(
    resolution: Resolution, piece: Conductivity, cells: Indices, slope: Array, flux: Array, volume: Array, total: float
) -> Squares:
    """The squares on some cells, which are cut into parts (collective).

    Args:
        resolution: Encloses κ.
        piece: κ there.
        cells: The cells.
        slope: ∇v in their vertices, for RT1 in the nodes of quadratics, shape (cells, nodes, dim).
        flux: y there.
        volume: Of the cells.
        total: So much may be missed of all squares together.
    """
    vertices, frame = resolution.vertices[cells], resolution.spaces.frame
    centre, hats = vertices.mean(axis=1), barycentric_gradients(vertices)
    cell, order = SIMPLEX[vertices.shape[2]], _order(resolution)
    points, weights = positive_quadrature(cell, 2 * (DEGREE + order))
    barycentric, rule = np.column_stack([1 - points.sum(axis=1), points]), weights / weights.sum()
    shares, of_nodes = exponents(cell, order) / order, interpolation(cell, order, points)
    of_ends = interpolation(cell, order, _nearer(points, 1 / INSIDE))
    fields = [[coefficients_of(component, cell) for component in np.moveaxis(each, 2, 0)] for each in (slope, flux)]

    def look(parts: Parts, *remainders: Remainder) -> Array:
        rows, corners = parts.simplex, parts.vertices.shape[1]
        at = 1 / corners + np.einsum("nqi,nvi->nqv", parts.vertices - centre[rows, None], hats[rows])
        near = 1 / corners + INSIDE * (shares - 1 / corners)

        def of(field: list[Array], places: Array) -> Array:
            return np.concatenate([jet(each[rows], places @ at) for each in field], axis=2)

        w = of_ends @ scaled(inverted(piece.at(near @ parts.vertices)), of(fields[1], near))
        slope, y = (of_nodes @ of(each, shares) for each in fields)
        kappa = piece.at(barycentric @ parts.vertices)
        off = scaled(kappa, slope) - y
        rho, least = piece.distance(remainders, DEGREE), piece.least(parts.vertices, remainders)
        seen = _product(off, scaled(inverted(kappa), off)) @ rule
        return np.stack([seen, *_missed(kappa, slope, y, w, rule, rho, least)], axis=1)

    def need(parts: Parts, of_parts: Array) -> Array:
        seen, small, _ = of_parts.T
        return np.where(small <= CLOSE * seen, 0.0, volume[parts.simplex] * parts.share * small / max(total, 1e-300))

    parts, of_parts = in_parts(piece.trees, vertices, frame, look, need, piece.smallest)
    return Squares(*(volume * parts.sums(of_parts, len(cells))))


def _order(resolution: Resolution) -> int:
    order: int = resolution.spaces.degree + 1
    return order if resolution.data.b is None else max(order, DEGREE_OF_B)


def _missed(
    kappa: Array, slope: Array, y: Array, w: Array, rule: Array, rho: Array, least: Array
) -> tuple[Array, Array]:
    """By how much the mean of |κ^½∇v − κ^-½y|² by a quadrature may be too small and too large, see the module."""

    def mean(a: Array, b: Array) -> Array:
        return np.asarray(_product(a, b) @ rule)

    r = y - scaled(kappa, w)
    of_kappa = 2 * rho * np.sqrt(mean(slope - w, slope - w) * mean(slope + w, slope + w))
    of_r, size = mean(r, scaled(inverted(kappa), r)), np.sqrt(mean(r, r)) + 2 * rho * np.sqrt(mean(w, w))
    with np.errstate(all="ignore"):
        whole = np.where(least > 0, size**2 / least, np.where(size > 0, np.inf, 0.0))
        return of_kappa + np.maximum(whole - of_r, 0.0), of_kappa + of_r


def _product(a: Array, b: Array) -> Array:
    return np.einsum("nqi,nqi->nq", a, b)


def _nearer(points: Array, share: float) -> Array:
    """Points of the reference cell, moved to have so many times their distance from the centroid."""
    middle = 1 / (points.shape[1] + 1)
    return middle + share * (points - middle)
