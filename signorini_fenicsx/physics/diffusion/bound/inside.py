"""Laws in Ω in the bound: −∇·σ + s = f with s ∈ ∂Φ(u) in each point.

Let v be in the domain of Φ, and η in that of Φ* in all points, near s_T = f_h + ∇·y with the same mean on each cell.
For the problem with the load η − ∇·y in the place of f, whose solution ũ has s̃,

    ½‖κ^½∇v − κ^-½y‖² + ∫Φ(v) + Φ*(η) − ηv = ½|∇(v − ũ)|² + ½‖y − κ∇ũ‖² + two integrals ≥ 0.

Proof. With U = v − ũ the difference of both sides without these integrals is (∇U, κ∇ũ − y) + ∫Φ(v) + Φ*(η) − ηv. As
∇·y − ∇·κ∇ũ = η − s̃, the first term is (U, η − s̃), and Φ(ũ) + Φ*(s̃) = s̃ũ. So what is left is ∫Φ(v) − Φ(ũ) − s̃(v − ũ),
which is ≥ 0, and ∫Φ*(η) − Φ*(s̃) − ũ(η − s̃), which is ≥ 0 too. Laws on Γ_S add what they add without laws in Ω.

The variational inequalities of u and ũ, each tested with the other one, give |∇(u − ũ)| ≤ osc as without laws in Ω. osc
is that of f − f_h + s_T − η. The density Φ(v) + Φ*(η) − ηv is an area between the graph and the line s = η, see `laws`.

*Where u is on a bound*, an end of the graph that is vertical, η may take f as it is: f̃ = f in the cells where s = s_T +
f − f_h is in the range of an obstacle in all points, or of such an end. So in contact f may jump and is not paid for.
Only the range of f is needed there, which intervals enclose, and the gap is bounded with the largest |s| of each cell,
the force λ.

*Elsewhere* η makes ∫Φ*(η) − ηv + ½ω|η − t|² least among those with the mean s_T, ω = (δ_T/π)², so that the sum of 2
gap and osc² is small. t is s_T plus the quadratic part of f − f_h, which a steep segment so takes as it is. With r =
t + (v + m)/ω and w = (I + ω∂Φ)⁻¹(ωr) it is η = r − w/ω; the number m gives the mean.

v is between the bounds. There it is a function that is quadratic on each cell, by Bernstein coefficients between those
of I_hψ, and then cut off by ψ itself. In vertices off Γ_D all of whose cells touch it is moved beyond ψ by as much as
I_hψ may be on the other side, so that v is ψ itself there.

With a term cu, s_T = f_h + ∇·y − c_h u*, and both sides have the terms of `reaction`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import cell_dofs, owned_values, sums_at
from signorini_fenicsx.base.reference_cells import orthonormal, positive_quadrature
from signorini_fenicsx.certificate.laws import Area, gap, with_mean
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.contact.conditions import Condition, SiteConditions
from signorini_fenicsx.contact.laws import Corners, Obstacle
from signorini_fenicsx.discrete.bernstein import make_linear, nodes_of, to_bernstein
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.datum import DEGREES, Datum, quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import extreme_around
from signorini_fenicsx.discrete.part_laws import PartLaw
from signorini_fenicsx.discrete.points import CellPoints, cell_quadrature, in_cells
from signorini_fenicsx.expressions.cutting import Frame
from signorini_fenicsx.physics.diffusion.bound.admissible_trace import Trace
from signorini_fenicsx.physics.diffusion.bound.law_bounds import Bound
from signorini_fenicsx.physics.diffusion.bound.limits import Simplices
from signorini_fenicsx.physics.diffusion.bound.local_fields import HIGH, OF_LAW, Projection, at_points, projected
from signorini_fenicsx.physics.diffusion.bound.metric import CellMetric
from signorini_fenicsx.physics.diffusion.bound.resolution import Resolution
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux
from signorini_fenicsx.physics.diffusion.discrete.cell_laws import CellLaws
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solution import Solution

ROOM = 2.0
"""Factor of the largest I_hψ − ψ in the points of a quadrature."""
SQUARE = 8
"""Degree of the square of a quadratic, and of its square."""
HALVINGS = 40
"""So often the interval of m is halved before it is taken to be linear there."""


def selected(laws: CellLaws, cells: SiteConditions, s: Array, u: Array, metric: CellMetric) -> Array:
    """The s per owned cell that the law under a condition allows: of flat and sloped segments, with u, what they say.

    Elsewhere it would be the error of the linear solver, and its product with v − ψ would add up with one sign. On
    steep segments it is s itself, as on vertical ones: there the error of u counts, and that of s costs little.
    """
    chains, rows = laws.chains, np.arange(len(s))
    segment = chains.segments(cells, (u - laws.means, -s))
    beta, load = laws.as_linear(cells)
    first, last = segment == 0, segment == chains.count
    least = np.where(first, -np.inf, -chains.flux[rows, np.maximum(segment - 1, 0)])
    most = np.where(last, np.inf, -chains.flux[rows, np.minimum(segment, chains.corners - 1)])
    held = beta * metric.diameter**2 > 1
    return np.where(held, np.clip(s, least, most), np.where(held, 0.0, beta) * u - load)


def room(laws: CellLaws, cells: SiteConditions, s: Array, u: Array) -> Array:
    """By how much s of each owned cell may grow or fall where its law holds u; 0 elsewhere."""
    chains, rows = laws.chains, np.arange(len(s))
    segment = chains.segments(cells, (u - laws.means, -s))
    above = np.where(segment == chains.count, np.inf, -chains.flux[rows, np.minimum(segment, chains.corners - 1)] - s)
    below = np.where(segment == 0, np.inf, s + chains.flux[rows, np.maximum(segment - 1, 0)])
    return np.where(cells.kind == Condition.ZERO_TRACE, np.minimum(above, below), 0.0)


@dataclass(frozen=True)
class Ray:
    """A bound of u in some cells.

    Attributes:
        name: Its name in messages and results.
        datum: The bound.
        sign: 1 for a lower bound, −1 for an upper one.
        cells: The owned cells where it holds.
        touched: Mask of the owned cells on it.
        everywhere: Whether it holds in all cells of all ranks.
    """

    name: str
    datum: Datum
    sign: float
    cells: Indices
    touched: Mask
    everywhere: bool

    @property
    def is_quadratic(self) -> bool:
        """Whether the bound is its own quadratic interpolant."""
        return self.datum.polynomial is not None and self.datum.polynomial <= 2

    def limits(self, v: fem.Function, frame: Frame) -> tuple[Array, Mask]:
        """What it asks of the coefficients of v, infinite in nodes off its cells, and the rough cells (collective)."""
        space, rough = v.function_space, np.zeros(len(self.touched), dtype=bool)
        if self.datum.number is None and self.datum.pieces is not None:
            nodes = cell_dofs(space)[self.cells]
            simplices = Simplices(
                corners(space.mesh)[self.cells], self.cells, nodes, v.x.array[nodes], self.touched[self.cells]
            )
            asked, rough[self.cells], _ = simplices.asked(self.datum, self.sign, space, frame)
            return extreme_around(space, nodes, asked, largest=self.sign > 0), rough
        bound = coefficients(self.datum, space)
        return bound if self.everywhere else np.where(_around(space, self.cells), bound, -self.sign * np.inf), rough

    def bound(self, linear: fem.FunctionSpace) -> Bound:
        """The bound, as it is known to `conforming`, with the depth 0 (collective)."""
        near = fem.Function(linear)
        near.x.array[:] = 1.0 if self.everywhere else _around(linear, self.cells)
        return Bound(self.datum, self.sign, near, 0.0)

    def touch(self, v: fem.Function, limit: Array, on_dirichlet: Indices) -> None:
        """Let v be I_hψ in the nodes of all cells on the bound, but not on Γ_D (collective)."""
        touched = _around(v.function_space, np.flatnonzero(self.touched))
        touched[on_dirichlet] = False
        v.x.array[:] = np.where(touched, limit, v.x.array)

    def move_inside(self, v: fem.Function, limits: tuple[Array, Mask], given: Indices) -> None:
        """Move v in the vertices all of whose cells touch, so that v cut off by ψ is ψ there (collective).

        In nodes where v is given, as on Γ_D, and in those of rough cells, it stays.
        """
        if self.is_quadratic:
            return
        space, mesh, (limit, rough) = v.function_space, v.function_space.mesh, limits
        above, interpolant = np.zeros(len(self.touched)), fem.Function(space)
        interpolant.x.array[:] = np.where(np.isfinite(limit), limit, 0.0)
        for points in cell_quadrature(mesh, self.cells.astype(np.int32), quadrature_degree(self.datum)):
            missed = self.sign * (points.bernstein(interpolant)[:, :, 0] - self.datum.values(points))
            above[points.cells] = missed.max(axis=1, initial=0.0)
        cells = cell_dofs(space)
        vertices = cells[:, : mesh.topology.dim + 1]
        apart = rough | (self.sign * v.x.array[cells] > self.sign * limit[cells]).any(axis=1)
        depth, free = fem.Function(space), fem.Function(space)
        for function, values in ((depth, ROOM * above), (free, 1.0 * apart)):
            np.maximum.at(function.x.array, vertices.ravel(), np.repeat(values, vertices.shape[1]))
            function.x.petsc_vec.ghostUpdate(addv=PETSc.InsertMode.MAX_VALUES, mode=PETSc.ScatterMode.REVERSE)
            function.x.scatter_forward()
        depth.x.array[free.x.array > 0] = 0.0
        depth.x.array[given] = 0.0
        make_linear(depth)
        v.x.array[:] -= self.sign * depth.x.array


def coefficients(datum: Datum, space: fem.FunctionSpace) -> Array:
    """Bernstein coefficients of the interpolant of a datum (collective)."""
    interpolant = datum.at_nodes(space, nodes_of(space))
    to_bernstein(interpolant)
    return np.asarray(interpolant.x.array, dtype=np.float64)


def _around(space: fem.FunctionSpace, cells: Indices) -> Mask:
    """Mask of the nodes of this rank that some owned cells of any rank have (collective)."""
    return sums_at(space.dofmap.index_map, space.dofmap.list[cells]) > 0


@dataclass(frozen=True)
class Inside:
    """The laws in Ω under the conditions of a solution, for its bound. Arrays have one entry per owned cell.

    Attributes:
        spaces: The discrete spaces.
        parts: The laws, each with its region; none without laws in Ω.
        s: The s_T.
        chains: The laws of each cell, by means.
        segment: The segment of each cell.
        rays: All bounds of u.
        largest: Upper bound of |s| in cells on a bound of u, 0 in others.
        takes_f: Mask of the cells where f̃ = f.
        f: The load, None without laws.
    """

    spaces: Spaces
    parts: tuple[PartLaw, ...]
    s: Array
    chains: Chains
    segment: Indices
    rays: tuple[Ray, ...]
    largest: Array
    takes_f: Mask
    f: Datum | None = None

    @classmethod
    def of(
        cls, solution: Solution, metric: CellMetric, y: fem.Function, level: fem.Function, resolution: Resolution
    ) -> Inside:
        """The laws with a flux, with u* as `level` (collective)."""
        spaces, data, laws = solution.spaces, solution.data, solution.data.inside
        if laws is None:
            none = np.zeros((2, len(spaces.cell_measures)))
            return cls(spaces, (), none[0], Chains.at_corner(0), none[0].astype(np.int64), (), none[1], none[1] > 0)
        u, cells = owned_values(level), solution.cell_conditions
        s = CellFlux.of(spaces, y).divergence + owned_values(data.source(level))
        s = selected(laws, cells, s, u, metric)
        segment = laws.chains.segments(cells, (u - laws.means, -s))
        rays = tuple(_rays(spaces, laws, segment))
        for part in laws.of_regions:
            resolution.by_quadrature |= {
                part.key(name)
                for name, datum in part.data.items()
                if not any(datum is bound for bound in part.bounds)
                and (datum.polynomial is None or 2 * datum.polynomial > DEGREES[1])
            }
        largest, takes_f = np.zeros(len(s)), np.zeros(len(s), dtype=bool)
        for ray in rays:
            largest[ray.touched] = np.maximum(-ray.sign * s[ray.touched], 0.0)
        inside = cls(spaces, laws.of_regions, s, laws.chains, segment, rays, largest, takes_f, data.f)
        if data.f.number is None:
            inside._take_f(data, resolution)
        return inside

    def _take_f(self, data: Data, resolution: Resolution) -> None:
        """Let η take f where it can, in place (collective)."""
        f_h, rows = data.means_of_f, np.arange(len(self.s))
        number, others = np.zeros(len(self.s), dtype=np.int64), np.zeros(len(self.s), dtype=bool)
        for part in self.parts:
            number[part.rows] += 1
        for part in self.parts:
            if type(part.law) is not Obstacle:
                others[part.rows] |= (number[part.rows] > 1) | (
                    type(part.law) is not Corners or not part.law.has_numbers
                )
        for ray in self.rays:
            cells = np.flatnonzero(ray.touched & (self.largest > 0) & ~others)
            s_end = -self.chains.flux[rows, np.where(ray.sign > 0, 0, self.chains.count - 1)]
            end = f_h + ray.sign * (self.largest - np.maximum(-ray.sign * s_end, 0.0))
            limit = end[cells] if ray.sign > 0 else np.full(len(cells), np.inf)
            f = resolution.range_of("f", data.f, cells, limit)
            far, near = (f.hi, f.lo) if ray.sign > 0 else (-f.lo, -f.hi)
            taken = far <= ray.sign * end[cells]
            self.takes_f[cells] = taken
            grown = self.largest[cells] + ray.sign * f_h[cells] - near
            self.largest[cells] = np.where(taken, grown, self.largest[cells])

    @property
    def forces(self) -> Array:
        """The slope of the gap where u is on a bound: λ below, −λ above, 0 elsewhere."""
        return sum((ray.sign * np.where(ray.touched, self.largest, 0.0) for ray in self.rays), np.zeros(len(self.s)))

    def gap(
        self, trace: Trace, metric: CellMetric, resolution: Resolution, area: Area = gap
    ) -> tuple[Array, Projection | None]:
        """Twice the gap, at most, and the load s_T − η without f − f_h, if any (collective); `area` is as in `laws`."""
        mesh = self.spaces.mesh
        if not self.parts:
            return np.zeros(len(self.s)), None
        number, dim, cell = len(self.s), mesh.topology.dim, mesh.basix_cell()
        squares, missed = np.zeros(number), np.zeros(number)
        load = Projection(np.zeros((number, orthonormal(cell, HIGH[dim]).dim - 1)), np.zeros(number))
        near = np.isin(np.arange(number), trace.cells)
        for parts, cells in self.groups():
            for close in (False, True):
                some = cells[near[cells] == close]
                points, weights = self.rule(trace, near=close)
                for at in in_cells(mesh, some.astype(np.int32), points, weights):
                    own = at.cells.astype(np.int64)
                    law = self.law_at(parts, at)
                    v = trace.jet(at, near=close)[:, :, 0]
                    eta = self._eta(law, v, self.s[own, None] + self._varying(at), metric, at)
                    missed[own] = self.s[own] - at.means(eta)
                    part = projected(self.s[own, None] - missed[own, None] - eta, cell, HIGH[dim], points, weights)
                    load.coefficients[own], load.rest[own] = part.coefficients, part.rest
                    pressed = self.largest[own] > 0
                    sides = np.sign(self.forces[own])
                    eta[pressed] = -(sides * self.largest[own])[pressed, None]
                    density = area(law, v.ravel(), -eta.ravel()).reshape(at.shape)
                    squares[own] = 2 * at.integrals(density)
        resolution.add_means("law", missed, metric)
        return squares, load

    def rule(self, trace: Trace, *, near: bool) -> tuple[Array, Array]:
        """The quadrature of the gap in the cells of the trace (near) or in others."""
        degree = max(SQUARE, quadrature_degree(*(datum for part in self.parts for datum in part.data.values())))
        cell = self.spaces.mesh.basix_cell()
        return positive_quadrature(cell, max(degree, trace.degree) if near else degree)

    def groups(self) -> Iterator[tuple[list[int], Indices]]:
        """The cells that have the same laws: numbers of these, and the owned cells; alike on all ranks (collective).

        Under obstacles alone v is between them in all points, so that cells on no obstacle have no gap.
        """
        parts = self.parts
        code = np.zeros(len(self.s), dtype=np.int64)
        for number, part in enumerate(parts):
            code[part.rows] += 2**number
        codes = {each for some in self.spaces.mesh.comm.allgather(set(np.unique(code).tolist())) for each in some}
        for each in sorted(codes - {0}):
            numbers = [number for number in range(len(parts)) if each & 2**number]
            inert = all(type(parts[number].law) is Obstacle for number in numbers) & (self.largest == 0)
            yield numbers, np.flatnonzero((code == each) & ~inert)

    def law_at(self, parts: list[int], at: CellPoints) -> Chains:
        """The sum of some laws in points of cells, cell after cell."""
        return reduce(Chains.plus, (self.parts[number].chains(at) for number in parts))

    def on_segment(self, law: Chains, at: CellPoints, segment: Indices) -> list[Array]:
        """β and value of a segment of each owned cell in points of some, and its least and largest u there."""
        sites, column = np.arange(len(law.p)), np.minimum(np.repeat(segment[at.cells], at.shape[1]), law.corners)
        ends = law.ends[0]
        of_sites = (law.slope[sites, column], law.value[sites, column], ends[sites, column], ends[sites, column + 1])
        return [values.reshape(at.shape) for values in of_sites]

    def _varying(self, at: CellPoints) -> Array:
        """The quadratic part of f − f_h in points of some cells, 0 where f̃ = f."""
        if self.f is None or self.f.number is not None:
            return np.zeros(at.shape)
        f, cell = self.f.values(at), at.mesh.basix_cell()
        part = projected(f - at.means(f)[:, None], cell, OF_LAW, at.points, at.weights)
        return np.where(self.takes_f[at.cells, None], 0.0, at_points(part, cell, OF_LAW, at.points))

    def _eta(self, law: Chains, v: Array, target: Array, metric: CellMetric, at: CellPoints) -> Array:
        """The η of the module in points of some cells, shape (cells, points), for values of t there."""
        s, omega = self.s[at.cells], (metric.diameter[at.cells] / math.pi) ** 2
        low, high = (-end.reshape(v.shape) for end in law.extent()[:1:-1])
        pressed = self.largest[at.cells] > 0
        eta, follows = _on_segment(self.on_segment(law, at, self.segment), v, s, target, omega, at.weights)
        eta[pressed] = s[pressed, None]
        free = ~pressed & ~follows
        if free.any():
            points = np.repeat(free, v.shape[1])
            eta[free] = nearest_to_graph(law[points], v[free], s[free], target[free], omega[free], at.weights)
        return with_mean(eta, low, high, s, at.weights)


def _on_segment(
    line_and_ends: list[Array], v: Array, s: Array, target: Array, omega: Array, weights: Array
) -> tuple[Array, Mask]:
    """The η of `nearest_to_graph` for cells that are on a flat or sloped segment in all points, and which these are."""
    slope, value, begin, end = line_and_ends
    line = np.where(np.isfinite(slope), slope, 0.0)
    theta = 1 / (1 + line * omega[:, None])
    eta = theta * (line * v - value) + (1 - theta) * target
    eta += np.where((line > 0).all(axis=1), s - eta @ (weights / weights.sum()), 0.0)[:, None]
    level = np.divide(eta + value, line, out=v.copy(), where=line > 0)
    follows = np.isfinite(slope) & (begin <= v) & (v <= end) & (begin <= level) & (level <= end)
    return eta, follows.all(axis=1)


def nearest_to_graph(law: Chains, v: Array, s: Array, target: Array, omega: Array, weights: Array) -> Array:
    """The η that makes ∫Φ*(η) − ηv + ½ω|η − t|² least among those with the mean s on each cell.

    Args:
        law: The law in the points of a quadrature, cell after cell.
        v: Values there, shape (cells, points).
        s: Per cell.
        target: t, shape (cells, points).
        omega: ω per cell.
        weights: Of the quadrature.
    """
    weights, at = weights / weights.sum(), omega[:, None] * target + v
    level = _level_at(law, np.repeat(s, v.shape[1])).reshape(v.shape)
    apart = level - v - omega[:, None] * (target - s[:, None])  # with such an m η is s in a point
    low, high = apart.min(axis=1), apart.max(axis=1)
    of_points = np.repeat(omega, v.shape[1])

    def eta_with(m: Array) -> Array:
        z = (at + m[:, None]).ravel()
        return ((z - _resolvent(law, z, of_points)) / of_points).reshape(v.shape)

    for _ in range(HALVINGS):
        middle = (low + high) / 2
        small = eta_with(middle) @ weights <= s
        low, high = np.where(small, middle, low), np.where(small, high, middle)
    ends = eta_with(low), eta_with(high)
    lowest, highest = (end @ weights for end in ends)
    share = np.divide(s - lowest, highest - lowest, out=np.zeros_like(s), where=highest > lowest)
    return ends[0] + np.clip(share, 0.0, 1.0)[:, None] * (ends[1] - ends[0])


def _level_at(law: Chains, s: Array) -> Array:
    """A u at which s is on the graph, per site; where s is beyond its range that of the nearest end."""
    rows = np.arange(len(s))
    flux = np.clip(-s, *law.extent()[2:])
    segment = np.minimum((law.flux > flux[:, None]).sum(axis=1), law.count)
    slope, value = law.slope[rows, segment], law.value[rows, segment]
    corner = law.p[rows, np.clip(segment, 0, law.count - 1)]
    sloped = (slope > 0) & np.isfinite(slope)
    on_slope = np.divide(value - flux, slope, out=np.zeros_like(value), where=sloped)
    return np.where(sloped, on_slope, np.where(np.isinf(slope), value, corner))


def _resolvent(law: Chains, z: Array, omega: Array) -> Array:
    """The w with w + ω∂Φ(w) ∋ z, per site."""
    rows = np.arange(len(z))
    with np.errstate(invalid="ignore"):
        corners = np.where(np.isfinite(law.p), law.p - omega[:, None] * law.flux, np.inf)
    segment = (corners < z[:, None]).sum(axis=1)
    slope, value = law.slope[rows, segment], law.value[rows, segment]
    vertical = np.isinf(slope)
    slope = np.where(vertical, 0.0, slope)
    return np.where(vertical, value, (z + omega * value) / (1 + omega * slope))


def _rays(spaces: Spaces, laws: CellLaws, segment: Indices) -> Iterator[Ray]:
    """All bounds of u (collective)."""
    number = len(segment)
    for part in laws.of_regions:
        everywhere = spaces.mesh.comm.allreduce(number - len(part.rows)) == 0
        for sign, datum in zip((1.0, -1.0), part.bounds, strict=True):
            if datum is None:
                continue
            key = next((name for name, each in part.data.items() if each is datum), "bound")
            touched = np.zeros(number, dtype=bool)
            end = np.zeros(number, dtype=np.int64) if sign > 0 else laws.chains.count
            touched[part.rows] = (segment == end)[part.rows]
            touched &= np.isinf(laws.chains.slope[np.arange(number), end])
            yield Ray(part.key(key), datum, sign, part.rows, touched, everywhere)


def add_load(load: fem.Function, spaces: Spaces, forces: Array) -> None:
    """Add ∫λφ for each node φ, on this rank: all Bernstein polynomials of a cell have the same integral."""
    nodes = cell_dofs(load.function_space)
    np.add.at(load.x.array, nodes.ravel(), np.repeat(forces * spaces.cell_measures / nodes.shape[1], nodes.shape[1]))
