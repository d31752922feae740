"""Laws on parts of Γ_S: their data on a mesh, and their graphs as chains of segments."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.contact.laws import Graph, Law
from signorini_fenicsx.discrete.datum import Datum, datum_of, quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.points import FacetPoints, facet_quadrature
from signorini_fenicsx.expressions.given import parsed

ROUNDING = 1e-12
"""Relative size of what is rounding in the order of bounds."""


@dataclass(frozen=True)
class PartLaw:
    """A law and where it holds.

    Attributes:
        law: The law.
        name: How messages call it: "law.0" for the first one that is listed, empty for ψ and q_S of the problem.
        rows: Its facets of this rank, as rows of `Spaces.facets`.
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
        return f"{self.name}.{name}" if self.name else name

    def chains(self, points: FacetPoints, flux_h: Array | None = None) -> Chains:
        """The law in each of some points of its facets, measured from u = 0 and κ∇u·n = 0.

        Args:
            points: The points; those of a quadrature if `flux_h` is given.
            flux_h: κ∇u·n at the reference of each facet. If it is a mean of one of the data, the graphs in the points
                of a facet are moved to have this mean: another quadrature of a kink has another one.
        """
        values = {name: datum.values(points).ravel() for name, datum in self.data.items()}
        graph, origin = self.law.graph(values), np.zeros(points.shape)
        reference = graph.reference[1]
        if flux_h is not None and any(reference is each for each in values.values()):
            origin[:] = (points.means(np.reshape(reference, points.shape)) - flux_h)[:, None]
        return chains_of(replace(graph, reference=(0.0, origin.ravel())), origin.size)


def chains_of(graph: Graph, number: int) -> Chains:
    """Chains through the corners of a graph at so many sites, measured from its reference."""
    p, flux = (
        np.stack([np.broadcast_to(corner[axis] - graph.reference[axis], number) for corner in graph.corners], axis=1)
        for axis in (0, 1)
    )
    p, flux = np.maximum.accumulate(p, axis=1), np.minimum.accumulate(flux, axis=1)  # but for rounding they are so
    before, beyond = (np.broadcast_to(slope, number) for slope in (graph.before, graph.beyond))
    chains = Chains.through(p, flux, before, beyond)
    return replace(chains, plain=len(graph.corners) == 1 and graph.corners[0] is graph.reference)


def parts_of_laws(spaces: MeshSpaces, laws: Sequence[Law]) -> set[str]:
    """The parts of all laws.

    Raises:
        InputError: If one is not of Γ_S, or is listed twice.
    """
    listed: set[str] = set()
    for i, law in enumerate(laws):
        for part in law.parts:
            if part not in spaces.part_names:
                known = ", ".join(spaces.part_names)
                raise InputError(f"law.{i}.parts: '{part}' is not a part of Γ_S, whose parts are {known}")
            if part in listed:
                raise InputError(f"law.{i}.parts: '{part}' is listed twice")
            listed.add(part)
    return listed


def data_of_law(spaces: MeshSpaces, law: Law, name: str) -> dict[str, Datum]:
    """The data of a law (collective).

    Raises:
        InputError: If a text cannot be read, or is no scalar.
    """
    found: dict[str, Datum] = {}
    for key, given in law.data().items():
        place = f"{name}.{key}"
        found[key] = datum_of(spaces, place, parsed(given, "xyz"[: spaces.mesh.geometry.dim], place))
    return found


def _not_monotone(graph: Graph) -> Iterator[tuple[str, Array]]:
    """How a graph is not monotone, in words, and where: a number > 0 there."""
    for i, (one, other) in enumerate(pairwise(graph.corners)):
        yield f"u must not fall from corner {i} to {i + 1}", np.subtract(one[0], other[0])
        yield f"κ∇u·n must not grow from corner {i} to {i + 1}", np.subtract(other[1], one[1])
    yield "before must not be negative", np.negative(graph.before)
    yield "beyond must not be negative", np.negative(graph.beyond)


def place_of(part: PartLaw) -> str:
    """Where a law holds, for messages."""
    return "on its parts" if part.name else "on Γ_S"


def refuse_data(spaces: MeshSpaces, part: PartLaw) -> None:
    """Refuse data that their law does not allow, and a graph that is not monotone, in points (collective).

    Raises:
        InputError: On all ranks, with the place of the worst.
    """
    comm, dim = spaces.mesh.comm, spaces.mesh.geometry.dim
    points = facet_quadrature(spaces.mesh, spaces.facets[part.rows], quadrature_degree(*part.data.values()))
    values = {key: datum.values(points).ravel() for key, datum in part.data.items()}
    with np.errstate(all="ignore"):  # of data that are refused below
        graph = part.law.graph(values)
    known = [*values.values(), *(each for corner in graph.corners for each in corner)]
    largest = max(float(np.abs(each).max(initial=0.0)) for each in known)
    rounding = ROUNDING * comm.allreduce(largest if np.isfinite(largest) else 0.0, MPI.MAX)
    for what, size in (*part.law.refused(values), *_not_monotone(graph)):
        size = np.broadcast_to(size, points.shape[0] * points.shape[1])
        worst: tuple[float, tuple[float, ...]] = (0.0, ())
        if size.max(initial=0.0) > rounding:
            worst = float(size.max()), tuple(points.x.reshape(-1, dim)[np.argmax(size)].tolist())
        excess, place = max(comm.allgather(worst))
        if place:
            at = ", ".join(f"{x:.4g}" for x in place)
            raise InputError(f"{part.name} ({part.law.name}): {what}, as at ({at}), by {excess:.3g}")
