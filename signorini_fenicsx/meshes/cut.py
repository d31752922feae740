"""A mesh cut along facets inside it, so that u may jump there: each becomes two facets of the boundary.

A vertex on the cut gets a copy for each group of cells around it that the cut separates from the others. So a vertex at
the edge of the cut, where the cells go around it, stays one vertex. All functions run on rank 0.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from signorini_fenicsx.base.arrays import AnyIndices, Array, Indices, Mask, rows_of
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.rows import joined
from signorini_fenicsx.base.text import place_in_words
from signorini_fenicsx.meshes.checks import FileMesh, faces, neighbours
from signorini_fenicsx.meshes.domain import other_side
from signorini_fenicsx.meshes.seams import unit_normals

PARALLEL = 1e-6
"""A direction is along a facet if the sine of the angle between them is below this."""


@dataclass(frozen=True)
class Opened:
    """A mesh that has been cut.

    Attributes:
        points: The points; copies come last.
        cells: The cells, in the order they had.
        sides: The two facets that each facet of the cut has become, as ascending vertices, shape (facets, 2, dim).
        pairs: Their cells, shape (facets, 2).
    """

    points: Array
    cells: Indices
    sides: Indices
    pairs: Indices


def cut(points: Array, cells: Indices, facets: Indices) -> Opened:
    """Cut a mesh along facets.

    Args:
        points: Shape (points, dim).
        cells: Shape (cells, dim + 1).
        facets: Facets between two cells as ascending vertices, shape (facets, dim). Those with all vertices at the edge
            of the cut stay closed, and are left out of the result.
    """
    number = len(cells)
    everything = faces(cells)
    one, other = neighbours(everything)
    is_cut = rows_of(everything[one], facets) >= 0
    pairs = np.stack([one[is_cut], other[is_cut]], axis=1)
    on_cut = np.zeros(len(points), dtype=bool)
    on_cut[facets] = True

    # the corners of cells at vertices on the cut, joined where two cells share a facet that is not cut
    cell, place = np.nonzero(on_cut[cells])
    row = np.full(cells.shape, -1)
    row[cell, place] = np.arange(len(cell))
    shut = np.stack([one[~is_cut], other[~is_cut]], axis=1)
    shut = shut[on_cut[everything[shut[:, 0]]].any(axis=1)]
    links = [np.empty((0, 2), dtype=np.int64)]
    for vertex in everything[shut[:, 0]].T:
        shared = on_cut[vertex]
        links.append(_corner(cells, row, shut[shared] % number, vertex[shared]))
    group = joined(len(cell), np.concatenate(links))

    # the first group of each vertex keeps the vertex, the others get copies
    of_group, first = np.unique(group, return_index=True)
    vertex = cells[cell, place][first]
    is_first = np.zeros(len(of_group), dtype=bool)
    is_first[np.unique(vertex, return_index=True)[1]] = True
    of_group[:] = vertex
    of_group[~is_first] = len(points) + np.arange(np.count_nonzero(~is_first))
    new_cells = cells.copy()
    new_cells[cell, place] = of_group[group]
    sides = faces(new_cells)[pairs]
    opened = np.any(sides[:, 0] != sides[:, 1], axis=1)
    return Opened(np.concatenate([points, points[vertex[~is_first]]]), new_cells, sides[opened], pairs[opened] % number)


def _corner(cells: Indices, row: Indices, of: Indices, vertex: Indices) -> Indices:
    """Rows of the corners of some cells, shape (n, 2), at these vertices."""
    place = np.argmax(cells[of] == vertex[:, None, None], axis=2)
    return row[of, place]


type Side = str | Sequence[float]
"""How a user names a side of an inner part: by a region of cells, or by a direction that points to it."""
ANY: Side = ()
"""Of a part of which it does not matter which side is the named one; nothing that a user can write."""


def opened(mesh: FileMesh, inner: Sequence[str], sides: Mapping[str, Side]) -> FileMesh:
    """A mesh that is cut along some of its parts.

    Args:
        mesh: The mesh.
        inner: These parts. Each part `name` becomes its facets on the named side, and a part `other_side(name)`.
        sides: For some of them the named side; for the others it is where the last coordinate is larger.

    Raises:
        InputError: If a part or region is unknown; if a facet is not inside the domain, or no facet opens; or if it is
            not clear which side of a facet is the named one.
    """
    for name in inner:
        if name not in mesh.parts:
            raise InputError(f"[boundary] inner: unknown part '{name}'; the mesh has {', '.join(mesh.parts) or 'none'}")
    everything = faces(mesh.cells)
    rows, times = np.unique(everything, axis=0, return_counts=True)
    for name in inner:
        outside = np.count_nonzero(times[rows_of(mesh.parts[name], rows)] != 2)
        if outside:
            raise InputError(f"[boundary] inner: part '{name}' has {outside} facets that are not between two cells")
    done = cut(mesh.points, mesh.cells, np.unique(np.concatenate([mesh.parts[name] for name in inner]), axis=0))
    before, after = everything, faces(done.cells)
    parts = {}
    for name, facets in mesh.parts.items():
        row = rows_of(facets, before)
        parts[name] = np.where((row >= 0)[:, None], after[row], facets)
    pairs = [np.empty((0, 2), dtype=np.int64)]
    original = rows_of(done.sides[:, 0], after)
    for name in inner:
        of_part = rows_of(before[original], mesh.parts[name]) >= 0
        if not of_part.any():
            raise InputError(f"[boundary] inner: part '{name}' opens nowhere, all its vertices are at its edge")
        two, cells = done.sides[of_part], done.pairs[of_part]
        second = _is_second(
            mesh, name, sides.get(name, (0.0,) * (mesh.dim - 1) + (1.0,)), before[original[of_part]], cells
        )
        named = second.astype(np.int64)
        each = np.arange(len(two))
        parts[name], parts[other_side(name)] = two[each, named], two[each, 1 - named]
        pairs.append(cells)
    return replace(mesh, points=done.points, cells=done.cells, parts=parts, together=np.concatenate(pairs))


def along_last_axis(mesh: FileMesh, name: str) -> bool:
    """Whether facets of a part are along the last coordinate axis, so that this is no direction to a side of it."""
    corners = mesh.points[mesh.parts[name]]
    return bool((np.abs(unit_normals(corners[:, 1:] - corners[:, :1])[:, -1]) < PARALLEL).any())


def _is_second(mesh: FileMesh, name: str, side: Side, facets: Indices, cells: Indices) -> Mask:
    """Whether the second of the two cells of each facet is on the named side.

    Raises:
        InputError: If that is not clear.
    """
    key, corners = f"[boundary] sides.{name}", mesh.points[facets]
    middle = mesh.points[mesh.cells[cells[:, 1]]].mean(axis=1)
    second, unclear, why = on_side(key, side, mesh.regions, cells, corners, middle)
    if unclear.any():
        where = place_in_words(corners[unclear][0].mean(axis=0), 6)
        raise InputError(
            f"{key}: {np.count_nonzero(unclear)} facets are {why}, the first around {where}; name the side by a "
            "region of cells, or by a direction that points to it from all its facets"
        )
    return second


def on_side(
    key: str, side: Side, regions: Mapping[str, AnyIndices], cells: AnyIndices, corners: Array, middle: Array
) -> tuple[Mask, Mask, str]:
    """Whether the second of the two cells of each facet is on a side.

    Args:
        key: What messages call the side.
        side: The side.
        regions: The cells of each region.
        cells: The cells of each facet, shape (facets, 2).
        corners: Of the facets, shape (facets, dim, dim).
        middle: Of the second cells, shape (facets, dim).

    Returns:
        Masks of the facets where it is, and of those where that is not clear; and why, in words.

    Raises:
        InputError: If the side is neither a region nor a direction.
    """
    if isinstance(side, str):
        if side not in regions:
            raise InputError(f"{key}: unknown region '{side}'; the mesh has {', '.join(regions) or 'none'}")
        first, second = np.isin(cells, regions[side]).T
        return second, first == second, f"not between '{side}' and another region"
    dim = corners.shape[2]
    direction = np.sqrt(np.arange(2.0, dim + 2)) if side is ANY else np.asarray(side, dtype=np.float64)
    if direction.shape != (dim,) or not np.isfinite(direction).all() or not direction.any():
        raise InputError(f"{key}: must be a region, or a direction of {dim} numbers, not {side}")
    across = unit_normals(corners[:, 1:] - corners[:, :1])
    along = across @ (direction / np.linalg.norm(direction))
    second = along * np.einsum("fi,fi->f", middle - corners[:, 0], across) > 0
    unclear = (np.abs(along) < PARALLEL) & (side is not ANY)
    return second, unclear, f"parallel to the direction {tuple(direction.tolist())}"
