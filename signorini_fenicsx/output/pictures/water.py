"""Seepage: if ψ is minus the height, u is minus the head of water, and the pictures show the water."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.tri import Triangulation

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.mesh_spaces import DIRICHLET
from signorini_fenicsx.output.gather import Fields
from signorini_fenicsx.output.pictures import style
from signorini_fenicsx.output.pictures.scene import Scene, chains
from signorini_fenicsx.output.pictures.streams import ARROW, head


@dataclass(frozen=True)
class Water:
    """The water inside and outside a domain in the plane.

    Attributes:
        scene: The solution.
        pools: Outlines of the water outside, each of shape (n, 2).
    """

    scene: Scene
    pools: list[Array]

    @classmethod
    def of(cls, scene: Scene) -> Water | None:
        """The water of a problem whose ψ is −y, None for other problems."""
        y, psi = scene.facets.x[:, 1], vars(scene.facets).get("psi")
        if psi is None or len(y) == 0:
            return None
        size = float(np.ptp(scene.fields.points[:, 1]))
        if not np.allclose(psi, -y, rtol=0, atol=1e-6 * size) or np.ptp(y) < 0.05 * size:
            return None
        boundary = scene.boundary
        is_dirichlet = boundary.kind == DIRICHLET
        pools = []
        for level in np.unique(np.round(-boundary.u[is_dirichlet] / size, 9)) * size:
            wet = is_dirichlet & np.isclose(-boundary.u, level, rtol=0, atol=1e-6 * size)
            for _, vertices in chains(boundary.vertices[wet]):
                points = scene.fields.points[vertices]
                if points[:, 1].max() <= level + 1e-6 * size:
                    pools.append(_pool(points, level, scene.fields.points))
        return cls(scene, pools)

    def draw(self, axes: Axes) -> None:
        """Draw the water outside with its level, and the water table, on which the pressure is 0."""
        size = float(np.ptp(self.scene.fields.points[:, 1]))
        for pool in self.pools:
            axes.fill(*pool.T, color=style.WATER, alpha=0.35, linewidth=0)
            low, high, level = pool[:, 0].min(), pool[:, 0].max(), pool[:, 1].max()
            axes.plot([low, high], [level, level], color=style.WATER, linewidth=1.2)
            axes.plot((low + high) / 2, level + 0.03 * size, "v", color=style.WATER, markersize=5)
        fields = self.scene.fields
        pressure = -self.scene.u - fields.points[:, 1]
        if pressure.min() < 0 < pressure.max():
            axes.tricontour(
                Triangulation(*fields.points.T, fields.cells), pressure, [0.0], colors="black", linewidths=1.8
            )

    def handles(self) -> list:
        """The entries of the legend for the water."""
        table = Line2D([], [], color="black", linewidth=1.8, label="water table")
        level = Line2D([], [], color=style.WATER, marker="v", linewidth=1.2, label="water outside")
        return [table, level]


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


def wet(fields: Fields) -> Triangulation:
    """The triangles of Baiocchi's dam below the phreatic line."""
    dry = fields.contact
    return Triangulation(*fields.points.T, fields.cells if dry is None or dry.all() else fields.cells[~dry])


def water_lines(fields: Fields) -> tuple[list[Array], Array]:
    """Streamlines of the water in Baiocchi's dam, and arrow heads, as `streamlines` has them.

    With the pressure −∂w/∂y and Δw = 1 the velocity is (∂²w/∂x∂y, −∂²w/∂x²). So its stream function is ∂w/∂x, whose
    level lines are drawn.
    """
    triangles, stream = wet(fields), fields.sigma_at_points[:, 0]
    seen = stream[triangles.triangles]
    levels = np.linspace(float(seen.min()), float(seen.max()), WATER_LINES + 2)[1:-1]
    if not levels[-1] > levels[0]:
        return [], np.empty((0, 3, 2))
    drawn = Figure().add_subplot().tricontour(triangles, stream, levels)
    lines = [
        line if line[-1, 0] > line[0, 0] else line[::-1] for each in drawn.allsegs for line in each if len(line) > 2
    ]
    size = float(np.ptp(fields.points, axis=0).max())
    return lines, np.array([head(line, ARROW * size) for line in lines]).reshape(-1, 3, 2)
