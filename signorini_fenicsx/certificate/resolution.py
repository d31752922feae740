"""Bounds of what quadrature may have missed of the data, by enclosures.

Data that a case gives as text are trees, which intervals enclose on whole cells and facets (`enclosures`). The
certificate replaces each expression e by a polynomial p; d = e − p is the difference.

- *Loads.* On a cell, (d, w)_T = (d, w − w_T)_T + |T| μ w_T with μ the mean of d and w_T that of w; the first term is at
  most (δ_T/π)‖d‖ |w|, as in `local_fluxes`. On a facet e of T, (d, w)_e ≤ C_e‖d‖_e |w| + |e| μ_e w_T. So the means
  together are one load per cell, c. Take z with −∇·z = 1, z·n = 0 on Γ_N and Γ_S, and let s be the largest κ^-½|z|. For
  all w = 0 on Γ_D

      |w|² ≥ (2tw z, ∇w) − ‖tκ^-½ wz‖² ≥ (t − t²s²)‖w‖² = ‖w‖²/4s²   with t = 1/2s²,   so (c, w) ≤ 2s‖c‖ |w|.

- *κ*, with P2 interpolant κ̃ and S = sup |κ − κ̃| on T: ‖κ^½∇v − κ^-½y‖ ≤ ρ^½‖κ̃^½∇v − κ̃^-½y‖ + S‖y‖/(κ_min^½ κ̃_min),
  ρ = 1 + S/κ̃_min, since κ^½∇v − κ^-½y = κ^½κ̃⁻¹(κ̃∇v − y) + κ^-½(κ − κ̃)κ̃⁻¹y.
- *u_D, ψ and an obstacle*, where v contains them themselves: see `hidden`.

For loads, quadrature is used where three conditions hold: its points show at least a third of d, quadratures of two
degrees agree about the mean of d, and d does not jump. Elsewhere ‖d‖ and the mean come from the enclosures.

Polynomials are integrated exactly. Data given in Python have no trees; for these the bound relies on quadrature.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.certificate.enclosures import Enclosure, cell_vertices, enclose
from signorini_fenicsx.certificate.interpolants import (
    POINTS,
    bernstein,
    edge_order,
    mean_above,
    quadratic_of,
)
from signorini_fenicsx.certificate.local_fluxes import facet_constants
from signorini_fenicsx.certificate.metric import CellMetric
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.points import FacetPoints, cell_quadrature
from signorini_fenicsx.expressions import TREES, Tree, polynomial_degree
from signorini_fenicsx.expressions.given import Rows
from signorini_fenicsx.expressions.intervals import Interval, enclosing
from signorini_fenicsx.expressions.quadratics import Quadratic, constant, interpolated
from signorini_fenicsx.physics.diffusion.data import Data
from signorini_fenicsx.physics.diffusion.spaces import Spaces

type Indices = npt.NDArray[np.int32]

EXACT = 15
"""Squares of polynomials up to this degree are integrated exactly, by quadrature of twice this degree."""
LOADS = ("f", "g_N", "q_S", "c")
AGREED = 0.1
"""Two quadratures agree about a mean if they differ by at most this share of the root mean square."""
OVERLOOKED = 3.0
"""Quadrature overlooks a gradient if the gradient is more than this times what the points show."""
LITTLE, MUCH = 0.1, 0.5
"""Shares of the bound by enclosures: up to the first, hit caps do not matter; above the second, data are unresolved."""
PLACES = 10
"""Largest number of unresolved places that are kept."""
SHARE = 0.02
"""Enclosures stop where their uncertainty is about this share of the error."""


@dataclass
class Resolution:
    """Encloses the data of one solution and records what quadrature may have missed.

    Attributes:
        spaces: The discrete spaces.
        data: The data.
        error: Rough size of the error in the energy norm.
        volume: |Ω|.
        by_quadrature: Data without enclosures: those given in Python, and loads if there is no Γ_D for their means.
        unresolved: Data with a place each where the cap on boxes was hit, on this rank.
        coarse: Mask of the owned cells with such places.
        load: c, the means of the missed loads, per owned cell.
        missed: What the enclosures add to the bound apart from these means, squared, per owned cell.
        lost: Data that the bound does not fully take into account.
    """

    spaces: Spaces
    data: Data
    error: float
    volume: float
    by_quadrature: set[str] = field(default_factory=set)
    unresolved: list[tuple[str, tuple[float, ...]]] = field(default_factory=list)
    coarse: npt.NDArray[np.bool_] = field(init=False)
    load: Interval = field(init=False)
    missed: Array = field(init=False)
    lost: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        number = self.spaces.Q.dofmap.index_map.size_local
        self.coarse, self.missed = np.zeros(number, dtype=bool), np.zeros(number)
        self.load = enclosing(np.zeros(number))

    def encloses(self, name: str) -> bool:
        """Whether enclosures are needed and possible: not for polynomials, and not for data given in Python."""
        return self.given_as_text(name) and any(_is_enclosed(tree) for tree, _ in self.of_regions(name))

    def on_cells(self, name: str, nodes: Array, seen: Array, metric: CellMetric, cells: Indices) -> Array:
        """Root mean square of a load minus p on some owned cells (collective).

        Args:
            name: Name of the load.
            nodes: Values of p in the nodes of P2, shape (cells, nodes).
            seen: The root mean square by quadrature, shape (cells,).
            metric: Metric of all owned cells.
            cells: The cells.
        """
        vertices = cell_vertices(self.spaces.mesh)[cells]
        tolerance = self.flux(metric)[cells] / self.volume ** (1 / vertices.shape[2])
        p, norm = quadratic_of(vertices, nodes), seen.copy()
        of_load, missed = np.zeros((2, len(self.missed))), np.zeros(len(self.missed))
        for tree, own in self.of_regions(name):
            if isinstance(tree, TREES) and _is_enclosed(tree):
                here = np.flatnonzero(np.isin(cells, own))
                norm[here], mean = self._load(
                    name, tree, vertices[here], p.of(here), seen[here], tolerance[here], cells[here]
                )
                of_load[:, cells[here]] = mean.lo, mean.hi
        self.load = self.load + Interval(*of_load)
        missed[cells] = np.where(norm > seen, norm, 0.0)
        self.missed += (metric.diameter / np.pi * missed) ** 2 * metric.volume / metric.low
        return norm

    def range_of(self, name: str, cells: Indices, limit: Array) -> Interval:
        """Range of a datum on some owned cells, as narrow as is needed to see whether it is ≤ a limit (collective).

        Of data given in Python the range in the points of a quadrature.
        """
        datum, lo, hi = self._datum(name), np.empty(len(cells)), np.empty(len(cells))
        for points in cell_quadrature(self.spaces.mesh, cells, quadrature_degree(datum)):
            seen, rows = datum.values(points), np.searchsorted(cells, points.cells)
            lo[rows], hi[rows] = seen.min(axis=1), seen.max(axis=1)
        for tree, own in self.of_regions(name) if self.given_as_text(name) else []:
            assert isinstance(tree, TREES)
            below = np.flatnonzero((hi <= limit) & np.isin(cells, own))
            least, most = (2 * lo - limit)[below], limit[below]
            vertices = cell_vertices(self.spaces.mesh)[cells[below]]
            middle = constant((least + most) / 2, vertices.shape[2])
            comm, scale = self.spaces.mesh.comm, self.scale()
            found = enclose(tree, vertices, middle, (most - least) / 2, comm, scale=scale, by="sup")
            lo[below], hi[below] = found.range.lo, found.range.hi
        return Interval(lo, hi)

    def on_facets(self, name: str, points: FacetPoints, nodes: Array, seen: Array, metric: CellMetric) -> Array:
        """L² norm of a flux minus p per facet, with arguments like those of `on_cells` (collective)."""
        p, tolerance, tree = quadratic_of(points.vertices, nodes), self.flux(metric)[points.cells], self.tree(name)
        assert tree is not None
        norm, mean = self._load(name, tree, points.vertices, p, seen, tolerance, points.cells)
        area = points.integrals(np.ones((len(points.cells), len(points.weights))))
        share = area / metric.volume[points.cells]
        number = len(metric.volume)
        self.load = self.load + Interval(*(points.per_cell(share * end, number) for end in (mean.lo, mean.hi)))
        squares = facet_constants(metric, points.cells, area) ** 2 * area * norm**2 / metric.low[points.cells]
        self.missed += points.per_cell(np.where(norm > seen, squares, 0.0), number)
        return np.asarray(norm * np.sqrt(area), dtype=np.float64)

    def _load(
        self, name: str, tree: Tree, vertices: Array, p: Quadratic, seen: Array, tolerance: Array, cells: Indices
    ) -> tuple[Array, Interval]:
        """Root mean square and mean of a load minus p; `seen` and 0 where quadrature is good enough (collective)."""
        comm, scale = self.spaces.mesh.comm, self.scale()
        enough = np.maximum(OVERLOOKED * seen, tolerance)
        first = enclose(tree, vertices, p, enough, comm, scale=scale)
        means = [mean_above(tree, vertices, p, degree) for degree in (POINTS, 2 * POINTS)]
        agree = np.abs(means[0] - means[1]) <= np.maximum(AGREED * seen, tolerance)
        hidden = ~((first.norm <= enough) & np.isfinite(first.slope) & agree)
        found = self.enclosed(name, tree, vertices[hidden], p.of(hidden), tolerance[hidden], cells[hidden], "mean")
        norm, lo, hi = seen.copy(), np.zeros(len(seen)), np.zeros(len(seen))
        norm[hidden], lo[hidden], hi[hidden] = np.maximum(found.norm, seen[hidden]), found.mean.lo, found.mean.hi
        return norm, Interval(lo, hi)

    def add_load(self, size: Array, metric: CellMetric) -> None:
        """Record a load of which only a bound of its size on each owned cell is known."""
        self.load = self.load + Interval(-size, size)
        self.missed += (metric.diameter / np.pi * size) ** 2 * metric.volume / metric.low

    def conductivity(self, metric: CellMetric, size: float) -> tuple[CellMetric, Array]:
        """The metric with κ ≥ low κ_h on whole cells, and S per owned cell (collective).

        With κ = κ̃ + δ, κ_h^-½κ̃κ_h^-½ is in each point a weighted mean of κ_h^-½κ_iκ_h^-½ for the Bernstein
        coefficients κ_i of κ̃.

        Args:
            metric: The metric, with `low` from the nodes of P2 only.
            size: ‖σ_h‖.
        """
        number, dim = len(metric.volume), metric.jacobian.shape[1]
        deviation = np.zeros(number)
        if self.data.kappa.number is not None or not self.given_as_text("kappa"):
            return metric, deviation
        vertices = cell_vertices(self.spaces.mesh)
        coefficients = np.zeros((number, len(edge_order(dim + 1)) + dim + 1, dim, dim))
        for tree, cells, entries in self._conductivities():
            p = interpolated(tree, vertices[cells])
            of_p = bernstein(p, vertices[cells])
            degree = polynomial_degree(tree)
            if degree is None or degree > 2:
                tolerance = SHARE * self.error / max(size, 1e-300) * np.abs(of_p).max(axis=1, initial=0.0)
                found = self.enclosed("kappa", tree, vertices[cells], p, tolerance, cells, "sup")
                deviation[cells] = np.hypot(deviation[cells], len(entries) ** 0.5 * found.sup)
            for i, j in entries:
                coefficients[cells, :, i, j] = of_p
        root = np.linalg.cholesky(of_all_cells(metric.inverse, number))[:, None]
        ratios = np.linalg.eigvalsh(root.transpose(0, 1, 3, 2) @ coefficients @ root)[:, :, 0].min(axis=1, initial=1.0)
        low = ratios - np.linalg.norm(metric.inverse, axis=(1, 2)) * deviation
        lost = ~(low > 0)
        if lost.any():
            self.lost.add("kappa")
        self.note("kappa", vertices[lost].mean(axis=1), np.flatnonzero(lost))
        low, deviation = np.where(lost, metric.low, low), np.where(lost, 0.0, deviation)
        return replace(metric, low=low, kappa_min=metric.kappa_min / metric.low * low), deviation

    def flux(self, metric: CellMetric) -> Array:
        """A flux size per owned cell that makes only the share SHARE of the error."""
        return SHARE * self.error * np.sqrt(np.maximum(metric.kappa_min, 0.0) / self.volume)

    def tree(self, name: str) -> Tree | None:
        """The expression of a datum that has to be enclosed; None for polynomials and for data given in Python."""
        tree = self.data.trees.get(name)
        return tree if self.given_as_text(name) and isinstance(tree, TREES) and _is_enclosed(tree) else None

    def given_as_text(self, name: str) -> bool:
        """Whether a datum is a number or a tree; otherwise it is added to `by_quadrature`."""
        is_number = self._datum(name).number is not None
        known = is_number or any(key.partition(".")[0] == name for key in self.data.trees)
        if not known:
            self.by_quadrature.add(name)
        return known

    def _datum(self, name: str) -> Datum:
        if name == "obstacle":
            assert self.data.obstacle is not None
            return self.data.obstacle.psi
        datum: Datum = getattr(self.data, name)
        return datum

    def of_regions(self, name: str) -> Iterator[tuple[Tree | Rows, Indices]]:
        """What f, κ or c was given as, for all owned cells or for those of each region."""
        for key, given in self.data.trees.items():
            datum, _, region = key.partition(".")
            if datum == name:
                yield given, self.spaces.domain.regions[region] if region else self._cells()

    def _conductivities(self) -> Iterator[tuple[Tree, Indices, list[tuple[int, int]]]]:
        """Each tree of κ, the owned cells where it holds, and its entries of the matrix."""
        dim = self.spaces.mesh.geometry.dim
        for given, cells in self.of_regions("kappa"):
            if isinstance(given, TREES):
                yield given, cells, [(i, i) for i in range(dim)]
                continue
            for i, j in np.ndindex(dim, dim):
                yield given[i][j], cells, [(i, j)]

    def enclosed(
        self,
        name: str,
        tree: Tree | None,
        vertices: Array,
        p: Quadratic,
        tolerance: Array,
        cells: npt.NDArray[np.integer],
        by: Literal["mean", "sup", "tilt"],
    ) -> Enclosure:
        """Enclose a datum minus quadratics on simplices of these cells, keep places not resolved (collective)."""
        assert tree is not None
        found = enclose(tree, vertices, p, tolerance, self.spaces.mesh.comm, scale=self.scale(), by=by)
        self.note(name, found.place[~found.resolved], cells[~found.resolved])
        return found

    def scale(self) -> float:
        """Size of the domain, for `enclose`."""
        return float(np.ptp(self.spaces.domain.box(), axis=0).max())

    def note(self, name: str, places: Array, cells: npt.NDArray[np.integer]) -> None:
        """Record places on some cells where a datum is not resolved."""
        self.unresolved += [(name, tuple(place)) for place in places.tolist()]
        self.coarse[cells] = True

    def _cells(self) -> Indices:
        return np.arange(len(self.coarse), dtype=np.int32)

    def load_left(self, measure: Callable[[Interval], float]) -> float:
        """What the means of the loads add to the bound, by `measure`; without Γ_D nothing, they rely on quadrature."""
        if self.spaces.has_dirichlet:
            return measure(self.load)
        self.by_quadrature |= {name for name in LOADS if self.encloses(name)}
        return 0.0

    def account(self, share: float) -> tuple[tuple[str, tuple[float, ...]], ...]:
        """Data that are not resolved, each with a place; the same on all ranks (collective).

        Enclosures are valid also where the cap on boxes was hit, so this matters only if they add much to the bound. If
        they make most of the bound, the places where they are largest are not resolved, with or without the cap.

        Args:
            share: Share of the bound that comes from the enclosures.
        """
        comm = self.spaces.mesh.comm
        if share <= LITTLE:
            self._forget()
        if not share <= MUCH:
            size = self.missed + np.maximum(np.abs(self.load.lo), np.abs(self.load.hi))
            size[np.isnan(size)] = np.inf
            worst = size >= comm.allreduce(size.max(initial=0.0), MPI.MAX) / 4
            names = ", ".join(name for name in LOADS if self.encloses(name)) or "u_D"
            self.note(names, cell_vertices(self.spaces.mesh)[worst].mean(axis=1), np.flatnonzero(worst))
        everything = sorted(entry for entries in comm.allgather(sorted(self.unresolved)[:PLACES]) for entry in entries)
        return tuple(everything[:PLACES])

    def _forget(self) -> None:
        self.unresolved = [entry for entry in self.unresolved if entry[0] in self.lost]
        self.coarse[:] &= bool(self.lost)


def _is_enclosed(tree: Tree | Rows) -> bool:
    """Whether quadrature may miss something of it: it is no polynomial, or one of a high degree."""
    degree = polynomial_degree(tree) if isinstance(tree, TREES) else None
    return degree is None or degree > EXACT


def of_all_cells(matrices: Array, number: int) -> Array:
    """One matrix per cell; `matrices` may hold one for all cells."""
    return np.broadcast_to(matrices, (number, *matrices.shape[1:]))
