"""Sheets of a solution in the plane: maps, a surface, traces along Γ_S, iterations."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LogNorm
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.polylines import chains
from signorini_fenicsx.base.tolerances import ROUNDING, TIE
from signorini_fenicsx.pictures import style, traces
from signorini_fenicsx.pictures.curves import draw_steps, moves
from signorini_fenicsx.pictures.geometry import finer, framed, thinned
from signorini_fenicsx.pictures.panels import Panel, Where, named_colours
from signorini_fenicsx.pictures.scene import Scene
from signorini_fenicsx.pictures.sheet import Sheet

MOST_FACES = 4_000
"""Most faces of a surface in perspective, which Matplotlib sorts and paints one by one."""
WIDE = 1.8
"""If width over height of a domain is above this, panels are below each other, and no surface is drawn."""
SLIM, NARROW = 0.25, 1.7
"""If width over height is below this, no surface is drawn, nor streamlines beside other panels; inches of a column."""
TALL = 6.0
"""Inches of the highest map."""
STEEP = 0.1
"""Where values differ by more than this share of the scale on a triangle, they are drawn on smaller ones."""
MAPS = (Where.MAP, Where.STREAMS, Where.SURFACE)
OVERVIEW_PARTS = 3
"""Most parts of Γ_S that a sheet with maps shows."""


@dataclass(frozen=True)
class Plane:
    """The pictures of a solution in the plane."""

    scene: Scene

    @cached_property
    def frame(self) -> Array:
        """Smallest and largest coordinates of what is drawn, with some room, shape (2, 2)."""
        if self.scene.frame is not None:
            return self.scene.frame
        return framed(np.concatenate([self.scene.fields.points, *(x for each in self.scene.over for x in each.points)]))

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
    def triangulation(self) -> Triangulation:
        """The painted triangles."""
        return Triangulation(*self.scene.fields.points.T, self.scene.fields.cells)

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

    def sheet(self, panels: Iterable[Panel], title: str = "") -> Sheet:
        """Maps above, traces of each part of Γ_S below; a wide domain has two maps in a row."""
        scene, wide, panels = self.scene, self.wide, list(panels)
        maps = self._maps(panels)
        shown = [each for each in panels if each.where is Where.GAMMA]
        of_parts = self._of_parts(shown, OVERVIEW_PARTS if maps else None)
        steps = [each for each in panels if each.where is Where.STEPS and moves(scene.history)]
        alone = not shown and not steps
        columns, width = (2, 4.4 if maps else 3.6) if wide or not maps else (3, 2.45)
        if alone:
            columns = 1 if wide else 2 if len(maps) == 4 and self.aspect > SLIM else len(maps)
            most = 3.2 if columns > 2 else 5.4 if maps[0].scene else 4.4
            width = 7.0 if wide else min(most, max(TALL * self.aspect, NARROW))
        if steps and not maps and not of_parts:
            columns, width = 1, 3.8
        left = -len(maps) % columns
        beside = bool(steps and maps and (wide or (left and not of_parts)))
        rows = -(-(len(maps) + beside) // columns) if maps else 0
        below = [1.55] * (len(of_parts) // 2) or [2.6] * bool(steps and not beside)
        heights = [min(width / self.aspect, TALL) if alone else width / max(self.aspect, 0.7)] * rows + below
        sheet, letters = Sheet([width] * columns, heights, bars=bool(maps), title=title), iter(range(26))

        def named(text: str) -> str:
            return f"{style.letter(next(letters))} {text}" if len(maps) + len(of_parts) + len(steps) > 1 else text

        handles = dict[str, Any]()
        for number, panel in enumerate(maps):
            plane = Plane(panel.scene) if panel.scene else self
            handles |= plane.handles
            look: dict[str, Any] = {"projection": "3d"} if panel.where is Where.SURFACE else {}
            aspect = 1.1 if look else plane.aspect
            plane.draw(panel, sheet, sheet.panel(*divmod(number, columns), aspect=aspect, **look), named(panel.title))
        of_steps = named(steps[0].title) if beside else ""
        for number, (each, part) in enumerate(of_parts):
            if each is not None:
                axes = sheet.panel(rows + number // 2, number % 2)
                traces.draw_trace(each.scene or scene, axes, part, each, named)
        entries = [
            *handles.values(),
            *named_colours(maps),
            *traces.handles(scene, shown if of_parts else [], shades=not maps),
        ]
        if steps:
            across = (
                {"columns": left or columns} if beside else {"rows": len(below)} if of_parts else {"columns": columns}
            )
            axes = sheet.panel(*(divmod(len(maps), columns) if beside else (rows, 2 if of_parts else 0)), **across)
            draw_steps(axes, scene.history, of_steps or named(steps[0].title))
            entries += axes.get_legend_handles_labels()[0]
        sheet.legend_below(entries)
        return sheet

    def _of_parts(self, shown: Sequence[Panel], most: int | None) -> list[tuple[Panel | None, str]]:
        """Panels and the parts on which they are, for rows of two; at most so many parts."""
        scene = self.scene
        return [
            (panel, part)
            for of in dict.fromkeys(each.scene for each in shown)
            for part in list((of or scene).labels)[:most]
            for panel in _in_pairs([each for each in shown if each.scene is of and (of or scene).shows(each, part)])
        ]

    def _maps(self, panels: Sequence[Panel]) -> list[Panel]:
        """The maps among panels, and surfaces that can be seen."""
        slim = self.aspect < SLIM
        maps = [each for each in panels if each.where in MAPS]
        maps = [each for each in maps if each.where is not Where.SURFACE or not (self.wide or slim)]
        return [each for each in maps if each.where is not Where.STREAMS or not slim or len(maps) == 1]

    @property
    def handles(self) -> dict[str, Any]:
        """The entries of the legend of a map by their labels."""
        return {each.label: each.handle() for each in self.scene.over if each.label and len(each.points)}

    def draw(self, panel: Panel, sheet: Sheet, axes: Axes, title: str) -> None:
        """A map of values with lines on levels or streamlines, or values as a surface."""
        if panel.where is Where.SURFACE:
            self._draw_surface(panel.what, axes, title)
            return
        values, points, triangles = panel.what, self.scene.fields.points, self.triangulation
        cells = self.scene.fields.cells if panel.only is None else self.scene.fields.cells[panel.only]
        seen = values if panel.only is None else values[cells]
        low, high, extend = panel.ends or (float(seen.min()), float(seen.max()), "neither")
        look: dict[str, Any] = {"vmin": low, "vmax": high}
        if panel.log:
            look = {"norm": log_norm(np.minimum(values, high))}
            values = np.maximum(values, look["norm"].vmin)
        drawn, colours = triangles, values
        if panel.in_cells:
            look |= {"edgecolors": "face", "linewidth": 0.3}
        else:
            look |= {"shading": "gouraud"}
            triangles = triangles if panel.only is None else Triangulation(*points.T, cells)
            points, cells, colours = finer(points, cells, values, STEEP * (high - low))
            drawn = Triangulation(*points.T, cells)
        image = axes.tripcolor(drawn, colours, cmap=panel.colours, rasterized=True, **look)
        bar = None if panel.names else sheet.bar(axes, image, panel.label, extend)
        if bar is not None and len(panel.levels):
            settled = on_levels(values, panel.levels)
            look = {"colors": "white", "linewidths": 0.6, "alpha": 0.8, "negative_linestyles": "solid"}
            bar.add_lines(axes.tricontour(triangles, settled, panel.levels, **look))
        lines, heads = panel.lines
        streams = LineCollection(lines, colors="white", linewidths=0.7), PolyCollection(heads, facecolors="white")
        for each in streams if panel.where is Where.STREAMS else ():
            axes.add_collection(each, autolim=False)
            each.set_clip_path(PathPatch(self.outline, transform=axes.transData))
        self.surround(axes, title)

    def _draw_surface(self, u: Array, axes: Axes, title: str) -> None:
        """Values as a surface over the domain, seen from the side of Γ_S."""
        scene = self.scene
        points = scene.fields.points
        triangles, _ = thinned(points, scene.fields.cells, MOST_FACES)
        axes.plot_trisurf(
            *points.T, u, triangles=triangles, cmap=style.U_MAP, linewidth=0, antialiased=False, rasterized=True
        )
        for group in scene.groups:
            for _, vertices in chains(scene.facets.vertices[group.facets]):
                axes.plot(*points[vertices].T, u[vertices], color=group.colour, linewidth=2, zorder=10)
        facets = scene.facets.x[:, :2]
        seen = np.average(facets, axis=0, weights=scene.facets.measure) if len(facets) > 0 else points.mean(axis=0)
        side = seen - points.mean(axis=0)
        far = np.linalg.norm(side) > 0.1 * np.ptp(points, axis=0).max()
        azimuth = np.degrees(np.arctan2(side[1], side[0])) if far else -90.0
        axes.view_init(elev=28, azim=azimuth + 30)
        axes.set(xlabel="$x$", ylabel="$y$", title=title)
        axes.set_box_aspect((*np.ptp(points, axis=0) / np.ptp(points, axis=0).max(), 0.55), zoom=1.25)
        axes.locator_params(nbins=4)

    def mesh(self) -> Sheet:
        """The mesh."""
        sheet, axes = self.one_map(bars=False)
        axes.triplot(self.triangulation, color="0.55", linewidth=0.3)
        self.surround(axes, self.scene.fields.count)
        sheet.legend_below(list(self.handles.values()))
        return sheet

    def one_map(self, *, bars: bool = True, dpi: float | None = None) -> tuple[Sheet, Axes]:
        """A sheet with the panel of a map."""
        width = 7.0 if self.wide else min(4.4, 6.0 * self.aspect)
        sheet = Sheet([width], [width / self.aspect], bars=bars, dpi=dpi)
        return sheet, sheet.panel(0, 0, aspect=self.aspect)

    def surround(self, axes: Axes, title: str) -> None:
        """What is drawn over a map."""
        for each in self.scene.over:
            if each.filled:
                axes.add_collection(PolyCollection(each.points, **each.look), autolim=False)
            elif len(each.points):
                ended = [np.vstack([line, [[np.nan, np.nan]]]) for line in each.points]
                axes.plot(*np.concatenate(ended).T, **each.look)
        self.shape(axes, title)

    def shape(self, axes: Axes, title: str) -> None:
        """Equal scales, and the names of the coordinates."""
        axes.grid(False)
        axes.set(aspect="equal", title=title, xlim=self.frame[:, 0], ylim=self.frame[:, 1])
        axes.set(xlabel=self.scene.plot.along("x"), ylabel=self.scene.plot.along("y"))
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)


def _in_pairs(panels: list[Panel]) -> list[Panel | None]:
    """Panels of one part, for rows of two."""
    return [*panels, *[None] * (len(panels) % 2)]


def log_norm(indicator: Array) -> LogNorm:
    """A logarithmic scale of four decades up to the largest value, or up to rounding if all are 0."""
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
