"""Which parts of bodies that share no nodes are near one another and face each other, for a first case."""

import itertools
import re
from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, rows_of
from signorini_fenicsx.base.rows import joined
from signorini_fenicsx.discrete.overlay import WHOLE, Surface, overlay
from signorini_fenicsx.meshes.checks import FileMesh, faces
from signorini_fenicsx.meshes.seams import unit_normals

NEAR = 0.1
"""Of the diameter of the smaller body: what is farther away is not near."""
FARTHER = 0.01
"""Of it: by how much other parts of two bodies may be farther from each other than the nearest ones."""
SAME = 1e-9
"""Distances that differ by less than this share of the largest body are the same."""
FACING = 0.02
"""At least this share of the smaller part faces the other one."""


@dataclass(frozen=True)
class Facing:
    """Two parts that may be a pair.

    Attributes:
        slave: The part with the larger facets, if enough of them are wholly opposite to the other one.
        master: The other one.
        least: The least distance along the normals of the slave, negative where the bodies overlap.
        most: The largest one.
        share: The share of the slave that is opposite to the master.
    """

    slave: str
    master: str
    least: float
    most: float
    share: float


def facing(mesh: FileMesh) -> list[Facing]:
    """Parts of different bodies that are near one another, the nearest first; each facet is in one of them (rank 0).

    Args:
        mesh: That of the bodies, of one file or several.
    """
    of_node = joined(len(mesh.points), mesh.cells)
    if not of_node.any():
        return []
    bodies_of = {part: frozenset(of_node[facets].ravel().tolist()) for part, facets in mesh.parts.items()}
    surfaces = {part: _surface(mesh, facets) for part, facets in mesh.parts.items()}
    sizes = dict[frozenset[int], float]()
    for part, surface in surfaces.items():
        sizes[bodies_of[part]] = max(sizes.get(bodies_of[part], 0.0), _size(surface.corners))

    def coarseness(part: str) -> tuple[float, int]:
        return -float(f"{surfaces[part].balls[1].mean():.6g}"), len(mesh.parts[part])

    found = []
    for two in itertools.combinations(surfaces, 2):
        bodies = [bodies_of[part] for part in two]
        if not frozenset.intersection(*bodies):
            within = NEAR * min(sizes[body] for body in bodies)
            found += _opposite(surfaces, sorted(two, key=coarseness), within)
    nearest, first = [], dict[frozenset[frozenset[int]], float]()
    facets_of = {part: set(map(tuple, facets.tolist())) for part, facets in mesh.parts.items()}
    used, least = set[tuple[int, ...]](), SAME * max(sizes.values())

    def order(each: Facing) -> tuple[float, float, int]:
        return round(abs(each.least) / least), -round(each.share, 9), _numbered(each.slave) + _numbered(each.master)

    for each in sorted(found, key=order):
        bodies = [bodies_of[each.slave], bodies_of[each.master]]
        farther = abs(each.least) - first.setdefault(frozenset(bodies), abs(each.least))
        facets = facets_of[each.slave] | facets_of[each.master]  # which other parts may have too
        if not facets & used and farther <= FARTHER * min(sizes[body] for body in bodies):
            nearest.append(each)
            used |= facets
    return nearest


def _numbered(part: str) -> bool:
    """Whether a part has a name such as those that programs give, Line7."""
    return re.fullmatch(r"[A-Za-z]+\d+", part) is not None


def _opposite(surfaces: dict[str, Surface], two: list[str], within: float) -> list[Facing]:
    """Two parts, the coarser one first, with how they are opposite to each other; nothing if they are not.

    The coarser one is the slave, unless too few of its facets are wholly opposite to the other part.
    """
    found = list[tuple[float, Facing]]()
    for slave, master in (two, two[::-1]):
        facets = surfaces[slave]
        pieces = overlay(facets, surfaces[master], facets.normals, within)
        whole = np.abs(pieces.covered(len(facets.corners)) - 1) <= WHOLE
        area, gap = float(facets.measure[whole].sum()), pieces.gap[whole[pieces.slave]]
        if area > FACING * min(surfaces[part].measure.sum() for part in two):
            share = area / float(facets.measure.sum())
            found.append((area, Facing(slave, master, float(gap.min()), float(gap.max()), share)))
    return [each for area, each in found if 2 * area >= max(found, key=lambda one: one[0])[0]][:1]


def _size(corners: Array) -> float:
    """The diagonal of the box around points."""
    return float(np.linalg.norm(np.ptp(corners.reshape(-1, corners.shape[-1]), axis=0)))


def _surface(mesh: FileMesh, facets: Indices) -> Surface:
    """The facets of a part with their outer normals."""
    everything = faces(mesh.cells)
    rows, first = np.unique(everything, axis=0, return_index=True)
    apex, cell = np.divmod(first[rows_of(facets, rows)], len(mesh.cells))
    corners = mesh.points[facets]
    normals = unit_normals(corners[:, 1:] - corners[:, :1])
    inwards = np.einsum("ni,ni->n", mesh.points[mesh.cells[cell, apex]] - corners[:, 0], normals)
    return Surface(corners, normals * -np.sign(inwards)[:, None])
