"""Where a mesh lies on itself without being joined: facets of the boundary on one another, cells that overlap.

Such facets should be inside the domain, and belong to only one cell. Lengths are compared only with those of the
cells. So the result does not depend on the unit of length, and flat cells do not count as cracks. Two simplices overlap
if along none of certain directions one is behind the other: the normals of their facets and, in space, what is normal
to an edge of each. Only simplices whose balls meet are tried.
"""

import itertools
from collections.abc import Iterator

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask

NEAR = 1e-5
"""Facets lie on one another if they are nearer than this share of the heights of their cells, and cells overlap that
are deeper in one another than this share of their widths; single precision is exact enough for it."""
PARALLEL = 1e-6
"""Edges whose unit vectors have a shorter product than this have no common normal."""
PAIRS = 10**5
"""Number of pairs that are tested at once."""
FEW = 2**20
"""Number of pairs whose distances take less time than to import SciPy's tree."""


def seams(corners: Array, apexes: Array, rows: Indices) -> tuple[Indices, Mask]:
    """Find facets of the boundary that lie on other facets of the boundary.

    Args:
        corners: Vertices of the facets of the boundary, shape (facets, dim, dim).
        apexes: Vertex opposite to each facet in its cell, shape (facets, dim).
        rows: Those whose pairs are sought; each pair is found at the larger of its facets.

    Returns:
        The pairs, shape (pairs, 2), and a mask of those whose cells are on the same side, where these overlap; the
        cells of the others are on different sides, as at a crack.
    """
    edges = corners[:, 1:] - corners[:, :1]
    normals = unit_normals(edges)
    heights = np.einsum("fi,fi->f", apexes - corners[:, 0], normals)
    radius = balls(corners)[1]
    pairs, same = [np.empty((0, 2), dtype=np.int64)], [np.empty(0, dtype=bool)]
    for row, other in meeting(corners[rows], corners):
        one = rows[row]
        smaller = (radius[other] < radius[one]) | ((radius[other] == radius[one]) & (other < one))
        one, other = one[smaller], other[smaller]
        above = np.einsum("pvi,pi->pv", corners[other] - corners[one, :1], normals[one])
        near = NEAR * np.minimum(np.abs(heights[one]), np.abs(heights[other]))
        flat = np.abs(above).max(axis=1, initial=0.0) <= near
        one, other = one[flat], other[flat]
        axes = edges[one]  # in the plane of the facets normal to their edges
        if corners.shape[2] == 3:
            axes = np.cross(np.concatenate([_edges(corners[one]), _edges(corners[other])], axis=1), normals[one, None])
        on = _depths(corners[one], corners[other], axes) > 0
        one, other = one[on], other[on]
        pairs.append(np.stack([one, other], axis=1))
        same.append(np.einsum("pi,pi->p", apexes[other] - corners[one, 0], normals[one]) * heights[one] > 0)
    return np.concatenate(pairs), np.concatenate(same)


def overlaps(cells: Array, bodies: Indices, others: Array, of_others: Indices) -> tuple[Array, Array, Mask]:
    """Find cells that overlap cells of other bodies, or cells of their body with which they have no vertex in common.

    Args:
        cells: Vertices of some cells, shape (cells, dim + 1, dim).
        bodies: The number of the body of each of them.
        others: Vertices of the cells that they may overlap, likewise.
        of_others: Their bodies.

    Returns:
        How deep each two are in one another, shape (pairs,), the middle of the place, shape (pairs, dim), and a mask of
        those that are of one body.
    """
    depths, places, of_one = [np.empty(0)], [np.empty((0, cells.shape[2]))], [np.empty(0, dtype=bool)]
    (low, high), (other_low, other_high) = ((each.min(axis=1), each.max(axis=1)) for each in (cells, others))
    for one, other in meeting(cells, others):
        boxes = ((low[one] < other_high[other]) & (other_low[other] < high[one])).all(axis=1)
        first, second, same = cells[one[boxes]], others[other[boxes]], (bodies[one] == of_others[other])[boxes]
        joined = np.zeros(len(same), dtype=bool)
        joined[same] = (first[same][:, :, None] == second[same][:, None]).all(axis=3).any(axis=(1, 2))
        first, second, same = first[~joined], second[~joined], same[~joined]
        depth = np.full(len(same), np.inf)
        for axes_of in (_across_facets, _across_edges)[: cells.shape[2] - 1]:
            depth = np.minimum(depth, _depths(first, second, axes_of(first, second)))
            first, second, same, depth = (each[depth > 0] for each in (first, second, same, depth))
        depths.append(depth)
        of_one.append(same)
        ends = np.maximum(first.min(axis=1), second.min(axis=1)), np.minimum(first.max(axis=1), second.max(axis=1))
        places.append((ends[0] + ends[1]) / 2)
    return np.concatenate(depths), np.concatenate(places), np.concatenate(of_one)


def unit_normals(edges: Array) -> Array:
    """Unit normals of facets with these edges from their first corner."""
    if edges.shape[2] == 2:
        normals = np.stack([edges[:, 0, 1], -edges[:, 0, 0]], axis=1)
    else:
        scale = np.abs(edges).max(axis=(1, 2), keepdims=True)  # otherwise squares of lengths may overflow
        normals = np.cross(*np.moveaxis(edges / scale, 1, 0))
    normals = normals / np.abs(normals).max(axis=1, keepdims=True)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def balls(simplices: Array) -> tuple[Array, Array]:
    """The centroids of simplices, and how far their vertices are from these."""
    middle = simplices.mean(axis=1)
    return middle, np.linalg.norm(simplices - middle[:, None], axis=2).max(axis=1, initial=0.0)


def meeting(some: Array, others: Array) -> Iterator[tuple[Indices, Indices]]:
    """Pairs of rows of simplices whose balls meet, so many at a time.

    Of few simplices, each is compared with all. Balls of about the same size are in one tree: otherwise the largest
    would decide how far all others look.
    """
    middle, radius = balls(some)
    other_middle, other_radius = balls(others)
    if len(some) * len(others) <= FEW:
        apart = np.sqrt(sum(np.subtract.outer(*each) ** 2 for each in zip(middle.T, other_middle.T, strict=True)))
        pairs = np.argwhere(apart <= (1 + NEAR) * np.add.outer(radius, other_radius))
        yield from (tuple(pairs[start : start + PAIRS].T) for start in range(0, len(pairs), PAIRS))
        return
    from scipy.spatial import cKDTree  # slow to import

    size = np.frexp(other_radius)[1]
    for exponent in np.unique(size):
        of_size = np.flatnonzero(size == exponent)
        tree, reach = cKDTree(other_middle[of_size]), (1 + NEAR) * (radius + 2.0**exponent)
        ends = np.cumsum(tree.query_ball_point(middle, reach, return_length=True))
        start = 0
        while start < len(middle):
            before = ends[start - 1] if start > 0 else 0
            stop = max(start + 1, int(np.searchsorted(ends, before + PAIRS)))
            near = tree.query_ball_point(middle[start:stop], reach[start:stop])
            row = np.repeat(np.arange(start, stop), [len(rows) for rows in near])
            other = of_size[np.concatenate([np.asarray(rows, dtype=np.int64) for rows in near])]
            apart = np.linalg.norm(middle[row] - other_middle[other], axis=1)
            meets = apart <= (1 + NEAR) * (radius[row] + other_radius[other])
            yield row[meets], other[meets]
            start = stop


def _depths(one: Array, other: Array, axes: Array) -> Array:
    """How deep pairs of simplices are in one another along the axis where that is least, or 0 (pairs,).

    It is 0 up to rounding, too; both have shape (pairs, vertices, dim), the axes (pairs, axes, dim).
    """
    length = np.linalg.norm(axes, axis=2, keepdims=True)
    axes = axes / np.where(length > 0, length, 1.0)
    first, second = (np.einsum("pvi,pai->pav", each - one[:, :1], axes) for each in (one, other))
    low, high = (np.stack([end(first, axis=2), end(second, axis=2)]) for end in (np.min, np.max))
    depth, width = high.min(axis=0) - low.max(axis=0), (high - low).min(axis=0)
    depth, width = (np.where(length[..., 0] > 0, each, np.inf).min(axis=1, initial=np.inf) for each in (depth, width))
    return np.where(depth > NEAR * width, depth, 0.0)


def _edges(simplices: Array) -> Array:
    """Unit vectors along all edges of simplices, shape (simplices, edges, dim)."""
    pairs = itertools.combinations(range(simplices.shape[1]), 2)
    edges = np.stack([simplices[:, b] - simplices[:, a] for a, b in pairs], axis=1)
    return edges / np.linalg.norm(edges, axis=2, keepdims=True)


def _across_facets(one: Array, other: Array) -> Array:
    """Normals of all facets of pairs of simplices."""
    normals = []
    for simplices in (one, other):
        for opposite in range(simplices.shape[1]):
            corners = np.delete(simplices, opposite, axis=1)
            normals.append(unit_normals(corners[:, 1:] - corners[:, :1]))
    return np.stack(normals, axis=1)


def _across_edges(one: Array, other: Array) -> Array:
    """What is normal to an edge of each of two tetrahedra, 0 for parallel edges."""
    axes = np.cross(_edges(one)[:, :, None], _edges(other)[:, None]).reshape(-1, 36, 3)
    return np.where(np.linalg.norm(axes, axis=2, keepdims=True) > PARALLEL, axes, 0.0)
