"""Tools for rendered views: rendering without a display, cropping, arrows along the coordinates."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import numpy.typing as npt
import pyvista
from matplotlib.axes import Axes

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.pictures.scene import Scene

MARGIN = 0.06
"""Around what is enlarged, of the width of the image."""
ARROWS = 50
"""Arrows on Γ_S are drawn on about this many facets; more would be too small to be seen."""
STREAMLINES = 70
STILL = 1e-3
"""Vectors that are less than this share of the largest one have no arrow head."""


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


def _ball(points: Array) -> tuple[Array, Array, float]:
    """Points in rows, and the middle and the radius of a ball around them."""
    points = points.reshape(-1, 3)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return points, middle, np.linalg.norm(points - middle, axis=1).max()


def go_near(camera: pyvista.Camera, points: Array, view: Array) -> None:
    """Show the neighbourhood of points of shape (…, 3) alone, in parallel projection."""
    _, middle, radius = _ball(points)
    camera.focal_point, camera.position, camera.parallel_scale = middle, middle + 3 * radius * view, radius


def cropped_near(image: npt.NDArray[np.uint8], points: Array, view: Array) -> npt.NDArray[np.uint8]:
    """The square image that `go_near` makes without what is farther from the points than some margin."""
    points, middle, radius = _ball(points)
    across, up = screen(view)
    places = (points - middle) @ np.column_stack([across, -up]) / (2 * radius) + 0.5
    low, high = (places.min(axis=0) - MARGIN) * len(image), (places.max(axis=0) + MARGIN) * len(image)
    (left, top), (right, bottom) = np.maximum(low, 0).astype(int), np.ceil(high).astype(int)
    return image[top:bottom, left:right]


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


def arrows_on(x: Array, measure: float, vectors: Array, least: float) -> pyvista.PolyData:
    """Arrows along vectors that are longer than the least length, all of one length, on some of many facets.

    Args:
        x: The middles of the facets.
        measure: Their area.
        vectors: The vectors, of which some may be NaN.
        least: The least length.
    """
    size = np.linalg.norm(np.nan_to_num(vectors), axis=1)
    rows = np.flatnonzero(size > least)
    rows = rows[:: 1 + len(rows) // ARROWS]
    if not len(rows):
        return pyvista.PolyData()
    length, ways = 0.5 * np.sqrt(measure / len(rows)), vectors[rows] / size[rows, None]
    points = pyvista.PolyData(x[rows] - length / 2 * ways)
    points["ways"] = ways
    return points.glyph(orient="ways", scale=False, factor=length)


def arrow_heads(seeds: pyvista.PolyData, length: float) -> pyvista.PolyData:
    """Cones at the points through which streamlines go, along their vectors, where these are not 0."""
    ways = seeds.extract_points(seeds["length"] > STILL * seeds["length"].max(), include_cells=False)
    cone = pyvista.Cone(height=length, radius=0.35 * length, resolution=16)
    return ways.glyph(orient="flow", scale=False, geom=cone) if ways.n_points else pyvista.PolyData()


def streamlines(scene: Scene, flow: Array, longest: float) -> tuple[pyvista.PolyData, pyvista.PolyData]:
    """Streamlines through points spread over the domain, and these points with the field there.

    VTK finds them in single precision, near 0. Of a field that jumps between cells, each cell has its own corners, and
    lines end a step before the boundary.

    Args:
        scene: A solution in space.
        flow: The field at the points of the scene, or if it jumps at the corners of cells, shape (cells, 4, 3).
        longest: Their greatest length.
    """
    measure = np.cumsum(scene.measure)
    share = (np.arange(STREAMLINES) + 0.5) / STREAMLINES
    first, points, cells = scene.fields.points[0], scene.fields.points, scene.fields.cells
    chosen = cells[np.searchsorted(measure, share * measure[-1])]
    corners, step = (points, 0.5) if flow.ndim == 2 else (points[cells].reshape(-1, 3), 0.1)
    numbers = cells if flow.ndim == 2 else np.arange(len(corners)).reshape(-1, 4)
    near_0 = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: numbers}, corners - first)
    near_0.point_data["flow"] = flow.reshape(-1, 3)
    near_0.point_data["length"] = np.linalg.norm(near_0.point_data["flow"], axis=1)
    seeds = pyvista.PolyData((points - first)[chosen].mean(axis=1))
    lines = near_0.streamlines_from_source(
        seeds,
        vectors="flow",
        max_length=longest,
        initial_step_length=step,
        max_step_length=step,
        max_steps=round(200 / step),
        interpolator_type="point" if flow.ndim == 2 else "cell",
    )
    seeds = seeds.sample(near_0)
    for each in (lines, seeds):
        each.points = np.asarray(each.points, dtype=np.float64) + first
    return lines, seeds
