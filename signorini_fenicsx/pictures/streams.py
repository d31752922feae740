"""Streamlines of σ_h in the plane."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.gather import DrawnFields

GRID = 110
"""Points of the grid along the longer side of the domain."""
ARROW = 0.022
"""Length of the arrow heads, relative to this side."""
DENSITY = 0.95
"""Lines along the longer side of the domain, in parts of 30; across a thin one there are fewer."""
APART = 1.6
"""Heads are at least this many times their length from each other."""
SHARES = (0.5, 0.4, 0.6, 0.3, 0.7)
"""Where a head may be on its line, the best place first."""
STILL = 1e-3
"""A flux smaller than this, relative to the usual one, has no meaningful direction."""
NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


def of_means(fields: DrawnFields) -> Array:
    """σ_h of RT0 at the corners of the cells, from its means and its divergence, shape (cells, 3, 2)."""
    corners = fields.points[fields.cells]
    offsets = corners - corners.mean(axis=1, keepdims=True)
    return np.asarray(fields.in_cells["sigma"][:, None] + fields.in_cells["divergence"][:, None, None] / 2 * offsets)


def streamlines(fields: DrawnFields, at_corners: Array) -> tuple[list[Array], Array]:
    """Streamlines of a field that is linear on cells, and arrow heads in their middle.

    Args:
        fields: The mesh.
        at_corners: The field at the corners of each cell, shape (cells, 3, 2).

    Returns:
        The points of each line, shape (n, 2), and the corners of the heads, shape (lines, 3, 2).
    """
    low, high = fields.points.min(axis=0), fields.points.max(axis=0)
    size = float((high - low).max())
    x, y = (np.linspace(a, b, max(round(GRID * (b - a) / size), 8)) for a, b in zip(low, high, strict=True))
    sigma = _spread(on_grid(fields, at_corners, x, y))
    norm = np.linalg.norm(sigma, axis=0)
    if not np.nanmax(norm, initial=0.0) > 0:
        return [], np.empty((0, 3, 2))
    sigma[:, norm < STILL * np.nanquantile(norm, style.QUANTILE)] = np.nan
    look = {"density": [DENSITY * np.sqrt(np.ptp(each) / size) for each in (x, y)], "num_arrows": 0}
    plot = Figure().add_subplot().streamplot(x, y, *sigma, integration_max_step_scale=2, **look)
    lines = [line for line in plot.lines.get_segments() if len(line) > 2]
    return lines, heads(lines, (low, high))


def on_grid(fields: DrawnFields, at_corners: Array, x: Array, y: Array) -> Array:
    """A field, linear on cells, at the points of a regular grid, shape (2, len(y), len(x)); NaN outside the domain."""
    origin, spacing = np.array([x[0], y[0]]), np.array([x[1] - x[0], y[1] - y[0]])
    corners = (fields.points[fields.cells] - origin) / spacing  # in units of the grid
    first = np.ceil(corners.min(axis=1) - 1e-9).astype(np.int64)
    number = np.maximum(np.floor(corners.max(axis=1) + 1e-9).astype(np.int64) - first + 1, 0)
    count = number.prod(axis=1)
    cell = np.repeat(np.arange(len(count)), count)
    within = np.arange(len(cell)) - np.repeat(np.cumsum(count) - count, count)
    node = first[cell] + np.column_stack([within % number[cell, 0], within // number[cell, 0]])
    edges = corners[:, 1:] - corners[:, :1]
    inverse = np.linalg.inv(edges.transpose(0, 2, 1))
    share = np.einsum("kij,kj->ki", inverse[cell], node - corners[cell, 0])
    inside = (share.min(axis=1) > -1e-6) & (share.sum(axis=1) < 1 + 1e-6)
    cell, (i, j) = cell[inside], node[inside].T
    shares = np.column_stack([1 - share.sum(axis=1), share])[inside]
    sigma = np.full((2, len(y), len(x)), np.nan)
    sigma[:, j, i] = np.einsum("na,nai->in", shares, at_corners[cell])
    return sigma


def _spread(sigma: Array) -> Array:
    """The field, continued by one point of the grid outside the domain, so that streamlines reach the boundary."""
    padded = np.pad(sigma, ((0, 0), (1, 1), (1, 1)), constant_values=np.nan)
    rows, columns = sigma.shape[1:]
    around = np.stack([padded[:, 1 + i : 1 + i + rows, 1 + j : 1 + j + columns] for i, j in NEIGHBOURS])
    finite = np.isfinite(around)
    mean = np.where(finite, around, 0).sum(axis=0) / np.maximum(finite.sum(axis=0), 1)
    return np.where(np.isfinite(sigma), sigma, np.where(finite.any(axis=0), mean, np.nan))


def heads(lines: Sequence[Array], box: tuple[Array, Array]) -> Array:
    """Triangles near the middle of lines, pointing along them, shape (heads, 3, 2); where there is room for them.

    Args:
        lines: The points of each line.
        box: The smallest and the largest coordinates of the domain, beyond which nothing is drawn.
    """
    low, high = box
    length, found = ARROW * float((high - low).max()), np.empty((0, 3, 2))
    for line in sorted(lines, key=_length, reverse=True):
        for head in (_head(line, length, share) for share in SHARES):
            others = np.linalg.norm(found.mean(axis=1) - head.mean(axis=0), axis=1)
            if others.min(initial=np.inf) > APART * length and np.all((head > low) & (head < high)):
                found = np.concatenate([found, head[None]])
                break
    return found


def _length(line: Array) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _head(line: Array, length: float, share: float) -> Array:
    steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    at = int(np.searchsorted(np.cumsum(steps), share * steps.sum()))
    along = line[at + 1] - line[at]
    along *= length / max(float(np.linalg.norm(along)), 1e-300)
    across = 0.38 * np.array([-along[1], along[0]])
    middle = (line[at] + line[at + 1]) / 2
    return np.array([middle + along / 2, middle - along / 2 + across, middle - along / 2 - across])
