"""The laws of a problem on a mesh: a chain per facet of Γ_S, from the means of their data over it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.chains import Chains, joined
from signorini_fenicsx.contact.laws import Graph, Law, Signorini
from signorini_fenicsx.discrete.data_values import check_nodes, facet_means
from signorini_fenicsx.discrete.datum import Datum, datum_of, quadrature_degree
from signorini_fenicsx.discrete.part_laws import PartLaw, chains_of, data_of_law, parts_of_laws, place_of, refuse_data
from signorini_fenicsx.discrete.points import facet_quadrature
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.spaces import Spaces


@dataclass(frozen=True)
class BoundaryLaws:
    """The laws on Γ_S.

    Attributes:
        of_parts: Each law with its parts; first ψ and q_S of the problem on the parts that `Boundary.signorini` lists.
        chains: Their graphs per facet, measured from the references.
    """

    of_parts: tuple[PartLaw, ...]
    chains: Chains

    @property
    def listed(self) -> bool:
        """Whether there are laws besides ψ and q_S of the problem."""
        return any(part.name for part in self.of_parts)

    def names(self) -> list[str]:
        """Names of all segments, law after law; see `labels`."""
        return [segment for part in self.of_parts for segment in part.law.segments]

    def labels(self, segment: np.ndarray) -> np.ndarray:
        """For each facet the row of its segment in `names`."""
        labels = np.array(segment, dtype=np.int64)
        first = 0
        for part in self.of_parts:
            labels[part.rows] += first
            first += len(part.law.segments)
        return labels


def boundary_laws(spaces: Spaces, problem: Problem, psi: Datum, q_S: Datum) -> tuple[BoundaryLaws, Array, Array]:
    """The laws of all parts of Γ_S (collective).

    Returns:
        They, and u and κ∇u·n at the reference of each facet: the means of ψ and q_S where these hold.

    Raises:
        InputError: If data are not what their law allows; the message says where.
    """
    listed = parts_of_laws(spaces, problem.laws)
    plain = [part for part in spaces.part_names if part not in listed]
    laws: list[tuple[str, Law, Mapping[str, Datum]]] = []
    if plain or not problem.laws:
        laws.append(("", Signorini(plain), {"psi": psi, "q_S": q_S}))
    for i, law in enumerate(problem.laws):
        laws.append((f"law.{i}", law, data_of_law(spaces, law, f"law.{i}")))
    number = len(spaces.facets)
    psi_h, q_Sh = np.empty(number), np.empty(number)
    of_parts, chains = [], []
    for name, law, data in laws:
        rows = np.flatnonzero(np.isin(spaces.part_of_facet, [spaces.part_names.index(part) for part in law.parts]))
        part = PartLaw(law, name, rows, data)
        means = _means(spaces, part)
        refuse_data(spaces, part)
        graph = law.graph(means)
        part = replace(part, bounds=_bounds(spaces, part, graph, means))
        psi_h[rows], q_Sh[rows] = graph.reference
        chains.append((rows, chains_of(graph, len(rows))))
        of_parts.append(part)
    return BoundaryLaws(tuple(of_parts), joined(chains, number)), psi_h, q_Sh


def _means(spaces: Spaces, part: PartLaw) -> dict[str, Array]:
    """Means of the data over the facets, some of them weighted (collective).

    Raises:
        InputError: If a datum is not finite.
    """
    facets, where = spaces.facets[part.rows], place_of(part)
    means = {key: facet_means(spaces, part.key(key), datum, facets, where) for key, datum in part.data.items()}
    for key, by in part.law.weights.items():
        datum, weight = part.data[key], part.data[by]
        if weight.number is None:
            points = facet_quadrature(spaces.mesh, facets, quadrature_degree(datum, weight, power=2))
            moments = points.means(datum.values(points) * weight.values(points))
            means[key] = np.divide(moments, points.means(weight.values(points)), out=means[key], where=means[by] > 0)
    return means


def _bounds(
    spaces: Spaces, part: PartLaw, graph: Graph, means: Mapping[str, Array]
) -> tuple[Datum | None, Datum | None]:
    """The data that bound u at the vertical ends of a graph in the means of the data, lower and upper (collective).

    A bound must be continuous. It is known by being the very array that the graph was given, so no law has to name it.

    Raises:
        InputError: If a bound is neither a datum nor a number, or is not finite somewhere.
    """
    found: list[Datum | None] = []
    for which, slope, (u, _) in (("first", graph.before, graph.corners[0]), ("last", graph.beyond, graph.corners[-1])):
        if not spaces.mesh.comm.allreduce(bool(np.isinf(slope).any()), MPI.LOR):
            found.append(None)
        elif np.ndim(u) == 0:
            found.append(datum_of(spaces, f"{part.name} ({part.law.name})", float(u)))
        else:
            key = next((key for key, values in means.items() if values is u), None)
            if key is None:
                raise InputError(
                    f"{part.name} ({part.law.name}): its graph is vertical at the {which} end, so u of the {which} "
                    "corner must be one of its data as it was given, or a number, not computed from them"
                )
            check_nodes(spaces, part.key(key), part.data[key], spaces.facets[part.rows], place_of(part))
            found.append(part.data[key])
    return found[0], found[1]
