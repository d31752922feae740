"""Laws in the normal direction on Γ_C: monotone graphs between the opening p = g − u_n and the pressure −σ_nn.

Where two bodies touch p = g − [u_n]. A facet vertex has the graph of the means: of the openings by its hat φ_i, and for
the pressures the value at the vertex of the nearest linear function.

On a slope the pressure λ is a spring: p = a − cλ with its compliance c. λ is linear on the facet, so the means of p by
the hats are a − c Σ_j λ_j ∫φ_iφ_j/∫φ_i. With a condition for each vertex alone, p_i = a − cλ_i, the pressure would
change a third as much along a facet as it should, in space a quarter. So let

    p_i = p'_i + c/(d + 1) Σ_j (λ_i − λ_j),

where each λ_j is cut to the pressures of the slope on which vertex i is. p' and λ have the graph, and p is the mean. It
is what a convex function of all λ_j gives, so the problem stays one of an SPD matrix and monotone graphs. Where a slope
has a slope or a vertical segment for neighbour, the function would not be convex; there p' is p.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.contact.chains import Chains, joined
from signorini_fenicsx.contact.conditions import Condition, SiteConditions
from signorini_fenicsx.contact.law import Graph, Law
from signorini_fenicsx.discrete.data_values import check_means
from signorini_fenicsx.discrete.datum import DEGREES, Datum, quadrature_degree
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, linear_values
from signorini_fenicsx.discrete.part_laws import (
    COMPLEX_STEP,
    PartLaw,
    chains_of,
    data_of_law,
    parts_of_laws,
    refuse_data,
)
from signorini_fenicsx.discrete.points import FacetPoints, facet_quadrature
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces


@dataclass(frozen=True)
class NormalLaw(PartLaw):
    """A law and where it holds; `rows` are those of `ElasticSpaces.contact`."""

    def graph(self, points: FacetPoints) -> Graph:
        """The graph in points."""
        return self.law.graph({name: datum.values(points).ravel() for name, datum in self.data.items()})

    def reference(self, points: FacetPoints) -> tuple[Array, Array]:
        """The opening and the pressure at the reference in points, shape (facets, points) each."""
        number = points.shape[0] * points.shape[1]
        opening, pressure = (np.broadcast_to(each, number) for each in self.graph(points).reference)
        return opening.reshape(points.shape), pressure.reshape(points.shape)

    @property
    def polynomial(self) -> int | None:
        """The degree of the opening at the reference, as if this were a datum; None if it is not quadratic."""
        return 2 if self.moves_only() else None

    def values(self, points: FacetPoints) -> Array:
        """The opening at the reference in points, shape (facets, points)."""
        return self.reference(points)[0]

    def varying(self) -> Mapping[str, Datum]:
        """The data that are no numbers."""
        return {name: datum for name, datum in self.data.items() if datum.polynomial != 0}

    def moves_only(self) -> bool:
        """Whether along a facet the graph is moved at most, by a quadratic opening and a linear pressure."""
        varying = self.varying()
        if not varying:
            return True
        values: Mapping[str, Array] = {name: np.ones(1) for name in self.data}
        graph = self.law.graph(values)
        if len(graph.corners) != 1 or graph.corners[0] is not graph.reference:
            return False
        most = {
            name: degree
            for degree, each in zip((2, 1), graph.reference, strict=True)
            for name in values
            if values[name] is each
        }
        degrees = {
            name: DEGREES[1] if datum.polynomial is None else datum.polynomial for name, datum in varying.items()
        }
        return all(degree <= most.get(name, 0) for name, degree in degrees.items())


@dataclass(frozen=True)
class Springs:
    """The slopes on which vertices are, as springs: the pressures of a facet are `stiffness @ (rest - p)`.

    Attributes:
        stiffness: Symmetric, 0 for vertices that are on no slope, shape (facets, d, d).
        rest: The means of the opening under which there is no pressure, shape (facets, d).
    """

    stiffness: Array
    rest: Array

    def pressure(self, p: Array) -> Array:
        """The pressures under these means of the opening, 0 at vertices that are on no slope, shape (sites,)."""
        pressure: Array = np.einsum("nij,nj->ni", self.stiffness, self.rest - p.reshape(self.rest.shape))
        return pressure.ravel()


@dataclass(frozen=True)
class NormalLaws:
    """The laws on Γ_C in the normal direction, contact among them.

    Attributes:
        of_parts: The laws besides contact, each with its parts.
        chains: The graph of each facet vertex, measured from its reference.
        opening: p at the reference of each facet vertex.
        pressure: −σ_nn there.
        shared: For each segment c/(d + 1) of the facet, 0 where p' is p, shape (facets, segments).
        dim: The dimension d.
    """

    of_parts: tuple[NormalLaw, ...]
    chains: Chains
    opening: Array
    pressure: Array
    shared: Array
    dim: int

    def corrections(self, pressure: Array) -> Array:
        """The differences p − p' by segment, under these pressures from the references, shape (sites, segments)."""
        facets = len(self.shared)
        low, high = self._ends()
        clipped = np.clip(pressure[:, None], low, high).reshape(facets, -1, self.shared.shape[1])
        with np.errstate(invalid="ignore"):  # segments behind the last one have infinite ends
            off = clipped.shape[1] * clipped - clipped.sum(axis=1, keepdims=True)
            corrections = np.where(self.shared[:, None] > 0, self.shared[:, None] * off, 0.0)
        return corrections.reshape(-1, self.shared.shape[1])

    def _ends(self) -> tuple[Array, Array]:
        """The least and the largest pressure of each segment, shape (sites, segments) each."""
        fluxes = self.chains.ends[1]
        return fluxes[:, 1:], fluxes[:, :-1]

    def own(self, segment: Indices, means: Array, pressure: Array) -> Array:
        """The openings p' from the means p. On a flat segment they make its ends those of the graph."""
        return self._moved(segment, means, pressure, inverse=False)

    def means(self, segment: Indices, own: Array, pressure: Array) -> Array:
        """The means p from p'."""
        return self._moved(segment, own, pressure, inverse=True)

    def _moved(self, segment: Indices, values: Array, pressure: Array, *, inverse: bool) -> Array:
        if self.chains.plain or len(values) == 0:
            return values
        corrections = np.pad(self.corrections(pressure), ((0, 0), (1, 1)))
        own, above, below = (np.take_along_axis(corrections, segment[:, None] + k, axis=1)[:, 0] for k in (1, 0, 2))
        ends = np.pad(self.chains.p, ((0, 0), (1, 1)), constant_values=((0, 0), (-np.inf, np.inf)))
        begin, end = (np.take_along_axis(ends, segment[:, None] + k, axis=1)[:, 0] for k in (0, 1))
        flat = np.take_along_axis(self.chains.slope, segment[:, None], axis=1)[:, 0] == 0
        sources, targets = (begin + above, end + below), (begin, end)
        if inverse:
            sources, targets = targets, sources
        with np.errstate(invalid="ignore", divide="ignore"):
            share = (targets[1] - targets[0]) / (sources[1] - sources[0])
            between = targets[0] + share * (values - sources[0])
        sign = 1.0 if inverse else -1.0
        before = (values <= sources[0]) | np.isinf(end)
        after = (values >= sources[1]) | np.isinf(begin)
        on_flat = np.where(before, values + sign * above, np.where(after, values + sign * below, between))
        return np.where(flat, on_flat, values + sign * own)

    def springs(self, conditions: SiteConditions) -> Springs:
        """The springs under the conditions of the facet vertices."""
        robin = conditions.kind == Condition.ROBIN
        facets, dim = len(self.shared), self.dim
        segment = self.chains.segments(conditions)
        shared = np.take_along_axis(self.shared, segment.reshape(facets, dim), axis=1)  # of vertex i
        of_facet = robin.reshape(facets, dim), segment.reshape(facets, dim)
        together = of_facet[0][:, :, None] & of_facet[0][:, None] & (of_facet[1][:, :, None] == of_facet[1][:, None])
        compliance = np.where(together, shared[:, :, None], 0.0)
        own = np.where(robin, 1 / np.where(robin, conditions.beta, 1.0), 1.0).reshape(facets, dim)
        diagonal = np.arange(dim)
        compliance[:, diagonal, diagonal] = own - np.where(of_facet[0], (dim - 1) * shared, 0.0)
        low, high = self._ends()
        rest = own * np.broadcast_to(conditions.value, robin.shape).reshape(facets, dim)
        for i in range(dim):
            column = np.repeat(of_facet[1][:, i], dim)[:, None]  # the segment of vertex i, at all vertices
            least, most = (np.take_along_axis(each, column, axis=1).reshape(facets, dim) for each in (low, high))
            apart = np.where(of_facet[1] < of_facet[1][:, [i]], most, least)
            apart = np.where(~together[:, i] & (shared[:, [i]] > 0) & (diagonal != i), apart, 0.0)
            rest[:, i] -= shared[:, i] * apart.sum(axis=1)
        stiffness = np.linalg.inv(compliance)
        stiffness[~(of_facet[0][:, :, None] & of_facet[0][:, None])] = 0.0
        return Springs(stiffness, np.where(of_facet[0], rest, 0.0))


def normal_laws(spaces: ElasticSpaces, laws: Sequence[tuple[int, Law]]) -> NormalLaws:
    """Read the laws, each with its number in the list of all laws; elsewhere Γ_C is in contact (collective).

    Raises:
        InputError: If data are not what their law allows; the message says where.
    """
    dim, number = spaces.dim, len(spaces.site_kinds["normal"])
    plain = Chains.at_corner(number)
    opening, pressure = np.zeros(number), np.zeros(number)
    if not laws:
        return NormalLaws((), plain, opening, pressure, np.zeros((len(spaces.contact.facets), 2)), dim)
    parts_of_laws(spaces, [law for _, law in laws])
    of_parts, chains = [], []
    taken = np.zeros(len(spaces.contact.facets), dtype=bool)
    for index, law in laws:
        numbers = [spaces.part_names.index(part) for part in law.parts]
        rows = np.flatnonzero(np.isin(spaces.part_of_facet, numbers))
        part = NormalLaw(law, f"law.{index}", rows, data_of_law(spaces, law, f"law.{index}"))
        refuse_data(spaces, part)
        sites = (dim * rows[:, None] + np.arange(dim)).ravel()
        own, opening[sites], pressure[sites] = _at_vertices(spaces, part)
        chains.append((sites, own))
        of_parts.append(part)
        taken[rows] = True
    others = np.flatnonzero(np.repeat(~taken, dim))
    all_of_them = joined([*chains, (others, plain[others])], number)
    return NormalLaws(tuple(of_parts), all_of_them, opening, pressure, _shared(all_of_them, dim), dim)


def _at_vertices(spaces: ElasticSpaces, part: NormalLaw) -> tuple[Chains, Array, Array]:
    """The graphs at the facet vertices, and the opening and the pressure at their references (collective)."""
    facets = spaces.contact.take(part.rows)
    points = _points(spaces, part)
    for name, datum in part.data.items():
        check_means(part.key(name), "on its parts", datum.values(points), spaces)
    return _graphs(facets, points, part.graph(points))


def _points(spaces: ElasticSpaces, part: NormalLaw) -> FacetPoints:
    """The points in which a law is taken (collective)."""
    facets = spaces.contact.facets[part.rows]
    return facet_quadrature(spaces.mesh, facets, quadrature_degree(*part.data.values(), power=2))


def _graphs(facets: BoundaryFacets, points: FacetPoints, graph: Graph) -> tuple[Chains, Array, Array]:
    """The graphs at the vertices of facets, and the opening and the pressure at their references, from one in points.

    Complex values give derivatives.
    """

    def opening(values: Array | float) -> Array:
        return (_moments(facets, points, values) * facets.vertices.shape[1] / facets.measure[:, None]).ravel()

    def pressure(values: Array | float) -> Array:
        return linear_values(_moments(facets, points, values), facets.measure).ravel()

    def slope(values: Array | float) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            return 1 / opening(1 / np.asarray(values))

    corners = [(opening(p), pressure(flux)) for p, flux in graph.corners]
    reference = opening(graph.reference[0]), pressure(graph.reference[1])
    if len(corners) == 1 and graph.corners[0] is graph.reference:
        corners = [reference]
    graph_of_means = Graph(reference, corners, slope(graph.before), slope(graph.beyond))
    return replace(chains_of(graph_of_means, len(reference[0])), plain=False), *reference


def lines_by_data(
    spaces: ElasticSpaces, part: NormalLaw, names: Sequence[str], segment: Indices, opening: Array
) -> Iterator[tuple[str, Array]]:
    """How the lines of a law move with its data, if these are linear on facets (collective).

    On a vertical segment it is the opening, on another the pressure under the present means of the opening; by a
    complex step, which has no error but rounding.

    Args:
        spaces: The spaces.
        part: A law.
        names: Some of its data.
        segment: The segment of each facet vertex of Γ_C.
        opening: The opening there, in means.

    Yields:
        A name, and the derivatives by the values of this datum at the vertices, shape (facets, d, d).
    """
    dim, facets, points = spaces.dim, spaces.contact.take(part.rows), _points(spaces, part)
    sites = (dim * part.rows[:, None] + np.arange(dim)).ravel()
    values = {name: datum.values(points).ravel() for name, datum in part.data.items()}
    hats = np.column_stack([1 - points.points.sum(axis=1), points.points])
    for name in names:
        changes = np.empty((len(part.rows), dim, dim))
        for vertex in range(dim):
            step = 1j * COMPLEX_STEP * hats[:, facets.ranking[:, vertex]].T.ravel()
            graph = part.law.graph(values | {name: values[name] + step})  # type: ignore[arg-type]
            chains, of_opening, of_pressure = _graphs(facets, points, graph)
            moved = NormalLaws((), chains, of_opening, of_pressure, _shared(chains, dim), dim)
            conditions = chains.conditions(segment[sites])
            kind = conditions.kind
            line = np.where(kind == Condition.ZERO_TRACE, of_opening, of_pressure) + conditions.value
            sprung = of_pressure + moved.springs(conditions).pressure(opening[sites] - of_opening)
            line = np.where(kind == Condition.ROBIN, sprung, line)
            changes[:, :, vertex] = line.imag.reshape(-1, dim) / COMPLEX_STEP
        yield name, changes


def _moments(facets: BoundaryFacets, points: FacetPoints, values: Array | float) -> Array:
    """∫ value φ_i over facets, shape (facets, d)."""
    at_points = np.broadcast_to(values, points.shape[0] * points.shape[1]).reshape(points.shape)
    return facets.moments(at_points, points.points, points.weights)


def _shared(chains: Chains, dim: int) -> Array:
    """`NormalLaws.shared`."""
    slope = chains.slope.reshape(-1, dim, chains.slope.shape[1])
    sloped = (slope > 0) & np.isfinite(slope)
    beside = np.pad(slope, ((0, 0), (0, 0), (1, 1)))
    alone = sloped & (beside[:, :, :-2] == 0) & (beside[:, :, 2:] == 0)
    slope = np.where(sloped, slope, 0.0)
    stiffest = np.take_along_axis(slope, slope.real.argmax(axis=1)[:, None], axis=1)[:, 0]
    return np.where(alone.all(axis=1), 1 / ((dim + 1) * np.where(stiffest > 0, stiffest, 1.0)), 0.0)
