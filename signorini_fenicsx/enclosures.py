"""What is certain of data on simplices: enclosures of an expression less a quadratic, by intervals and bisection.

A simplex is bisected, longest edge first, until enough is known. On each part, with its vertices x_v, its centroid c,
enclosures of e, ∇e and ∇²e over its bounding box and of e and ∇e in c, and d = e − p:

    ∇d(x) ∈ ∇d(c) + [∇²d](x − c) =: G        and        d(x) ∈ d(c) + G·(x − c)

by the mean value theorem, both as hulls over the vertices; what the box itself says is used where it says more. With
G = G_m ± δ and V = Σ_v (x_v − c)(x_v − c)ᵀ/((k + 1)(k + 2)), the covariance of x on a simplex of dimension k, the mean
of d is in d(c) ± Σ δ_i √V_ii, since that of G_m·(x − c) is 0, and its root mean square at most √(d(c)² + G_m·V G_m) +
Σ δ_i √V_ii. Where a condition is undecided, ∇e is unknown, and d is in the hull of both branches.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh, entities_to_geometry
from mpi4py import MPI

from signorini_fenicsx.expressions import Tree
from signorini_fenicsx.expressions.intervals import WHOLE, Array, Elementary, FromNumPy, Interval, Mask, enclosing
from signorini_fenicsx.expressions.quadratics import Quadratic
from signorini_fenicsx.expressions.simplices import ROUNDING, Parts, all_changes, evaluated, stacked

CAP = 1000
"""Boxes that one simplex may cost."""
BUDGET, BUDGET_EACH = 200_000, 10
"""Boxes that all simplices may cost together: so many, and so many more for each of them: some seconds."""
WORST = 0.25
"""Parts are cut whose share in what is not known is at least so much of the largest share in their simplex."""
CLOSE = 0.5
"""An upper bound of ‖d‖² that is at most so much too large, relative to itself, is good enough."""
CHUNK = 20000
"""Boxes evaluated at once."""


def cell_vertices(mesh: Mesh) -> Array:
    """Vertices of the owned cells, shape (cells, d + 1, d)."""
    dim = mesh.geometry.dim
    cells = mesh.geometry.dofmaps[0][: mesh.topology.index_map(dim).size_local]
    return np.array(mesh.geometry.x[cells, :dim])


def facet_vertices(mesh: Mesh, facets: npt.NDArray[np.int32]) -> Array:
    """Vertices of facets, shape (facets, d, d)."""
    dim = mesh.geometry.dim
    nodes = entities_to_geometry(mesh, dim - 1, facets) if len(facets) else np.empty((0, dim), dtype=np.int32)
    return np.array(mesh.geometry.x[nodes, :dim])


@dataclass(frozen=True)
class Enclosure:
    """What is certain of d = e − p on each of n simplices. Arrays of shape (n,), infinite where nothing is.

    Attributes:
        mean: The mean of d lies in it.
        norm: Upper bound of the root mean square of d, which is ‖d‖/|T|^½ in L².
        sup: Upper bound of |d|.
        slope: Upper bound of |∇d|, along T and across it.
        range: All values of e lie in it.
        resolved: Where the bisection came to an end before its cap.
        place: Centroid of the part of a simplex that adds most to the upper bound of ‖d‖, shape (n, d).
        boxes: Parts that were looked at.
    """

    mean: Interval
    norm: Array
    sup: Array
    slope: Array
    range: Interval
    resolved: Mask
    place: Array
    boxes: int


def enclose(
    tree: Tree,
    vertices: Array,
    p: Quadratic,
    tolerance: Array,
    comm: MPI.Comm,
    *,
    scale: float,
    by: Literal["norm", "sup", "slope"] = "norm",
    elementary: Elementary | None = None,
) -> Enclosure:
    """Enclose an expression less a quadratic on simplices, each by itself (collective).

    A simplex is resolved where the upper bound of the root mean square of d is below the tolerance, or not much above a
    lower bound; or that of |d| or |∇d| is below the tolerance. What was reached elsewhere is valid too. Nothing depends
    on the number of ranks.

    Args:
        tree: The expression, in x, y and, in 3D, z.
        vertices: Of the n simplices of this rank, of any dimension k ≥ 1 in d dimensions, shape (n, k + 1, d).
        p: What is to be taken off.
        tolerance: For each simplex, shape (n,).
        comm: The ranks.
        scale: Size of the whole domain: decides what is rounding in the place of a discontinuity; 0: nothing is.
        by: What the tolerance is for: `Enclosure.norm`, `sup` or `slope`.
        elementary: Bounds of sin, exp, …; by default those of NumPy.
    """
    algebra = elementary or FromNumPy()

    def look(parts: Parts) -> Array:
        starts = range(0, max(len(parts.own), 1), CHUNK)
        return np.concatenate(
            [_known(tree, parts.take(slice(a, a + CHUNK)), vertices, p, scale, algebra) for a in starts]
        )

    with np.errstate(all="ignore"):
        work = _Bisection(vertices, tolerance, by)
        parts = Parts(vertices, np.arange(len(vertices)), np.ones(len(vertices)))
        known = look(parts)
        left = (BUDGET_EACH - 1) * comm.allreduce(len(vertices)) + BUDGET
        while True:
            active, cut = work.decide(parts, known)
            wanted = 2 * comm.allreduce(np.count_nonzero(cut))
            if not 0 < wanted <= left:
                work.add(parts, known, unresolved=cut)
                return work.result()
            left -= wanted
            work.add(parts.take(~active), known[~active], unresolved=np.zeros(np.count_nonzero(~active), dtype=bool))
            halves = parts.halves(cut)
            kept = active & ~cut
            parts, known = parts.take(kept).and_(halves), np.concatenate([known[kept], look(halves)])


MEAN_LO, MEAN_HI, SQUARE, LEAST, SUP, SLOPE, LO, HI = range(8)
"""Columns of what is known of a part: d's mean, mean square from above and below, |d|, |∇d|; e's range."""


class _Bisection:
    """The decision which parts are cut, and sums over the parts of simplices that are done."""

    def __init__(self, vertices: Array, tolerance: Array, by: str):
        n = len(vertices)
        self._tolerance = tolerance
        self._bounded = {"sup": SUP, "slope": SLOPE}.get(by)
        self._cost = np.ones(n, dtype=np.int64)
        self._sums = np.zeros((n, 3))
        self._most = np.zeros((n, 2))
        self._range = np.tile([np.inf, -np.inf], (n, 1))
        self._resolved = np.ones(n, dtype=bool)
        self._place = vertices.mean(axis=1)

    def decide(self, parts: Parts, known: Array) -> tuple[Mask, Mask]:
        """Parts of simplices that too little is known of, and the worst of them, which are to be cut."""
        own, n = parts.own, len(self._cost)
        if self._bounded is not None:
            bound = known[:, self._bounded]
            gap = np.where(bound <= self._tolerance[own], 0.0, bound)
            needy = np.bincount(own, gap > 0, n) > 0
        else:
            gap = parts.share * (known[:, SQUARE] - known[:, LEAST])
            upper = np.bincount(own, parts.share * known[:, SQUARE], n)
            close = np.isfinite(upper) & (np.bincount(own, gap, n) <= CLOSE * upper)
            needy = ~(close | (upper <= self._tolerance**2))
        largest = np.zeros(n)
        np.maximum.at(largest, own, gap)
        cut = needy[own] & (gap >= WORST * largest[own])
        cost = self._cost + 2 * np.bincount(own, cut, n).astype(np.int64)
        capped = needy & (cost > CAP)
        self._resolved &= ~capped
        needy &= ~capped
        self._cost = np.where(needy, cost, self._cost)
        return needy[own], cut & needy[own]

    def add(self, parts: Parts, known: Array, unresolved: Mask) -> None:
        """Sum up all parts of simplices that are done."""
        own, n = parts.own, len(self._cost)
        self._resolved[own[unresolved]] = False
        for column, name in enumerate((MEAN_LO, MEAN_HI, SQUARE)):
            self._sums[:, column] += np.bincount(own, parts.share * known[:, name], n)
        for column, name in enumerate((SUP, SLOPE)):
            np.maximum.at(self._most[:, column], own, known[:, name])
        np.minimum.at(self._range[:, 0], own, known[:, LO])
        np.maximum.at(self._range[:, 1], own, known[:, HI])
        order = np.argsort(parts.share * known[:, SQUARE], kind="stable")  # the last of each simplex is its worst
        self._place[own[order]] = parts.vertices[order].mean(axis=1)

    def result(self) -> Enclosure:
        """The sums, inflated by their rounding."""
        norm = np.sqrt(self._sums[:, 2]) * (1 + ROUNDING)
        rounding = ROUNDING * np.abs(self._sums[:, :2]).max(axis=1)
        return Enclosure(
            mean=Interval(self._sums[:, 0] - rounding, self._sums[:, 1] + rounding),
            norm=norm,
            sup=self._most[:, 0],
            slope=self._most[:, 1],
            range=Interval(self._range[:, 0], self._range[:, 1]),
            resolved=self._resolved & np.isfinite(norm),
            place=self._place,
            boxes=int(self._cost.sum()),
        )


def _known(tree: Tree, parts: Parts, simplices: Array, p: Quadratic, scale: float, elementary: Elementary) -> Array:
    """What one box each says of the parts of simplices."""
    centre, arms = parts.centred()
    e = evaluated(tree, parts, scale, elementary)

    # p in the centres, and how it changes from there
    offset = centre - simplices[parts.own].mean(axis=1)
    hessian = p.hessian[parts.own]
    bend = np.einsum("nij,nj->ni", hessian, offset)
    slope = p.gradient[parts.own] + bend
    rise = ((p.gradient[parts.own] + bend / 2) * offset).sum(axis=1)
    value = p.value[parts.own] + rise
    noise = ROUNDING * (np.abs(p.value[parts.own]) + np.abs(rise))
    turn = np.einsum("nij,nvj->nvi", hessian, arms)
    reach = np.abs(arms).max(axis=1)
    arch = np.einsum("ni,nij,nj->n", reach, np.abs(hessian), reach) / 2

    # ∇d, d(c) and d
    curved = stacked([all_changes(h - enclosing(hessian[:, i]), arms) for i, h in enumerate(e.hessian)])
    over_box = Interval(e.gradient.lo - slope - turn.max(axis=1), e.gradient.hi - slope - turn.min(axis=1))
    G = over_box.meet(e.middle_gradient - enclosing(slope) + curved)
    at_centre = e.middle - enclosing(value) + Interval(-noise, noise)
    change_of_p = all_changes(enclosing(slope), arms) + Interval(-arch, arch)
    d = (e.value - enclosing(value) - change_of_p + Interval(-noise, noise)).meet(at_centre + all_changes(G, arms))
    return _summary(d, at_centre, G, arms, e.value.meet(e.middle + all_changes(e.gradient, arms)))


def _summary(d: Interval, at_centre: Interval, G: Interval, arms: Array, every: Interval) -> Array:
    """The columns, from d and d(c), ∇d and e."""
    corners = arms.shape[1]
    covariance = np.einsum("nvi,nvj->nij", arms, arms) / (corners * (corners + 1))
    deviation = np.sqrt(np.einsum("nii->ni", covariance))
    half = (G.hi + G.lo) / 2
    radius = np.maximum(G.hi - half, half - G.lo)
    rest = (radius * deviation).sum(axis=1) * (1 + ROUNDING)
    tilt = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", half, covariance, half), 0.0))
    mean = d.meet(at_centre + Interval(-rest, rest))
    norm = np.fmin(d.largest, np.hypot(at_centre.largest, tilt) + rest) * (1 + ROUNDING)
    least = np.fmax(mean.smallest, np.hypot(at_centre.smallest, tilt) - rest)
    mean = mean.where(~np.isnan(mean.lo + mean.hi), WHOLE)
    every = every.where(~np.isnan(every.lo + every.hi), WHOLE)
    slope = np.sqrt((G.largest**2).sum(axis=1)) * (1 + ROUNDING)
    columns = [
        mean.lo,
        mean.hi,
        norm**2,
        np.minimum(np.fmax(least, 0.0), norm) ** 2,
        d.largest,
        slope,
        every.lo,
        every.hi,
    ]
    return np.stack(columns, axis=1)
