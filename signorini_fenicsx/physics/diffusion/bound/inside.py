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

*With RT1* s is linear on each cell, and f_h has the slope of −∇·y besides the mean of f. In cells all of whose vertices
are on a bound η is s, or f̃ = f where f + ∇·y has the right sign in all points. Cells whose vertices are on several
segments are those that a free boundary crosses; there η is found as elsewhere, near what f + ∇·y is in each point.

v is between the bounds, see `rays`.

With a term cu, s_T = f_h + ∇·y − c_h u*, and both sides have the terms of `reaction`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import cell_dofs, owned_values
from signorini_fenicsx.base.reference_cells import orthonormal, positive_quadrature
from signorini_fenicsx.certificate.laws import Area, LawPoints, gap, with_mean
from signorini_fenicsx.contact.chains import Chains, Condition, SiteConditions
from signorini_fenicsx.contact.laws import Corners, Obstacle
from signorini_fenicsx.discrete.bernstein import degree_of, exponents
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.part_laws import PartLaw
from signorini_fenicsx.discrete.points import CellPoints, in_cells
from signorini_fenicsx.expressions.intervals import Interval
from signorini_fenicsx.physics.diffusion.bound.admissible_trace import Trace
from signorini_fenicsx.physics.diffusion.bound.laws import is_rough, trace_on
from signorini_fenicsx.physics.diffusion.bound.local_fields import (
    HIGH,
    OF_LAW,
    CellMetric,
    Projection,
    at_points,
    projected,
)
from signorini_fenicsx.physics.diffusion.bound.rays import Ray, rays_of
from signorini_fenicsx.physics.diffusion.bound.resolution import Resolution
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux, cell_values, linear_in
from signorini_fenicsx.physics.diffusion.discrete.cell_laws import CellLaws
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solution import Solution

MOVED = 2.0
"""Share of the largest force in cells of RT1 that only touch a bound, which η may have in a point."""
SQUARE = 8
"""Degree of the square of a quadratic, and of its square."""
HALVINGS = 40
"""So often the interval of m is halved before it is taken to be linear there."""


def selected(solution: Solution, laws: CellLaws, s: Array, u: Array, metric: CellMetric) -> Array:
    """The s per owned cell that the law under a condition allows: of flat and sloped segments, with u, what they say.

    Elsewhere it would be the error of the linear solver, and its product with v − ψ would add up with one sign. On
    steep segments it is s itself, as on vertical ones: there the error of u counts, and that of s costs little. With
    RT1 it is s itself wherever a mean cannot tell what the vertices are on, see `Solution.blurred_cells`.
    """
    cells, ends = solution.cell_conditions, laws.chains.extent()[:1:-1]
    beta, load = laws.as_linear(cells)
    held, blurred = beta * metric.diameter**2 > 1, solution.blurred_cells
    of_segment = _ends_of_segment(laws, cells, s, u)
    least, most = (np.where(blurred, -end, each) for end, each in zip(ends, of_segment, strict=True))
    return np.where(held | blurred, np.clip(s, least, most), np.where(held, 0.0, beta) * u - load)


def room(laws: CellLaws, cells: SiteConditions, s: Array, u: Array) -> Array:
    """By how much s of each owned cell may grow or fall where its law holds u; 0 elsewhere."""
    least, most = _ends_of_segment(laws, cells, s, u)
    return np.where(cells.kind == Condition.ZERO_TRACE, np.minimum(most - s, s - least), 0.0)


def _ends_of_segment(laws: CellLaws, cells: SiteConditions, s: Array, u: Array) -> tuple[Array, Array]:
    """The least and the largest s on the segment of each owned cell."""
    chains, rows = laws.chains, np.arange(len(s))
    segment = chains.segments(cells, (u - laws.means, -s))
    least = np.where(segment == 0, -np.inf, -chains.flux[rows, np.maximum(segment - 1, 0)])
    most = np.where(segment == chains.count, np.inf, -chains.flux[rows, np.minimum(segment, chains.corners - 1)])
    return least, most


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
        blurred: Mask of the cells whose segment is not that of all of the cell, see `Solution.blurred_cells`.
        tilt: With RT1 what ∇·y is in the vertices of the cells beyond its mean; None with RT0.
        s_tilt: What s is there beyond s_T; None with RT0.
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
    blurred: Mask | None = None
    tilt: Array | None = None
    s_tilt: Array | None = None

    @classmethod
    def of(
        cls, solution: Solution, metric: CellMetric, y: fem.Function, level: fem.Function, resolution: Resolution
    ) -> "Inside":
        """The laws with a flux, with u* as `level` (collective)."""
        spaces, data, laws = solution.spaces, solution.data, solution.data.inside
        if not laws:
            none = np.zeros((2, len(spaces.cell_measures)))
            return cls(spaces, (), none[0], Chains.at_corner(0), none[0].astype(np.int64), (), none[1], none[1] > 0)
        u, divergence, tilt, s_tilt = owned_values(level), CellFlux.of(spaces, y).divergence, None, None
        if spaces.degree:
            s_tilt, tilt = (each - each.mean(axis=1)[:, None] for each in (-cell_values(solution.force()), divergence))
            divergence = divergence.mean(axis=1)
        s = selected(solution, laws, divergence + owned_values(data.source(level)), u, metric)
        segment = laws.chains.segments(solution.cell_conditions, (u - laws.means, -s))
        blurred = solution.blurred_cells
        rays = tuple(rays_of(spaces, laws, segment, s, blurred))
        for part in laws.of_regions:
            resolution.by_quadrature |= {
                part.key(name)
                for name, datum in part.data.items()
                if is_rough(datum) and not any(datum is bound for bound in part.bounds)
            }
        takes_f = np.zeros(len(s), dtype=bool)
        of_cells = s, laws.chains, segment, rays, np.zeros(len(s)), takes_f, data.f, blurred, tilt, s_tilt
        inside = cls(spaces, laws.of_regions, *of_cells)
        for ray in rays:
            room = np.where(ray.touched, 1.0, MOVED)
            inside.largest[ray.pressed] = (room * inside.pressure(ray.sign).max(axis=1))[ray.pressed]
        if data.f.number is None or tilt is not None:
            inside._take_f(data, resolution)
        return inside

    def s_at(self, at: CellPoints) -> Array:
        """The values of s in points of cells, shape (cells, points)."""
        s = np.repeat(self.s[at.cells, None], at.shape[1], axis=1)
        return s if self.s_tilt is None else s + linear_in(at, self.s_tilt)

    def pressure(self, sign: float) -> Array:
        """−s, of an upper bound s, in the vertices of the cells, at least 0; of RT0 in one column."""
        s = self.s[:, None] if self.s_tilt is None else self.s[:, None] + self.s_tilt
        return np.maximum(-sign * s, 0.0)

    def _take_f(self, data: Data, resolution: Resolution) -> None:
        """Let η take f where it can, in place (collective)."""
        f_h, rows, tilt = data.means_of_f, np.arange(len(self.s)), np.zeros((len(self.s), 1))
        tilt = tilt if self.tilt is None else self.tilt
        number, others = np.zeros(len(self.s), dtype=np.int64), np.zeros(len(self.s), dtype=bool)
        for part in self.parts:
            number[part.rows] += 1
        for part in self.parts:
            if type(part.law) is not Obstacle:
                others[part.rows] |= (number[part.rows] > 1) | (
                    type(part.law) is not Corners or not part.law.has_numbers
                )
        for ray in self.rays:
            cells = np.flatnonzero(ray.pressed & (self.largest > 0) & ~others)
            s_end = -self.chains.flux[rows, np.where(ray.sign > 0, 0, self.chains.count - 1)]
            pressure = np.maximum(-ray.sign * self.s, 0.0)
            end = f_h + ray.sign * (pressure - np.maximum(-ray.sign * s_end, 0.0))
            lo, hi = tilt.min(axis=1)[cells], tilt.max(axis=1)[cells]
            limit = end[cells] - hi if ray.sign > 0 else np.full(len(cells), np.inf)
            f = Interval(f_h[cells], f_h[cells])
            if data.f.number is None:
                f = resolution.range_of("f", data.f, cells, limit)
            jumps = f.hi - f.lo > pressure[cells]  # so the linear s overshoots, and some vertices are free
            f = Interval(f.lo + lo, f.hi + hi)
            far, near = (f.hi, f.lo) if ray.sign > 0 else (-f.lo, -f.hi)
            taken = far <= ray.sign * end[cells]
            taken &= ray.touched[cells] | jumps
            self.takes_f[cells], ray.touched[cells[taken]] = taken, True
            grown = pressure[cells] + ray.sign * f_h[cells] - near
            self.largest[cells] = np.where(taken, grown, self.largest[cells])

    @cached_property
    def held(self) -> Mask:
        """Mask of the owned cells all of which a bound of u presses."""
        touched = sum((ray.touched for ray in self.rays), np.zeros(len(self.s), dtype=bool))
        return np.asarray(touched & (self.largest > 0))

    @cached_property
    def sides(self) -> Array:
        """Per owned cell 1 where u is pressed by a lower bound, −1 where by an upper one, 0 elsewhere."""
        sides = np.zeros(len(self.s))
        for ray in self.rays:
            sides[ray.pressed & (self.largest > 0)] = ray.sign
        return sides

    @property
    def forces(self) -> Array:
        """The slope of the gap where u is on a bound: λ below, −λ above, 0 elsewhere; in vertices as `pressure`."""
        sides = self.sides[:, None]
        forces = np.where(sides > 0, self.pressure(1.0), np.where(sides < 0, -self.pressure(-1.0), 0.0))
        return np.where(self.takes_f[:, None], sides * self.largest[:, None], forces)

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
                    ids = at.cells.astype(np.int64)
                    law = self.law_at(parts, at)
                    v = trace.jet(at, near=close)[:, :, 0]
                    eta = self._eta(law, v, self.s[ids, None] + self._varying(at), metric)
                    missed[ids] = self.s[ids] - at.means(eta)
                    part = projected(self.s[ids, None] - missed[ids, None] - eta, cell, HIGH[dim], points, weights)
                    load.coefficients[ids], load.rest[ids] = part.coefficients, part.rest
                    held = self.held[ids]
                    eta[held] = -(self.sides[ids] * self.largest[ids])[held, None]
                    density = law.areas(area, v, -eta)
                    squares[ids] = 2 * at.integrals(density)
        resolution.add_means("law", missed, metric)
        return squares, load

    def rule(self, trace: Trace, *, near: bool) -> tuple[Array, Array]:
        """The quadrature of the gap in the cells of the trace (near) or in others."""
        degree = quadrature_degree(*(datum for part in self.parts for datum in part.data.values()))
        degree = max(SQUARE + 2 * self.spaces.degree, degree)
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

    def meets(self, cells: Mask) -> bool:
        """Whether some of these owned cells have a law (collective)."""
        met = any(bool(cells[part.rows].any()) for part in self.parts)
        return bool(self.spaces.mesh.comm.allreduce(met, MPI.LOR))

    def law_at(self, parts: list[int], at: CellPoints) -> LawPoints:
        """The sum of some laws in points of cells."""
        return LawPoints(at, reduce(Chains.plus, (self.parts[number].chains(at) for number in parts)))

    def _varying(self, at: CellPoints) -> Array:
        """The quadratic part of f − f_h in points of some cells, f_h with the slope of −∇·y; 0 where f̃ = f."""
        values = np.zeros(at.shape)
        if self.f is not None and self.f.number is None:
            f, cell = self.f.values(at), at.mesh.basix_cell()
            part = projected(f - at.means(f)[:, None], cell, OF_LAW, at.points, at.weights)
            values += at_points(part, cell, OF_LAW, at.points)
        if self.tilt is not None:
            values += linear_in(at, self.tilt)
        return np.where(self.takes_f[at.cells, None], 0.0, values)

    def _eta(self, law: LawPoints, v: Array, target: Array, metric: CellMetric) -> Array:
        """The η of the module in points of some cells, shape (cells, points), for values of t there."""
        at, segment = law.points, self.segment[law.points.cells]
        s, omega = self.s[at.cells], (metric.diameter[at.cells] / math.pi) ** 2
        low, high = (-end for end in law.extent()[:1:-1])
        pressed = self.held[at.cells]
        eta, follows = _on_segment([*law.on(segment), *law.traces(segment)], v, s, target, omega, at.weights)
        eta[pressed] = np.where(self.takes_f[at.cells, None], s[:, None], self.s_at(at))[pressed]
        largest = self.largest[at.cells, None]
        most = np.where(largest > 0, largest, np.inf)
        low, high = np.maximum(low, -most), np.minimum(high, most)
        if self.blurred is not None:
            follows &= ~self.blurred[at.cells]
        free = ~pressed & ~follows
        if free.any():
            points = np.repeat(free, v.shape[1])
            eta[free] = nearest_to_graph(law.law[points], v[free], s[free], target[free], omega[free], at.weights)
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
    return np.where(slope == 0, corner, trace_on(slope, value, flux))


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


def add_load(load: fem.Function, spaces: Spaces, forces: Array) -> None:
    """Add ∫λφ for each node φ, on this rank, for λ on cells by one value, or linear by those in the vertices.

    All Bernstein polynomials of a cell have the same integral, and λ_v B_α is (α_v + 1)/(n + 1) times one of degree
    n + 1.
    """
    space, nodes = load.function_space, cell_dofs(load.function_space)
    shares = np.full((1, nodes.shape[1]), 1 / nodes.shape[1])
    if forces.shape[1] > 1:
        of_node = exponents(space.mesh.basix_cell(), degree_of(space)).T + 1
        shares = of_node / of_node.sum()  # each vertex has the same share of the cell
    np.add.at(load.x.array, nodes.ravel(), ((forces * spaces.cell_measures[:, None]) @ shares).ravel())
