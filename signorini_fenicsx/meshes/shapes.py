"""Domains: named shapes with meshes of a given fineness, and meshes of one's own from files."""

import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import dolfinx.mesh
import gmsh
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.signals import listen_again
from signorini_fenicsx.meshes.checks import FileMesh, check_boundary, diameters
from signorini_fenicsx.meshes.domain import (
    AXES,
    Domain,
    Marks,
    Part,
    axis_part,
    distribute,
    largest_diameter,
    marked_domain,
)
from signorini_fenicsx.meshes.files import MAX_CELLS, read_mesh_file

BEND = 1.0
"""No named shape has a radius of curvature below 1/8, and a chord of length h leaves its circle by h²/(8R)."""
OWN_BEND = 8.0
"""The same for a domain from a file of size 1, taken to have no radius below 1/64."""
TINY = np.finfo(np.float64).tiny

type Array = npt.NDArray[np.float64]
type Indices = npt.NDArray[np.int64]
type Simplices = tuple[Array, Indices]
"""Points of shape (points, dim) and cells of shape (cells, dim + 1)."""


@dataclass(frozen=True)
class NamedPart(Part):
    """A boundary part of a named shape.

    Attributes:
        contains: Tells for points of shape (3, n) which lie on the part.
    """

    contains: Callable[[Array], npt.NDArray[np.bool_]] = field(kw_only=True)


@dataclass(frozen=True)
class Shape:
    """A named domain.

    Attributes:
        dim: Dimension, 2 or 3.
        measure: Area or volume.
        diameter: Largest distance between two of its points.
        parts: Boundary parts; they cover the boundary.
        outline: Adds the domain to the current Gmsh model.
        grid: Structured mesh of a given fineness and diagonal, or None where there is none.
    """

    dim: int
    measure: float
    diameter: float
    parts: Mapping[str, NamedPart]
    outline: Callable[[], None]
    grid: Callable[[float, str], Simplices] | None = None


def _plane(axis: int, value: float) -> NamedPart:
    other = 1 - min(axis, 1)
    return NamedPart(lambda x: x[other], "xy"[other], contains=lambda x: np.isclose(x[axis], value))


def _circle(radius: float, *, lower_half: bool = False) -> NamedPart:
    """A circle by its angle from the positive x axis: −π to 0 on the lower half, else −π to π."""

    def contains(x: Array) -> npt.NDArray[np.bool_]:
        on = np.isclose(np.hypot(x[0], x[1]), radius)
        return on & (x[1] < radius * 1e-9) if lower_half else on

    return NamedPart(
        lambda x: np.arctan2(x[1], x[0]),
        "angle",
        lambda x: x * radius / np.maximum(np.hypot(x[0], x[1]), TINY),
        contains=contains,
    )


def _hemisphere(sign: int) -> NamedPart:
    """The half of the unit sphere with sign·z ≥ 0."""

    def contains(x: Array) -> npt.NDArray[np.bool_]:
        return np.isclose(np.linalg.norm(x, axis=0), 1.0) & (sign * x[2] > -1e-9)

    return NamedPart(lambda x: x[2], "z", lambda x: x / np.maximum(np.linalg.norm(x, axis=0), TINY), contains=contains)


def _polygon(*corners: tuple[float, float], height: float = 0.0) -> Callable[[], None]:
    """A polygon in the plane z = 0, or with a height the prism above it."""

    def outline() -> None:
        points = [gmsh.model.geo.addPoint(x, y, 0) for x, y in corners]
        lines = [gmsh.model.geo.addLine(a, b) for a, b in zip(points, points[1:] + points[:1], strict=True)]
        base = gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(lines)])
        if height > 0:
            gmsh.model.geo.extrude([(2, base)], 0, 0, height)

    return outline


def _circle_loop(radius: float) -> int:
    centre, *points = [
        gmsh.model.geo.addPoint(radius * x, radius * y, 0) for x, y in [(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1)]
    ]
    arcs = [gmsh.model.geo.addCircleArc(a, centre, b) for a, b in zip(points, points[1:] + points[:1], strict=True)]
    return gmsh.model.geo.addCurveLoop(arcs)


def _half_disk() -> None:
    left, centre, right, bottom = [gmsh.model.geo.addPoint(x, y, 0) for x, y in [(-1, 0), (0, 0), (1, 0), (0, -1)]]
    arcs = [
        gmsh.model.geo.addCircleArc(left, centre, bottom),
        gmsh.model.geo.addCircleArc(bottom, centre, right),
    ]
    gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop([*arcs, gmsh.model.geo.addLine(right, left)])])


def _annulus() -> None:
    gmsh.model.geo.addPlaneSurface([_circle_loop(1.0), _circle_loop(0.5)])


def _ball() -> None:
    """The unit ball: eight octants of the sphere, so that the equator is resolved."""
    centre, *equator, south, north = [
        gmsh.model.geo.addPoint(*point, 0)
        for point in [(0, 0, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, -1), (0, 0, 1)]
    ]
    following = equator[1:] + equator[:1]
    around = [gmsh.model.geo.addCircleArc(a, centre, b) for a, b in zip(equator, following, strict=True)]
    octants = []
    for pole in (south, north):
        up = [gmsh.model.geo.addCircleArc(a, centre, pole) for a in equator]
        for arc, here, there in zip(around, up, up[1:] + up[:1], strict=True):
            loop = gmsh.model.geo.addCurveLoop([arc, there, -here])
            octants.append(gmsh.model.geo.addSurfaceFilling([loop], sphereCenterTag=centre))
    gmsh.model.geo.addVolume([gmsh.model.geo.addSurfaceLoop(octants)])


def _cube() -> None:
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()


def _triangle_grid(h: float, diagonal: str, *, side: int, keep: Callable[[Array], npt.NDArray[np.bool_]]) -> Simplices:
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


def _tetrahedron_grid(h: float, *, side: int, keep: Callable[[Array], npt.NDArray[np.bool_]]) -> Simplices:
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


def _everywhere(x: Array) -> npt.NDArray[np.bool_]:
    return np.full(x.shape[1], True)


def _outside_notch(x: Array) -> npt.NDArray[np.bool_]:
    return (x[0] < 1) | (x[1] < 1)


def _square_grid(h: float, diagonal: str) -> Simplices:
    return _triangle_grid(h, diagonal, side=1, keep=_everywhere)


def _lshape_grid(h: float, diagonal: str) -> Simplices:
    return _triangle_grid(h, diagonal, side=2, keep=_outside_notch)


def _cube_grid(h: float, _diagonal: str) -> Simplices:
    return _tetrahedron_grid(h, side=1, keep=_everywhere)


def _lprism_grid(h: float, _diagonal: str) -> Simplices:
    return _tetrahedron_grid(h, side=2, keep=_outside_notch)


L_CORNERS = ((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2))
NOTCH = {
    "notch_x": NamedPart(lambda x: x[1], "y", contains=lambda x: np.isclose(x[0], 1) & (x[1] > 1 - 1e-9)),
    "notch_y": NamedPart(lambda x: x[0], "x", contains=lambda x: np.isclose(x[1], 1) & (x[0] > 1 - 1e-9)),
}

SHAPES: Mapping[str, Shape] = {
    "square": Shape(
        2,
        1.0,
        math.sqrt(2),
        {"left": _plane(0, 0), "right": _plane(0, 1), "bottom": _plane(1, 0), "top": _plane(1, 1)},
        _polygon((0, 0), (1, 0), (1, 1), (0, 1)),
        _square_grid,
    ),
    "lshape": Shape(
        2,
        3.0,
        2 * math.sqrt(2),
        {
            "left": _plane(0, 0),
            "right": _plane(0, 2),
            "bottom": _plane(1, 0),
            "top": _plane(1, 2),
            **NOTCH,
        },
        _polygon(*L_CORNERS),
        _lshape_grid,
    ),
    "half_disk": Shape(
        2, math.pi / 2, 2.0, {"arc": _circle(1.0, lower_half=True), "diameter": _plane(1, 0)}, _half_disk
    ),
    "annulus": Shape(2, 0.75 * math.pi, 2.0, {"inner": _circle(0.5), "outer": _circle(1.0)}, _annulus),
    "cube": Shape(
        3,
        1.0,
        math.sqrt(3),
        {
            "left": _plane(0, 0),
            "right": _plane(0, 1),
            "front": _plane(1, 0),
            "back": _plane(1, 1),
            "bottom": _plane(2, 0),
            "top": _plane(2, 1),
        },
        _cube,
        _cube_grid,
    ),
    "lprism": Shape(
        3,
        3.0,
        3.0,
        {
            "left": _plane(0, 0),
            "right": _plane(0, 2),
            "front": _plane(1, 0),
            "back": _plane(1, 2),
            **NOTCH,
            "bottom": _plane(2, 0),
            "top": _plane(2, 1),
        },
        _polygon(*L_CORNERS, height=1.0),
        _lprism_grid,
    ),
    "ball": Shape(3, 4 / 3 * math.pi, 2.0, {"lower": _hemisphere(-1), "upper": _hemisphere(1)}, _ball),
}


def estimated_cells(shape_name: str, h: float) -> float:
    """Rough number of cells of an unstructured mesh of a named shape with largest cell diameter h.

    Raises:
        InputError: If there are more than MAX_CELLS.
    """
    shape, edge = SHAPES[shape_name], 0.65 * h
    cells = shape.measure / (edge**2 * math.sqrt(3) / 4 if shape.dim == 2 else edge**3 / (6 * math.sqrt(2)))
    return _allowed(cells, h, shape_name)


def _allowed(cells: float, h: float, name: str) -> float:
    if cells > MAX_CELLS:
        raise InputError(f"h = {h:g} asks for about {cells:.1e} cells of {name}; at most {MAX_CELLS:.0e} are made")
    return cells


def build_domain(comm: MPI.Comm, shape_name: str, h: float, *, mesh: str, diagonal: str | None = None) -> Domain:
    """Mesh a named shape so that its largest cell diameter is at most h and more than h/2 (collective).

    Args:
        comm: Communicator of the mesh; rank 0 generates it.
        shape_name: Key of SHAPES.
        h: Wanted largest cell diameter.
        mesh: "unstructured" (Gmsh) or "structured".
        diagonal: How structured squares are cut: left, right (the default) or crossed.

    Raises:
        InputError: If h asks for more than MAX_CELLS cells or no mesh with this h exists.
    """
    shape = SHAPES[shape_name]
    estimated_cells(shape_name, h)  # refuses too many

    def generate() -> Simplices:
        if mesh == "structured" and shape.grid is not None:
            points, cells = shape.grid(h, diagonal or "right")
        else:
            points, cells = _gmsh_mesh(shape, h)
        achieved = float(diameters(points, cells).max())
        if not h / 2 < achieved <= h * (1 + 1e-12):
            raise InputError(
                f"h = {h:g}: {mesh} meshes of {shape_name} near this size have largest diameter {achieved:.4g}, "
                "not in (h/2, h]; choose a smaller h"
            )
        return points, cells

    simplices = on_root_only(comm, generate, shape.dim)
    return label_parts(distribute(comm, *simplices, shape.dim), shape)


def on_root_only(comm: MPI.Comm, generate: Callable[[], Simplices], dim: int) -> Simplices:
    """Generate a mesh on rank 0; the others get empty arrays, as `create_mesh` wants them (collective)."""
    made: list[Simplices] = []
    on_root(comm, lambda: made.append(generate()))
    return made[0] if made else (np.empty((0, dim)), np.empty((0, dim + 1), dtype=np.int64))


def label_parts(mesh: dolfinx.mesh.Mesh, shape: Shape) -> Domain:
    """Find the facets of each boundary part of a named shape (collective)."""
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    facets = {
        name: dolfinx.mesh.locate_entities_boundary(mesh, dim - 1, part.contains) for name, part in shape.parts.items()
    }
    return Domain(mesh, largest_diameter(mesh), shape.parts, facets, {}, BEND)


def own_domain(comm: MPI.Comm, path: str, h: float | None, conditions: Mapping[str, Sequence[str]]) -> Domain:
    """Read a mesh, or make that of a `.geo` file, and check it (collective).

    Args:
        comm: Communicator of the mesh; rank 0 reads it.
        path: Of the file.
        h: Wanted largest cell diameter of the mesh of a `.geo` file, which has sizes of its own.
        conditions: The parts with each kind of condition, see `check_boundary`.

    Raises:
        InputError: If the file, its mesh or its parts cannot be used.
    """
    read: list[FileMesh] = []

    def about() -> tuple[int, dict[str, str], tuple[str, ...], float]:
        mesh = read_mesh_file(path, h)
        try:
            check_boundary(mesh, conditions)
        except InputError as error:
            raise InputError(f"mesh {path}: {error}") from None
        read.append(mesh)
        labels = {name: AXES[_longest_axis(mesh.points[facets])] for name, facets in mesh.parts.items()}
        return mesh.dim, labels, tuple(mesh.regions), OWN_BEND / float(np.ptp(mesh.points, axis=0).max())

    dim, labels, regions, bend = on_root(comm, about)
    points, cells = np.empty((0, dim)), np.empty((0, dim + 1), dtype=np.int64)
    facets: Mapping[str, Indices] = {name: np.empty((0, dim), dtype=np.int64) for name in labels}
    inside = None
    if read:
        points, cells, facets = read[0].points, read[0].cells, read[0].parts
        inside = np.zeros((len(cells), len(regions)), dtype=bool)
        for column, chosen in enumerate(read[0].regions.values()):
            inside[chosen, column] = True
    parts = {name: axis_part(label) for name, label in labels.items()}
    return marked_domain(distribute(comm, points, cells, dim), parts, Marks(facets, inside, regions), bend)


@functools.cache
def _own_size(path: str) -> tuple[int, int, float]:
    mesh = read_mesh_file(path)
    return mesh.dim, len(mesh.cells), float(diameters(mesh.points, mesh.cells).max())


def expected_cells(path: str, h: float | None) -> float:
    """Cells of the mesh of a file; for an h asked of a `.geo` file, extrapolated from its own sizes (rank 0).

    Raises:
        InputError: If the file or its mesh cannot be used, or there are more than MAX_CELLS.
    """
    dim, cells, own_h = _own_size(path)
    return cells if h is None else _allowed(cells * (own_h / h) ** dim, h, path)


def _longest_axis(points: Array) -> int:
    return int(np.argmax(np.ptp(points.reshape(-1, points.shape[-1]), axis=0))) if points.size else 0


def _gmsh_mesh(shape: Shape, h: float) -> Simplices:
    """Mesh with Gmsh, shrinking its size parameter until no cell is larger than h (rank 0 only)."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    listen_again()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
        gmsh.option.setNumber("Mesh.MeshSizeFromPoints", 0)
        shape.outline()
        gmsh.model.geo.synchronize()
        size, achieved = {2: 0.72, 3: 0.47}[shape.dim] * h, math.inf
        while achieved > h:
            gmsh.option.setNumber("Mesh.MeshSizeMin", size)
            gmsh.option.setNumber("Mesh.MeshSizeMax", size)
            gmsh.model.mesh.clear()
            gmsh.model.mesh.generate(shape.dim)
            points, cells = _gmsh_simplices(shape.dim)
            achieved = float(diameters(points, cells).max())
            size *= 0.94 * h / achieved
        return points, cells
    finally:
        gmsh.finalize()


def _gmsh_simplices(dim: int) -> Simplices:
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    _, nodes = gmsh.model.mesh.getElementsByType({2: 2, 3: 4}[dim])  # Gmsh's numbers of triangle and tetrahedron
    row = np.empty(int(tags.max()) + 1, dtype=np.int64)
    row[tags.astype(np.int64)] = np.arange(len(tags))
    used, cells = np.unique(row[nodes.astype(np.int64)], return_inverse=True)  # drops centres of circles
    return coordinates.reshape(-1, 3)[used, :dim], cells.reshape(-1, dim + 1).astype(np.int64)
