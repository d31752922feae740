"""What a reader should know of an elastic problem and of its solution, in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from signorini_fenicsx.base.text import place_in_words
from signorini_fenicsx.discrete.continuity import NO_TRACE, TIGHTER, jump_in_words
from signorini_fenicsx.discrete.curved import curved_parts
from signorini_fenicsx.discrete.pair_overviews import Overview, overviews
from signorini_fenicsx.discrete.pairing import COARSER, MeshPair
from signorini_fenicsx.expressions.simplices import barycentric_gradients
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.show.readings import largest_of
from signorini_fenicsx.physics.elasticity.show.tables import jumps

if TYPE_CHECKING:  # it has these
    from signorini_fenicsx.physics.elasticity.solution import ElasticSolution

SMALL = 0.1
"""The largest strain, and the largest rotation in radians, of which nothing is said: the error is of their size."""
STIFFER = 1.5
"""A slave that is stiffer than its master by this factor should be coarser by `COARSER`."""


def notes_of(spaces: ElasticSpaces, data: ElasticData) -> list[str]:
    """Where displacements that are given jump, or the gap; what would be better for pairs (collective)."""
    given = [("gap", data.gap, spaces.contact.facets, TIGHTER)]
    for facets, _, _, of in spaces.fixed:
        given += [("u_D", data.u_D.components[r], facets.facets, NO_TRACE) for r in of]
    notes = [
        note
        for name, datum, facets, so in given
        for mask, part in datum.by_facets(facets)
        for note in jump_in_words(spaces, name, part, facets[mask], so)
    ]
    pairs = zip(spaces.pairs, overviews(spaces.pairs, spaces.mesh.comm), strict=True)
    advice = [
        sentence for pair, about in pairs for sentence in about.advice() or _stiff_slave(spaces, data, pair, about)
    ]
    return [*dict.fromkeys(notes), *advice]


def _stiff_slave(spaces: ElasticSpaces, data: ElasticData, pair: MeshPair, about: Overview) -> list[str]:
    """The note that a slave is stiffer than its master and not coarser, if it is so (collective).

    u of the master is linear on its facets, and what the true u bends more is passed on to the slave as a gap.
    """
    sums = np.zeros((2, 2))
    for row, facets in zip(sums, (pair.slaves, pair.masters), strict=True):
        cells = spaces.boundary_facets(facets).cells
        row[:] = data.material.young[0].values(data.points(spaces, cells)).mean(axis=1).sum(), len(cells)
    (of_slave, slaves), (of_master, masters) = spaces.mesh.comm.allreduce(sums)
    (slave, master), stiffer = about.sizes, of_slave / slaves > STIFFER * of_master / masters
    if pair.parts.tied or not stiffer or slave > COARSER * master:
        return []
    return [
        f"pair {about.words}: the slave is stiffer than the master, and its facets are not coarser, {slave:.3g} and "
        f"{master:.3g}; swap slave and master, or give the master facets that are finer by {COARSER:g}: else the "
        "pressure goes up and down within facets, though its means over them are right"
    ]


def direction_of_gap(spaces: ElasticSpaces, data: ElasticData) -> list[str]:
    """Along what the gap is measured, if it varies and a part in contact is curved (collective)."""
    slaves = [part for pair in spaces.pairs for part in pair.parts.slave]
    curved = [name for name in curved_parts(spaces) if name in spaces.part_names and name not in slaves]
    if not curved or all(part.number is not None for _, part in data.gap.by_facets(spaces.contact.facets)):
        return []
    return [
        f"the gap on {', '.join(curved)} is the distance along the outer normal of each facet, which turns on the "
        "part; to a plane at the distance d along a direction m it is d/(n·m)"
    ]


def far_slides(solution: ElasticSolution) -> list[str]:
    """Pairs whose surfaces slide in contact by more than a facet (collective)."""
    spaces, notes = solution.spaces, list[str]()
    for pair in spaces.pairs if solution.converged else ():
        touching = solution.touching[spaces.rows_of(pair)]
        sizes = np.linalg.norm(jumps(solution, pair), axis=2)[: len(touching)]
        shares = np.where(touching, sizes / (2 * pair.slave.balls[1][: len(touching), None]), 0.0)
        corners = pair.slave.corners[: len(touching)].reshape(-1, spaces.dim)
        largest = largest_of(spaces.mesh.comm, shares.ravel(), corners)
        if largest.get("largest", 0.0) > 1:
            notes.append(
                f"pair {pair.parts.words}: they slide on each other by {largest['largest']:.2g} facets of the slave at "
                f"{place_in_words(largest['at'])}, and the law holds between points that were opposite before"
            )
    return notes


def large_deformation(solution: ElasticSolution) -> list[str]:
    """The largest strain and rotation, if one of them is not small (collective).

    Both are of u_h, which is linear on each cell: its strain has these largest eigenvalues in size, and the largest
    entry of the other part of the gradient, in space the length of its axis, is the rotation.
    """
    if not solution.converged:
        return []
    spaces = solution.spaces
    slopes = barycentric_gradients(spaces.vertices)
    gradient = np.einsum("nvi,nvj->nij", spaces.displacement_values(solution.u), slopes)
    turned = gradient.swapaxes(1, 2)
    strains = np.abs(np.linalg.eigvalsh((gradient + turned) / 2)).max(axis=1, initial=0.0)
    rotations = np.sqrt((((gradient - turned) / 2) ** 2).sum(axis=(1, 2)) / 2)
    largest = [largest_of(spaces.mesh.comm, each, spaces.vertices.mean(axis=1)) for each in (strains, rotations)]
    (strain, at_strain), (rotation, at_rotation) = ((each["largest"], place_in_words(each["at"])) for each in largest)
    if max(strain, rotation) <= SMALL:
        return []
    return [
        f"strains are up to {100 * strain:.2g} % at {at_strain}, rotations up to {np.degrees(rotation):.2g}° at "
        f"{at_rotation}: the equations are those of small ones, and no bound knows what that neglects"
    ]
