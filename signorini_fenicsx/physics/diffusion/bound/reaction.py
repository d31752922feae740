"""What the term cu adds to the certificate.

Errors are measured by ‖w‖² = |∇w|² + ‖c^½w‖², and the gap has ½‖c^-½ r‖² with r = f + ∇·y − cv, see
`forms/certificate.py`. Let ∇·y = −f_h + c_h u* on each cell T, with a number u* near u_h. Of r the part g = δc is left
in the gap, with the number δ for which r − g has mean 0 on T: ‖c^-½ g‖² = δ²∫c. With all of r the gap would be 3 to 32
times too large. r − g is a load like f − f_h, for which

    (r − g, w)_T ≤ min(the factor of `local_fields`, c^-½‖r − g‖_T) ‖w‖_T.

For c a quadratic p stands, with mean p_T, S is at least the root mean square of c − p, and μ its mean: r is f − f_h +
(p_T u* − pv), δ = ∫p(u* − v)/∫p, and there are two more loads: (c_h − p_T − μ)u*, a number on each cell, and (p − c +
μ)u* + (p − c)(v + δ − u*). With D ≥ |v + δ − u*| the mean of the second one is at most SD, and its root mean square at
most S(|u*| + D). Where p_T ≤ 0, δ is 0.

Where S is not small, r − f + f_h is integrated part by part, see below, with the δ that makes its mean 0. In a
step in time what it takes from those before is a part of it, as both nearly cancel.

*Loads with factors that the mesh does not resolve, such as c or a capacity that jumps*: integrated part by part.

Let a load on a cell T be L = s + Σ_i e_i q_i with a number s, expressions e_i and polynomials q_i, and on each part P
of T let e_i be within ρ_i of a polynomial. With the quadrature Q of the parts, which is exact for squares of these
polynomials times q_i, and an orthonormal basis φ of polynomials on T, the load is Σ_a Q(Lφ_a)φ_a + R with
‖R‖ ≤ Q((L − Σ_a Q(Lφ_a)φ_a)²)^½ + E, E = 2 Σ_i (Σ_P ρ_i²‖q_i‖²_P)^½, and its mean is Q(L) ± E|T|^-½.

Proof. With the polynomials in the place of e_i all of this is exact without E. The change of L has at most half of E as
its norm, in L² and by Q.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import AnyIndices, Array, Indices, Mask
from signorini_fenicsx.base.owned import cell_dofs, owned_cells, owned_values
from signorini_fenicsx.base.reference_cells import orthonormal, positive_quadrature
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.points import CellPoints, PartPoints, Points, in_cells
from signorini_fenicsx.expressions import TREES, is_polynomial
from signorini_fenicsx.expressions.cutting import CHUNK, in_parts
from signorini_fenicsx.expressions.enclosures import ranges
from signorini_fenicsx.expressions.intervals import Interval, enclosing
from signorini_fenicsx.expressions.series import DEGREE, Remainder
from signorini_fenicsx.expressions.simplices import Parts, Quadratic, bernstein, constant, interpolated
from signorini_fenicsx.physics.diffusion.bound.admissible_trace import Trace
from signorini_fenicsx.physics.diffusion.bound.local_fields import HIGH, OF_LOAD, CellMetric, Projection, projected
from signorini_fenicsx.physics.diffusion.bound.resolution import SMALLEST, Resolution
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.quasilinear import OnCells
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces

LOST = 1e-14
"""Rounding of means of squares, as a share of the sizes."""


@dataclass(frozen=True)
class Term:
    """A term e q of a load.

    Attributes:
        name: Name of e.
        e: A text, or texts by regions.
        q: Gives q in points, of a degree ≤ dim + 1 on each cell, for RT1 one more.
        size: Rough size of q on each owned cell.
    """

    name: str
    e: Datum
    q: Callable[[Points], Array]
    size: Array


@dataclass(frozen=True)
class CutLoads:
    """Loads L − δe_1 with mean 0 but for what is unsure, per cell.

    Attributes:
        load: Their projections, and bounds of the rest.
        delta: δ; 0 where the mean of e_1 is not positive, then the mean of L is in `mean`.
        mean: The mean by quadrature.
        unsure: E|T|^-½.
        of_first: Upper bound of the mean of e_1.
    """

    load: Projection
    delta: Array
    mean: Array
    unsure: Array
    of_first: Array

    def of(self, rows: Mask) -> "CutLoads":
        """A selection of the cells."""
        return CutLoads(self.load.of(rows), self.delta[rows], self.mean[rows], self.unsure[rows], self.of_first[rows])


def cut_loads(
    terms: list[Term], numbers: Array, resolution: Resolution, cells: Indices, fine: Array, metric: CellMetric
) -> CutLoads:
    """Integrate loads on some owned cells, about as sharply as `fine` (collective).

    Args:
        terms: The terms.
        numbers: s of each owned cell.
        resolution: Has the data.
        cells: The cells, ascending.
        fine: A load size per owned cell that need not be seen.
        metric: Metric of the owned cells.
    """
    mesh = resolution.spaces.mesh
    cell, dim = mesh.basix_cell(), mesh.topology.dim
    basis = orthonormal(cell, HIGH[dim])
    points, weights = positive_quadrature(cell, 2 * (DEGREE + dim + 1 + resolution.spaces.degree))
    volume, columns = weights.sum(), 2 * basis.dim + 3
    weight = np.stack([(term.size / np.maximum(fine, SMALLEST))[cells] ** 2 for term in terms])
    weight *= metric.volume[cells] / resolution.volume
    sums, unsure = np.zeros((len(cells), columns)), np.full((len(cells), len(terms) + 1), np.inf)

    def look(parts: Parts, *remainders: Remainder) -> Array:
        return np.stack([remainder.distance() for remainder in remainders], axis=1)

    def integrate(parts: Parts, rho: Array) -> None:
        of_parts = PartPoints(mesh, cells[parts.simplex].astype(np.int32), points, weights, parts.vertices)
        e, q = [term.e.values(of_parts) for term in terms], [term.q(of_parts) for term in terms]
        load = numbers[of_parts.cells, None] + sum(a * b for a, b in zip(e, q, strict=True))
        x = of_parts.barycentric[:, :, 1:]
        phi = basis.tabulate(0, x.reshape(-1, dim))[0][:, :, 0].reshape(*x.shape[:2], -1)
        moments = [np.einsum("nq,q,nqa->na", each, weights, phi) for each in (load, e[0])]
        squares = [(one * other) @ weights for one, other in ((load, load), (load, e[0]), (e[0], e[0]))]
        share = parts.share[:, None]
        np.add.at(sums, parts.simplex, share * np.column_stack([*moments, *squares]))
        of_q = [rho[:, i] ** 2 * (each**2 @ weights) for i, each in enumerate(q)]
        np.add.at(unsure, parts.simplex, share * np.column_stack([*of_q, rho[:, 0] ** 2 * volume]))

    groups: list[tuple[tuple, Indices]] = [((), np.arange(len(cells)))]
    for term in terms:
        pieces = resolution.pieces(term.name, term.e)
        groups = [((*trees, tree), rows[np.isin(cells[rows], on)]) for trees, rows in groups for tree, on in pieces]
    for trees, rows in groups:
        unsure[rows] = 0.0

        def need(parts: Parts, rho: Array, rows: Indices = rows) -> Array:
            return np.asarray(parts.share * (weight[:, rows[parts.simplex]].T * rho**2).sum(axis=1))

        parts, rho = in_parts(trees, resolution.vertices[cells[rows]], resolution.spaces.frame, look, need)
        parts = Parts(parts.vertices, rows[parts.simplex], parts.share)
        for begin in range(0, len(parts.simplex), CHUNK):
            some = slice(begin, begin + CHUNK)
            integrate(parts.take(some), rho[some])
    return _balanced(sums, unsure, basis.dim, volume)


def _balanced(sums: Array, unsure: Array, number: int, volume: float) -> CutLoads:
    """Loads less the multiple of e_1 that has their mean, from sums over the parts."""
    of_load, of_first = sums[:, :number], sums[:, number : 2 * number]
    positive = of_first[:, 0] > 0
    delta = np.divide(of_load[:, 0], of_first[:, 0], out=np.zeros(len(sums)), where=positive)
    coefficients = of_load - delta[:, None] * of_first
    squares = sums[:, 2 * number] - 2 * delta * sums[:, -2] + delta**2 * sums[:, -1]
    rounding = LOST * (sums[:, 2 * number] + delta**2 * sums[:, -1])
    rest = np.maximum(squares - (coefficients**2).sum(axis=1), 0.0) + rounding
    missed = 2 * (np.sqrt(unsure[:, :-1]).sum(axis=1) + np.abs(delta) * np.sqrt(unsure[:, -1]))
    load = Projection(coefficients[:, 1:], (np.sqrt(rest) + missed) ** 2)
    most = of_first[:, 0] / np.sqrt(volume) + 2 * np.sqrt(unsure[:, -1] / volume)
    return CutLoads(load, delta, coefficients[:, 0] / np.sqrt(volume), missed / np.sqrt(volume), most)


SQUARE = 8
"""Degree of (pv)² for two quadratics."""


SAME, ROUNDING = 1e-12, 1e-9
"""v is the quadratic beside Γ_D and Γ_S, too, if it differs by no more than the first share; a c < 0 of the size of the
second, relative to the largest c, counts as rounding."""


@dataclass(frozen=True)
class ReactionTerms:
    """The terms of cu, per owned cell.

    Attributes:
        gap: ‖c^-½ g‖².
        load: r − g without f − f_h.
        least: Lower bound of c.
        most: Upper bound of c.
        takes: Mask of the cells where what a step in time takes from those before is a part of `load`.
    """

    gap: Array
    load: Projection
    least: Array
    most: Array
    takes: Mask

    def beside(self, d: Array) -> "ReactionTerms":
        """The same for v + d, with ‖d‖ on the owned cells: ‖c^½d‖ is in the gap."""
        most = np.where(d > 0, self.most, 0.0)
        return replace(self, gap=(np.sqrt(self.gap) + np.sqrt(most) * d) ** 2)

    def hidden(self, value: Array, metric: CellMetric, resolution: Resolution) -> Array:
        """What osc_T grows by, as quadrature may miss `value` of the root mean square of v: the load c·v has that too.

        It is bounded by its norm with c^-½ where that is less; else its mean is recorded.
        """
        size = np.where(value > 0, self.most, 0.0) * value
        of_slope = metric.diameter / np.pi / np.sqrt(metric.low)
        small = self.least * of_slope**2 > 1
        far = np.where(small, 0.0, size)
        resolution.add_load("u_D", Interval(-far, far), far, metric)
        of_c = np.divide(1, np.sqrt(self.least), out=np.zeros_like(size), where=small)
        added: Array = size * np.sqrt(metric.volume) * np.where(small, of_c, of_slope)
        resolution.record_missed("u_D", np.flatnonzero(small), added[small] ** 2)
        return added


@dataclass(frozen=True)
class _Coefficient:
    """The datum c as p and S per owned cell.

    Attributes:
        values: p in points.
        deviation: S.
        mean: μ.
        ends: Bounds of c.
    """

    values: Callable[[CellPoints], Array]
    deviation: Array
    mean: Interval
    ends: Interval


def reaction_terms(
    spaces: Spaces,
    data: Data,
    metric: CellMetric,
    trace: Trace,
    u: fem.Function,
    resolution: Resolution,
    memory: Sequence[Term],
) -> ReactionTerms | None:
    """The terms for the admissible function of a trace and u* in P0; None where c = 0 (collective).

    `memory` has the terms of what a step in time takes from those before, if they are known.
    """
    if data.c.number == 0:
        return None
    level, fine = owned_values(u), resolution.tolerance(metric)
    nodes = np.abs(trace.v.x.array[cell_dofs(trace.v.function_space)] - level[:, None]).max(axis=1)
    farthest = np.abs(level) + nodes
    coefficient = _coefficient(data, metric, resolution, farthest, trace.cells)
    if coefficient is None:
        return None
    squares = SQUARE + 2 * spaces.degree  # of RT1 v is cubic
    if "c" in resolution.by_quadrature:
        squares = max(squares, quadrature_degree(data.c, power=2))
    of_load = HIGH[spaces.mesh.topology.dim] if spaces.degree and data.memory is not None else OF_LOAD
    near = _near(trace, coefficient, level, nodes, squares, of_load)
    c_h, load = np.zeros_like(level) if data.c_h is None else owned_values(data.c_h), near.load
    of_level = (Interval(c_h - near.mean, c_h - near.mean) - coefficient.mean) * level
    size = near.missed + coefficient.deviation * np.abs(level)
    of_mean = Interval(of_level.lo - near.missed, of_level.hi + near.missed)
    gap = near.delta**2 * (np.maximum(near.mean, 0.0) + coefficient.deviation) * metric.volume
    load.rest[:] = (np.sqrt(load.rest) + size / np.sqrt(math.factorial(spaces.mesh.topology.dim))) ** 2
    rough, takes = coefficient.deviation * farthest > fine, np.zeros(len(level), dtype=bool)
    if memory and data.c.number is None and "c" not in resolution.by_quadrature:
        bent = metric.diameter / np.pi * np.sqrt(math.factorial(spaces.mesh.topology.dim) * load.rest)
        rough |= bent * np.sqrt(metric.kappa_min) > resolution.flux(metric)
    rows = np.flatnonzero(rough & ~near.apart)
    if spaces.mesh.comm.allreduce(len(rows)):
        of_u = Term("c", data.c, lambda points: -points.bernstein(trace.v)[:, :, 0], farthest)
        numbers = c_h * level - (data.means_of_memory if memory else 0.0)
        cut = cut_loads([of_u, *memory], numbers, resolution, rows, fine, metric)
        known = np.isfinite(cut.unsure + cut.load.rest + cut.delta)
        rows, cut = rows[known], cut.of(known)
        takes[rows], load = bool(memory), load.with_rows(rows, cut.load)
        gap[rows], size[rows] = cut.delta**2 * cut.of_first * metric.volume[rows], cut.unsure
        of_mean.lo[rows], of_mean.hi[rows] = cut.mean - cut.unsure, cut.mean + cut.unsure
    resolution.add_load("c", of_mean, size, metric)
    return ReactionTerms(gap, load, coefficient.ends.lo, coefficient.ends.hi, takes)


@dataclass(frozen=True)
class _Near:
    """What p leaves on the owned cells.

    Attributes:
        mean: p_T.
        delta: δ.
        missed: SD, and the mean where p_T ≤ 0.
        load: p_T u* − p(v + δ) without its mean.
        apart: Mask of the cells where the admissible function is not the quadratic v.
    """

    mean: Array
    delta: Array
    missed: Array
    load: Projection
    apart: Mask


def _near(trace: Trace, coefficient: _Coefficient, level: Array, nodes: Array, squares: int, of_load: int) -> _Near:
    """What p leaves, projected to polynomials of a degree (collective).

    `squares` is the degree of (pv)², `nodes` has bounds of |v − u*| far from Γ_S.
    """
    mesh, number = trace.v.function_space.mesh, len(level)
    cell = mesh.basix_cell()
    delta, mean, missed = np.zeros(number), np.zeros(number), np.zeros(number)
    size = orthonormal(cell, of_load).dim - 1
    load, apart = Projection(np.zeros((number, size)), np.zeros(number)), np.zeros(number, dtype=bool)
    far = np.setdiff1d(owned_cells(mesh), trace.cells)
    for near, cells, degree in ((False, far, squares), (True, trace.cells, max(trace.degree, squares))):
        points, weights = positive_quadrature(cell, degree)
        for some in in_cells(mesh, cells, points, weights):
            numbers = some.cells
            v, p = trace.jet(some, near=near)[:, :, 0], coefficient.values(some)
            mean[numbers] = some.means(p)
            lacking = some.means(p * (level[numbers, None] - v))
            positive = mean[numbers] > 0
            delta[numbers] = np.divide(lacking, mean[numbers], out=np.zeros(len(numbers)), where=positive)
            values = (mean[numbers] * level[numbers])[:, None] - p * (v + delta[numbers, None])
            missed[numbers] = np.where(positive, 0.0, np.abs(lacking))
            farthest = np.maximum(nodes[numbers], np.abs(v - level[numbers, None]).max(axis=1, initial=0.0)) + np.abs(
                delta[numbers]
            )
            missed[numbers] += coefficient.deviation[numbers] * farthest
            part = projected(values - some.means(values)[:, None], cell, of_load, points, weights)
            load.coefficients[numbers], load.rest[numbers] = part.coefficients, part.rest
            if near:
                between = np.abs(v - some.bernstein(trace.v)[:, :, 0]).max(axis=1, initial=0.0)
                apart[numbers] = between > SAME * (np.abs(level) + nodes)[numbers]
    return _Near(mean, delta, missed, load, apart)


def _coefficient(
    data: Data, metric: CellMetric, resolution: Resolution, size: Array, near: AnyIndices
) -> _Coefficient | None:
    """The pair of p and S for a c given as text; another c as it is; None where c is certainly 0 (collective).

    `size` is that of u on each cell; the upper bound of c is sharp in cells that are `near`.
    """
    nothing = np.zeros(len(metric.volume))
    if isinstance(data.c, OnCells):
        ends = enclosing(data.c.on_cells[:, 0])
        return None if data.c_h is None else _Coefficient(data.c.values, nothing, enclosing(nothing), ends)
    pieces = resolution.pieces("c", data.c)
    if not pieces:
        zero = enclosing(nothing)
        return None if data.c_h is None else _Coefficient(data.c.values, nothing, zero, zero)
    vertices, least, most = resolution.vertices, nothing.copy(), nothing.copy()
    p, deviation, mean = near_quadratics("c", data.c, metric, resolution, size)
    for tree, cells in pieces:
        assert isinstance(tree, TREES)
        coefficients = bernstein(p.of(cells), vertices[cells])
        least[cells], most[cells] = coefficients.min(axis=1), coefficients.max(axis=1)
        if not is_polynomial(tree, 2):
            high = np.where(np.isin(cells, near), 0.0, np.inf)
            values = ranges(tree, vertices[cells], None, resolution.spaces.frame, 0.0, high)
            least[cells], most[cells] = values.lo, values.hi
    below = np.flatnonzero(least < -ROUNDING * np.abs(p.value).max(initial=0.0))
    resolution.note("the sign of c", vertices[below].mean(axis=1), below)
    if not resolution.spaces.mesh.comm.allreduce(bool(p.value.any() or deviation.any()), MPI.LOR):
        return None
    ends = Interval(np.maximum(least, 0.0), np.maximum(most, 0.0))
    return _Coefficient(lambda points: at_points(p, points), deviation, mean, ends)


def near_quadratics(
    name: str, datum: Datum, metric: CellMetric, resolution: Resolution, size: Array
) -> tuple[Quadratic, Array, Interval]:
    """Quadratics near a factor of u given as text; root mean square and mean of the rest per owned cell (collective).

    `size` is that of u on each cell.
    """
    number, dim = len(metric.volume), metric.jacobian.shape[1]
    if datum.number is not None:
        return constant(np.full(number, datum.number), dim), np.zeros(number), Interval(*np.zeros((2, number)))
    vertices, p, (deviation, *mean) = resolution.vertices, constant(np.zeros(number), dim), np.zeros((3, number))
    tolerance = resolution.tolerance(metric) / np.maximum(size, SMALLEST)
    for tree, cells in resolution.pieces(name, datum):
        assert isinstance(tree, TREES)
        q = interpolated(tree, vertices[cells])
        p.value[cells], p.gradient[cells], p.hessian[cells] = q.value, q.gradient, q.hessian
        if not is_polynomial(tree, 2):
            deviation[cells], (mean[0][cells], mean[1][cells]) = resolution.deviation(tree, q, cells, tolerance[cells])
    return p, deviation, Interval(*mean)


def at_points(p: Quadratic, points: CellPoints) -> Array:
    """Values of quadratics on the owned cells in points of some of them."""
    return p.of(points.cells).at(points.arms)[:, :, 0]
