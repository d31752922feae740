"""Structured meshes of the named shapes that have them."""

import itertools
import math
from collections.abc import Callable

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask

type Simplices = tuple[Array, Indices]
"""Points of shape (points, dim) and cells of shape (cells, dim + 1)."""


def square_grid(h: float, diagonal: str) -> Simplices:
    """The unit square: triangles of diameter at most h."""
    return _triangle_grid(h, diagonal, side=1, keep=_everywhere)


def lshape_grid(h: float, diagonal: str) -> Simplices:
    """The L-shape (0, 2)² without the notch [1, 2)²: triangles of diameter at most h."""
    return _triangle_grid(h, diagonal, side=2, keep=_outside_notch)


def cube_grid(h: float, _diagonal: str) -> Simplices:
    """The unit cube: tetrahedra of diameter at most h."""
    return _tetrahedron_grid(h, side=1, keep=_everywhere)


def lprism_grid(h: float, _diagonal: str) -> Simplices:
    """The L-shape of height 1: tetrahedra of diameter at most h."""
    return _tetrahedron_grid(h, side=2, keep=_outside_notch)


def _triangle_grid(h: float, diagonal: str, *, side: int, keep: Callable[[Array], Mask]) -> Simplices:
    """Squares of a grid on (0, side)², each cut into two triangles (left, right) or four (crossed)."""
    per_unit = math.ceil((1.0 if diagonal == "crossed" else math.sqrt(2)) / h * (1 - 1e-12))
    n = side * per_unit
    j, i = (index.ravel() for index in np.indices((n, n)))
    inside = keep((np.stack([i, j]) + 0.5) / per_unit)
    i, j = i[inside], j[inside]
    y, x = (index.ravel() / per_unit for index in np.indices((n + 1, n + 1)))
    points = np.stack([x, y], axis=1)
    a = i + (n + 1) * j
    b, c, d = a + 1, a + n + 2, a + n + 1  # a b c d run around the square
    if diagonal == "crossed":
        m = len(points) + np.arange(len(a))
        points = np.concatenate([points, (np.stack([i, j], axis=1) + 0.5) / per_unit])
        triangles = [(a, b, m), (b, c, m), (c, d, m), (d, a, m)]
    elif diagonal == "right":
        triangles = [(a, b, c), (a, c, d)]
    else:
        triangles = [(a, b, d), (b, c, d)]
    used, cells = np.unique(np.concatenate([np.stack(t, axis=1) for t in triangles]), return_inverse=True)
    return points[used], cells


def _tetrahedron_grid(h: float, *, side: int, keep: Callable[[Array], Mask]) -> Simplices:
    """Cubes of a grid on (0, side)² × (0, 1), each cut into six tetrahedra along the same space diagonal (Kuhn)."""
    per_unit = math.ceil(math.sqrt(3) / h * (1 - 1e-12))
    n = side * per_unit
    points = np.stack([index.ravel() / per_unit for index in np.indices((n + 1, n + 1, per_unit + 1))], axis=1)
    cubes = np.indices((n, n, per_unit)).reshape(3, -1)
    strides = ((n + 1) * (per_unit + 1), per_unit + 1, 1)
    corner = cubes[:, keep((cubes + 0.5) / per_unit)].T @ strides
    paths = [
        np.stack([corner + offset for offset in itertools.accumulate((0, *steps))], axis=1)
        for steps in itertools.permutations(strides)
    ]
    used, cells = np.unique(np.concatenate(paths), return_inverse=True)
    return points[used], cells


def _everywhere(x: Array) -> Mask:
    return np.full(x.shape[1], True)


def _outside_notch(x: Array) -> Mask:
    return (x[0] < 1) | (x[1] < 1)
