"""Pictures of a run in time: the contact set over time, and an animation."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.lines import Line2D
from PIL import Image

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.discrete.site_table import FacetTable
from signorini_fenicsx.output.pictures import style
from signorini_fenicsx.output.pictures.plane import Plane
from signorini_fenicsx.output.pictures.plane_files import one_map
from signorini_fenicsx.output.pictures.scene import Group, Scene
from signorini_fenicsx.output.pictures.sheet import Sheet

MOST_FRAMES = 200
"""Most pictures of an animation; of more steps only some are shown."""
SECONDS = 8.0
"""How long an animation takes, and the most for one picture below."""
SLOW = 0.4
FRONTS = 8
"""Fronts of so many steps are drawn in one map."""

type Frame = tuple[float, Array, FacetTable]
"""The time, u_h in the cells of the scene, and Γ_S."""


@mpl.rc_context(style.STYLE)
def draw_sets(
    folder: Path, scene: Scene, tables: Sequence[FacetTable], times: Sequence[float], rows: Sequence[Mapping[str, Any]]
) -> None:
    """Draw `contact.png`: the sets on each part of Γ_S over time; in space at three times, and their measures (rank 0).

    The cells in each state of laws in Ω, whose measures are in the rows, have a panel of their own.
    """
    in_cells = {name: [row[key] for row in rows] for key, name in scene.columns.items() if key in rows[-1]}
    scenes = [replace(scene, facets=replace(table, vertices=scene.facets.vertices)) for table in tables]
    ends, groups, plane = [0.0, *times], _groups(scenes), scene.dim == 2
    of_parts = [2.4] * len(scene.labels) if plane else [2.5, 2.4] if scene.labels else []
    sheet = Sheet([5.4] if plane else 3 * [2.5], of_parts + ([2.4] if in_cells else []), bars=False)
    columns = 1 if plane else 3
    if plane:
        for part, name in enumerate(scene.labels):
            axes = sheet.panel(part, 0)
            _draw_part(axes, scenes, groups, part, ends)
            axes.set(xlabel=f"arc length on {name}", ylabel="$t$", title=f"sets on {name}")
    elif scene.labels:
        _draw_views(sheet, scenes, times)
        axes = sheet.panel(1, 0, columns=columns)
        for name, colour in groups.items():
            sizes = [_measure(each, name) for each in scenes]
            axes.plot(times, sizes, color=colour, linewidth=1.6)
        axes.set(xlabel="$t$", ylabel="measure", title="sets")
    if in_cells:
        axes = sheet.panel(len(of_parts), 0, columns=columns)
        for name, measures in in_cells.items():
            axes.plot(times, measures, linewidth=1.6, label=name)
        axes.legend()
        axes.set(xlabel="$t$", ylabel="area" if plane else "volume", title=r"cells by the laws in $\Omega$")
    handles = [Line2D([], [], color=colour, linewidth=6, label=name) for name, colour in groups.items()]
    sheet.legend_below(handles)
    sheet.save(folder / "contact.png")


@mpl.rc_context(style.STYLE)
def draw_fronts(path: Path, scene: Scene, states: Mapping[float, Indices]) -> None:
    """Draw the edges between cells in different states at some times in one map, coloured by time (rank 0).

    Args:
        path: The file.
        scene: The scene of the last step, in the plane.
        states: The states of the cells by time.
    """
    plane, times = Plane(scene), list(states)
    sheet, axes = one_map(plane)
    colours = mpl.cm.ScalarMappable(mpl.colors.Normalize(0, times[-1]), style.U_MAP)
    axes.add_collection(LineCollection(scene.fields.points[scene.boundary.vertices], colors="black", linewidths=1.0))
    for t, of_cells in states.items():
        then = replace(scene, fields=replace(scene.fields, states=of_cells))
        lines = scene.fields.points[then.free_boundary()]
        axes.add_collection(LineCollection(lines, colors=[colours.to_rgba(t)], linewidths=1.8))
    style.shape_axes(axes, scene.edges, plane.frame)
    sheet.bar(axes, colours, "$t$")
    sheet.legend_below([])
    sheet.save(path)


def chosen_for_fronts(steps: int) -> list[int]:
    """The steps whose fronts are drawn."""
    return sorted({-(-steps * number // FRONTS) for number in range(1, FRONTS + 1)})


def _draw_views(sheet: Sheet, scenes: Sequence[Scene], times: Sequence[float]) -> None:
    """Γ_S with its sets in space, early, in the middle and at the end."""
    from signorini_fenicsx.output.pictures.space import Space  # imports VTK

    for column, step in enumerate(three_of(len(scenes))):
        space = Space(scenes[step])
        space.draw_contact(sheet.view(0, column), f"$t = {style.power(times[step])}$", space.views[0])


def three_of(steps: int) -> list[int]:
    """The rows of the steps that are shown in space: an early one, one in the middle and the last; all of few."""
    return sorted({max((number * steps) // 3 - 1, 0) for number in (1, 2, 3)})


def _groups(scenes: Sequence[Scene]) -> dict[str, str]:
    """The colours of all groups of facets, by name."""
    return {group.name: group.colour for scene in scenes for group in scene.groups}


def _measure(scene: Scene, name: str) -> float:
    return float(sum(scene.facets.measure[group.facets].sum() for group in scene.groups if group.name == name))


def _draw_part(axes: Axes, scenes: Sequence[Scene], groups: dict[str, str], part: int, ends: Sequence[float]) -> None:
    """One row of colours for each step; a row reaches from the time before to its own."""
    names = list(groups)
    rows: Indices = np.flatnonzero(scenes[0].facets.part == part)
    lengths = scenes[0].facets.measure[rows]
    shown = np.array([_numbers(scene.groups, names, len(scene.facets.part))[rows] for scene in scenes])
    axes.pcolormesh(
        np.concatenate([[0.0], np.cumsum(lengths)]),
        ends,
        shown,
        cmap=ListedColormap([to_rgb(colour) for colour in groups.values()]),
        vmin=-0.5,
        vmax=len(names) - 0.5,
        rasterized=True,
    )
    axes.grid(visible=False)


def _numbers(groups: Sequence[Group], names: Sequence[str], size: int) -> Indices:
    """The number of the group of each facet."""
    numbers = np.zeros(size, dtype=np.int64)
    for group in groups:
        numbers[group.facets] = names.index(group.name)
    return numbers


def shown(steps: int) -> list[int]:
    """The steps that an animation shows: all, or some of them with the last one."""
    return list(range(steps, 0, -steps // MOST_FRAMES))[::-1]


@mpl.rc_context(style.STYLE)
def animate(path: Path, scene: Scene, chosen: Sequence[Frame]) -> None:
    """Write u_h and the sets over time as an animated GIF (rank 0).

    Args:
        path: The file.
        scene: The scene of the last step.
        chosen: The steps that `shown` chooses.
    """
    low, high = min(u.min() for _, u, _ in chosen), max(u.max() for _, u, _ in chosen)
    plane = Plane(scene)
    sheet, axes = one_map(plane, dpi=80)
    image = axes.tripcolor(plane.triangulation, chosen[0][1], cmap=style.U_MAP, vmin=low, vmax=high)
    sheet.bar(axes, image, scene.plot.u_label)
    segments = scene.fields.points[scene.facets.vertices]
    line = axes.add_collection(LineCollection(segments, linewidths=4, clip_on=False, zorder=5))
    groups = _groups([replace(scene, facets=table) for _, _, table in chosen])
    style.shape_axes(axes, "", plane.frame)
    sheet.legend_below([Line2D([], [], color=colour, linewidth=4, label=name) for name, colour in groups.items()])
    canvas, pictures = FigureCanvasAgg(sheet), []
    for t, u, table in chosen:
        image.set_array(u)
        colours = np.empty((len(table.part), 3))
        for group in replace(scene, facets=table).groups:
            colours[group.facets] = to_rgb(group.colour)
        line.set_color(colours)
        axes.set_title(f"$t = {style.power(t)}$")
        canvas.draw()
        pictures.append(Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("P", palette=Image.Palette.ADAPTIVE))
    duration = 1000 * min(SECONDS / len(pictures), SLOW)
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=duration, loop=0)
