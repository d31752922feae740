"""What a reader should know of an elastic problem and of its solution, in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from signorini_fenicsx.base.text import place_in_words
from signorini_fenicsx.discrete.continuity import NO_TRACE, TIGHTER, jump_in_words
from signorini_fenicsx.discrete.curved import curved_parts
from signorini_fenicsx.discrete.pair_overviews import overviews
from signorini_fenicsx.expressions.quadratics import barycentric_gradients
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.show.readings import largest_of
from signorini_fenicsx.physics.elasticity.show.tables import jumps

if TYPE_CHECKING:  # it has these
    from signorini_fenicsx.physics.elasticity.solution import ElasticSolution

SMALL = 0.1
"""The largest strain, and the largest rotation in radians, of which nothing is said: the error is of their size."""


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
    advice = [sentence for each in overviews(spaces.joints, spaces.mesh.comm) for sentence in each.advice()]
    return [*dict.fromkeys(notes), *advice]


def direction_of_gap(spaces: ElasticSpaces, data: ElasticData) -> list[str]:
    """Along what the gap is measured, if it varies and a part in contact is curved (collective)."""
    slaves = [part for joint in spaces.joints for part in joint.pair.slave]
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
    for joint in spaces.joints if solution.converged else ():
        touching = solution.touching[spaces.rows_of(joint)]
        sizes = np.linalg.norm(jumps(solution, joint), axis=2)[: len(touching)]
        shares = np.where(touching, sizes / (2 * joint.slave.balls[1][: len(touching), None]), 0.0)
        corners = joint.slave.corners[: len(touching)].reshape(-1, spaces.dim)
        largest = largest_of(spaces.mesh.comm, shares.ravel(), corners)
        if largest.get("largest", 0.0) > 1:
            notes.append(
                f"pair {joint.pair.words}: they slide on each other by {largest['largest']:.2g} facets of the slave at "
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
