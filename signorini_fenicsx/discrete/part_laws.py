"""Laws on parts of Γ_S and in regions of Ω: their data on a mesh, and their graphs as chains of segments."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import place_in_words
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.contact.law import Graph, Law, LawWithMemory
from signorini_fenicsx.contact.laws import Corners
from signorini_fenicsx.discrete.data_values import check_finite, check_means, in_problem, worst_of
from signorini_fenicsx.discrete.datum import Datum, datum_of, quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.points import (
    Points,
    cell_quadrature,
    facet_quadrature,
    facet_type,
    in_cells,
    in_facets,
    quadratic_nodes,
)
from signorini_fenicsx.expressions.given import parsed

ROUNDING = 1e-12
"""Relative size of what is rounding in the order of bounds."""
COMPLEX_STEP = 1e-200
"""Of a derivative by complex data, which has no error but rounding."""
SHORT = "obstacle"
"""The name of the law that the key `obstacle` of a problem is a short form of."""


@dataclass(frozen=True)
class PartLaw:
    """A law and where it holds.

    Attributes:
        law: The law.
        name: How messages call it: "law.0" for the first one that is listed, "pair.0" for that of the first pair, empty
            for ψ and q_S of the problem.
        rows: Its facets of this rank, as rows of `Spaces.facets`; of a law in regions its owned cells.
        data: Its data by their names.
        bounds: The data that are the least and the largest u, None where the graph does not end in a vertical segment.
    """

    law: Law
    name: str
    rows: Indices
    data: Mapping[str, Datum]
    bounds: tuple[Datum | None, Datum | None] = (None, None)

    def key(self, name: str) -> str:
        """The name of one of its data in messages."""
        return name if not self.name else self.name if self.name == SHORT else f"{self.name}.{name}"

    @property
    def where(self) -> str:
        """The place where the law holds, for messages."""
        return {"": "on Γ_S", SHORT: "in the domain"}.get(
            self.name, "in its regions" if self.law.region else "on its parts"
        )

    def titles(self) -> list[str]:
        """What pictures call the segments: those of a graph without names by their u, if its data are numbers."""
        numbers = {name: np.array(datum.number) for name, datum in self.data.items() if datum.number is not None}
        if not isinstance(self.law, Corners) or self.law.names or len(numbers) < len(self.data):
            return list(self.law.segments)
        corners = [f"{float(u):g}" for u, _ in self.law.graph(numbers).corners]
        between = [f"jump at $u = {a}$" if a == b else f"$u$ from {a} to {b}" for a, b in pairwise(corners)]
        return [f"up to $u = {corners[0]}$", *between, f"from $u = {corners[-1]}$"]

    def quadrature(self, spaces: MeshSpaces, degree: int) -> list[Points]:
        """The points of a quadrature in its facets or cells, some at a time (collective)."""
        if self.law.region:
            return list(cell_quadrature(spaces.mesh, self.rows.astype(np.int32), degree))
        return [facet_quadrature(spaces.mesh, spaces.facets[self.rows], degree)]

    def nodes(self, spaces: MeshSpaces) -> list[Points]:
        """The vertices and edge midpoints of its facets or cells (collective)."""
        mesh = spaces.mesh
        if self.law.region:
            return list(in_cells(mesh, self.rows.astype(np.int32), quadratic_nodes(mesh.basix_cell())))
        return [in_facets(mesh, spaces.facets[self.rows], quadratic_nodes(facet_type(mesh.topology.dim)))]

    def chains(self, points: Points, flux_h: Array | None = None) -> Chains:
        """The law in each of some points of its facets or cells, measured from u = 0 and κ∇u·n = 0.

        Args:
            points: The points; those of a quadrature if `flux_h` is given.
            flux_h: κ∇u·n at the reference of each facet. If it is a mean of one of the data, the graphs in the points
                of a facet are moved to have this mean: another quadrature of a kink has another one.
        """
        return chains_of(replace(self.falling(points, flux_h), reference=(0.0, 0.0)), points.shape[0] * points.shape[1])

    def falling(self, points: Points, flux_h: Array | None = None) -> Graph:
        """The graph in points, with κ∇u·n at its reference as an array, moved as `chains` says."""
        values = {name: datum.values(points).ravel() for name, datum in self.data.items()}
        graph, origin = self.law.falling(values), np.zeros(points.shape)
        reference = graph.reference[1]
        if flux_h is not None and any(reference is each for each in values.values()):
            origin[:] = (points.means(np.reshape(reference, points.shape)) - flux_h)[:, None]
        moved = {id(each): (each[0], each[1] - origin.ravel()) for each in (graph.reference, *graph.corners)}
        corners = [moved[id(each)] for each in graph.corners]  # one that is the reference stays it
        return replace(graph, reference=moved[id(graph.reference)], corners=corners)


def checked(spaces: MeshSpaces, part: PartLaw) -> tuple[PartLaw, Graph]:
    """The law with its bounds, and its graph in the means of the data, if these are what they must be (collective).

    Raises:
        InputError: If data are not what their law allows; the message says where.
    """
    if ("region" if part.law.region else "parts") not in part.law.places:
        place = "parts of the boundary, not regions" if part.law.region else "regions, not parts: give region"
        raise InputError(f"{part.name} ({part.law.name}): this law is one of {place}")
    means = means_of(spaces, part)
    refuse_data(spaces, part)
    graph = part.law.falling(means)
    return replace(part, bounds=_bounds(spaces, part, graph, means)), graph


def by_ends(spaces: MeshSpaces, part: PartLaw) -> list[PartLaw]:
    """A law with memory by the facets whose graphs are vertical at the same ends, others as they are (collective).

    So a bound of u is one on all facets of a part, as bare metal has u = 0 and metal below a film has not.
    """
    if not isinstance(part.law, LawWithMemory):
        return [part]
    graph = part.law.falling(means_of(spaces, part))
    ends = np.zeros(len(part.rows), dtype=np.int64) + np.isinf(graph.before) + 2 * np.isinf(graph.beyond)
    kinds = np.unique(np.concatenate(spaces.mesh.comm.allgather(np.unique(ends))))
    return [replace(part, rows=part.rows[ends == kind]) for kind in kinds]


def parts_of_laws(spaces: MeshSpaces, laws: Sequence[tuple[str, Law]]) -> set[str]:
    """The parts of all laws, each with its name in messages.

    Raises:
        InputError: If one is not of Γ_S, or is listed twice, or a law has neither parts nor a region.
    """
    listed: set[str] = set()
    for name, law in laws:
        if not law.parts and not law.region:
            raise InputError(f"{name}: has neither parts nor a region")
        for part in law.parts:
            if part not in spaces.part_names:
                parts = ", ".join(spaces.part_names)
                raise InputError(f"{name}.parts: '{part}' is not a part of Γ_S, whose parts are {parts}")
            if part in listed:
                raise InputError(f"{name}.parts: '{part}' is listed twice")
            listed.add(part)
    return listed


def chains_of(graph: Graph, number: int) -> Chains:
    """Chains through the corners of a graph at so many sites, measured from its reference."""
    p, flux = (
        np.stack([np.broadcast_to(corner[axis] - graph.reference[axis], number) for corner in graph.corners], axis=1)
        for axis in (0, 1)
    )
    most, least = np.maximum.accumulate(p.real, axis=1), np.minimum.accumulate(flux.real, axis=1)
    p, flux = np.where(most > p.real, most, p), np.where(least < flux.real, least, flux)  # but for rounding they are so
    before, beyond = (np.broadcast_to(slope, number) for slope in (graph.before, graph.beyond))
    chains = Chains.through(p, flux, before, beyond)
    return replace(chains, plain=len(graph.corners) == 1 and graph.corners[0] is graph.reference)


def data_of_law(spaces: MeshSpaces, law: Law, name: str) -> dict[str, Datum]:
    """The data of a law (collective).

    Raises:
        InputError: If a text cannot be read, or is no scalar; if it is a law with memory outside of steps in time.
    """
    if isinstance(law, LawWithMemory) and not law.now:
        raise InputError(f"{name} ({law.name}): this law has a memory, so it needs [time], without physics")
    data: dict[str, Datum] = {}
    for key, given in law.data().items():
        place = f"{name}.{key}"
        data[key] = datum_of(spaces, place, parsed(given, "xyz"[: spaces.mesh.geometry.dim], place))
    return data


def means_of(spaces: MeshSpaces, part: PartLaw) -> dict[str, Array]:
    """Means of the data over the facets or cells, some of them weighted (collective).

    Raises:
        InputError: If a datum is not finite.
    """
    means = {}
    for key, datum in part.data.items():
        if datum.number is not None:
            means[key] = np.full(len(part.rows), datum.number)
        else:
            blocks = part.quadrature(spaces, quadrature_degree(datum))
            means[key] = np.concatenate([points.means(datum.values(points)) for points in blocks])
        check_means(part.key(key), part.where, means[key], spaces)
    for key, by in part.law.weights.items():
        datum, weight = part.data[key], part.data[by]
        if weight.number is None:
            blocks = part.quadrature(spaces, quadrature_degree(datum, weight, power=2))
            moments, sizes = (
                np.concatenate([points.means(factor(points)) for points in blocks])
                for factor in (lambda x, of=datum, by=weight: of.values(x) * by.values(x), weight.values)
            )
            means[key] = np.divide(moments, sizes, out=means[key], where=means[by] > 0)
    return means


def _not_monotone(graph: Graph, *, inside: bool) -> Iterator[tuple[str, Array]]:
    """How a graph is not monotone, in words, and where: a number > 0 there."""
    falls = "s must not fall" if inside else "κ∇u·n must not grow"
    for i, (one, other) in enumerate(pairwise(graph.corners)):
        yield f"u must not fall from corner {i} to {i + 1}", np.subtract(one[0], other[0])
        yield f"{falls} from corner {i} to {i + 1}", np.subtract(other[1], one[1])
    yield "before must not be negative", np.negative(graph.before)
    yield "beyond must not be negative", np.negative(graph.beyond)


def _bounds(
    spaces: MeshSpaces, part: PartLaw, graph: Graph, means: Mapping[str, Array]
) -> tuple[Datum | None, Datum | None]:
    """The data that bound u at the vertical ends of a graph in the means of the data, lower and upper (collective).

    A bound must be continuous. It is known by being the very array that the graph was given, so no law has to name it.

    Raises:
        InputError: If a bound is neither a datum nor a number, or is not finite somewhere.
    """
    bounds: list[Datum | None] = []
    for which, slope, (u, _) in (("first", graph.before, graph.corners[0]), ("last", graph.beyond, graph.corners[-1])):
        if not spaces.mesh.comm.allreduce(bool(np.isinf(slope).any()), MPI.LOR):
            bounds.append(None)
        elif (number := _one_number(u, spaces.mesh.comm)) is not None:
            bounds.append(datum_of(spaces, f"{part.name} ({part.law.name})", number))
        else:
            key = next((key for key, values in means.items() if values is u), None)
            if key is None:
                raise InputError(
                    f"{part.name} ({part.law.name}): its graph is vertical at the {which} end, so u of the {which} "
                    "corner must be one of its data as it was given, or a number, not computed from them"
                )
            _check_nodes(spaces, part, key)
            bounds.append(part.data[key])
    return bounds[0], bounds[1]


def _one_number(u: Array | float, comm: MPI.Comm) -> float | None:
    """The number that all values on all ranks are; None if they differ (collective)."""
    if np.ndim(u) == 0:
        return float(u)
    least, most = (
        comm.allreduce(float(np.min(u, initial=np.inf)), MPI.MIN),
        comm.allreduce(float(np.max(u, initial=-np.inf)), MPI.MAX),
    )
    return least if least == most else None


def _check_nodes(spaces: MeshSpaces, part: PartLaw, key: str) -> None:
    """Make sure that a bound is finite at vertices and edge midpoints, in cells with its gradient (collective).

    Raises:
        InputError: If it is not.
    """
    datum = part.data[key]
    finite = all(bool(np.isfinite(datum.values(points)).all()) for points in part.nodes(spaces))
    if not spaces.mesh.comm.allreduce(finite, MPI.LAND):
        raise InputError(f"{in_problem(part.key(key))}: not finite everywhere {part.where}")
    if part.law.region:
        check_finite(spaces, in_problem(part.key(key)), part.where, datum, part.rows.astype(np.int32))


def refuse_data(spaces: MeshSpaces, part: PartLaw) -> None:
    """Refuse data that their law does not allow, and a graph that is not monotone, in points (collective).

    Raises:
        InputError: On all ranks, with the place of the worst.
    """
    comm = spaces.mesh.comm
    for points in part.quadrature(spaces, quadrature_degree(*part.data.values())):
        values = {key: datum.values(points).ravel() for key, datum in part.data.items()}
        with np.errstate(all="ignore"):  # of data that are refused below
            graph = part.law.falling(values)
        numbers = [*values.values(), *(each for corner in graph.corners for each in corner)]
        largest = max(float(np.abs(each).max(initial=0.0)) for each in numbers)
        rounding = ROUNDING * comm.allreduce(largest if np.isfinite(largest) else 0.0, MPI.MAX)
        for what, size in (*part.law.refused(values), *_not_monotone(graph, inside=bool(part.law.region))):
            excess, place = worst_of(comm, np.broadcast_to(size, points.shape[0] * points.shape[1]), points)
            if excess > rounding:
                at = place_in_words(place)
                raise InputError(f"{part.name} ({part.law.name}): {what}, as at {at}, by {excess:.3g}")
