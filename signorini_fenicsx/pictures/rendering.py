"""Tools for rendered views: rendering without a display, cropping, arrows along the coordinates."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import numpy.typing as npt
import pyvista
from matplotlib.axes import Axes

from signorini_fenicsx.base.arrays import Array, Indices


@contextmanager
def offscreen() -> Iterator[None]:
    """Let VTK render without a display; otherwise it searches for an X server and warns."""
    key = "VTK_DEFAULT_OPENGL_WINDOW"
    if "DISPLAY" in os.environ or key in os.environ:
        yield
        return
    os.environ[key] = "vtkEGLRenderWindow"
    try:
        yield
    finally:
        del os.environ[key]


def screen(view: Array) -> tuple[Array, Array]:
    """The directions to the right and up on the screen."""
    across = np.cross([0, 0, 1.0], view)
    across /= np.linalg.norm(across)
    up = np.cross(view, across)
    return across, up / np.linalg.norm(up)


def go_near(camera: pyvista.Camera, points: Array, view: Array) -> None:
    """Show the neighbourhood of points of shape (…, 3) alone, in parallel projection."""
    points = points.reshape(-1, 3)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    radius = np.linalg.norm(points - middle, axis=1).max()
    camera.focal_point, camera.position, camera.parallel_scale = middle, middle + 3 * radius * view, radius


def cropped(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """The image without its white margins."""
    drawn = (image < 250).any(axis=2)
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    if not len(rows):
        return image
    return image[max(rows[0] - 4, 0) : rows[-1] + 5, max(columns[0] - 4, 0) : columns[-1] + 5]


def triad(axes: Axes, view: Array, size: tuple[float, float]) -> None:
    """Small arrows along x, y and z in the lower left corner, on these shares of the width and the height."""
    across, up = screen(view)
    corner = axes.inset_axes((0, 0, *size))
    corner.set(xlim=(-1.5, 1.5), ylim=(-1.5, 1.5), aspect="equal")
    corner.set_axis_off()
    for name, direction in zip("xyz", np.eye(3), strict=True):
        tip = np.array([direction @ across, direction @ up])
        corner.annotate("", tip, (0, 0), arrowprops={"arrowstyle": "->", "lw": 0.9, "shrinkA": 0, "shrinkB": 0})
        corner.text(*(1.35 * tip), f"${name}$", ha="center", va="center", fontsize=9)


def lines_of(points: Array, edges: Indices) -> pyvista.PolyData:
    """Edges of a mesh, shape (edges, 2)."""
    if not len(edges):
        return pyvista.PolyData()
    return pyvista.PolyData(points, lines=np.column_stack([np.full(len(edges), 2), edges]).ravel())


def surface_of(triangles: Sequence[Array]) -> pyvista.PolyData:
    """A surface of triangles."""
    corners = np.concatenate(triangles)
    return pyvista.PolyData.from_regular_faces(corners, np.arange(len(corners)).reshape(-1, 3))
