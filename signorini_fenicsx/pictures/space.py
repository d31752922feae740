"""Sheets of views of a solution in space: VTK renders surfaces, Matplotlib adds titles, axes and colour bars."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import numpy.typing as npt
import pyvista
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.tolerances import TIE
from signorini_fenicsx.cases.plot import with_unit
from signorini_fenicsx.discrete.mesh_spaces import SIGNORINI
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.curves import draw_steps, moves
from signorini_fenicsx.pictures.cuts import VIEWS, Cut, best_cuts, best_view, outward, seen_from
from signorini_fenicsx.pictures.geometry import creases
from signorini_fenicsx.pictures.panels import Overlay, Panel, Where, named_colours
from signorini_fenicsx.pictures.plane import levels_between, log_norm
from signorini_fenicsx.pictures.rendering import (
    arrow_heads,
    arrows_on,
    cropped,
    cropped_near,
    go_near,
    lines_of,
    offscreen,
    streamlines,
    surface_of,
    triad,
)
from signorini_fenicsx.pictures.scene import Scene, scale_on_gamma, sizes
from signorini_fenicsx.pictures.sheet import Sheet

PIXELS = 700
EDGES_UP_TO = 6_000
"""Edges of Γ_S are drawn up to this number of triangles; more cannot be distinguished."""
STILL = 1e-6
"""Vectors that are less than this share of the largest one of the scale have no arrow."""
HULL = "#c8c8c8"
"""The colour of the boundary that is not in Γ_S."""
NEAR = 0.6
"""Γ_S is shown from near if it is less long than this share of the domain."""
SAME = 0.92
"""One view is enough if it shows this share of what all views show."""
SIDE, WIDE_SIDE = 2.7, 3.4
"""Inches of a view in a sheet of three columns and of fewer."""
type Cell = tuple[int, int]
SHOWN, CUTS = set(Where) - {Where.SURFACE}, (Where.MAP, Where.CUT, Where.ACROSS)


@dataclass(frozen=True)
class Space:
    """The views of a solution in space.

    Attributes:
        scene: The solution.
        rendered: Images by content and direction of view.
        others: Views of other scenes that are on the same sheets.
    """

    scene: Scene
    rendered: dict[tuple[object, tuple[float, ...]], npt.NDArray[np.uint8]] = field(default_factory=dict)
    others: dict[int, Space] = field(default_factory=dict)

    @cached_property
    def grid(self) -> pyvista.UnstructuredGrid:
        """The mesh."""
        fields = self.scene.fields
        grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: fields.cells}, fields.points)
        grid.cell_data["cell"] = np.arange(len(fields.cells))
        return grid

    @cached_property
    def extent(self) -> float:
        """The longest side of the domain."""
        return float(np.ptp(self.scene.fields.points, axis=0).max())

    @property
    def reach(self) -> str:
        """From where to where the domain reaches."""
        ends = np.stack([self.scene.fields.points.min(axis=0), self.scene.fields.points.max(axis=0)])
        low, high = np.where(np.abs(ends) < TIE * self.extent, 0.0, ends).tolist()
        sides = (
            rf"${style.decimal(a)} \leq {x} \leq {style.decimal(b)}$" for x, a, b in zip("xyz", low, high, strict=True)
        )
        return with_unit(", ".join(sides), self.scene.plot.length_unit)

    @cached_property
    def is_small(self) -> bool:
        """Whether Γ_S is too small for a view of the whole domain to show what is on it."""
        on_gamma = self.scene.fields.points[self.scene.facets.vertices]
        return bool(np.ptp(on_gamma, axis=(0, 1)).max() < NEAR * self.extent)

    @cached_property
    def hull(self) -> pyvista.PolyData:
        """The boundary without Γ_S."""
        return self._triangles(self.scene.boundary.vertices[self.scene.boundary.kind != SIGNORINI])

    @cached_property
    def gamma(self) -> pyvista.PolyData:
        """The triangles of Γ_S."""
        return self._triangles(self.scene.facets.vertices)

    @cached_property
    def frame(self) -> pyvista.PolyData:
        """The edges of the domain."""
        return lines_of(self.scene.fields.points, creases(self.scene.fields.points, self.scene.boundary.vertices))

    @cached_property
    def rim(self) -> pyvista.PolyData:
        """The rim of the contact set."""
        touching = self.scene.facets.vertices[self.scene.touching]
        return lines_of(self.scene.fields.points, creases(self.scene.fields.points, touching, angle=180))

    @cached_property
    def views(self) -> list[Array]:
        """One direction from which Γ_S is seen, or two if one hides a part of it."""
        groups, directions = [group.facets for group in self.scene.groups], np.array(VIEWS)
        seen = np.array([seen_from(self.scene, view) for view in VIEWS])
        first = best_view(seen, groups, directions)
        hidden = np.maximum(seen - seen[first], 0)
        if hidden.sum(axis=1).max(initial=0.0) <= (1 - SAME) * seen.max(axis=0).sum():
            return [VIEWS[first]]
        return [VIEWS[first], VIEWS[best_view(hidden, groups, directions)]]

    @cached_property
    def view_of_contact(self) -> Array:
        """The first view, or another one if that shows much more of the contact set."""
        seen = [seen_from(self.scene, view)[self.scene.touching].sum() for view in self.views]
        return self.views[0 if seen[0] >= 0.5 * max(seen) else int(np.argmax(seen))]

    @cached_property
    def cuts(self) -> list[Cut]:
        """The two planes on which the inside is shown, the better one first."""
        return best_cuts(self.scene, self._is_inside)

    def _is_inside(self, x: Array) -> Mask:
        """Mask of the points in the domain."""
        return np.atleast_1d(self.grid.find_containing_cell(x)) >= 0 if len(x) else np.zeros(0, dtype=bool)

    @property
    def surfaces(self) -> list[Overlay]:
        """What the physics draws over maps: surfaces, which are lines on cuts."""
        return [each for each in self.scene.over if not each.filled and len(each.points)]

    def streamlines(self, panel: Panel) -> tuple[pyvista.PolyData, pyvista.PolyData]:
        """Streamlines of a panel, and the points where they begin."""
        assert panel.flow is not None
        return streamlines(self.scene, panel.flow, 2 * self.extent)

    def sheet(self, panels: Iterable[Panel], title: str = "") -> Sheet:
        """Views in rows; those of Γ_S alone of each part, from all sides that show it."""
        steps, on_gamma = moves(self.scene.history), (Where.GAMMA, Where.SETS)
        shown = [each for each in panels if each.where in SHOWN and (steps or each.where is not Where.STEPS)]
        shown = [each for each in shown if each.where is not Where.GAMMA or self._by_parts(each)]
        if alone := all(each.where in on_gamma for each in shown):
            shown = [part for each in shown for part in self._by_parts(each)]
        views = {id(each): self._views_of(each, alone) for each in shown}
        cells = [(panel, view) for side in range(2) for panel in shown for view in views[id(panel)][side : side + 1]]
        columns = min(2 if len(cells) == 4 else 3, len(cells))
        size, handles = SIDE if columns == 3 else WIDE_SIDE, [*self.handles(), *named_colours(shown)]
        title = f"{title}\n{self.reach}".strip()
        sheet = Sheet([size] * columns, [0.0] * -(-len(cells) // columns), title=title)
        for number, (panel, view) in enumerate(cells):
            place = divmod(number, columns)
            name = panel.title if len(cells) == 1 else f"{style.letter(number)} {panel.title}"
            if panel.where is Where.STEPS:
                axes, sheet.heights[place[0]] = sheet.panel(*place), size
                draw_steps(axes, self.scene.history, name)
                handles += axes.get_legend_handles_labels()[0]
            else:
                (self.of(panel.scene) if panel.scene else self).draw(panel, sheet, place, name, view)
        sheet.legend_below(handles)
        return sheet

    def _by_parts(self, panel: Panel) -> list[Panel]:
        """A panel of Γ_S for each part on which it shows something."""
        scene = panel.scene or self.scene
        if panel.where is not Where.GAMMA:
            return [panel]
        if len(scene.labels) == 1:
            return [panel] if scene.shows(panel, *scene.labels) else []
        return [replace(panel, scene=part) for part in scene.by_parts if part.shows(panel, *part.labels)]

    def _views_of(self, panel: Panel, alone: bool) -> list[Array]:
        """From where a panel is seen."""
        if alone or (panel.where is Where.GAMMA and panel.scene):
            return (self.of(panel.scene) if panel.scene else self).views[: None if alone else 1]
        return [self.view_of_contact]

    def of(self, scene: Scene) -> Space:
        """The views of another scene, which keep their images too."""
        return self.others.setdefault(id(scene), Space(scene))

    def draw(
        self, panel: Panel, sheet: Sheet, place: Cell, title: str, view: Array, scenes: Sequence[Scene] = ()
    ) -> None:
        """A panel. A small Γ_S is enlarged, and its title tells.

        Args:
            panel: What is shown.
            sheet: The sheet.
            place: Row and column where it is drawn.
            title: The title, without what the view adds.
            view: Direction from which Γ_S is seen.
            scenes: The scenes that share the scale of the colours on Γ_S, if not this one alone.
        """
        where, cut, near = panel.where, None, panel.where is Where.GAMMA and self.is_small
        ends = 0.0, 1.0, "neither"
        if where is Where.GAMMA:
            ends = scale_on_gamma(panel, scenes or [self.scene])
            title = f"{title}{'' if scenes else f' on {self.scene.gamma}'}{', enlarged' * near}"
            if panel.peak:
                title += f", at most {getattr(self.scene.sites, panel.what).max():.4g}"
        elif where is not Where.SETS:
            seen = panel.what if where not in CUTS or panel.in_cells else self._on_cuts(panel)
            view, ends = self.views[0], panel.ends or (float(seen.min()), float(seen.max()), "neither")
        norm = log_norm(np.minimum(panel.what, ends[1])) if panel.log else Normalize(*ends[:2])
        if where in CUTS:
            cut = self.cuts[where is Where.ACROSS]
            view, across = cut.view, " across (a)" * (where is Where.ACROSS)
            title += ", behind a cut" if panel.in_cells else f" on a cut{across}"
        build = partial(self._fill, panel=panel, norm=norm, view=view, cut=cut)
        axes = self._show(sheet, place, title, panel, build, view, near=near)
        if where is not Where.SETS and not panel.names:
            sheet.bar(axes, ScalarMappable(norm, panel.colours), panel.label, ends[2])

    def _fill(self, plotter: pyvista.Plotter, panel: Panel, norm: Normalize, view: Array, cut: Cut | None) -> None:
        """What a panel shows."""
        look: dict[str, Any] = {"cmap": panel.colours, "clim": (norm.vmin, norm.vmax), "lighting": False}
        look |= {"show_scalar_bar": False, "log_scale": panel.log}
        if panel.where is Where.SETS:
            self._add_contact(plotter)
            self._add_hull(plotter)
        elif panel.where is Where.GAMMA:
            values = self.scene.on_facets(panel.what)
            plotter.add_mesh(self.gamma, scalars=sizes(values), nan_color=HULL, **look, **self._edges())
            self._add_arrows(plotter, values, STILL * look["clim"][1], view)
            self._add_hull(plotter)
        elif panel.where is Where.STREAMS:
            self._add_contact(plotter, opacity=0.3)
            for each in self.surfaces:
                plotter.add_mesh(surface_of(each.points), lighting=False, **each.look)
            lines, seeds = self.streamlines(panel)
            tubes = lines.tube(radius=0.005 * self.extent, n_sides=8) if lines.n_points else lines
            for mesh in (tubes, arrow_heads(seeds, 0.04 * self.extent)):
                if mesh.n_points:  # without flux each line is a point, which has no tube
                    plotter.add_mesh(mesh, scalars="length", **look | {"lighting": True, "ambient": 0.4})
        elif panel.where is Where.OUTSIDE:
            surface = self.with_values(panel).extract_surface(algorithm=None)
            plotter.add_mesh(surface, scalars="values", **look)
            for each in (each for each in self.scene.given or () if each.filled and len(each.points)):
                plotter.add_mesh(surface_of(each.points), color=each.look["color"], opacity=0.35, lighting=False)
        elif cut is not None and panel.in_cells:
            self._add_half(plotter, panel, cut, look)
        elif cut is not None:
            section, levels = self.with_values(panel).slice(cut.normal, origin=cut.origin), list(panel.levels)
            plotter.add_mesh(section, scalars="values", **look)
            if levels and not self.scene.plot.levels:  # those of the whole domain may be beyond what is seen
                levels = levels_between(norm.vmin, norm.vmax)
            if levels and (lines := section.contour(levels, scalars="values")).n_points:
                self._add_lines(plotter, lines, view, "white", 1.5)
            self._add_shell_of(plotter, cut)

    def _add_half(self, plotter: pyvista.Plotter, panel: Panel, cut: Cut, look: dict[str, Any]) -> None:
        """Values of the cells behind a cut."""
        half = self.grid.clip(cut.normal, origin=cut.origin, crinkle=True).extract_surface(algorithm=None)
        half.cell_data["values"] = np.asarray(panel.what)[half.cell_data["cell"]]
        plotter.add_mesh(half, scalars="values", **look)
        rim = self.rim.clip(cut.normal, origin=cut.origin) if self.rim.n_cells else self.rim
        if rim.n_cells:
            self._add_lines(plotter, rim, cut.view, style.CONTACT, 4)

    def _on_cuts(self, panel: Panel) -> Array:
        """The values of a panel on both cuts."""
        grid = self.with_values(panel)
        sections = (grid.slice(cut.normal, origin=cut.origin) for cut in self.cuts)
        return np.concatenate([np.asarray(each["values"]) for each in sections])

    def with_values(self, panel: Panel) -> pyvista.UnstructuredGrid:
        """The mesh with the values of a panel at its points, or in its cells."""
        grid = self.grid.copy(deep=False)
        (grid.cell_data if panel.in_cells else grid.point_data)["values"] = panel.what
        return grid

    def mesh(self) -> Sheet:
        """The mesh on the boundary, with the contact set."""
        sheet = Sheet([WIDE_SIDE] * len(self.views), [0.0], title=self.reach)

        def build(plotter: pyvista.Plotter) -> None:
            plotter.add_mesh(self.hull, color="white", lighting=False, show_edges=True, line_width=0.5)
            self._add_contact(plotter)

        for number, view in enumerate(self.views):
            self._show(sheet, (0, number), self.scene.fields.count, Where.MAP, build, view)
        sheet.legend_below(self.handles())
        return sheet

    def handles(self) -> list:
        """The entries of the legend of Γ_S and of the states of laws in Ω."""
        name, between = self.scene.fronts
        edge = [Patch(color=style.CONTACT, label=name)] if len(between) else []
        groups = self.scene.groups
        names = [Patch(color=each.look["color"], label=each.label) for each in self.surfaces]
        of_gamma = [Patch(color=group.colour, label=f"{self.scene.gamma}, {group.name}") for group in groups]
        around = Line2D([], [], color=style.CONTACT, linewidth=2.5, label=self.scene.word("around the contact set"))
        rim = self.rim.n_cells > 0 and style.CONTACT not in [group.colour for group in groups]
        return [*of_gamma, *[around] * rim, *edge, *names]

    def _add_shell_of(self, plotter: pyvista.Plotter, cut: Cut) -> None:
        """The shell of the domain, whose inner side is pale where it is before the cut, and hidden by all else."""
        boundary, facets = self.scene.boundary, self.scene.facets
        groups = [(group.colour, facets.vertices[group.facets]) for group in self.scene.groups]
        for colour, vertices in [*groups, (HULL, boundary.vertices[boundary.kind != SIGNORINI])]:
            self._add_shell(plotter, cut, colour, vertices)
        for each in self.surfaces:
            edge = surface_of(each.points).slice(cut.normal, origin=cut.origin)
            if edge.n_cells:
                self._add_lines(plotter, edge, cut.view, each.look["color"], 4)
        sets = [*groups, (style.CONTACT, self.scene.fronts[1])]
        for colour, vertices in (each for each in sets if len(each[1])):
            edge = self._triangles(vertices).slice(cut.normal, origin=cut.origin)
            if edge.n_cells:
                self._add_lines(plotter, edge, cut.view, colour, 5)

    def _add_shell(self, plotter: pyvista.Plotter, cut: Cut, colour: str, vertices: Indices) -> None:
        """Triangles of the boundary behind a cut, and those before it that turn their inner side to the eye.

        These are moved along the view, which in parallel projection changes nothing but what hides what.
        """
        if not len(vertices):
            return
        corners = self.scene.fields.points[vertices]
        inner = cut.turned_inside(corners, outward(self.scene, vertices))
        away = -2 * np.linalg.norm(np.ptp(self.scene.fields.points, axis=0)) * cut.view
        parts = [(vertices, True, colour, 0 * away), (vertices[inner], False, _pale(colour), away)]
        for triangles, is_behind, shown_in, moved in parts:
            if len(triangles):
                clipped = self._triangles(triangles).clip(cut.normal, origin=cut.origin, invert=is_behind)
                if clipped.n_cells:
                    look = {"ambient": 0.6, "diffuse": 0.45, "specular": 0.0, "reset_camera": False}
                    plotter.add_mesh(clipped.translate(moved), color=shown_in, **look)

    def _triangles(self, vertices: Indices) -> pyvista.PolyData:
        return pyvista.PolyData.from_regular_faces(self.scene.fields.points, vertices)

    def _edges(self) -> dict[str, Any]:
        return {"show_edges": self.gamma.n_cells <= EDGES_UP_TO, "line_width": 0.4, "edge_color": "dimgrey"}

    def _add_contact(self, plotter: pyvista.Plotter, opacity: float = 1.0) -> None:
        for group in self.scene.groups:
            triangles = self._triangles(self.scene.facets.vertices[group.facets])
            edges = self._edges() if opacity == 1.0 else {}
            plotter.add_mesh(triangles, color=group.colour, opacity=opacity, lighting=False, **edges)
        _, between = self.scene.fronts
        if len(between) > 0:
            plotter.add_mesh(self._triangles(between), color=style.CONTACT, opacity=opacity, lighting=False)

    def _add_hull(self, plotter: pyvista.Plotter) -> None:
        if self.hull.n_cells:
            plotter.add_mesh(self.hull, color="grey", opacity=0.12, lighting=False)

    def _add_arrows(self, plotter: pyvista.Plotter, vectors: Array, least: float, view: Array) -> None:
        """Arrows along vectors on facets of Γ_S that are longer than the least length; numbers have none."""
        if vectors.ndim == 1:
            return
        facets = self.scene.facets
        drawn = arrows_on(facets.x + 0.004 * self.extent * view, facets.measure.sum(), vectors, least)
        if drawn.n_points:
            edge = {"color": "black", "line_width": 2}
            plotter.add_mesh(drawn, color="white", lighting=False, silhouette=edge)

    def _add_lines(
        self, plotter: pyvista.Plotter, lines: pyvista.PolyData, view: Array, color: str, width: float
    ) -> None:
        """Lines, moved a little towards the eye, so that the surface on which they lie does not hide them."""
        moved = lines.translate(0.004 * self.extent * view)
        plotter.add_mesh(moved, color=color, line_width=width, lighting=False, render_lines_as_tubes=width > 2)

    def _show(
        self,
        sheet: Sheet,
        place: Cell,
        title: str,
        key: object,
        build: Callable[[Any], None],
        view: Array,
        *,
        near: bool = False,
    ) -> Axes:
        """Render a view, with the edges of the domain and the coordinate directions; each image is rendered once."""
        if (key, tuple(view)) not in self.rendered:
            is_cut = isinstance(key, Panel) and key.where in CUTS
            self.rendered[key, tuple(view)] = self._render(build, view, is_cut=is_cut, near=near)
        image = self.rendered[key, tuple(view)]
        height, width = image.shape[:2]
        room = 0.1 * max(width, height)  # for the coordinate directions, also beside what is flat
        axes = sheet.view(*place, (width + room) / (height + room))
        axes.imshow(image, interpolation="antialiased")
        axes.set(xlim=(-room, width), ylim=(height + room, 0))
        axes.set_axis_off()
        axes.set_title(title)
        triad(axes, view, (2.2 * room / (width + room), 2.2 * room / (height + room)))
        return axes

    def _render(self, build: Callable[[Any], None], view: Array, *, is_cut: bool, near: bool) -> npt.NDArray[np.uint8]:
        with offscreen():
            plotter = pyvista.Plotter(off_screen=True, window_size=(PIXELS, PIXELS))
            plotter.suppress_rendering = True  # otherwise each of the following calls renders
            plotter.set_background("white")
            build(plotter)
            for lines, color, width in ((self.frame, "black", 1.5), (self.rim, style.CONTACT, 4)):
                if lines.n_cells and not (is_cut and lines is self.rim):
                    self._add_lines(plotter, lines, view, color, width)
            plotter.enable_parallel_projection()
            plotter.view_vector(view, (0, 0, 1), bounds=self.grid.bounds if is_cut else None)
            if near:
                go_near(plotter.camera, self.scene.fields.points[self.scene.facets.vertices], view)
            plotter.reset_camera_clipping_range()
            plotter.enable_anti_aliasing("msaa")
            plotter.suppress_rendering = False
            image = plotter.screenshot(return_img=True)
            plotter.close()
        on_gamma = self.scene.fields.points[self.scene.facets.vertices]
        return cropped_near(image, on_gamma, view) if near else cropped(image)


def _pale(colour: str) -> tuple[float, ...]:
    """A colour, mixed with white."""
    return tuple((1 + part) / 2 for part in to_rgb(colour))
