"""Structured meshes of the named shapes that have them; each rank makes some rows of squares or cubes."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices

type Simplices = tuple[Array, Indices]
"""Points of shape (points, dim) and cells of shape (cells, dim + 1)."""


@dataclass(frozen=True)
class Share:
    """The share of a grid that a rank makes. Points are numbered in the order of the ranks."""

    rank: int = 0
    ranks: int = 1


def rectangle_grid(low: Array, high: Array, h: float, diagonal: str, share: Share) -> Simplices:
    """The rectangle with these lower left and upper right corners: triangles of diameter at most h."""
    across, up = (math.ceil(side * _per_unit(h, diagonal) * (1 - 1e-12)) for side in (high - low).tolist())
    points, triangles = _cut_squares(_Rows(np.full(up, across), share), diagonal)
    return low + (high - low) * (points / [across, up]), triangles


class _Rows:
    """Rows of squares.

    Attributes:
        squares: Number of squares in each row.
        points: Number of points in each row of points, one row more.
        own: Rows of squares of this rank.
        own_points: Rows of points of this rank.
    """

    def __init__(self, squares: Indices, share: Share):
        self.squares = squares
        self.points = np.maximum(np.append(self.squares, 0), np.insert(self.squares, 0, 0)) + 1
        self.own = np.array_split(np.arange(len(self.squares)), share.ranks)[share.rank]
        last = share.rank == share.ranks - 1
        self.own_points = np.append(self.own, len(self.squares)) if last else self.own


def _l_shape(side: int, per_unit: int) -> Indices:
    """Squares in the rows of one unit square (side 1), or of an L of three (side 2)."""
    return np.repeat(per_unit * np.arange(side, 0, -1), per_unit)


def _per_unit(h: float, diagonal: str) -> float:
    """Squares per unit of length."""
    return (1.0 if diagonal == "crossed" else math.sqrt(2)) / h


def _places(rows: Indices, lengths: Indices) -> tuple[Indices, Indices]:
    """For each entry of some rows of these lengths, its row and its place in the row."""
    ends = np.cumsum(lengths)
    return np.repeat(rows, lengths), np.arange(lengths.sum()) - np.repeat(ends - lengths, lengths)


def l_grid(h: float, diagonal: str, share: Share) -> Simplices:
    """The L-shape (0, 2)² without [1, 2)²: triangles of diameter at most h."""
    per_unit = math.ceil(_per_unit(h, diagonal) * (1 - 1e-12))
    points, triangles = _cut_squares(_Rows(_l_shape(2, per_unit), share), diagonal)
    return points / per_unit, triangles


def _cut_squares(rows: _Rows, diagonal: str) -> Simplices:
    """Squares of size 1, each cut into two triangles (left, right) or four (crossed)."""
    crossed = diagonal == "crossed"
    lengths = rows.points + crossed * np.append(rows.squares, 0)  # the centres of a row follow its points
    first = np.cumsum(lengths) - lengths
    j, i = _places(rows.own_points, lengths[rows.own_points])
    centre = i >= rows.points[j]
    x, y = np.where(centre, i - rows.points[j] + 0.5, i), j + 0.5 * centre

    j, i = _places(rows.own, rows.squares[rows.own])
    a, d, m = first[j] + i, first[j + 1] + i, first[j] + rows.points[j] + i
    b, c = a + 1, d + 1  # a b c d run around the square, m is its centre
    if crossed:
        triangles = [(a, b, m), (b, c, m), (c, d, m), (d, a, m)]
    elif diagonal == "right":
        triangles = [(a, b, c), (a, c, d)]
    else:
        triangles = [(a, b, d), (b, c, d)]
    return np.stack([x, y], axis=1), np.concatenate([np.stack(t, axis=1) for t in triangles])


def tetrahedron_grid(h: float, _diagonal: str, share: Share, *, side: int = 1) -> Simplices:
    """The unit cube, or for side 2 the L-shape of height 1: tetrahedra of diameter at most h.

    Each cube of a grid is cut into six of them, along the same space diagonal (Kuhn).
    """
    per_unit = math.ceil(math.sqrt(3) / h * (1 - 1e-12))
    rows = _Rows(_l_shape(side, per_unit), share)  # a row is a layer here, and has columns of points
    column = per_unit + 1
    lengths = rows.points * column
    first = np.cumsum(lengths) - lengths
    i, place = _places(rows.own_points, lengths[rows.own_points])
    points = np.stack([i, place // column, place % column], axis=1) / per_unit

    i, place = _places(rows.own, rows.squares[rows.own] * per_unit)
    corner = first[i] + place // per_unit * column + place % per_unit
    steps = (first[i + 1] - first[i], column, 1)
    paths = [
        np.stack(list(itertools.accumulate((corner, *(steps[axis] for axis in order)))), axis=1)
        for order in itertools.permutations(range(3))
    ]
    return points, np.concatenate(paths)
