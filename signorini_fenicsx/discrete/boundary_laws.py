"""The laws of a problem on a mesh: a chain per facet of Γ_S, from the means of their data over it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import dolfinx.mesh
import numpy as np
from mpi4py import MPI
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.chains import Chains, joined
from signorini_fenicsx.discrete.laws import Graph, Law, Signorini
from signorini_fenicsx.discrete.spaces import Spaces

ROUNDING = 1e-12
"""Relative size of what is rounding in the order of bounds."""

type MeansOf = Callable[[str, Expr, Indices, Expr | None], Array]
"""Means of a datum over some rows of `Spaces.facets`, weighted by another one if there is one (collective)."""


@dataclass(frozen=True)
class PartLaw:
    """A law and where it holds.

    Attributes:
        law: The law.
        name: What messages call it: "law.0" for the first one that is listed.
        rows: Its facets of this rank, rows of `Spaces.facets`.
        data: Its data by their names.
    """

    law: Law
    name: str
    rows: Indices
    data: Mapping[str, Expr]


@dataclass(frozen=True)
class BoundaryLaws:
    """What holds on Γ_S.

    Attributes:
        of_parts: The laws; that of the parts that `Boundary.signorini` lists comes first, if there are some.
        chains: Their graphs per facet, measured from the references.
    """

    of_parts: tuple[PartLaw, ...]
    chains: Chains

    @property
    def listed(self) -> bool:
        """Whether there are laws beside that of the parts that `Boundary.signorini` lists."""
        return any(part.name for part in self.of_parts)

    def names(self) -> list[str]:
        """Names of all segments, those of the laws one after another; see `labels`."""
        return [segment for part in self.of_parts for segment in part.law.segments]

    def labels(self, segment: np.ndarray) -> np.ndarray:
        """For each facet the row of its segment in `names`."""
        labels = np.array(segment, dtype=np.int64)
        first = 0
        for part in self.of_parts:
            labels[part.rows] += first
            first += len(part.law.segments)
        return labels


def signorini_alone(spaces: Spaces, data: Mapping[str, Expr]) -> BoundaryLaws:
    """The law of Signorini on all of Γ_S."""
    rows = np.arange(len(spaces.facets))
    return BoundaryLaws((PartLaw(Signorini(spaces.part_names), "", rows, data),), Chains.at_corner(len(rows)))


def several_laws(
    spaces: Spaces, laws: Sequence[tuple[str, Law, Mapping[str, Expr]]], means_of: MeansOf
) -> tuple[BoundaryLaws, Array, Array]:
    """Several laws, each on its parts (collective).

    Args:
        spaces: The discrete spaces.
        laws: For each law its name, itself and its data.
        means_of: Takes means.

    Returns:
        They, and u and κ∇u·n at the reference of each facet.

    Raises:
        InputError: If data are not what their law allows; the message says where.
    """
    number = len(spaces.facets)
    psi_h, q_Sh = np.empty(number), np.empty(number)
    of_parts, chains = [], []
    for name, law, data in laws:
        parts = [spaces.part_names.index(part) for part in law.parts]
        rows = np.flatnonzero(np.isin(spaces.part_of_facet, parts))
        weights = {key: data[weight] for key, weight in law.weights.items()}
        means = {key: means_of(f"{name}.{key}", value, rows, weights.get(key)) for key, value in data.items()}
        for what, size in law.refused(means):
            _refuse(f"{name} ({law.name}): {what}", size, means, spaces, rows)
        graph = law.graph(means)
        psi_h[rows], q_Sh[rows] = graph.reference
        chains.append((rows, _chains(graph, len(rows))))
        of_parts.append(PartLaw(law, name, rows, data))
    return BoundaryLaws(tuple(of_parts), joined(chains, number)), psi_h, q_Sh


def _chains(graph: Graph, number: int) -> Chains:
    """Chains measured from the references."""
    p, flux = (
        np.stack([np.broadcast_to(corner[axis] - graph.reference[axis], number) for corner in graph.corners], axis=1)
        for axis in (0, 1)
    )
    p, flux = np.maximum.accumulate(p, axis=1), np.minimum.accumulate(flux, axis=1)  # but for rounding they are so
    before, beyond = (np.broadcast_to(slope, number) for slope in (graph.before, graph.beyond))
    chains = Chains.through(p, flux, before, beyond)
    return replace(chains, plain=len(graph.corners) == 1 and graph.corners[0] is graph.reference)


def _refuse(what: str, size: Array, means: Mapping[str, Array], spaces: Spaces, rows: Indices) -> None:
    """Refuse data where a size is > 0, but for rounding (collective).

    Raises:
        InputError: On all ranks, with the place of the largest.
    """
    scale = max([0.0, *(float(np.abs(values).max(initial=0.0)) for values in means.values())])
    comm = spaces.mesh.comm
    wrong = np.flatnonzero(size > ROUNDING * comm.allreduce(scale, MPI.MAX))
    dim = spaces.mesh.topology.dim
    worst = (-np.inf, ())
    if len(wrong) > 0:
        row = wrong[np.argmax(size[wrong])]
        x = dolfinx.mesh.compute_midpoints(spaces.mesh, dim - 1, spaces.facets[rows[[row]]])[0, :dim]
        worst = float(size[row]), tuple(x.tolist())
    size_there, place = max(comm.allgather(worst))
    if place:
        at = ", ".join(f"{x:.4g}" for x in place)
        raise InputError(f"[[law]] {what}, as on the facet at ({at}), by {size_there:.3g}")
