"""The named shapes: their boundary parts, their outlines for Gmsh and their structured meshes.

A rectangle has its corners in its name: "[-2, 2] x [0, 1]" is −2 < x < 2, 0 < y < 1.
"""

import functools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import gmsh
import numpy as np

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import did_you_mean
from signorini_fenicsx.expressions import parse_number
from signorini_fenicsx.meshes.domain import Part, other_side
from signorini_fenicsx.meshes.grids import Share, Simplices, l_grid, rectangle_grid, tetrahedron_grid

TINY = np.finfo(np.float64).tiny
THINNEST = 1e-9
"""The least share of the longer side of a rectangle that the other one is: in thinner ones solutions are rounding."""
SAME = 1e-6
"""A point is on a side if it is nearer than this share of the size of the shape, across the side."""


@dataclass(frozen=True)
class NamedPart(Part):
    """A boundary part of a named shape.

    Attributes:
        contains: Maps points of shape (3, n) to a mask of those on the part.
        side: Of an inner part 1 for its upper side, −1 for its lower one; 0 for parts of the boundary.
    """

    contains: Callable[[Array], Mask] = field(kw_only=True)
    side: int = 0


@dataclass(frozen=True)
class Shape:
    """A named domain.

    Attributes:
        dim: Dimension, 2 or 3.
        measure: Area or volume.
        diameter: Largest distance between two of its points.
        parts: Boundary parts; they cover the boundary. Inner parts are among them, with both sides.
        outline: Adds the domain to the current Gmsh model, with its corner in the origin if there is a `corner`.
        grid: Makes a rank's share of the structured mesh for h and a diagonal; None if there is none.
        corner: Where the outline has to be moved to: Gmsh's tolerances do not suit coordinates that are far from 0.
    """

    dim: int
    measure: float
    diameter: float
    parts: Mapping[str, NamedPart]
    outline: Callable[[], None]
    grid: Callable[[float, str, Share], Simplices] | None = None
    corner: tuple[float, ...] = ()

    @property
    def names(self) -> list[str]:
        """The parts, each inner one once."""
        return [name for name, part in self.parts.items() if part.side >= 0]

    @property
    def inside(self) -> list[str]:
        """The inner parts."""
        return [name for name, part in self.parts.items() if part.side > 0]


def _plane(axis: int, value: float, size: float) -> NamedPart:
    """The side on which this coordinate has this value; `size` is that of the domain in this direction."""
    other, off = 1 - min(axis, 1), SAME * size
    return NamedPart(lambda x: x[other], "xy"[other], contains=lambda x: np.abs(x[axis] - value) <= off)


def _between(names: str, axis: int, low: float, high: float) -> dict[str, NamedPart]:
    """The two sides at the ends of an interval of a coordinate, by their names."""
    return {name: _plane(axis, end, high - low) for name, end in zip(names.split(), (low, high), strict=True)}


def _circle(radius: float, *, lower_half: bool = False) -> NamedPart:
    """A circle with the angle from the positive x axis: −π to 0 for the lower half, −π to π for the whole circle."""

    def contains(x: Array) -> Mask:
        on = np.abs(np.hypot(x[0], x[1]) - radius) <= SAME
        return on & (x[1] <= SAME) if lower_half else on

    return NamedPart(
        lambda x: np.arctan2(x[1], x[0]),
        "angle",
        lambda x: x * radius / np.maximum(np.hypot(x[0], x[1]), TINY),
        contains=contains,
    )


def _hemisphere(sign: int) -> NamedPart:
    """The half of the unit sphere with sign·z ≥ 0."""

    def contains(x: Array) -> Mask:
        return (np.abs(np.linalg.norm(x, axis=0) - 1) <= SAME) & (sign * x[2] >= -SAME)

    return NamedPart(lambda x: x[2], "z", lambda x: x / np.maximum(np.linalg.norm(x, axis=0), TINY), contains=contains)


def _polygon(*corners: tuple[float, float], height: float = 0.0) -> Callable[[], None]:
    """A polygon in the plane z = 0, or with a height > 0 the prism above it."""

    def outline() -> None:
        _, base = _filled(corners)
        if height > 0:
            gmsh.model.geo.extrude([(2, base)], 0, 0, height)

    return outline


def _filled(corners: Sequence[tuple[float, float]]) -> tuple[list[int], int]:
    """The corners of a polygon in the plane z = 0, and its surface."""
    points = [gmsh.model.geo.addPoint(x, y, 0) for x, y in corners]
    lines = [gmsh.model.geo.addLine(a, b) for a, b in zip(points, points[1:] + points[:1], strict=True)]
    return points, gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(lines)])


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


def _slit_square() -> None:
    """The square (−1, 1)² with a line in it, from the middle of its left side to its centre."""
    points, square = _filled([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, 0)])
    slit = gmsh.model.geo.addLine(points[-1], gmsh.model.geo.addPoint(0, 0, 0))
    gmsh.model.geo.synchronize()
    gmsh.model.mesh.embed(1, [slit], 2, square)


def _slit(side: int) -> NamedPart:
    return NamedPart(lambda x: x[0], "x", contains=lambda x: (np.abs(x[1]) <= SAME) & (x[0] <= SAME), side=side)


def _ball() -> None:
    """The unit ball, made of eight octants, so that the mesh resolves the equator."""
    centre, *equator, south, north = [
        gmsh.model.geo.addPoint(*point, 0)
        for point in [(0, 0, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, -1), (0, 0, 1)]
    ]
    following = equator[1:] + equator[:1]
    around = [gmsh.model.geo.addCircleArc(a, centre, b) for a, b in zip(equator, following, strict=True)]
    octants = []
    for pole in (south, north):
        up = [gmsh.model.geo.addCircleArc(a, centre, pole) for a in equator]
        for arc, begin, end in zip(around, up, up[1:] + up[:1], strict=True):
            loop = gmsh.model.geo.addCurveLoop([arc, end, -begin])
            octants.append(gmsh.model.geo.addSurfaceFilling([loop], sphereCenterTag=centre))
    gmsh.model.geo.addVolume([gmsh.model.geo.addSurfaceLoop(octants)])


def _cube() -> None:
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()


@functools.cache
def _rectangle(left: float, right: float, low: float, high: float) -> Shape:
    width, height = right - left, high - low
    return Shape(
        2,
        width * height,
        math.hypot(width, height),
        _between("left right", 0, left, right) | _between("bottom top", 1, low, high),
        _polygon((0, 0), (width, 0), (width, height), (0, height)),
        functools.partial(rectangle_grid, np.array([left, low]), np.array([right, high])),
        (left, low),
    )


L_CORNERS = ((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2))
NOTCH = {
    "notch_x": NamedPart(lambda x: x[1], "y", contains=lambda x: (np.abs(x[0] - 1) <= SAME) & (x[1] >= 1 - SAME)),
    "notch_y": NamedPart(lambda x: x[0], "x", contains=lambda x: (np.abs(x[1] - 1) <= SAME) & (x[0] >= 1 - SAME)),
}

SHAPES: Mapping[str, Shape] = {
    "square": _rectangle(0.0, 1.0, 0.0, 1.0),
    "lshape": Shape(
        2,
        3.0,
        2 * math.sqrt(2),
        _between("left right", 0, 0, 2) | _between("bottom top", 1, 0, 2) | NOTCH,
        _polygon(*L_CORNERS),
        l_grid,
    ),
    "slit": Shape(
        2,
        4.0,
        2 * math.sqrt(2),
        _between("left right", 0, -1, 1)
        | _between("bottom top", 1, -1, 1)
        | {"slit": _slit(1), other_side("slit"): _slit(-1)},
        _slit_square,
    ),
    "half_disk": Shape(
        2, math.pi / 2, 2.0, {"arc": _circle(1.0, lower_half=True), "diameter": _plane(1, 0, 1)}, _half_disk
    ),
    "annulus": Shape(2, 0.75 * math.pi, 2.0, {"inner": _circle(0.5), "outer": _circle(1.0)}, _annulus),
    "cube": Shape(
        3,
        1.0,
        math.sqrt(3),
        _between("left right", 0, 0, 1) | _between("front back", 1, 0, 1) | _between("bottom top", 2, 0, 1),
        _cube,
        tetrahedron_grid,
    ),
    "lprism": Shape(
        3,
        3.0,
        3.0,
        _between("left right", 0, 0, 2) | _between("front back", 1, 0, 2) | NOTCH | _between("bottom top", 2, 0, 1),
        _polygon(*L_CORNERS, height=1.0),
        functools.partial(tetrahedron_grid, side=2),
    ),
    "ball": Shape(3, 4 / 3 * math.pi, 2.0, {"lower": _hemisphere(-1), "upper": _hemisphere(1)}, _ball),
}


INTERVAL = r"\s*\[([^,\[\]]*),([^,\[\]]*)\]\s*"


def shape_of(name: str) -> Shape:
    """The shape with this name.

    Raises:
        InputError: If there is none, or an interval of a rectangle is empty.
    """
    return SHAPES[name] if name in SHAPES else _rectangle(*_intervals(name))


def full_name(name: str) -> str:
    """The name of a shape as it is in results: with the numbers of a rectangle as decimals.

    Raises:
        InputError: If there is no such shape, or an interval of a rectangle is empty.
    """
    if name in SHAPES:
        return name
    ends = [repr(end).removesuffix(".0") for end in _intervals(name)]
    return "[{}, {}] x [{}, {}]".format(*ends)


def _intervals(name: str) -> tuple[float, float, float, float]:
    """The ends of both intervals of a rectangle.

    Raises:
        InputError: If this is not the name of one.
    """
    match = re.fullmatch(f"{INTERVAL}x{INTERVAL}", name)
    if match is None:
        meant = did_you_mean(name, SHAPES)
        raise InputError(
            f"unknown shape '{name}'; use one of {', '.join(SHAPES)}, or a rectangle such as '[-2, 2] x [0, 1]'{meant}"
        )
    left, right, low, high = (parse_number(end.strip()) for end in match.groups())
    if not (left < right and low < high):
        raise InputError(f"shape '{name}': each interval must begin with the smaller number")
    shorter, longer = sorted((right - left, high - low))
    if not (shorter >= THINNEST * longer and 1e-60 < longer < 1e60):
        sides = f"sides of {shorter:.3g} and {longer:.3g}"
        raise InputError(f"shape '{name}': {sides} are too different, or outside 1e-60 … 1e60")
    return left, right, low, high
