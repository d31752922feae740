"""What quadrature may have missed of the data: enclosures of what they are less what the certificate takes them for.

Data that a case gives as text are trees, which intervals enclose on whole cells and facets (`enclosures`). For each of
them the certificate works with a polynomial p, and d = e − p is what is left of the expression e.

- *Loads.* On a cell, (d, w)_T = (d, w − w_T)_T + |T| μ w_T with μ the mean of d and w_T that of w; the first term is at
  most (δ_T/π)‖d‖ |w|, as in `local_fluxes`. On a facet e of T, (d, w)_e ≤ C_e‖d‖_e |w| + |e| μ_e w_T. So all means make
  one load per cell, c. With −∇·z = 1, z·n = 0 on Γ_N and Γ_S, and s the largest κ^-½|z|, for all w = 0 on Γ_D

      |w|² ≥ (2tw z, ∇w) − ‖tκ^-½ wz‖² ≥ (t − t²s²)‖w‖² = ‖w‖²/4s²   with t = 1/2s²,   so (c, w) ≤ 2s‖c‖ |w|.

- *κ*, with P2 interpolant κ̃ and S = sup |κ − κ̃| on T: ‖κ^½∇v − κ^-½y‖ ≤ ρ^½‖κ̃^½∇v − κ̃^-½y‖ + S‖y‖/(κ_min^½ κ̃_min),
  ρ = 1 + S/κ̃_min, since κ^½∇v − κ^-½y = κ^½κ̃⁻¹(κ̃∇v − y) + κ^-½(κ − κ̃)κ̃⁻¹y.
- *u_D and ψ* near Γ_D and Γ_S, where v takes them as they are: ‖κ^½∇(χd)‖_T ≤ κ_max^½ (‖∇d‖ + |T|^½ |∇χ| sup|d|)
  with d what P2 does not see of them. Integrals over these cells see d in the points of a quadrature. Where these show
  less than a third of ∇d, and that may make more than all the rest of the bound, u_D or ψ are not resolved.

So it is with loads: where the points of a quadrature show at least a third of d, where quadratures of two degrees agree
about its mean, and d does not jump, its integrals are left to quadrature. Elsewhere ‖d‖ and its mean are those of the
enclosures.

Polynomials are integrated exactly. Data given in Python have no trees: there the bound rests on quadrature.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.certificate.admissible_trace import Trace
from signorini_fenicsx.certificate.enclosures import Enclosure, cell_vertices, enclose, facet_vertices
from signorini_fenicsx.certificate.interpolants import (
    POINTS,
    bernstein,
    edge_order,
    in_nodes,
    mean_above,
    quadratic_of,
    seen_slope,
)
from signorini_fenicsx.certificate.local_fluxes import facet_constants
from signorini_fenicsx.certificate.metric import CellMetric
from signorini_fenicsx.discrete.data import Data
from signorini_fenicsx.discrete.points import FacetPoints
from signorini_fenicsx.discrete.spaces import Spaces
from signorini_fenicsx.expressions import TREES, Tree, polynomial_degree
from signorini_fenicsx.expressions.intervals import Interval, enclosing
from signorini_fenicsx.expressions.quadratics import Quadratic, barycentric_gradients, interpolated

type Indices = npt.NDArray[np.int32]

EXACT = 15
"""Squares of polynomials up to this degree are integrated exactly: quadrature goes twice as far."""
LOADS = ("f", "g_N", "q_S")
SEEN = 0.25
"""Enclosures of u_D and ψ stop where what is not quadratic in them makes about half of this part of the error."""
AGREED = 0.1
"""Two quadratures agree about a mean if they differ by so much of the root mean square."""
OVERLOOKED = 3.0
"""Quadrature overlooks a gradient if it is so many times what its points show."""
LITTLE, MUCH = 0.1, 0.5
"""Parts of the bound."""
PLACES = 10
"""Unresolved places that are kept."""
SHARE = 0.02
"""Enclosures stop where what they leave is about this share of the error."""


@dataclass
class Resolution:
    """Encloses the data of one solution and keeps the account of what that says.

    Attributes:
        spaces: The discrete spaces.
        data: The data.
        error: About the error in the energy norm.
        volume: |Ω|.
        by_quadrature: Data that nothing is certain of: given in Python, or there is no Γ_D to hold their means.
        unresolved: Data with a place each where the cap on boxes was hit, of this rank.
        coarse: The owned cells where that is.
        load: c, the means of what was missed of the loads, per owned cell.
        missed: What the enclosures add to the bound but for these means, squared, per owned cell.
        lost: Data of which the bound does not take account.
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
        """Whether enclosures are needed and can be had: not of polynomials, nor of data given in Python."""
        return self._tree(name) is not None

    def on_cells(self, name: str, nodes: Array, seen: Array, metric: CellMetric) -> Array:
        """Root mean square per owned cell of a load less p, given in the nodes of P2 (collective).

        Args:
            name: Of the load.
            nodes: Values of p, shape (cells, nodes).
            seen: What a quadrature says of it.
            metric: Of the cells.
        """
        vertices = cell_vertices(self.spaces.mesh)
        tolerance = self._flux(metric) / self.volume ** (1 / vertices.shape[2])
        norm, mean = self._load(name, vertices, quadratic_of(vertices, nodes), seen, tolerance, self._cells())
        self.load = self.load + mean
        self.missed += np.where(norm > seen, (metric.diameter / np.pi * norm) ** 2 * metric.volume / metric.low, 0.0)
        return norm

    def on_facets(self, name: str, points: FacetPoints, nodes: Array, seen: Array, metric: CellMetric) -> Array:
        """The same per facet for a flux, in L² (collective)."""
        p, tolerance = quadratic_of(points.vertices, nodes), self._flux(metric)[points.cells]
        norm, mean = self._load(name, points.vertices, p, seen, tolerance, points.cells)
        area = points.integrals(np.ones((len(points.cells), len(points.weights))))
        share = area / metric.volume[points.cells]
        number = len(metric.volume)
        self.load = self.load + Interval(*(points.per_cell(share * end, number) for end in (mean.lo, mean.hi)))
        squares = facet_constants(metric, points.cells, area) ** 2 * area * norm**2 / metric.low[points.cells]
        self.missed += points.per_cell(np.where(norm > seen, squares, 0.0), number)
        return np.asarray(norm * np.sqrt(area), dtype=np.float64)

    def _load(
        self, name: str, vertices: Array, p: Quadratic, seen: Array, tolerance: Array, cells: Indices
    ) -> tuple[Array, Interval]:
        """Root mean square and mean of a load less p; where quadrature sees it, what that says, and 0 (collective)."""
        tree, comm, scale = self._tree(name), self.spaces.mesh.comm, self._scale()
        assert tree is not None
        enough = np.maximum(OVERLOOKED * seen, tolerance)
        first = enclose(tree, vertices, p, enough, comm, scale=scale)
        means = [mean_above(tree, vertices, p, degree) for degree in (POINTS, 2 * POINTS)]
        agree = np.abs(means[0] - means[1]) <= np.maximum(AGREED * seen, tolerance)
        hidden = ~((first.norm <= enough) & np.isfinite(first.slope) & agree)
        some = Quadratic(p.value[hidden], p.gradient[hidden], p.hessian[hidden])
        found = self._enclosed(name, tree, vertices[hidden], some, tolerance[hidden], cells[hidden], "mean")
        norm, lo, hi = seen.copy(), np.zeros(len(seen)), np.zeros(len(seen))
        norm[hidden], lo[hidden], hi[hidden] = np.maximum(found.norm, seen[hidden]), found.mean.lo, found.mean.hi
        return norm, Interval(lo, hi)

    def conductivity(self, metric: CellMetric, size: float) -> tuple[CellMetric, Array]:
        """The metric with κ ≥ low κ_h on whole cells, and S per owned cell (collective).

        With κ = κ̃ + δ, κ_h^-½κ̃κ_h^-½ is a mean of what it would be for each Bernstein coefficient of κ̃.

        Args:
            metric: With low from some points.
            size: ‖σ_h‖.
        """
        number, dim = len(metric.volume), metric.jacobian.shape[1]
        deviation = np.zeros(number)
        if self.data.kappa.number is not None or not self._given_as_text("kappa"):
            return metric, deviation
        vertices = cell_vertices(self.spaces.mesh)
        coefficients = np.zeros((number, len(edge_order(dim + 1)) + dim + 1, dim, dim))
        for tree, cells, entries in self._conductivities():
            p = interpolated(tree, vertices[cells])
            of_p = bernstein(p, vertices[cells])
            degree = polynomial_degree(tree)
            if degree is None or degree > 2:
                tolerance = SHARE * self.error / max(size, 1e-300) * np.abs(of_p).max(axis=1, initial=0.0)
                found = self._enclosed("kappa", tree, vertices[cells], p, tolerance, cells, "sup")
                deviation[cells] = np.hypot(deviation[cells], len(entries) ** 0.5 * found.sup)
            for i, j in entries:
                coefficients[cells, :, i, j] = of_p
        root = np.linalg.cholesky(_of_all(metric.inverse, number))[:, None]
        ratios = np.linalg.eigvalsh(root.transpose(0, 1, 3, 2) @ coefficients @ root)[:, :, 0].min(axis=1, initial=1.0)
        low = ratios - np.linalg.norm(metric.inverse, axis=(1, 2)) * deviation
        lost = ~(low > 0)
        if lost.any():
            self.lost.add("kappa")
        self._note("kappa", vertices[lost].mean(axis=1), np.flatnonzero(lost))
        low, deviation = np.where(lost, metric.low, low), np.where(lost, 0.0, deviation)
        return replace(metric, low=low, kappa_min=metric.kappa_min / metric.low * low), deviation

    def near_boundary(self, trace: Trace, metric: CellMetric) -> Array:
        """Bound of ‖κ^½∇(χd)‖_T for u_D and ψ together, per owned cell (collective).

        v has ψ in it where it touches, and where it would else fall below, which it cannot where it is higher above
        I_hψ than ψ ever is.
        """
        extra = np.zeros(len(metric.volume))
        above = self._facets_of_psi(trace)
        touching = np.union1d(trace.touching, self.spaces.cells[above]).astype(np.int32)
        for name, cells in (("u_D", trace.at_dirichlet), ("psi", touching)):
            tree = self._tree(name)
            if tree is None:
                continue
            vertices, inverse = cell_vertices(self.spaces.mesh)[cells], _of_all(metric.inverse, len(extra))[cells]
            strip = self.spaces.mesh.comm.allreduce(metric.volume[cells].sum())
            kappa_max = (2 - metric.low[cells]) / np.linalg.eigvalsh(inverse)[:, 0]
            steep = SEEN / 2 * self.error / np.sqrt(max(strip, 1e-300) * kappa_max)
            p = quadratic_of(vertices, in_nodes(tree, vertices))
            found = self._enclosed(name, tree, vertices, p, steep, cells, "tilt")
            decay = 2 * np.linalg.norm(barycentric_gradients(vertices), axis=2).max(axis=1, initial=0.0)
            hidden = found.tilt > OVERLOOKED * seen_slope(tree, vertices, p)
            more = np.sqrt(kappa_max * metric.volume[cells]) * (found.tilt + decay * found.sup)
            extra[cells] += np.where(hidden, more, 0.0)
        return extra

    def _facets_of_psi(self, trace: Trace) -> npt.NDArray[np.bool_]:
        """The facets of Γ_S where ψ may be above v, which is quadratic there."""
        tree = self._tree("psi")
        if tree is None:
            return np.zeros(len(self.spaces.facets), dtype=bool)
        vertices = facet_vertices(self.spaces.mesh, self.spaces.facets)
        p = quadratic_of(vertices, in_nodes(tree, vertices))
        tolerance = np.maximum(trace.lowest, 0.0)
        comm, scale = self.spaces.mesh.comm, self._scale()
        found = enclose(tree, vertices, p, np.where(tolerance > 0, tolerance, np.inf), comm, scale=scale, by="sup")
        return np.asarray(found.sup > tolerance)

    def _flux(self, metric: CellMetric) -> Array:
        """About a flux on each cell that is no more than a share of the error."""
        return SHARE * self.error * np.sqrt(np.maximum(metric.kappa_min, 0.0) / self.volume)

    def _tree(self, name: str) -> Tree | None:
        tree = self.data.trees.get(name)
        if not self._given_as_text(name) or not isinstance(tree, TREES):
            return None
        degree = polynomial_degree(tree)
        return None if degree is not None and degree <= EXACT else tree

    def _given_as_text(self, name: str) -> bool:
        """Whether a datum is a number or a tree; takes note if it is neither."""
        is_number = getattr(self.data, name).number is not None
        known = is_number or any(key.partition(".")[0] == name for key in self.data.trees)
        if not known:
            self.by_quadrature.add(name)
        return known

    def _conductivities(self) -> Iterator[tuple[Tree, Indices, list[tuple[int, int]]]]:
        """Each tree of κ, the owned cells where it holds, and which entries of the matrix it is."""
        dim = self.spaces.mesh.geometry.dim
        for name, given in self.data.trees.items():
            key, _, region = name.partition(".")
            if key != "kappa":
                continue
            cells = self.spaces.domain.regions[region] if region else self._cells()
            if isinstance(given, TREES):
                yield given, cells, [(i, i) for i in range(dim)]
                continue
            for i, j in np.ndindex(dim, dim):
                yield given[i][j], cells, [(i, j)]

    def _enclosed(
        self,
        name: str,
        tree: Tree | None,
        vertices: Array,
        p: Quadratic,
        tolerance: Array,
        cells: npt.NDArray[np.integer],
        by: Literal["mean", "sup", "tilt"] = "mean",
    ) -> Enclosure:
        assert tree is not None
        found = enclose(tree, vertices, p, tolerance, self.spaces.mesh.comm, scale=self._scale(), by=by)
        self._note(name, found.place[~found.resolved], cells[~found.resolved])
        return found

    def _scale(self) -> float:
        return float(np.ptp(self.spaces.domain.box(), axis=0).max())

    def _note(self, name: str, places: Array, cells: npt.NDArray[np.integer]) -> None:
        self.unresolved += [(name, tuple(place)) for place in places.tolist()]
        self.coarse[cells] = True

    def _cells(self) -> Indices:
        return np.arange(len(self.coarse), dtype=np.int32)

    def overlooked(self, beside: Array) -> None:
        """Take note that quadrature may overlook u_D or ψ where these are, squared per owned cell, the largest."""
        comm = self.spaces.mesh.comm
        worst = beside >= comm.allreduce(beside.max(initial=0.0), MPI.MAX) / 4
        names = ", ".join(name for name in ("u_D", "psi") if self.encloses(name))
        self.lost.add(names)
        self._note(names, cell_vertices(self.spaces.mesh)[worst].mean(axis=1), np.flatnonzero(worst))

    def load_left(self, measure: Callable[[Interval], float]) -> float:
        """What the means of the loads add to the bound, as they are measured; without Γ_D they rest on quadrature."""
        if self.spaces.has_dirichlet:
            return measure(self.load)
        self.by_quadrature |= {name for name in LOADS if self.encloses(name)}
        return 0.0

    def account(self, share: float) -> tuple[tuple[str, tuple[float, ...]], ...]:
        """Data that are not resolved with a place each, the same on all ranks (collective).

        Where the cap on boxes was hit, the enclosures are valid all the same: that matters if they add much to the
        bound. If they make most of it, the places where they do so are not resolved, cap or not.

        Args:
            share: Part of the bound that the enclosures make.
        """
        comm = self.spaces.mesh.comm
        if share <= LITTLE:
            self._forget()
        if not share <= MUCH:
            size = self.missed + np.maximum(np.abs(self.load.lo), np.abs(self.load.hi))
            size[np.isnan(size)] = np.inf
            worst = size >= comm.allreduce(size.max(initial=0.0), MPI.MAX) / 4
            names = ", ".join(name for name in LOADS if self.encloses(name)) or "u_D"
            self._note(names, cell_vertices(self.spaces.mesh)[worst].mean(axis=1), np.flatnonzero(worst))
        everything = sorted(entry for entries in comm.allgather(self.unresolved[:PLACES]) for entry in entries)
        return tuple(everything[:PLACES])

    def _forget(self) -> None:
        self.unresolved = [entry for entry in self.unresolved if entry[0] in self.lost]
        self.coarse[:] &= bool(self.lost)


def _of_all(matrices: Array, number: int) -> Array:
    """One matrix per cell, where there may be one for all."""
    return np.broadcast_to(matrices, (number, *matrices.shape[1:]))
