"""Laws on facets with linear fluxes: a monotone graph between p and the flux for each vertex of a facet.

Laws in cells with linear u are the same, with u for p and the force −s for the flux, and d + 1 for d below.

A facet vertex has the graph of the means: of p by its hat φ_i, and for the flux λ the value at the vertex of the
nearest linear function. Of a body p is the opening and λ the pressure.

On a slope the flux λ is a spring: p = a − cλ with its compliance c. λ is linear on the facet, so the means of p by
the hats are a − c Σ_j λ_j ∫φ_iφ_j/∫φ_i. With a condition for each vertex alone, p_i = a − cλ_i, the flux would
change a third as much along a facet as it should, in space a quarter. So let

    p_i = p'_i + c/(d + 1) Σ_j (λ_i − λ_j),

where each λ_j is cut to the fluxes of the slope on which vertex i is. p' and λ have the graph, and p is the mean. It
is what a convex function of all λ_j gives, so the problem stays one of an SPD matrix and monotone graphs. Where a slope
has a slope or a vertical segment for neighbour, the function would not be convex; there p' is p.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.contact.chains import Chains, Condition, SiteConditions, joined
from signorini_fenicsx.contact.law import Graph
from signorini_fenicsx.discrete.data_values import check_means
from signorini_fenicsx.discrete.datum import quadrature_degree
from signorini_fenicsx.discrete.linear_traces import Hats, LinearTraces, linear_values
from signorini_fenicsx.discrete.part_laws import COMPLEX_STEP, PartLaw, chains_of
from signorini_fenicsx.discrete.points import FacetPoints, Points, facet_quadrature


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
class VertexLaws:
    """The laws of one direction on Γ_S or Γ_C by facet vertices, or those in Ω by vertices of cells.

    Attributes:
        of_parts: The laws with their parts; of a body those besides contact.
        chains: The graph of each facet vertex, measured from its reference.
        p_h: p at the reference of each facet vertex.
        flux_h: The flux there, of a body −σ_nn.
        shared: For each segment c/(d + 1) of the facet, 0 where p' is p, shape (facets, segments).
        size: The number of vertices of a facet, d, or of a cell.
    """

    of_parts: tuple[Any, ...]
    chains: Chains
    p_h: Array
    flux_h: Array
    shared: Array
    size: int

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

    def openings(self, segment: Indices, means: Array, pressure: Array) -> Array:
        """The openings p' from the means p. On a flat segment they make its ends those of the graph."""
        return self._moved(segment, means, pressure, inverse=False)

    def means(self, segment: Indices, p: Array, pressure: Array) -> Array:
        """The means p from p'."""
        return self._moved(segment, p, pressure, inverse=True)

    def _moved(self, segment: Indices, values: Array, pressure: Array, *, inverse: bool) -> Array:
        if self.chains.plain or len(values) == 0:
            return values
        corrections = np.pad(self.corrections(pressure), ((0, 0), (1, 1)))
        at, above, below = (np.take_along_axis(corrections, segment[:, None] + k, axis=1)[:, 0] for k in (1, 0, 2))
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
        return np.where(flat, on_flat, values + sign * at)

    def springs(self, conditions: SiteConditions) -> Springs:
        """The springs under the conditions of the facet vertices; of a penalty each vertex has its own."""
        robin = conditions.kind == Condition.ROBIN
        facets, size = len(self.shared), self.size
        if self.chains.plain:
            slope = np.where(robin, conditions.beta, 0.0).reshape(facets, size)
            rest = np.where(robin, conditions.value / np.where(robin, conditions.beta, 1.0), 0.0)
            return Springs(slope[:, :, None] * np.eye(size), rest.reshape(facets, size))
        segment = self.chains.segments(conditions)
        shared = np.take_along_axis(self.shared, segment.reshape(facets, size), axis=1)  # of vertex i
        of_facet = robin.reshape(facets, size), segment.reshape(facets, size)
        together = of_facet[0][:, :, None] & of_facet[0][:, None] & (of_facet[1][:, :, None] == of_facet[1][:, None])
        compliance = np.where(together, shared[:, :, None], 0.0)
        slopes = np.where(robin, 1 / np.where(robin, conditions.beta, 1.0), 1.0).reshape(facets, size)
        diagonal = np.arange(size)
        compliance[:, diagonal, diagonal] = slopes - np.where(of_facet[0], (size - 1) * shared, 0.0)
        low, high = self._ends()
        rest = slopes * np.broadcast_to(conditions.value, robin.shape).reshape(facets, size)
        for i in range(size):
            column = np.repeat(of_facet[1][:, i], size)[:, None]  # the segment of vertex i, at all vertices
            least, most = (np.take_along_axis(each, column, axis=1).reshape(facets, size) for each in (low, high))
            apart = np.where(of_facet[1] < of_facet[1][:, [i]], most, least)
            apart = np.where(~together[:, i] & (shared[:, [i]] > 0) & (diagonal != i), apart, 0.0)
            rest[:, i] -= shared[:, i] * apart.sum(axis=1)
        stiffness = np.linalg.inv(compliance)
        stiffness[~(of_facet[0][:, :, None] & of_facet[0][:, None])] = 0.0
        return Springs(stiffness, np.where(of_facet[0], rest, 0.0))


@dataclass(frozen=True)
class InCells:
    """Laws in cells under conditions at their vertices: −s = load − stiffness u, or u is held.

    Attributes:
        stiffness: Of the means of u by the hats, shape (cells, d + 1, d + 1).
        load: Shape (cells, d + 1).
        held: Mask of the vertices where the mean of u is given.
        values: These means, 0 elsewhere.
    """

    stiffness: Array
    load: Array
    held: Mask
    values: Array

    @classmethod
    def of(cls, laws: VertexLaws, conditions: SiteConditions) -> "InCells":
        """The laws under conditions."""
        springs, p_h = laws.springs(conditions), laws.p_h.reshape(-1, laws.size)
        kind, value = (
            np.broadcast_to(each, laws.p_h.shape).reshape(p_h.shape) for each in (conditions.kind, conditions.value)
        )
        load = np.einsum("nij,nj->ni", springs.stiffness, springs.rest + p_h)
        held = kind == Condition.ZERO_TRACE
        load += np.where(kind == Condition.NO_FLUX, value, 0.0)
        return cls(springs.stiffness, load, held, np.where(held, p_h + value, 0.0))


def vertex_laws(spaces: LinearTraces, parts: Sequence[PartLaw]) -> VertexLaws:
    """The laws of parts, and on all others p ≥ 0 and a flux ≥ 0, one of which is 0 (collective).

    Raises:
        InputError: If a datum is not finite, or of no usable size.
    """
    dim, facets = spaces.dim, len(spaces.facets)
    plain, taken = Chains.at_corner(dim * facets), np.zeros(facets, dtype=bool)
    p_h, flux_h, chains = np.zeros(dim * facets), np.zeros(dim * facets), []
    for part in parts:
        points = law_points(spaces, part)
        for name, datum in part.data.items():
            check_means(part.key(name), "on its parts", datum.values(points), spaces)
        sites = (dim * part.rows[:, None] + np.arange(dim)).ravel()
        graphs, p_h[sites], flux_h[sites] = vertex_graphs(spaces.contact.take(part.rows), points, part.falling(points))
        chains.append((sites, graphs))
        taken[part.rows] = True
    others = np.flatnonzero(np.repeat(~taken, dim))
    everywhere = joined([*chains, (others, plain[others])], dim * facets) if parts else plain
    return VertexLaws(tuple(parts), everywhere, p_h, flux_h, shared_compliance(everywhere, dim), dim)


def law_degree(part: PartLaw) -> int:
    """The degree of the quadrature in whose points a law is taken."""
    return quadrature_degree(*part.data.values(), power=2)


def law_points(spaces: LinearTraces, part: PartLaw) -> FacetPoints:
    """The points in which a law is taken (collective)."""
    return facet_quadrature(spaces.mesh, spaces.facets[part.rows], law_degree(part))


def vertex_graphs(
    hats: Hats, points: Points, graph: Graph, first: Array | float = np.nan
) -> tuple[Chains, Array, Array]:
    """The graphs at the vertices of facets or cells, and p and the flux at their references, from one in points.

    Complex values give derivatives.

    Args:
        hats: The facets or cells.
        points: Points of a quadrature in them.
        graph: The graph in these points.
        first: p at the reference of each vertex where it is not to be that of the graph, NaN where it is.
    """

    def opening(values: Array | float) -> Array:
        return (_moments(hats, points, values) * hats.ranking.shape[1] / hats.measure[:, None]).ravel()

    def pressure(values: Array | float) -> Array:
        return linear_values(_moments(hats, points, values), hats.measure).ravel()

    def slope(values: Array | float) -> Array:
        if np.ndim(values) == 0:
            return np.asarray(values)
        with np.errstate(divide="ignore", invalid="ignore"):
            found = 1 / opening(1 / np.asarray(values))
        return np.where(np.isnan(found), 0.0, found)  # flat in some point, which may have a weight of either sign

    corners = [(opening(p), pressure(flux)) for p, flux in graph.corners]
    reference = opening(graph.reference[0]), pressure(graph.reference[1])
    reference = np.where(np.isnan(first), reference[0], first), reference[1]
    if len(corners) == 1 and graph.corners[0] is graph.reference:
        corners = [reference]
    graph_of_means = Graph(reference, corners, slope(graph.before), slope(graph.beyond))
    chains = chains_of(graph_of_means, len(reference[0]))
    ends = np.ndim(graph.before) == np.ndim(graph.beyond) == 0 and (graph.before, graph.beyond)
    signorini = chains.plain and ends == (np.inf, 0.0)  # on others p' is not p
    return replace(chains, plain=signorini), *reference


def lines_by_data(
    spaces: LinearTraces,
    part: PartLaw,
    points: FacetPoints,
    present: tuple[Indices, Array],
    penalty: Callable[[Chains], Chains] = lambda chains: chains,
) -> Iterator[tuple[str, Array]]:
    """How the lines of a law move with its data that are given in UFL (collective).

    On a vertical segment it is p, on another the flux under the present means of p; by a complex step, which has no
    error but rounding.

    Args:
        spaces: The spaces.
        part: A law.
        points: Those in which it is taken, see `law_points`.
        present: The segment of each vertex of the facets of Γ_S, and p there, in means.
        penalty: What a penalty makes of the graphs.

    Yields:
        A name, and the derivatives by the datum in each point, shape (facets, d, points).
    """
    dim, facets = spaces.dim, spaces.contact.take(part.rows)
    sites = (dim * part.rows[:, None] + np.arange(dim)).ravel()
    segment, p = (each[sites] for each in present)
    values = {name: datum.values(points).ravel() for name, datum in part.data.items()}
    for name in [name for name, datum in part.data.items() if datum.pieces is None]:
        changes = np.empty((len(part.rows), dim, points.shape[1]))
        for number, unit in enumerate(np.eye(points.shape[1])):
            step = 1j * COMPLEX_STEP * np.tile(unit, len(part.rows))
            graph = part.law.falling(values | {name: values[name] + step})
            chains, of_p, of_flux = vertex_graphs(facets, points, graph)
            chains = penalty(chains)
            moved = VertexLaws((), chains, of_p, of_flux, shared_compliance(chains, dim), dim)
            conditions = chains.conditions(segment)
            kind = conditions.kind
            line = np.where(kind == Condition.ZERO_TRACE, of_p, of_flux) + conditions.value
            sprung = of_flux + moved.springs(conditions).pressure(p - of_p)
            changes[:, :, number] = np.where(kind == Condition.ROBIN, sprung, line).imag.reshape(-1, dim) / COMPLEX_STEP
        yield name, changes


def shared_compliance(chains: Chains, size: int) -> Array:
    """`VertexLaws.shared`."""
    slope = chains.slope.reshape(-1, size, chains.slope.shape[1])
    sloped = (slope > 0) & np.isfinite(slope)
    beside = np.pad(slope, ((0, 0), (0, 0), (1, 1)))
    alone = sloped & (beside[:, :, :-2] == 0) & (beside[:, :, 2:] == 0)
    slope = np.where(sloped, slope, 0.0)
    stiffest = np.take_along_axis(slope, slope.real.argmax(axis=1)[:, None], axis=1)[:, 0]
    return np.where(alone.all(axis=1), 1 / ((size + 1) * np.where(stiffest > 0, stiffest, 1.0)), 0.0)


def _moments(hats: Hats, points: Points, values: Array | float) -> Array:
    """∫ value φ_i over facets or cells, shape (n, their vertices)."""
    at_points = np.broadcast_to(values, points.shape[0] * points.shape[1]).reshape(points.shape)
    return hats.moments(at_points, points.points, points.weights)
