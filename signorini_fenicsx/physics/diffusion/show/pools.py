"""Seepage: if ψ is minus the height, u is minus the head of water, and the pictures show the water."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.discrete.mesh_spaces import DIRICHLET
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.gather import Fields
from signorini_fenicsx.pictures.geometry import chains, level_lines
from signorini_fenicsx.pictures.panels import Overlay
from signorini_fenicsx.pictures.scene import Scene
from signorini_fenicsx.pictures.streams import heads


@dataclass(frozen=True)
class Pools:
    """The water inside and outside a domain in the plane.

    Attributes:
        scene: The solution.
        pools: Outlines of the water outside, each of shape (n, 2).
    """

    scene: Scene
    pools: list[Array]

    @classmethod
    def of(cls, scene: Scene) -> Pools | None:
        """The water of a problem in the plane whose ψ is −y, None for other problems."""
        y, psi = scene.facets.x[:, 1], getattr(scene.sites, "psi", None)
        if psi is None or len(y) == 0 or scene.dim == 3:
            return None
        size = float(np.ptp(scene.fields.points[:, 1]))
        if not np.allclose(psi, -y, rtol=0, atol=1e-6 * size) or np.ptp(y) < 0.05 * size:
            return None
        boundary = scene.boundary
        is_dirichlet = boundary.kind == DIRICHLET
        pools = []
        for level in np.unique(np.round(-boundary.u[is_dirichlet] / size, 9)) * size:
            below = is_dirichlet & np.isclose(-boundary.u, level, rtol=0, atol=1e-6 * size)
            for _, vertices in chains(boundary.vertices[below]):
                points = scene.fields.points[vertices]
                if points[:, 1].max() <= level + 1e-6 * size:
                    pools.append(_pool(points, level, scene.fields.points))
        return cls(scene, pools)

    def overlays(self) -> list[Overlay]:
        """The water outside with its level, and the water table, on which the pressure is 0."""
        fields, blue = self.scene.fields, {"color": style.WATER}
        levels = [
            np.column_stack([np.linspace(pool[:, 0].min(), pool[:, 0].max(), 3), np.full(3, pool[:, 1].max())])
            for pool in self.pools
        ]
        pressure = -self.scene.u - fields.points[:, 1]
        at_0 = pressure.min() < 0 < pressure.max()
        table = level_lines(fields.points, fields.cells, pressure, [0.0]) if at_0 else []
        mark = {"linewidth": 1.2, "marker": 7, "markevery": slice(1, None, 4), "markersize": 5, "markeredgewidth": 0}
        return [
            Overlay("", self.pools, {"facecolors": style.WATER, "alpha": 0.35, "linewidths": 0}, filled=True),
            Overlay("water table", table, {"color": "black", "linewidth": 1.8}),
            Overlay("water outside", levels, blue | mark),
        ]


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
