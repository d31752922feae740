"""Maps of a solution in the plane: u_h, σ_h, the certificate, the mesh. Each is drawn into given axes."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LogNorm
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.tolerances import ROUNDING, TIE
from signorini_fenicsx.discrete.mesh_spaces import DIRICHLET, NEUMANN
from signorini_fenicsx.output.pictures import style
from signorini_fenicsx.output.pictures.scene import Scene, chains, thinned
from signorini_fenicsx.output.pictures.sheet import Sheet
from signorini_fenicsx.output.pictures.streams import streamlines
from signorini_fenicsx.output.pictures.water import Water, water_lines, wet
from signorini_fenicsx.solving.drawn import PARTLY_FIXED

MOST_FACES = 4_000
"""Most faces of a surface in perspective, which Matplotlib sorts and paints one by one."""
WIDE = 1.8
"""If width over height of a domain is above this, panels are below each other, and no surface is drawn."""


@dataclass(frozen=True)
class Plane:
    """The maps of a solution in the plane."""

    scene: Scene

    @cached_property
    def frame(self) -> Array:
        """Smallest and largest coordinates of what is drawn, with some room, shape (2, 2)."""
        pools = [] if self.water is None else self.water.pools
        return framed(np.concatenate([self.scene.fields.points, *pools]))

    @property
    def aspect(self) -> float:
        """Width over height."""
        width, height = np.ptp(self.frame, axis=0)
        return float(width / height)

    @property
    def wide(self) -> bool:
        """Whether the domain is much wider than high."""
        return self.aspect > WIDE

    @cached_property
    def water(self) -> Water | None:
        """The water of a seepage problem; None for other problems."""
        return Water.of(self.scene)

    @cached_property
    def triangulation(self) -> Triangulation:
        """The painted triangles."""
        return Triangulation(*self.scene.fields.points.T, self.scene.fields.cells)

    @cached_property
    def streams(self) -> tuple[list[Array], Array]:
        """Streamlines of the physical flux and their arrow heads."""
        fields = self.scene.fields
        if self.scene.phreatic_line is not None:
            return water_lines(fields)
        sign = self.scene.plot.sign
        return streamlines(replace(fields, sigma=sign * fields.sigma, divergence=sign * fields.divergence))

    @property
    def u_label(self) -> str:
        """The name of u in labels."""
        return "$H = -u_h$" if self.water and not self.scene.plot.u else self.scene.plot.u_label

    @property
    def flux_title(self) -> str:
        """What the map of the flux shows."""
        if self.scene.phreatic_line is not None:
            return r"water on its head $y - \partial_y u_h$"
        plot = self.scene.plot
        return plot.flux_name if plot.flux else f"{plot.flux_name} on {plot.flux_label}"

    @cached_property
    def outline(self) -> Outline:
        """The domain as one path, with its holes."""
        points = self.scene.fields.points
        loops = [points[vertices] for _, vertices in chains(self.scene.boundary.vertices)]
        outlines = [Outline(loop) for loop in loops]
        paths = []
        for loop in loops:
            hole = sum(other.contains_point(loop[:2].mean(axis=0)) for other in outlines if other.vertices is not loop)
            area = np.sum(loop[:-1, 0] * loop[1:, 1] - loop[1:, 0] * loop[:-1, 1])
            forwards = (area > 0) == (hole % 2 == 0)
            codes = [Outline.MOVETO, *[Outline.LINETO] * (len(loop) - 2), Outline.CLOSEPOLY]
            paths.append(Outline(loop if forwards else loop[::-1], codes))
        return Outline.make_compound_path(*paths)

    def draw_u(self, sheet: Sheet, axes: Axes, title: str) -> None:
        """u_h as a map with contour lines."""
        scene = self.scene
        values = -scene.u if self.water else scene.u
        image = axes.tripcolor(self.triangulation, values, cmap=style.U_MAP, shading="gouraud", rasterized=True)
        levels = scene.plot.levels or levels_between(float(values.min()), float(values.max()))
        bar = sheet.bar(axes, image, self.u_label)
        if levels:  # none where u is constant
            settled = on_levels(values, levels)
            lines = axes.tricontour(self.triangulation, settled, levels, colors="white", linewidths=0.6, alpha=0.8)
            bar.add_lines(lines)
        self._surroundings(axes, title)

    def draw_surface(self, axes: Axes, title: str) -> None:
        """u_h as a surface over the domain, seen from the side of Γ_S."""
        scene = self.scene
        points = scene.fields.points
        triangles, _ = thinned(points, scene.fields.cells, MOST_FACES)
        axes.plot_trisurf(
            *points.T, scene.u, triangles=triangles, cmap=style.U_MAP, linewidth=0, antialiased=False, rasterized=True
        )
        for group in scene.groups:
            for _, vertices in chains(scene.facets.vertices[group.facets]):
                axes.plot(*points[vertices].T, scene.u[vertices], color=group.colour, linewidth=2, zorder=10)
        facets = scene.facets.x[:, :2]
        seen = np.average(facets, axis=0, weights=scene.facets.measure) if len(facets) > 0 else points.mean(axis=0)
        side = seen - points.mean(axis=0)
        far = np.linalg.norm(side) > 0.1 * np.ptp(points, axis=0).max()
        azimuth = np.degrees(np.arctan2(side[1], side[0])) if far else -90.0
        axes.view_init(elev=28, azim=azimuth + 30)
        axes.set(xlabel="$x$", ylabel="$y$", title=title)
        axes.set_box_aspect((*np.ptp(points, axis=0) / np.ptp(points, axis=0).max(), 0.55), zoom=1.25)
        axes.locator_params(nbins=4)

    def draw_sigma(self, sheet: Sheet, axes: Axes, title: str) -> None:
        """Streamlines of the physical flux on its length; of Baiocchi's dam those of the water on its head."""
        scene, triangles = self.scene, self.triangulation
        low, high, extend = style.limits(scene.sigma_norm, scene.measure)
        values, label = np.linalg.norm(scene.fields.sigma_at_points, axis=1), scene.plot.flux_label
        if scene.phreatic_line is not None:
            triangles, values = wet(scene.fields), scene.fields.points[:, 1] - scene.fields.sigma_at_points[:, 1]
            seen = values[triangles.triangles]
            low, high, extend, label = float(seen.min()), float(seen.max()), "neither", "head"
        image = axes.tripcolor(
            triangles, values, cmap=style.FLUX_MAP, vmin=low, vmax=high, shading="gouraud", rasterized=True
        )
        sheet.bar(axes, image, label, extend)
        lines, heads = self.streams
        clip = PathPatch(self.outline, transform=axes.transData)
        for drawn in (LineCollection(lines, colors="white", linewidths=0.7), PolyCollection(heads, facecolors="white")):
            axes.add_collection(drawn, autolim=False)
            drawn.set_clip_path(clip)
        self._surroundings(axes, title)

    def draw_certificate(self, sheet: Sheet, axes: Axes, title: str) -> None:
        """η_T, the contribution of each cell to the certified error, on a logarithmic scale."""
        indicator = self.scene.fields.indicator
        assert indicator is not None
        norm = log_norm(indicator)
        image = axes.tripcolor(
            self.triangulation, np.maximum(indicator, norm.vmin), norm=norm, cmap=style.ERROR_MAP, rasterized=True
        )
        sheet.bar(axes, image, r"$\eta_T$")
        self._surroundings(axes, title)

    def draw_mesh(self, axes: Axes) -> None:
        """The mesh."""
        axes.triplot(self.triangulation, color="0.55", linewidth=0.3)
        self._surroundings(axes, self.scene.fields.count)

    def handles(self) -> list:
        """The entries of the legend of a map."""
        scene = self.scene
        kinds = set(scene.boundary.kind.tolist())
        seepage = " (seepage face)" if self.water else ""
        listed = [
            (
                True,
                f"{scene.gamma}, {group.name}" + seepage * (group.name == "contact"),
                {"color": group.colour, "linewidth": 3},
            )
            for group in scene.groups
        ]
        listed += [
            (DIRICHLET in kinds, r"$\Gamma_D$", {"color": "black", "linewidth": 1.2}),
            (NEUMANN in kinds, r"$\Gamma_N$", {"color": "black", "linewidth": 1.2, "linestyle": ":"}),
            (PARTLY_FIXED in kinds, "partly fixed", {"color": "black", "linewidth": 1.2, "linestyle": "-."}),
            (len(scene.free_boundary()) > 0, scene.edges, {"color": style.CONTACT, "linewidth": 1.8}),
            (scene.phreatic_line is not None, "phreatic line", {"color": style.WATER, "linewidth": 1.8}),
            (len(scene.interfaces()) > 0, "regions", {"color": "black", "linewidth": 0.8, "linestyle": "--"}),
        ]
        handles = [Line2D([], [], label=label, **look) for is_drawn, label, look in listed if is_drawn]
        return handles + ([] if self.water is None else self.water.handles())

    def _surroundings(self, axes: Axes, title: str) -> None:
        """Boundary, regions and water, the same on all maps."""
        scene = self.scene
        points = scene.fields.points
        if self.water is not None:
            self.water.draw(axes)
        if scene.fields.contact is not None:
            zone = points[scene.fields.cells[scene.fields.contact]]
            tint = PolyCollection(zone, facecolors=style.CONTACT, alpha=0.25, linewidths=0, rasterized=True)
            axes.add_collection(tint, autolim=False)
            axes.add_collection(LineCollection(points[scene.free_boundary()], colors=style.CONTACT, linewidths=1.8))
        if scene.phreatic_line is not None:
            axes.plot(*scene.phreatic_line.T, color=style.WATER, linewidth=1.8)
        inner = LineCollection(points[scene.interfaces()], colors="black", linewidths=0.8, linestyles="--")
        axes.add_collection(inner)
        for kind, look in ((DIRICHLET, "-"), (NEUMANN, ":"), (PARTLY_FIXED, "-.")):
            for _, vertices in chains(scene.boundary.vertices[scene.boundary.kind == kind]):
                axes.plot(*points[vertices].T, color="black", linewidth=1.2, linestyle=look, clip_on=False)
        edge = [patheffects.Stroke(linewidth=4.5, foreground="black"), patheffects.Normal()]
        for group in reversed(scene.groups):
            for _, vertices in chains(scene.facets.vertices[group.facets]):
                line = axes.plot(*points[vertices].T, color=group.colour, linewidth=3, clip_on=False, zorder=5)[0]
                line.set(solid_capstyle="butt", path_effects=edge)
        style.shape_axes(axes, title, self.frame)


def log_norm(indicator: Array) -> LogNorm:
    """A logarithmic scale of four decades up to the largest η_T, or up to rounding if all are 0."""
    largest = float(indicator.max()) or ROUNDING
    return LogNorm(max(float(indicator.min()), 1e-4 * largest), largest)


def levels_between(low: float, high: float) -> list[float]:
    """Some round values well inside a range: a line at its end would follow the rounding of a flat part."""
    margin = 0.01 * (high - low)
    return [level for level in MaxNLocator(12).tick_values(low, high) if low + margin < level < high - margin]


def on_levels(values: Array, levels: Iterable[float]) -> Array:
    """The values, but levels in the place of those that are levels up to rounding.

    Else the level of an obstacle would be drawn all over the cells in contact, wherever rounding crosses it.
    """
    near, settled = TIE * np.ptp(values), values.copy()
    for level in levels:
        settled[np.abs(values - level) <= near] = level
    return settled


def framed(points: Array) -> Array:
    """Smallest and largest coordinates with some room around, shape (2, 2)."""
    low, high = points.min(axis=0), points.max(axis=0)
    room = 0.02 * (high - low).max()
    return np.stack([low - room, high + room])
