"""Triangles and edges for pictures: fewer of them, creases, frames, level lines."""

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from signorini_fenicsx.base.arrays import Array, Indices

PIECES = 8
"""Into so many pieces each edge of a triangle is cut."""


def thinned(points: Array, triangles: Indices, most: int) -> tuple[Indices, Indices]:
    """Fewer triangles with the same corners and edges, for pictures of large meshes.

    All vertices within a box of a grid are replaced by one of them: the one that is farthest from the mean of its
    neighbours, so that boundaries stay in place.

    Returns:
        The remaining triangles, and their rows in `triangles`.
    """
    rows = np.arange(len(triangles))
    if len(triangles) <= most:
        return triangles, rows
    corners = np.zeros((len(triangles), 3, 3))
    corners[:, :, : points.shape[1]] = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.sqrt(np.linalg.norm(normals, axis=1).sum() / most)  # twice the area; two triangles per box
    box = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    _, box_of = np.unique(box, axis=0, return_inverse=True)
    box_of = box_of.ravel()
    vertices, others = triangles.ravel(), np.roll(triangles, 1, axis=1).ravel()
    count = np.maximum(np.bincount(vertices, minlength=len(points)), 1)
    offsets = [np.bincount(vertices, x[others] - x[vertices], minlength=len(points)) / count for x in points.T]
    order = np.lexsort((np.linalg.norm(offsets, axis=0), box_of))
    last = np.append(np.diff(box_of[order]) > 0, True)
    chosen = order[last][box_of]
    moved = chosen[triangles]
    kept = (moved[:, 0] != moved[:, 1]) & (moved[:, 1] != moved[:, 2]) & (moved[:, 2] != moved[:, 0])
    return moved[kept], rows[kept]


def finer(points: Array, triangles: Indices, values: Array, most: float) -> tuple[Array, Indices, Array]:
    """The same linear values, on smaller triangles where they differ by more than `most` on one.

    Between the corners of a triangle Matplotlib mixes colours, and those of a scale do not mix to colours of the scale.

    Returns:
        The points, the triangles and the values at the points.
    """
    i, j = np.array([(i, j) for i in range(PIECES + 1) for j in range(PIECES + 1 - i)]).T
    number = np.zeros((PIECES + 2, PIECES + 2), dtype=np.int64)
    number[i, j] = np.arange(len(i))
    shares, low, high = np.column_stack([PIECES - i - j, i, j]) / PIECES, i + j < PIECES, i + j < PIECES - 1
    upright = np.column_stack([number[i, j], number[i + 1, j], number[i, j + 1]])[low]
    turned = np.column_stack([number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]])[high]
    steep = np.ptp(values[triangles], axis=1) > most
    corners, small = triangles[steep], np.concatenate([upright, turned])
    begins = len(points) + len(i) * np.arange(len(corners))
    return (
        np.concatenate([points, (shares @ points[corners]).reshape(-1, points.shape[1])]),
        np.concatenate([triangles[~steep], (begins[:, None, None] + small).reshape(-1, 3)]),
        np.concatenate([values, (values[corners] @ shares.T).ravel()]),
    )


def creases(points: Array, triangles: Indices, angle: float = 30) -> Indices:
    """Edges where triangles end or meet at more than this angle, shape (edges, 2), for triangles of any orientation."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [0, 2]]]), axis=1)
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    order = np.lexsort(edges.T)
    first, second = order[:-1], order[1:]
    pair = np.all(edges[first] == edges[second], axis=1)
    cosine = np.abs(np.sum(normals[first % len(triangles)] * normals[second % len(triangles)], axis=1))
    flat = cosine >= np.cos(np.radians(angle))
    inner = np.zeros(len(edges), dtype=bool)
    inner[first] |= pair & flat
    inner[second] |= pair & flat
    return np.unique(edges[~inner], axis=0)


def arrows(begins: Array, along: Array, wide: float) -> Array:
    """Arrows in the plane as polygons, shape (arrows, 7, 2).

    Args:
        begins: Where they begin, shape (arrows, 2).
        along: Where they end from there.
        wide: The width of their heads.
    """
    length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    across = wide / length * np.column_stack([-along[:, 1], along[:, 0]])
    head = 1 - np.minimum(1.2 * wide / length, 0.8)
    shaft, side = 0.12 * across, 0.5 * across
    neck, tip = begins + head * along, begins + along
    corners = [begins + shaft, neck + shaft, neck + side, tip, neck - side, neck - shaft, begins - shaft]
    return np.stack(corners, axis=1)


def framed(points: Array) -> Array:
    """Smallest and largest coordinates with some room around, shape (2, 2)."""
    low, high = points.min(axis=0), points.max(axis=0)
    room = 0.02 * (high - low).max()
    return np.stack([low - room, high + room])


def level_lines(points: Array, triangles: Indices, values: Array, levels: npt.ArrayLike) -> list[Array]:
    """The lines in the plane on which linear functions on triangles have some values; nothing if it is constant."""
    if not len(triangles) or not values.min() < values.max():
        return []
    drawn = Figure().add_subplot().tricontour(*points.T, triangles, values, levels)
    return [line for of_level in drawn.allsegs for line in of_level if len(line) > 1]
