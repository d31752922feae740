"""The admissible function of `conforming` as jets in points: u_D on Γ_D, and the bounds of u on Γ_S."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.owned import cell_dofs
from signorini_fenicsx.certificate import opposite
from signorini_fenicsx.certificate.opposite import Opposite
from signorini_fenicsx.contact.law import Values
from signorini_fenicsx.contact.laws import Corners
from signorini_fenicsx.discrete.bernstein import basis, degree_of, nodes_of
from signorini_fenicsx.discrete.cell_shapes import Entities
from signorini_fenicsx.discrete.continuity import facet_nodes
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.pairing import MeshPair
from signorini_fenicsx.discrete.part_laws import COMPLEX_STEP, PartLaw
from signorini_fenicsx.discrete.points import (
    FacetPoints,
    PartPoints,
    Points,
    facet_lattice,
    facet_type,
    from_inside,
    in_facets,
)
from signorini_fenicsx.physics.diffusion.bound.admissible_trace import SAMPLES
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces, Spaces

ROUNDING = 1e-12
"""Relative size of what is rounding in jumps."""
OF_PAIRS = "a slave cannot follow its masters: facets turn, these are several bodies, or an edge of it has a law too"
OF_UFL = "data in UFL are not known on masters beside Γ_D or laws; give them as texts"
SAFE = 2.0
"""Factor of what ℓ needs in sampled points."""


@dataclass(frozen=True)
class Bound:
    """A bound of u on some facets of Γ_S.

    Attributes:
        datum: The bound.
        sign: 1 for a lower bound, −1 for an upper one.
        near: 1 in the vertices of the facets and 0 in the others, linear.
        depth: ℓ is so many times 1 − near.
    """

    datum: Datum
    sign: float
    near: fem.Function
    depth: float

    def apply(self, points: Points, jet: Array, *, gradient: bool) -> Array:
        """The jet of a function, bounded (collective)."""
        near = points.linear(self.near, gradient=gradient)
        apart = near.copy()
        apart[:, :, 0] -= 1.0
        touched = self.near.x.array[self.near.function_space.dofmap.list[points.cells]].any(axis=1)
        with np.errstate(invalid="ignore", over="ignore"):
            bound = self.sign * self.datum.jet(points, gradient=gradient) + self.depth * apart
            limited = self.sign * larger(self.sign * jet, bound)
        return np.where(touched[:, None, None], limited, jet)


@dataclass(frozen=True)
class Level(Datum):
    """The u of steep segments in a row of a graph by its corners, see `Corners.level`; in UFL this is one of the data.

    Attributes:
        part: The law.
        segments: The first and the last one.
    """

    part: PartLaw
    segments: tuple[int, int]

    @property
    def degree(self) -> int:
        """The largest degree of the data."""
        return max(datum.degree for datum in self.part.data.values())

    @cached_property
    def number(self) -> float | None:
        """The number that it is if all data are numbers; None for all else."""
        numbers = {name: np.array(datum.number) for name, datum in self.part.data.items() if datum.number is not None}
        return float(self._level(numbers)) if len(numbers) == len(self.part.data) else None

    @property
    def polynomial(self) -> int | None:
        """The largest degree of the data; None if it is a quotient, or one of them is no polynomial."""
        degrees = [datum.polynomial for datum in self.part.data.values()]
        known = [degree for degree in degrees if degree is not None]
        whole = isinstance(self.part.law, Corners) and self.part.law.has_numbers and len(known) == len(degrees)
        return max(known) if whole else None

    def _look(self, points: Points, *, slope: bool) -> Array:
        jets = {name: datum.jet(points, gradient=slope) for name, datum in self.part.data.items()}
        values = {name: jet[:, :, 0] for name, jet in jets.items()}
        if not slope:
            return self._level(values)
        steps = (
            {name: value + 1j * COMPLEX_STEP * jets[name][:, :, i] for name, value in values.items()}
            for i in range(1, 1 + points.mesh.geometry.dim)
        )
        return np.stack([self._level(step).imag / COMPLEX_STEP for step in steps], axis=-1)

    def _level(self, values: Values) -> Array:
        assert isinstance(self.part.law, Corners)
        with np.errstate(all="ignore"):  # where there is none, v has none
            return self.part.law.level(*self.segments, values)


@dataclass(frozen=True)
class LawTrace:
    """The function of the module by its parts, as jets in points, see `discrete.points`.

    Attributes:
        u_D: The datum, and I_hu_D.
        v: v_2.
        near_dirichlet: χ_D.
        moved: v_1.
        levels: Data b that hold u, with I_hb and χ_b.
        bounds: Those of all parts.
        opposites: Pairs of surfaces by the nodes of v_2.
    """

    u_D: tuple[Datum, fem.Function]
    v: fem.Function
    near_dirichlet: fem.Function
    moved: fem.Function
    levels: list[tuple[Datum, fem.Function, fem.Function]]
    bounds: list[Bound]
    opposites: list[tuple[MeshPair, Opposite]]

    def jet(self, points: Points, *, gradient: bool = False) -> Array:
        """The jet of the bound (collective)."""
        datum, interpolant = self.u_D
        values = points.bernstein(self.v, gradient=gradient) + points.linear(self.moved, gradient=gradient)
        kept = self._kept(points, gradient=gradient)
        values = values + kept
        if datum.number is None or self.levels:
            missed = datum.jet(points, gradient=gradient) - points.bernstein(interpolant, gradient=gradient)
            values = values + cut_off(points.linear(self.near_dirichlet, gradient=gradient), missed - kept)
        for bound in self.bounds:
            values = bound.apply(points, values, gradient=gradient)
        return values

    def on_gamma_s(self, spaces: Spaces, points: FacetPoints) -> Array:
        """Values of the bound in points of all facets of Γ_S; where there are two sides its jump (collective)."""
        values = self._on_facets(points)
        if spaces.inner.present:
            across, order = points.across(spaces.inner.rows, spaces.inner.facets)
            values[spaces.inner.rows] -= np.take_along_axis(self._on_facets(across), order, axis=1)
        for pair, sides in self.opposites:
            if not pair.parts.tied:
                on_slaves = in_facets(spaces.mesh, pair.slaves, points.points)
                values[spaces.rows_of(pair)] -= self._opposite(sides, on_slaves)
        return values

    def jumps_of_tied(self, parts: int) -> float:
        """The largest jump of v + d where pairs are tied in points of facets whose edges are cut (collective)."""
        mesh, largest = self.v.function_space.mesh, 0.0
        for pair, sides in self.opposites:
            if pair.parts.tied:
                points = facet_lattice(mesh, pair.slaves, parts)
                jumps = self._on_facets(points) - self._opposite(sides, points)
                largest = max(largest, np.abs(jumps).max(initial=0.0))
        return float(mesh.comm.allreduce(largest, MPI.MAX))

    def lacking(self, spaces: Spaces) -> tuple[Array, str]:
        """‖∇d‖² and ‖d‖² on owned cells, see `certificate.opposite`, and why there is no d, in words (collective)."""
        assert isinstance(spaces, RT1Spaces)
        contact, coefficients = spaces.contact, self.v.x.array[:, None]
        beside = [contact.take(spaces.outer_rows), contact.take(spaces.inner.rows), spaces.across, spaces.dirichlet]
        beside += [pair.masters.facets for _, pair in self.opposites]
        given = [(facets, np.ones((len(facets.cells), 1))) for facets in beside]
        pairs = [(pair, pair.following(coefficients)) for _, pair in self.opposites]
        squares, past = opposite.lacking(pairs, spaces, given)
        beside_data = any(self._differs(pair.masters.facets.cells).any() for _, pair in self.opposites) and self.of_ufl
        if spaces.mesh.comm.allreduce(beside_data, MPI.LOR):
            return squares, OF_UFL
        sizes = past, float(np.abs(coefficients).max(initial=0.0))
        past, size = (spaces.mesh.comm.allreduce(each, MPI.MAX) for each in sizes)
        return squares, OF_PAIRS if past > ROUNDING * size else ""

    def _opposite(self, pair: Opposite, points: FacetPoints) -> Array:
        """What a slave follows, with what the bound differs from v_2 by opposite to it, in points (collective)."""
        space = self.v.function_space
        followed = pair.following(self.v.x.array[:, None])[:, 0][facet_nodes(space, points.facets)]
        cell = facet_type(points.mesh.topology.dim)
        values = followed @ basis(cell, degree_of(space), points.points).T
        hats = np.column_stack([1 - points.points.sum(axis=1), points.points])
        piece, on_master = pair.across(hats[:, pair.slaves.facets.ranking].swapaxes(0, 1))
        masters, rows = pair.masters.facets, pair.pieces.master[piece]
        x = np.einsum("fqa,fqai->fqi", on_master, masters.vertices[rows])
        some = np.nonzero(self._differs(masters.cells)[rows] & (not self.of_ufl))
        ends = np.repeat(x[some][:, None], x.shape[2], axis=1)
        at = PartPoints(points.mesh, masters.cells[rows][some], points.points[:1], np.empty(0), ends)
        values[some] += (self.jet(at) - at.bernstein(self.v))[:, 0, 0]
        return values

    @property
    def of_ufl(self) -> bool:
        """Whether some of the data are known in cells alone."""
        data = [self.u_D[0], *(datum for datum, *_ in self.levels), *(bound.datum for bound in self.bounds)]
        return any(datum.pieces is None and datum.number is None for datum in data)

    def _differs(self, cells: Entities) -> Mask:
        """In which of these cells the bound may differ from v_2."""
        near = [self.moved, *(near for *_, near in self.levels), *(bound.near for bound in self.bounds)]
        near += [] if self.u_D[0].number is not None and not self.levels else [self.near_dirichlet]
        return np.any([each.x.array[each.function_space.dofmap.list[cells]].any(axis=1) for each in near], axis=0)

    def is_on(self, datum: Datum, facets: Entities) -> Mask:
        """The boundary facets of some where the bound is this level itself, but for rounding (collective)."""
        size = self.v.function_space.mesh.comm.allreduce(float(np.abs(self.v.x.array).max(initial=0.0)), MPI.MAX)
        vertices = facet_nodes(self.moved.function_space, facets)
        others = [near for level, _, near in self.levels if level is not datum]
        held = [(near.x.array[vertices] == 1).all(axis=1) for level, _, near in self.levels if level is datum]
        apart = [
            (np.abs(each.x.array[vertices]) > ROUNDING * size).any(axis=1)
            for each in (self.moved, self.near_dirichlet, *others)
        ]
        return np.any(held, axis=0) & ~np.any(apart, axis=0) if held else np.zeros(len(facets), dtype=bool)

    def _on_facets(self, points: FacetPoints) -> Array:
        if self.u_D[0].number is not None:
            return self.jet(points)[:, :, 0]
        return from_inside(lambda beside: self.jet(beside)[:, :, 0], points)

    def _kept(self, points: Points, *, gradient: bool = False) -> Array:
        """The sum of all χ_b(b − I_hb) (collective)."""
        kept = np.zeros((*points.shape, 1 + gradient * points.mesh.geometry.dim))
        for level, quadratic, near in self.levels:
            missed = level.jet(points, gradient=gradient) - points.bernstein(quadratic, gradient=gradient)
            kept += cut_off(points.linear(near, gradient=gradient), missed)
        return kept


def level_of(part: PartLaw, first: int, last: int) -> Datum | None:
    """The datum with which u varies on vertical or steep segments in a row; None if it is not known."""
    name = part.law.level_of(first) if first == last else None
    if name is not None:
        return part.data[name]
    by_corners = isinstance(part.law, Corners)
    return Level(next(iter(part.data.values())).ufl, part, (first, last)) if by_corners else None


def depth(trace: LawTrace, datum: Datum, sign: float, near: fem.Function, spaces: Spaces) -> float:
    """How steep ℓ has to be: away from the facets, and on Γ_D, the bound must not change v (collective)."""
    mesh = spaces.mesh
    dofs = cell_dofs(near.function_space)
    cells = np.flatnonzero(near.x.array[dofs].any(axis=1)).astype(np.int32)
    bound = datum.at_nodes(trace.v.function_space, nodes_of(trace.v.function_space)).x.array
    nodes = trace.v.function_space.dofmap.list[cells]
    with np.errstate(invalid="ignore", over="ignore"):
        over = (sign * bound[nodes]).max(axis=1, initial=-np.inf)
        under = (sign * trace.v.x.array[nodes]).min(axis=1, initial=np.inf)
        needed = float((over - under).max(initial=0.0))
        on_wall = facet_lattice(mesh, spaces.dirichlet_facets, SAMPLES)
        on_wall = on_wall.among(near.x.array[dofs].any(axis=1))
        room = 1 - on_wall.linear(near)[:, :, 0]
        above = sign * (datum.values(on_wall) - trace.jet(on_wall)[:, :, 0])
        steep = np.where((room > 0) & (above > 0), above / np.where(room > 0, room, 1.0), 0.0).max(initial=0.0)
    return SAFE * mesh.comm.allreduce(max(needed, float(steep)), MPI.MAX)


def bounds_of_jumps(parts: Sequence[PartLaw], spaces: Spaces) -> Iterator[tuple[npt.NDArray[np.intp], float, Array]]:
    """Each bound of a jump: the rows of its facets, 1 for lower and −1 for upper, its values in sampled points."""
    for part in parts:
        rows = np.setdiff1d(part.rows, spaces.outer_rows)
        for sign, bound in zip((1.0, -1.0), part.bounds, strict=True):
            if bound is not None:
                lattice = facet_lattice(spaces.mesh, spaces.facets[rows], SAMPLES)
                yield rows, sign, bound.values(lattice)


def jumps_obey(trace: LawTrace, parts: Sequence[PartLaw], spaces: Spaces) -> bool:
    """Whether jumps are between their bounds in sampled points (collective).

    They are so in all points if the bounds are quadratic, by their coefficients: the box has them in middle nodes, and
    the vertices are among the points. What is rounding in v is rounding in its jumps.
    """
    mesh = spaces.mesh
    jumps = trace.on_gamma_s(spaces, facet_lattice(mesh, spaces.facets, SAMPLES))
    short, size = trace.jumps_of_tied(SAMPLES), np.abs(trace.v.x.array).max(initial=0.0)
    for rows, sign, bound in bounds_of_jumps(parts, spaces):
        short = max(short, float((sign * (bound - jumps[rows])).max(initial=0.0)))
        size = max(size, np.abs(bound).max(initial=0.0))
    worst, largest = (mesh.comm.allreduce(float(number), MPI.MAX) for number in (short, size))
    return bool(worst <= ROUNDING * largest)


def product(a: Array, b: Array) -> Array:
    """The jet of a product of two functions, from theirs."""
    jet = a[..., :1] * b + b[..., :1] * a
    jet[..., :1] = a[..., :1] * b[..., :1]
    return jet


def cut_off(cut: Array, jet: Array) -> Array:
    """The jet of χ times a function; 0 where χ is 0, whatever the function is there."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.where(cut[..., :1] > 0, product(cut, jet), 0.0)


def larger(a: Array, b: Array) -> Array:
    """The jet of the larger of two functions."""
    return np.where(a[..., :1] >= b[..., :1], a, b)
