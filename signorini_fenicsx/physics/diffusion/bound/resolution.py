"""The data of a certificate, enclosed: what quadrature may have missed of them enters the bound.

Data that a case gives as text are trees, which `expressions.enclosures` encloses on whole cells and facets. The
certificate replaces a load e by a polynomial p; d = e − p is the difference.

- *Loads.* On a cell, (d, w)_T = (d, w − w_T)_T + |T| μ w_T with μ the mean of d and w_T that of w; the first term is at
  most (δ_T/π)‖d‖ |w|, as in `local_fields`. On a facet e of T, (d, w)_e ≤ C_e‖d‖_e |w| + |e| μ_e w_T. The means
  together are one load per cell, for which see `equilibrated`.

- *κ*: see `mismatch`.
- *u_D, ψ and bounds in Ω*, where v contains them themselves: see `hidden`.

Polynomials are integrated exactly. Data given in Python have no trees; for these the bound relies on quadrature.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import AnyIndices, Array, Indices, Mask
from signorini_fenicsx.base.reference_cells import positive_quadrature
from signorini_fenicsx.certificate.certificate import Places, first_places
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.points import FacetPoints, cell_quadrature, in_cells
from signorini_fenicsx.expressions import TREES, Tree, is_polynomial, values
from signorini_fenicsx.expressions.enclosures import distances, means, ranges
from signorini_fenicsx.expressions.given import Rows
from signorini_fenicsx.expressions.intervals import Interval, enclosing
from signorini_fenicsx.expressions.products import EXACT, SMALLEST
from signorini_fenicsx.expressions.series import DEGREE
from signorini_fenicsx.expressions.simplices import Polynomial, Quadratic
from signorini_fenicsx.physics.diffusion.bound.local_fields import CellMetric, facet_constants
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces

MUCH = 0.5
"""If enclosures add more than this share of the bound, data are not resolved."""
SHARE, QUANTUM = 0.02, 1e-6
"""Enclosures stop where their uncertainty is about the first share of the error; loads that return are rounded to about
the second share of the largest."""


@dataclass(frozen=True)
class Rest:
    """What quadrature shows of d = e − p on some cells or facets.

    Attributes:
        p: p.
        norm: Root mean square of d.
        mean: Its mean.
    """

    p: Quadratic | Polynomial
    norm: Array
    mean: Array

    def of(self, rows: AnyIndices | Mask) -> "Rest":
        """A selection of the simplices."""
        return Rest(self.p.of(rows), self.norm[rows], self.mean[rows])


@dataclass
class Resolution:
    """What encloses the data of one solution and records what quadrature may have missed.

    Attributes:
        spaces: The discrete spaces.
        data: The data.
        error: Rough size of the error in the energy norm.
        volume: |Ω|.
        returns: Whether data are those of many problems, such as of all steps: then what is made of them returns.
        by_quadrature: Data without enclosures: those given in Python, and loads if there is no Γ_D for their means.
        unresolved: Data with a place each that are not resolved, on this rank.
        coarse: Mask of the owned cells with such places.
        load: c, the means of the missed loads, per owned cell.
        size: The sum of the largest |c| of each of these loads.
        missed: What the enclosures add to the bound apart from these means, squared, per owned cell.
    """

    spaces: Spaces
    data: Data
    error: float
    volume: float
    returns: bool = False
    by_quadrature: set[str] = field(default_factory=set)
    unresolved: list[tuple[str, tuple[float, ...]]] = field(default_factory=list)
    coarse: Mask = field(init=False)
    load: Interval = field(init=False)
    size: Array = field(init=False)
    missed: Array = field(init=False)
    _sizes: dict[str, Array] = field(default_factory=dict)
    _loads: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        number = len(self.spaces.cell_measures)
        self.coarse, self.missed, self.size = np.zeros(number, dtype=bool), np.zeros(number), np.zeros(number)
        self.load = enclosing(np.zeros(number))

    @cached_property
    def vertices(self) -> Array:
        """The vertices of the owned cells, shape (cells, dim + 1, dim)."""
        return corners(self.spaces.mesh)

    def pieces(self, name: str, datum: Datum) -> list[tuple[Tree | Rows, Indices]]:
        """The trees of a datum and the owned cells of each; none for data given in Python, which are recorded."""
        if datum.pieces is None:
            self.by_quadrature.add(name)
        return list(datum.pieces_in(np.arange(len(self.coarse))))

    def encloses(self, name: str, datum: Datum) -> bool:
        """Whether enclosures are needed and possible: not for polynomials, and not for data given in Python."""
        return any(is_enclosed(tree) for tree, _ in self.pieces(name, datum))

    def tree(self, name: str, datum: Datum) -> Tree | None:
        """The tree of a datum that is to be enclosed and is given everywhere at once; None if there is none."""
        return next(
            (tree for tree, _ in self.pieces(name, datum) if isinstance(tree, TREES) and is_enclosed(tree)), None
        )

    def on_cells(
        self, name: str, datum: Datum, seen: Rest, metric: CellMetric, cells: AnyIndices, factor: Array | float = 1.0
    ) -> Array:
        """Root mean square of a load minus p on some owned cells; its mean is recorded (collective).

        Args:
            name: Name of the load.
            datum: The load, but for the factor.
            seen: What quadrature shows on these cells, without the factor.
            metric: Metric of all owned cells.
            cells: The cells, ascending.
            factor: Of each of them.
        """
        norm, mean = seen.norm.copy(), np.stack([seen.mean, seen.mean])
        weight = (factor / self.tolerance(metric)[cells]) ** 2 * metric.volume[cells] / self.volume
        for tree, within in self.pieces(name, datum):
            if isinstance(tree, TREES) and is_enclosed(tree):
                rows = np.flatnonzero(np.isin(cells, within))
                norm_and_mean = self._enclosed(tree, self.vertices[cells[rows]], seen.of(rows), weight[rows])
                norm[rows], mean[:, rows] = norm_and_mean
        size = np.abs(factor)
        squares = (size * metric.diameter[cells] / np.pi) ** 2 * metric.volume[cells] / metric.low[cells]
        beyond = squares * np.maximum(norm**2 - seen.norm**2, 0.0)
        self._record(name, cells, Interval(*mean) * factor, beyond, metric)
        return np.asarray(size * norm, dtype=np.float64)

    def on_facets(self, name: str, datum: Datum, seen: Rest, points: FacetPoints, metric: CellMetric) -> Array:
        """L² norm of a flux minus p per facet; its mean is recorded (collective).

        Args:
            name: Name of the flux.
            datum: The flux, a tree.
            seen: What quadrature shows on these facets.
            points: Points in them.
            metric: Metric of all owned cells.
        """
        cells, area = points.cells, points.integrals(np.ones(points.shape))
        weight = area**2 / metric.volume[cells] / self.volume / self.tolerance(metric)[cells] ** 2
        ((tree, _),) = self.pieces(name, datum)
        assert isinstance(tree, TREES)
        norm, (lo, hi) = self._enclosed(tree, points.vertices, seen, weight)
        squares = facet_constants(metric, cells, area) ** 2 * area / metric.low[cells]
        mean = Interval(lo, hi) * (area / metric.volume[cells])
        self._record(name, cells, mean, squares * np.maximum(norm**2 - seen.norm**2, 0.0), metric)
        return np.asarray(norm * np.sqrt(area), dtype=np.float64)

    def deviation(self, tree: Tree, p: Quadratic, cells: AnyIndices, tolerance: Array) -> tuple[Array, Array]:
        """Root mean square and the ends of the mean of a tree minus quadratics on owned cells (collective).

        They are about as sharp as `tolerance`.
        """
        rule = positive_quadrature(self.spaces.mesh.basix_cell(), 2 * DEGREE)
        norm, mean = np.empty((2, len(cells)))
        for points in in_cells(self.spaces.mesh, cells.astype(np.int32), *rule):
            rows, weights = np.searchsorted(cells, points.cells), points.weights / points.weights.sum()
            rest = values(tree, points.x)
            rest = rest - p.of(rows).at(points.arms)[:, :, 0]
            norm[rows], mean[rows] = np.sqrt(rest**2 @ weights), rest @ weights
        weight = self.spaces.cell_measures[cells] / self.volume / np.maximum(tolerance, SMALLEST) ** 2
        return self._enclosed(tree, self.vertices[cells], Rest(p, norm, mean), weight)

    def _enclosed(self, tree: Tree, vertices: Array, seen: Rest, weight: Array) -> tuple[Array, Array]:
        """Root mean square and the ends of the mean of a tree minus p, with the weights of `means` (collective)."""
        p = [getattr(seen.p, each.name) for each in fields(seen.p)]
        arrays = [np.asarray(each) for each in (*p, vertices, seen.norm, seen.mean, weight)]
        kept, comm = self.spaces.kept_results, self.spaces.mesh.comm
        return kept.get(comm, "enclosed", tree, arrays, lambda: self._newly_enclosed(tree, vertices, seen, weight))

    def _newly_enclosed(self, tree: Tree, vertices: Array, seen: Rest, weight: Array) -> tuple[Array, Array]:
        limit = 1 / np.sqrt(self.spaces.frame.simplices * weight)
        rho = 2 * distances(tree, vertices, self.spaces.frame, limit / 4)
        norm, mean = seen.norm + rho, np.stack([seen.mean - rho, seen.mean + rho])
        hidden = rho > limit / 2
        enclosed = means(tree, vertices[hidden], seen.p.of(hidden), self.spaces.frame, weight[hidden])
        norm[hidden], mean[:, hidden] = enclosed.norm, [enclosed.mean.lo, enclosed.mean.hi]
        return norm, mean

    def _record(self, name: str, cells: AnyIndices, mean: Interval, squares: Array, metric: CellMetric) -> None:
        """Record a load of which these means, and these squares of factors of |w|, are not seen."""
        number = len(self.coarse)
        self.load = self.load + Interval(*(np.bincount(cells, end, number) for end in (mean.lo, mean.hi)))
        self.record_missed(name, cells, squares)
        self.size = self.size + np.bincount(cells, mean.largest, number)
        of_mean = (SHARE * self.error * mean.largest / self.tolerance(metric)[cells]) ** 2
        self._loads.add(name)
        self._sizes[name] += np.bincount(cells, of_mean * metric.volume[cells] / self.volume, number)

    def record_missed(self, name: str, cells: AnyIndices, squares: Array) -> None:
        """Record squares of what a datum adds to the bound on some owned cells."""
        of_cells = np.bincount(cells, squares, len(self.coarse))
        self.missed += of_cells
        self._sizes[name] = self._sizes.get(name, 0.0) + of_cells

    def add_means(self, name: str, means: Array, metric: CellMetric) -> None:
        """Record the means of a load on the owned cells."""
        self._record(name, np.arange(len(means)), enclosing(means), np.zeros(len(means)), metric)

    def add_load(self, name: str, mean: Interval, size: Array, metric: CellMetric) -> None:
        """Record a load of which only its mean and a bound of its size on each owned cell are known."""
        squares = (metric.diameter / np.pi * size) ** 2 * metric.volume / metric.low
        self._record(name, np.arange(len(size)), mean, squares, metric)

    def range_of(self, name: str, datum: Datum, cells: AnyIndices, limit: Array) -> Interval:
        """Range of a datum on some owned cells, as narrow as is needed to see whether it is ≤ a limit (collective).

        Of data given in Python the range in the points of a quadrature.
        """
        lo, hi = np.empty(len(cells)), np.empty(len(cells))
        for points in cell_quadrature(self.spaces.mesh, cells.astype(np.int32), quadrature_degree(datum)):
            seen, rows = datum.values(points), np.searchsorted(cells, points.cells)
            lo[rows], hi[rows] = seen.min(axis=1, initial=np.inf), seen.max(axis=1, initial=-np.inf)
        for tree, within in self.pieces(name, datum):
            assert isinstance(tree, TREES)
            below = np.flatnonzero((hi <= limit) & np.isin(cells, within))
            least, most = (2 * lo - limit)[below], limit[below]
            narrower = ranges(tree, self.vertices[cells[below]], None, self.spaces.frame, least, most)
            lo[below], hi[below] = narrower.lo, narrower.hi
        return Interval(lo, hi)

    def flux(self, metric: CellMetric) -> Array:
        """A flux size per owned cell that makes only the share SHARE of the error."""
        return SHARE * self.error * np.sqrt(np.maximum(metric.kappa_min, 0.0) / self.volume)

    def tolerance(self, metric: CellMetric) -> Array:
        """A load size per owned cell that makes about the share SHARE of the error."""
        return np.maximum(self.flux(metric) / self.volume ** (1 / self.vertices.shape[2]), SMALLEST)

    def load_left(self, measure: Callable[[Interval], float]) -> float:
        """What the means of the loads add to the bound, by `measure`; where that is infinite without Γ_D, nothing.

        Then these loads rely on quadrature (collective).
        """
        left = measure(_rounded_out(self.load, self.spaces.mesh.comm) if self.returns else self.load)
        if np.isfinite(left) or self.spaces.held:
            return left
        self.by_quadrature |= self._loads
        return 0.0

    def note(self, name: str, places: Array, cells: AnyIndices) -> None:
        """Record places on some cells where a datum is not resolved."""
        self.unresolved += [(name, tuple(place)) for place in places.tolist()]
        self.coarse[cells] = True

    def account(self, share: float) -> Places:
        """Data that are not resolved, each with a place; the same on all ranks (collective).

        If enclosures add much to the bound, the places where they add most are not resolved.

        Args:
            share: Share of the bound that comes from the enclosures.
        """
        comm = self.spaces.mesh.comm
        if not share <= MUCH:
            sizes = {name: np.where(np.isnan(size), np.inf, size) for name, size in self._sizes.items()}
            most = comm.allreduce(max((size.max(initial=0.0) for size in sizes.values()), default=0.0), MPI.MAX)
            for name, size in sizes.items():
                worst = (size >= most / 4) & (size > 0)
                self.note(name, self.vertices[worst].mean(axis=1), np.flatnonzero(worst))
        return first_places(self.unresolved, comm)


def _rounded_out(load: Interval, comm: MPI.Comm) -> Interval:
    """An interval around a load that is not another one for rounding, so that what is kept of it is found (collective).

    Its ends are multiples of a power of 2 that is about QUANTUM of the largest load.
    """
    largest = comm.allreduce(load.largest.max(initial=0.0), MPI.MAX)
    if not 0 < largest < math.inf:
        return load
    step = 2.0 ** math.floor(math.log2(QUANTUM * largest))
    return Interval(step * (np.round(load.lo / step) - 1), step * (np.round(load.hi / step) + 1))


def is_enclosed(tree: Tree | Rows) -> bool:
    """Whether quadrature may miss something of it: it is no polynomial, or one of a high degree."""
    return not (isinstance(tree, TREES) and is_polynomial(tree, EXACT))
