"""Finds places where the boundary of a mesh lies on itself: cracks, hanging nodes, pieces not joined, overlaps.

There, facets that should be inside the domain belong to only one cell and count as boundary. They are found by a few
points of each facet that lie inside another facet. Lengths are compared only with the heights of cells. So the result
does not depend on the unit of length, and flat cells do not count as cracks.
"""

from collections.abc import Iterator

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask

NEAR = 1e-5
"""Facets lie on one another if they are nearer than this share of the heights of their cells; single precision is
exact enough for it."""
WEIGHTS = {
    2: np.array([[0.71, 0.29], [0.29, 0.71]]),
    3: np.array([[0.62, 0.27, 0.11], [0.11, 0.62, 0.27], [0.27, 0.11, 0.62]]),
}
"""Barycentric coordinates of the tried points of a facet, away from lines of symmetry, where other facets may end."""
PAIRS = 10**6
"""Number of pairs of facets and points that are tested at once."""


def seams(corners: Array, apexes: Array) -> tuple[Mask, Mask]:
    """Find facets of the boundary that lie on other facets of the boundary.

    Args:
        corners: Vertices of the facets of the boundary, shape (facets, dim, dim).
        apexes: Vertex opposite to each facet in its cell, shape (facets, dim).

    Returns:
        Two masks of facets that lie on another one: those with the cells on different sides, as at a crack, and those
        with the cells on the same side, where cells overlap.
    """
    count, dim = apexes.shape
    edges = corners[:, 1:] - corners[:, :1]
    normals = unit_normals(edges)
    heights = np.einsum("fi,fi->f", apexes - corners[:, 0], normals)
    tried = np.einsum("wc,fci->fwi", WEIGHTS[dim], corners).reshape(-1, dim)
    crack, overlap = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    for facet, point in _near(corners, tried):
        other = point // dim
        facet, point, other = (rows[other != facet] for rows in (facet, point, other))
        offset = tried[point] - corners[facet, 0]
        above = np.einsum("pi,pi->p", offset, normals[facet])
        near = np.abs(above) <= NEAR * np.minimum(np.abs(heights[facet]), np.abs(heights[other]))
        facet, other, offset = facet[near], other[near], offset[near]
        inside = _is_inside(edges[facet], offset)
        facet, other = facet[inside], other[inside]
        side = np.einsum("pi,pi->p", apexes[other] - corners[facet, 0], normals[facet]) * heights[facet]
        crack[facet[side <= 0]] = crack[other[side <= 0]] = True
        overlap[facet[side > 0]] = overlap[other[side > 0]] = True
    return crack, overlap


def unit_normals(edges: Array) -> Array:
    """Unit normals of facets with these edges from their first corner."""
    if edges.shape[2] == 2:
        normals = np.stack([edges[:, 0, 1], -edges[:, 0, 0]], axis=1)
    else:
        scale = np.abs(edges).max(axis=(1, 2), keepdims=True)  # otherwise squares of lengths may overflow
        normals = np.cross(*np.moveaxis(edges / scale, 1, 0))
    normals = normals / np.abs(normals).max(axis=1, keepdims=True)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _is_inside(edges: Array, offset: Array) -> Mask:
    """Whether points in the planes of facets, relative to the first corner, are inside the facets."""
    scale = np.abs(edges).max(axis=(1, 2), keepdims=True)
    edges, offset = edges / scale, offset / scale[:, :, 0]
    gram = edges @ edges.transpose(0, 2, 1)
    share = np.linalg.solve(gram, (edges @ offset[:, :, None]))[:, :, 0]
    return np.all(share > 0, axis=1) & (share.sum(axis=1) < 1)


def _near(corners: Array, tried: Array) -> Iterator[tuple[Indices, Indices]]:
    """Pairs of a facet and a point in the smallest ball around the middle of the facet that contains the facet."""
    from scipy.spatial import cKDTree  # slow to import, and needed for meshes from files only

    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    tree = cKDTree(tried)
    ends = np.cumsum(tree.query_ball_point(middle, radius, return_length=True))
    start = 0
    while start < len(middle):
        before = ends[start - 1] if start > 0 else 0
        stop = max(start + 1, int(np.searchsorted(ends, before + PAIRS)))
        near = tree.query_ball_point(middle[start:stop], radius[start:stop])
        facet = np.repeat(np.arange(start, stop), [len(points) for points in near])
        yield facet, np.concatenate([np.asarray(points, dtype=np.int64) for points in near])
        start = stop
