"""Surfaces from mesh files, such as STL: triangles in space, segments in the plane; and how far points are away."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.meshes.contents import Contents, check_widths
from signorini_fenicsx.meshes.files import read_file

KIND = {2: "line", 3: "triangle"}
IN_WORDS = {2: "segments", 3: "triangles"}
AT_ONCE = 1_000_000
"""Pairs of a point and an element that are in memory at the same time."""
EDGE, FLAT = 1e-9, 1e-12
"""An element is larger on each side by the first share of itself, so that nothing passes between two of them; a line
that goes along it, up to the second share, does not cross it."""


@dataclass(frozen=True)
class Foundation:
    """A surface; all ranks have all of it.

    Attributes:
        corners: The corners of its elements, shape (elements, d, d).
    """

    corners: Array

    def distances(self, x: Array, directions: Array) -> Array:
        """How far points are from it along unit directions: negative behind them, infinite where the line misses it.

        Of several crossings the nearest counts, on whatever side.

        Args:
            x: Shape (points, d).
            directions: Likewise.
        """
        nearest = np.full(len(x), np.inf)
        parts = -(-len(x) * len(self.corners) // AT_ONCE)
        for rows in np.array_split(np.arange(len(x)), parts) if parts > 0 else []:
            near, element = self._near(x[rows], directions[rows])
            distance, crossed = self._crossings(x[rows[near]], directions[rows[near]], element)
            far_first = np.argsort(-np.abs(distance[crossed]), kind="stable")
            nearest[rows[near[crossed][far_first]]] = distance[crossed][far_first]
        return nearest

    def _near(self, x: Array, directions: Array) -> tuple[Indices, Indices]:
        """Pairs of a line and an element whose ball it meets."""
        middles = self.corners.mean(axis=1)
        radii = np.linalg.norm(self.corners - middles[:, None], axis=2).max(axis=1)
        away = middles - x[:, None]
        along = np.einsum("nmi,ni->nm", away, directions)
        beside = (away**2).sum(axis=2) - along**2
        slack = EDGE * (radii**2 + np.abs(x).max(initial=0.0) ** 2)
        return np.nonzero(beside <= (1 + EDGE) * radii**2 + slack)

    def _crossings(self, x: Array, directions: Array, element: Indices) -> tuple[Array, Indices]:
        """Where lines cross the planes of elements, and which of them cross the elements themselves."""
        corners = self.corners[element]
        edges = corners[:, 1:] - corners[:, :1]
        matrices = np.concatenate([edges, -directions[:, None]], axis=1).swapaxes(1, 2)
        crosses = np.abs(np.linalg.det(matrices)) > FLAT * np.linalg.norm(edges, axis=2).prod(axis=1)
        solved = np.full(x.shape, np.nan)
        solved[crosses] = np.linalg.solve(matrices[crosses], (x - corners[:, 0])[crosses][..., None])[..., 0]
        inside = (solved[:, :-1] >= -EDGE).all(axis=1) & (solved[:, :-1].sum(axis=1) <= 1 + EDGE)
        return solved[:, -1], np.flatnonzero(crosses & inside)


def read_surface(comm: MPI.Comm, path: str | Path, dim: int) -> Foundation:
    """Read a surface in space, or a line in the plane (collective; rank 0 reads).

    Raises:
        InputError: If the file cannot be read, or has no triangles, in the plane no segments.
    """
    return Foundation(on_root(comm, lambda: read_file("surface", str(path), partial(_corners, dim))))


def _corners(dim: int, contents: Contents) -> Array:
    """The corners of the elements of a surface.

    Raises:
        InputError: If there are none, or they are not where a body of this dimension can be.
    """
    check_widths(contents.points, contents.blocks)
    blocks = [elements for kind, elements in contents.blocks if kind == KIND[dim] and len(elements) > 0]
    if not blocks:
        raise InputError(f"has no {IN_WORDS[dim]}")
    elements = np.concatenate(blocks)
    if elements.min() < 0 or elements.max() >= len(contents.points):
        raise InputError("an element has a point that is not in the file")
    points = contents.points[elements]
    if not np.isfinite(points).all():
        raise InputError("a point has a coordinate that is not a number, or infinite")
    if points.shape[2] < dim or points[..., dim:].any():
        raise InputError("is not in the plane of the body, z = 0" if dim == 2 else "is not in space")
    return np.ascontiguousarray(points[..., :dim])
