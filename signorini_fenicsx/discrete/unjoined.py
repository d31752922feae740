"""The check that no bodies, or sides of a crack, lie on one another in a mesh although they share no facets.

Each of two such parts has a condition of its own: nothing passes from one to the other, which nobody means who lets
bodies touch. Only the two sides of a part inside the domain, along which the mesh is cut, belong to each other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import cell_nodes, cells_of_facets
from signorini_fenicsx.base.text import counted, place_in_words
from signorini_fenicsx.discrete.cell_shapes import corners, facet_corners
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.meshes.domain import other_side
from signorini_fenicsx.meshes.seams import balls, overlaps, seams, unit_normals

SHARE = (
    "let both sides share their facets (in Gmsh, BooleanFragments or Coherence), and where they may part, name these "
    "as one part in inner, with a law"
)
"""What is to be done."""
PAIR = "or pair them where their meshes have nothing in common: a Pair, in a case file [[pair]]"
"""The other thing that may be done."""
FACING = -0.5
"""Facets face each other if the product of their outer unit normals is below this."""
SAME = 1e-6
"""Depths that differ by less than this share are taken for equal, on any number of ranks."""


@dataclass(frozen=True)
class Faces:
    """All facets of the boundary, on all ranks.

    Attributes:
        corners: Their vertices, relative to the origin, shape (facets, d, d).
        apexes: The vertices opposite to them, shape (facets, d).
        bodies: The number of the body of each.
        parts: The row of its part in a list of names.
        rows: Those of this rank.
        origin: A corner of the domain.
    """

    corners: Array
    apexes: Array
    bodies: Indices
    parts: Indices
    rows: Indices
    origin: Array

    @classmethod
    def of(cls, spaces: MeshSpaces, names: Sequence[str]) -> Self:
        """Gather them (collective).

        Args:
            spaces: The spaces.
            names: "" for no part, and the parts; a facet in several of them counts to the last one.
        """
        mesh, comm, dim = spaces.mesh, spaces.mesh.comm, spaces.mesh.topology.dim
        facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
        cells, local = cells_of_facets(mesh, facets)
        apexes = mesh.geometry.x[cell_nodes(mesh)[cells, local], :dim]
        part = np.zeros(len(facets), dtype=np.int64)
        for number, name in enumerate(names[1:], start=1):
            part[np.isin(facets, spaces.domain.facets[name])] = number
        low = spaces.domain.box()[0, :dim]
        arrays = facet_corners(mesh, facets) - low, apexes - low, spaces.bodies[cells], part
        rows = comm.scan(len(facets)) - len(facets) + np.arange(len(facets))
        vertices, opposite, bodies, parts = (np.concatenate(comm.allgather(each)) for each in arrays)
        return cls(vertices, opposite, bodies, parts, rows, low)

    def told(self, pairs: Indices) -> str:
        """How many facets are in some pairs, and where the first one is, in words."""
        facets = np.unique(pairs)
        first = _first(self.corners[facets].mean(axis=1))
        return f"{counted(len(facets), 'facet')}, the first around {place_in_words(first + self.origin)}"


def check_joined(
    spaces: MeshSpaces, named: Mapping[str, Sequence[str]], pairs: Sequence[tuple[Sequence[str], Sequence[str]]] = ()
) -> None:
    """Refuse bodies that overlap, and facets of the boundary that lie on one another (collective).

    Faces on one another that are both in Γ_N, as those of an open crack, are noted in `spaces.notices`. Named shapes
    have no such places.

    Args:
        spaces: The spaces.
        named: The parts of each kind of boundary.
        pairs: Names of parts that are paired, on both sides; these may lie on one another, and overlap.

    Raises:
        InputError: If there are such bodies, or such facets but for the two sides of an inner part.
    """
    if spaces.domain.is_shape:
        return
    inside = named.get("inner", ())
    others = dict(zip(inside, map(other_side, inside), strict=True))
    listed = {part for parts in named.values() for part in parts} | set(others.values())
    names = ["", *sorted(spaces.domain.parts, key=lambda part: part in listed)]
    faces = Faces.of(spaces, names)
    may_overlap = _paired(faces, names, pairs)
    _check_apart(spaces, faces, may_overlap)
    rows, same = seams(faces.corners, faces.apexes, faces.rows)
    is_cut = np.zeros((len(names), len(names)), dtype=bool)
    for part, other in others.items():
        two = [names.index(part), names.index(other)]
        is_cut[two, two[::-1]] = True
    for slave, master in pairs:
        paired = np.ix_([names.index(part) for part in slave], [names.index(part) for part in master])
        is_cut[paired] = True
        is_cut |= is_cut.T
    lying = ~is_cut[tuple(faces.parts[rows].T)] & ~(same & may_overlap[tuple(faces.bodies[rows].T)])
    rows, same = (np.concatenate(spaces.mesh.comm.allgather(each[lying])) for each in (rows, same))
    if same.any():
        raise InputError(
            f"cells overlap: {faces.told(rows[same])}, lie on one another with their cells on the same side; each "
            "point must be in one cell only"
        )
    both = np.sort(faces.parts[rows], axis=1)
    for one, other in np.unique(both, axis=0).tolist():
        parts, where = sorted((names[one], names[other])), faces.told(rows[(both == [one, other]).all(axis=1)])
        words = f"{_lie(*parts)} ({where}) and share no facet: nothing passes from one to the other"
        if not set(parts) <= set(named.get("neumann", ())):
            raise InputError(f"{words}; {SHARE}; {PAIR}")
        spaces.note(f"{words}, as at an open crack; if it should, {SHARE}")


def _lie(one: str, other: str) -> str:
    """The words that two parts lie on one another; "" are facets in no part."""
    if one == other:
        return f"facets of part '{one}' lie on one another" if one else "facets in no part lie on one another"
    return f"{f"part '{one}'" if one else 'facets in no part'} and part '{other}' lie on one another"


def _paired(faces: Faces, names: Sequence[str], pairs: Sequence[tuple[Sequence[str], Sequence[str]]]) -> Mask:
    """Whether facets of two bodies are paired, shape (bodies, bodies)."""
    paired = np.zeros((faces.bodies.max(initial=-1) + 1,) * 2, dtype=bool)
    for sides in pairs:
        slave, master = (faces.bodies[np.isin(faces.parts, [names.index(part) for part in side])] for side in sides)
        paired[np.ix_(np.unique(slave), np.unique(master))] = True
    return paired | paired.T


def _check_apart(spaces: MeshSpaces, faces: Faces, paired: Mask) -> None:
    """Refuse bodies that overlap one another, or themselves at their boundaries (collective).

    Where a body is twice in a place, the boundary of one part of it crosses that of another, or is within it. Bodies
    that are paired may overlap.

    Raises:
        InputError: If one does.
    """
    comm, x = spaces.mesh.comm, corners(spaces.mesh) - faces.origin
    low, high, near = x.min(axis=1), x.max(axis=1), np.zeros(len(x), dtype=bool)
    near[cells_of_facets(spaces.mesh, dolfinx.mesh.exterior_facet_indices(spaces.mesh.topology))[0]] = True
    for body in np.unique(faces.bodies):
        ends = faces.corners[faces.bodies == body]
        meets = (low <= ends.max(axis=(0, 1))) & (high >= ends.min(axis=(0, 1)))
        near |= meets.all(axis=1) & (spaces.bodies != body)
    cells = np.concatenate([faces.corners, faces.apexes[:, None]], axis=1)
    found = []
    for body in np.unique(faces.bodies):
        rows, others = near & (spaces.bodies == body), ~paired[body, faces.bodies]
        found.append(overlaps(x[rows], spaces.bodies[rows], cells[others], faces.bodies[others]))
    several = (np.concatenate(each) for each in zip(*found, strict=True))
    depths, places, of_one = (np.concatenate(comm.allgather(each)) for each in several)
    if len(depths) > 0:
        place = place_in_words(_first(places[depths >= (1 - SAME) * depths.max()]) + faces.origin)
        what, they = ("a body overlaps itself", "its sides") if of_one.all() else ("two bodies overlap", "them")
        raise InputError(
            f"{what}, by {depths.max():.3g} around {place}; each point must be in one cell only. Make {they} only "
            f"touch; then {SHARE}; {PAIR}"
        )


def note_facing(spaces: MeshSpaces, contact: Array, normals: Array, gap: Array) -> None:
    """Note that foundations are where other bodies are, in `spaces.notices` (collective).

    They are where the nearest facet of another body faces one with a foundation, and is not farther away than twice the
    gap and the radii of both: each of two bodies may have half the distance as its gap.

    Args:
        spaces: The spaces.
        contact: Vertices of this rank's facets with a foundation, rows `spaces.outer_rows`, shape (facets, d, d).
        normals: Their outer unit normals.
        gap: The gap on each of them.
    """
    comm, of_body = spaces.mesh.comm, spaces.bodies[spaces.cells[spaces.outer_rows]]
    if not comm.allreduce(bool(len(gap) > 0), MPI.LOR) or not comm.allreduce(bool(spaces.bodies.any()), MPI.LOR):
        return
    from scipy.spatial import cKDTree  # slow to import

    faces, found = Faces.of(spaces, [""]), [np.empty((0, contact.shape[2]))]
    away = unit_normals(faces.corners[:, 1:] - faces.corners[:, :1])
    away *= np.sign(np.einsum("fi,fi->f", faces.corners[:, 0] - faces.apexes, away))[:, None]
    middle, reach = balls(contact - faces.origin)
    middles, radii = balls(faces.corners)
    reach += 2 * np.where(np.isfinite(gap), np.abs(gap), 0.0)
    for body in np.unique(of_body):
        rows, others = np.flatnonzero(of_body == body), np.flatnonzero(faces.bodies != body)
        distance, nearest = cKDTree(middles[others]).query(middle[rows])
        other = others[nearest]
        faced = np.einsum("ni,ni->n", normals[rows], away[other]) < FACING
        before = np.einsum("ni,ni->n", normals[rows], middles[other] - middle[rows]) > 0
        found.append(middle[rows[faced & before & (distance <= reach[rows] + radii[other])]])
    places = np.concatenate(comm.allgather(np.concatenate(found)))
    if len(places) > 0:
        spaces.note(
            f"around {place_in_words(_first(places) + faces.origin)} a body has its rigid foundation where another "
            "body is, and does not press on that one; if it should, mesh them without a gap, "
            f"{SHARE} that has the gap"
        )


def _first(places: Array) -> Array:
    """The first of some places by their coordinates, the same for any number of ranks."""
    return np.asarray(places[np.lexsort(places.T[::-1])[0]])
