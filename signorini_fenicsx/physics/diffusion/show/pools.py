"""Water in pictures: its head, whatever of it u is, and the water outside; of Baiocchi's dam its streamlines."""

from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.polylines import chains
from signorini_fenicsx.discrete.mesh_spaces import DIRICHLET
from signorini_fenicsx.physics.diffusion.show.heads import INTEGRAL, SAME, Water
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.gather import Fields
from signorini_fenicsx.pictures.geometry import level_lines
from signorini_fenicsx.pictures.panels import Overlay
from signorini_fenicsx.pictures.scene import Scene
from signorini_fenicsx.pictures.streams import heads

WALL = 0.02
"""Water stands before a wall that is at least as high as this share of the domain."""


@dataclass(frozen=True)
class Pools:
    """The water inside and outside a domain.

    Attributes:
        head: Its head at the points of the scene.
        pressure: Its pressure head there.
        pools: In the plane outlines of the water outside, each of shape (n, 2).
    """

    head: Array
    pressure: Array
    pools: list[Array]

    @classmethod
    def of(cls, scene: Scene) -> "Pools | None":
        """The water of a problem, None for other problems and of Baiocchi's dam."""
        water: Water | None = getattr(scene.solution, "water_kind", None)
        if water is None or water.u == INTEGRAL:
            return None
        points = scene.fields.points
        head, pressure = water.head(points, scene.u), water.pressure(points, scene.u)
        return cls(head, pressure, _pools(scene, water) if scene.dim == 2 else [])

    def overlays(self) -> list[Overlay]:
        """The water outside with its level."""
        blue = {"color": style.WATER}
        levels = [
            np.column_stack([np.linspace(pool[:, 0].min(), pool[:, 0].max(), 3), np.full(3, pool[:, 1].max())])
            for pool in self.pools
        ]
        mark = {"linewidth": 1.2, "marker": 7, "markevery": slice(1, None, 4), "markersize": 5, "markeredgewidth": 0}
        return [
            Overlay("", self.pools, {"facecolors": style.WATER, "alpha": 0.35, "linewidths": 0}, filled=True),
            Overlay("water outside", levels, blue | mark),
        ]


def _pools(scene: Scene, water: Water) -> list[Array]:
    """Outlines of the water before walls that it wets: parts of Γ_D with one head, and rivers."""
    boundary, points = scene.boundary, scene.fields.points
    size, middle = float(np.ptp(points[:, 1])), points[boundary.vertices].mean(axis=1)
    level = np.where(boundary.kind == DIRICHLET, water.head(middle, boundary.u), np.nan)
    pools = []
    for each in np.unique(np.round(level[np.isfinite(level)] / size, 9)) * size:
        for _, vertices in chains(boundary.vertices[np.isclose(level, each, rtol=0, atol=SAME * size)]):
            wall = points[vertices]
            wall = wall[wall[:, 1] <= each + SAME * size]
            if len(wall) and np.ptp(wall[:, 1]) > WALL * size:
                pools.append(_pool(wall, each, points))
    return pools


def _pool(wall: Array, level: float, domain: Array) -> Array:
    """The outline of the water before a wall, from the base up to its level; a quarter of the domain's height wide."""
    order = np.argsort(wall[:, 1])
    wall = wall[order]
    left = wall[:, 0].mean() < domain[:, 0].mean()
    away = 0.25 * float(np.ptp(domain[:, 1]))
    end = domain[:, 0].min() - away if left else domain[:, 0].max() + away
    return np.concatenate([wall, [[wall[-1, 0], level], [end, level], [end, wall[0, 1]]]])


WATER_LINES = 14
"""Streamlines of the water in Baiocchi's dam; between two neighbours the discharge is the same."""


def wet(fields: Fields) -> Mask:
    """The cells of Baiocchi's dam below the phreatic line."""
    dry = fields.in_cells["contact"]
    return np.ones(len(dry), dtype=bool) if dry.all() else ~dry


def water_lines(fields: Fields) -> tuple[list[Array], Array]:
    """Streamlines of the water in Baiocchi's dam, and arrow heads, as `streamlines` has them.

    With the pressure −∂w/∂y and Δw = 1 the velocity is (∂²w/∂x∂y, −∂²w/∂x²). So its stream function is ∂w/∂x, whose
    level lines are drawn.
    """
    cells, stream = fields.cells[wet(fields)], fields.at_points["sigma"][:, 0]
    seen = stream[cells]
    levels = np.linspace(float(seen.min()), float(seen.max()), WATER_LINES + 2)[1:-1]
    lines = level_lines(fields.points, cells, stream, levels) if levels[-1] > levels[0] else []
    lines = [line if line[-1, 0] > line[0, 0] else line[::-1] for line in lines]
    return lines, heads(lines, float(np.ptp(fields.points, axis=0).max()))
