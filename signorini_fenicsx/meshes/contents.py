"""The contents of a file, as the confined process reads them; importing it is quick (`file_worker`)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError

SIMPLICES = {"vertex": 0, "line": 1, "triangle": 2, "tetra": 3}
"""Accepted kinds of elements and their dimensions."""
SECOND = {"line3": "line", "triangle6": "triangle", "tetra10": "tetra"}
"""Elements of second order, accepted if they are straight, and those with their corners, which come first."""
DIMENSION = (
    SIMPLICES
    | {kind: SIMPLICES[corners] for kind, corners in SECOND.items()}
    | {"quad": 2, "hexahedron": 3, "wedge": 3, "pyramid": 3}
)
"""The dimension of each kind that is read."""
DRAWINGS = (".geo", ".step", ".stp", ".brep")
"""Endings of files with a geometry, which Gmsh meshes."""
OF_GMSH = (*DRAWINGS, ".msh", ".unv", ".bdf")
"""Endings of files that Gmsh reads."""
STRAIGHT, ROUNDED = 1e-6, 2e-6
"""Largest distance of a point from the middle of its edge in a straight element, relative to the element's size, and to
the size of the mesh: points of a NASTRAN file have seven digits or fewer."""


@dataclass(frozen=True)
class Contents:
    """The contents of a file.

    Attributes:
        points: Shape (points, 2 or 3).
        blocks: Kind of the elements, with meshio's name, and the points of each element.
        groups: Name, dimension, and elements by block and row.
        straight: Whether the geometry is known to have straight edges and plane faces.
        values: Values at the points by their names, shape (points,) or (points, components).
    """

    points: Array
    blocks: list[tuple[str, Indices]]
    groups: list[tuple[str, int, list[tuple[int, Indices]]]]
    straight: bool = False
    values: Mapping[str, Array] = field(default_factory=dict)


def faces(cells: Indices) -> Indices:
    """Facets of all cells as ascending vertices: first those opposite to the first vertices, then to the second etc."""
    width = cells.shape[1]
    return np.sort(np.concatenate([np.delete(cells, opposite, axis=1) for opposite in range(width)]), axis=1)


def straightened(points: Array, kind: str, elements: Indices) -> tuple[str, Indices]:
    """Elements of second order as those of first order if they are straight; all other ones as they are."""
    if kind not in SECOND:
        return kind, elements
    corners = points[elements[:, : SIMPLICES[SECOND[kind]] + 1]]
    one, other = np.triu_indices(corners.shape[1], 1)
    middles, between = (corners[:, one] + corners[:, other]) / 2, points[elements[:, corners.shape[1] :]]
    off = np.linalg.norm(between[:, :, None] - middles[:, None], axis=3).min(axis=2).max(initial=0.0)
    size = np.linalg.norm(corners[:, one] - corners[:, other], axis=2).max(axis=1, initial=0.0).min(initial=np.inf)
    most = max(STRAIGHT * size, ROUNDED * (float(np.ptp(points, axis=0).max()) if len(points) else 0.0))
    return (SECOND[kind], elements[:, : corners.shape[1]]) if off <= most else (kind, elements)


def check_widths(points: Array, blocks: Sequence[tuple[str, Indices]]) -> None:
    """Refuse points without two or three coordinates, and simplices with a wrong number of points.

    Raises:
        InputError: If there are any.
    """
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise InputError(f"its points are an array of shape {points.shape}; 2 or 3 coordinates for each are needed")
    for kind, elements in blocks:
        if kind in SIMPLICES and len(elements) > 0 and elements.shape[1:] != (SIMPLICES[kind] + 1,):
            raise InputError(
                f"an array of elements of kind '{kind}' has the shape {elements.shape}; {SIMPLICES[kind] + 1} points "
                "for each are needed"
            )
