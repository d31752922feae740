"""Water in pictures: its head, whatever of it u is, and the water outside; of Baiocchi's dam its streamlines."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.polylines import chains
from signorini_fenicsx.contact.laws import River
from signorini_fenicsx.discrete.mesh_spaces import DIRICHLET
from signorini_fenicsx.physics.diffusion.show.heads import INTEGRAL, SAME, Water
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.gather import DrawnFields
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
        water: What u is of it.
        head: Its head at the points of the scene.
        pressure: Its pressure head there.
        pools: In the plane outlines of the water outside, each of shape (n, 2), in space the triangles that it wets.
        only: Mask of the cells that are wet, if there is nothing to be seen in the others.
    """

    water: Water
    head: Array
    pressure: Array
    pools: list[Array]
    only: Mask | None

    @classmethod
    def of(cls, scene: Scene) -> "Pools | None":
        """The water of a problem, None for other problems."""
        water: Water | None = getattr(scene.solution, "water_kind", None)
        if water is None:
            return None
        at = scene.fields.points, u_at_points(scene), scene.fields.at_points["sigma"]
        only = wet(scene.fields) if water.u == INTEGRAL else None
        return cls(water, water.head(*at), water.pressure(*at), _pools(scene, water), only)

    def heads_on(self, sites: Any, dim: int) -> dict[str, Array]:
        """The columns of a table of Γ_S that have u, or bounds of it, as heads."""
        x = {
            key: sites.x_at if key.endswith("_at") else sites.x
            for key in ("p", "u", "psi", "p_at")
            if key in vars(sites)
        }
        return {key: self.water.head(at[..., :dim], getattr(sites, key)) for key, at in x.items()}

    def overlays(self) -> list[Overlay]:
        """The water outside with its level."""
        blue: dict[str, Any] = {"color": style.WATER}
        if self.pools and self.pools[0].shape[1] == 3:
            return [Overlay("water outside", self.pools, blue | {"opacity": 0.5})]
        levels = [
            np.column_stack([np.linspace(pool[:, 0].min(), pool[:, 0].max(), 3), np.full(3, pool[:, 1].max())])
            for pool in self.pools
        ]
        mark = {"linewidth": 1.2, "marker": 7, "markevery": slice(1, None, 4), "markersize": 5, "markeredgewidth": 0}
        return [
            Overlay("", self.pools, {"facecolors": style.WATER, "alpha": 0.35, "linewidths": 0}, filled=True),
            Overlay("water outside", levels, blue | mark),
        ]


def u_at_points(scene: Scene) -> Array:
    """u_h at the points of the scene: p_h on Γ_S, u_D on Γ_D, elsewhere the mean over the cells around."""
    inner, known = scene.fields.at_points["u"][:, 0], scene.boundary.known[:, 0]
    finite = np.isfinite(known)
    vertices = scene.boundary.vertices[finite].ravel()
    count = np.bincount(vertices, minlength=len(inner))
    total = np.bincount(vertices, np.repeat(known[finite], scene.dim), minlength=len(inner))
    return np.where(count > 0, total / np.maximum(count, 1), inner)


def _levels(scene: Scene, water: Water) -> tuple[Indices, Array]:
    """The facets that water outside may wet, and its level before each, NaN where there is none.

    These are walls where u is given, on Γ_S where the pressure is positive, and rivers. Of Baiocchi's dam they are
    upright.
    """
    boundary, points = scene.boundary, scene.fields.points
    given = boundary.vertices[boundary.kind == DIRICHLET]
    middle, dam = points[given].mean(axis=1), getattr(scene.solution.source, "dam", None)
    if dam is not None:
        levels = np.where(middle[:, 0] < dam.L / 2, dam.H, dam.h)
        return given, np.where(np.ptp(points[given][:, :, 0], axis=1) == 0, levels, np.nan)
    x = scene.facets.x[:, : scene.dim]
    on_gamma = water.head(x, scene.on_facets("p"))
    on_gamma[on_gamma <= x[:, -1] + SAME * float(np.ptp(points[:, -1]))] = np.nan
    laws = scene.solution.data.laws.of_parts
    rivers = [part for each in laws if isinstance(each.law, River) for part in each.law.parts]
    at_river = np.isin(scene.facets.part, [index for index, part in enumerate(scene.labels) if part in rivers])
    on_gamma[at_river] = water.head(x, scene.on_facets("psi"))[at_river]
    level = water.head(middle, boundary.known[boundary.kind == DIRICHLET, 0])
    return np.concatenate([given, scene.facets.vertices]), np.concatenate([level, on_gamma])


def _pools(scene: Scene, water: Water) -> list[Array]:
    """Outlines of the water before walls that it wets, in space what it wets."""
    points = scene.fields.points
    size, (facets, level) = float(np.ptp(points[:, -1])), _levels(scene, water)
    if scene.dim == 3:
        return list(points[facets[level > points[facets][:, :, 2].mean(axis=1)]])
    pools = []
    for each in np.unique(np.round(level[np.isfinite(level)] / size, 7)) * size:
        near = np.isclose(level, each, rtol=0, atol=SAME * size)
        top = float(np.median(level[near]))
        for _, vertices in chains(facets[near]):
            wall = points[vertices]
            wall = wall[wall[:, 1] <= top + SAME * size]
            if len(wall) and np.ptp(wall[:, 1]) > WALL * size:
                pools.append(_pool(wall, top, points))
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


def wet(fields: DrawnFields) -> Mask:
    """The cells of Baiocchi's dam below the phreatic line."""
    dry = fields.in_cells["contact"]
    return np.ones(len(dry), dtype=bool) if dry.all() else ~dry


def water_lines(fields: DrawnFields) -> tuple[list[Array], Array]:
    """Streamlines of the water in Baiocchi's dam, and arrow heads, as `streamlines` has them.

    With the pressure −∂w/∂y and Δw = 1 the velocity is (∂²w/∂x∂y, −∂²w/∂x²). So its stream function is ∂w/∂x, whose
    level lines are drawn.
    """
    cells, stream = fields.cells[wet(fields)], fields.at_points["sigma"][:, 0]
    seen = stream[cells]
    levels = np.linspace(float(seen.min()), float(seen.max()), WATER_LINES + 2)[1:-1]
    lines = level_lines(fields.points, cells, stream, levels) if levels[-1] > levels[0] else []
    lines = [line if line[-1, 0] > line[0, 0] else line[::-1] for line in lines]
    return lines, heads(lines, (fields.points.min(axis=0), fields.points.max(axis=0)))
