"""Pictures of a run in time: Γ_S over time, fronts, an animation."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from PIL import Image

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.panels import DrawnSteps, Panel, Where
from signorini_fenicsx.pictures.plane import Plane
from signorini_fenicsx.pictures.scene import Scene
from signorini_fenicsx.pictures.sheet import Sheet
from signorini_fenicsx.pictures.traces import pieces

MOST_FRAMES = 200
"""Most pictures of an animation; of more steps only some are shown."""
SECONDS = 8.0
"""How long an animation takes, and the most for one picture below."""
SLOW = 0.4
FRONTS = 8
"""Fronts of so many steps are drawn in one map."""

type Curves = Mapping[tuple[str, str], Mapping[str, tuple[Sequence[float], str | None]]]
NONE: Curves = MappingProxyType({})


@mpl.rc_context(style.STYLE)
def draw_over_time(path: Path, scene: Scene, steps: DrawnSteps, panels: Sequence[Panel], curves: Curves = NONE) -> None:
    """Draw panels of Γ_S over time: along each part in the plane, in space at three times (rank 0).

    Args:
        path: The file.
        scene: The scene of the last step.
        steps: All steps.
        panels: What is drawn; of sets their measures in space too.
        curves: Values of all steps by their names, which have a panel of their own, by its title and label.
    """
    scenes, sets = (
        [scene.with_surface(table=table) for table in steps.tables],
        [p for p in panels if p.where is Where.SETS],
    )
    groups = _groups(scenes) if sets else {}
    if scene.dim == 3 and sets and scene.labels:
        sizes = {name: ([_measure(each, name) for each in scenes], colour) for name, colour in groups.items()}
        curves = {("sets", "measure"): sizes, **curves}
    handles = [Line2D([], [], color=colour, linewidth=6, label=name) for name, colour in groups.items()]
    draw = _draw_along if scene.dim == 2 else _draw_views
    sheet, rows, entries = draw(scenes, steps.times, panels if scene.labels else [], len(curves))
    for row, ((title, label), named) in enumerate(curves.items(), start=rows):
        axes = sheet.panel(row, 0, columns=len(sheet.widths))
        for name, (values, colour) in named.items():
            (line,) = axes.plot(steps.times, values, color=colour, linewidth=1.6, label=name)
            entries += [line] if name not in groups else []
        axes.set(xlabel=scene.plot.along("t"), ylabel=label, title=title)
    sheet.legend_below([*handles, *entries])
    sheet.save(path)


def _draw_along(
    scenes: Sequence[Scene], times: Sequence[float], panels: Sequence[Panel], below: int
) -> tuple[Sheet, int, list]:
    """One row of colours for each step, from the time before to its own, where it ever touches (plane)."""
    scene = scenes[-1]
    parts, width = list(scene.labels) if panels else [], (5.4, 5.4, 3.6, 2.8)[min(len(panels), 3)]
    values_of = any(panel.where is Where.GAMMA for panel in panels)
    sheet = Sheet([width] * max(len(panels), 1), [2.4] * (len(parts) + below), bars=values_of, title=scene.title)
    ends = [2 * times[0] - times[1] if len(times) > 1 else 0.0, *times]
    touched, blank = np.any([each.touching for each in scenes], axis=0), False
    for part, column in itertools.product(range(len(parts)), range(len(panels))):
        panel, axes = panels[column], sheet.panel(part, column, aspect=width / 2.4 if values_of else None)
        lines, label = pieces(scene, part)
        on_part = scene.facets.part == part
        over_time, look = _numbers(scenes) if panel.where is Where.SETS else _values(scenes, panel, on_part)
        for line in lines:
            image = axes.pcolormesh(line.ends, ends, over_time[:, line.rows], rasterized=True, **look)
        if panel.where is Where.GAMMA:
            sheet.bar(axes, image, panel.label)
            blank |= bool(np.isnan(over_time[:, on_part]).any())
            if (on_part & touched).any():
                pairs = [np.stack([line.ends[:-1], line.ends[1:]], axis=1)[touched[line.rows]] for line in lines]
                shown = np.concatenate(pairs)
                room = 0.1 * np.ptp(shown)
                axes.set_xlim(max(shown.min() - room, lines[0].ends[0]), min(shown.max() + room, lines[-1].ends[-1]))
        axes.set_facecolor("0.85")
        axes.grid(visible=False)
        axes.set(xlabel=scene.plot.along(label), ylabel=scene.plot.along("t"), title=f"{panel.title} on {parts[part]}")
    return sheet, len(parts), [Patch(color="0.85", label=scene.word("apart"))] if blank else []


def _groups(scenes: Sequence[Scene]) -> dict[str, str]:
    """The colours of all groups of facets, by name."""
    return {group.name: group.colour for each in scenes for group in each.groups}


def _numbers(scenes: Sequence[Scene]) -> tuple[Array, dict[str, Any]]:
    """The number of the group of each facet in each step, and their colours."""
    groups = _groups(scenes)
    numbers = np.zeros((len(scenes), len(scenes[0].facets.part)))
    for row, group in ((row, group) for row, scene in zip(numbers, scenes, strict=True) for group in scene.groups):
        row[group.facets] = list(groups).index(group.name)
    return numbers, {"cmap": ListedColormap(list(groups.values())), "vmin": -0.5, "vmax": len(groups) - 0.5}


def _values(scenes: Sequence[Scene], panel: Panel, on_part: Mask) -> tuple[Array, dict[str, Any]]:
    """The means of a column over each facet in each step, and their colours for some of them."""
    column = next(iter(panel.curves))
    values = np.array([scene.on_facets(column) for scene in scenes])
    largest = max(float(np.abs(np.nan_to_num(values[:, on_part])).max(initial=0.0)), 1e-300)
    low = -largest if panel.colours == style.SIGNED_MAP else 0.0
    return values, {"cmap": panel.colours, "vmin": low, "vmax": largest}


def _draw_views(
    scenes: Sequence[Scene], times: Sequence[float], panels: Sequence[Panel], below: int
) -> tuple[Sheet, int, list]:
    """Γ_S early, in the middle and at the end, in one scale of colours for each panel (space)."""
    from signorini_fenicsx.pictures.space import HULL, SIDE, Space  # imports VTK

    steps = three_of(len(scenes))
    shown = [scenes[step] for step in steps]
    spaces = [Space(each) for each in shown]
    rows = [(view, panel) for view in spaces[-1].views for panel in panels] if panels else []
    sheet = Sheet(
        max(len(steps), 1) * [SIDE], [0.0] * len(rows) + [2.4] * below, title=f"{shown[-1].title}\n{spaces[-1].reach}"
    )
    for row, (view, panel) in enumerate(rows):
        for column, (space, step) in enumerate(zip(spaces, steps, strict=True)):
            title = f"{panel.title}, $t = {style.decimal(times[step])}$"
            space.draw(panel, sheet, (row, column), title, view, shown)
    columns = [panel.what for panel in panels if panel.where is Where.GAMMA]
    rim = any(len(each.rim.lines) > 0 for each in spaces) and bool(columns)
    blank = any(np.isnan(each.on_facets(column)).any() for each in shown for column in columns)
    word = shown[-1].word
    around = Line2D([], [], color=style.CONTACT, linewidth=2.5, label=word("around the contact set"))
    return sheet, len(rows), [around] * rim + [Patch(color=HULL, label=word("apart or without friction"))] * blank


@mpl.rc_context(style.STYLE)
def draw_fronts(path: Path, scene: Scene, lines: Mapping[float, Sequence[Array]], title: str) -> None:
    """Draw lines at some times in one map, coloured by time (rank 0).

    Args:
        path: The file.
        scene: The scene of the last step, in the plane.
        lines: The points of the lines by time, each of shape (points, 2).
        title: What they are.
    """
    plane = Plane(scene)
    sheet, axes = plane.one_map()
    colours = mpl.cm.ScalarMappable(mpl.colors.Normalize(0, max(lines)), style.U_MAP)
    axes.add_collection(LineCollection(scene.fields.points[scene.boundary.vertices], colors="black", linewidths=1.0))
    for t, then in lines.items():
        axes.add_collection(LineCollection(then, colors=[colours.to_rgba(t)], linewidths=1.8))
    plane.shape(axes, title)
    sheet.bar(axes, colours, scene.plot.along("t"))
    sheet.legend_below([])
    sheet.save(path)


def fronts_of(scene: Scene, states: Indices) -> Array:
    """The edges between cells that are in different states then, shape (edges, 2, 2)."""
    return scene.fields.points[scene.between(states[:, None])]


def chosen_for_fronts(steps: int) -> list[int]:
    """The steps whose fronts are drawn."""
    return sorted({-(-steps * number // FRONTS) for number in range(1, FRONTS + 1)})


def three_of(steps: int) -> list[int]:
    """The rows of the steps that are shown in space: an early one, one in the middle and the last; all of few."""
    return sorted({max((number * steps) // 3 - 1, 0) for number in (1, 2, 3)})


def _measure(scene: Scene, name: str) -> float:
    return float(sum(scene.facets.measure[group.facets].sum() for group in scene.groups if group.name == name))


def shown(steps: int) -> list[int]:
    """The steps that an animation shows: all, or some of them with the last one."""
    return list(range(steps, 0, -steps // MOST_FRAMES))[::-1]


@mpl.rc_context(style.STYLE)
def animate(path: Path, scene: Scene, steps: DrawnSteps, fields: Mapping[int, Array]) -> None:
    """Write a field in cells and the sets over time as an animated GIF (rank 0).

    Args:
        path: The file.
        scene: The scene of the last step, in the plane.
        steps: All steps.
        fields: The field after those that `shown` chooses.
    """
    low, high = min(u.min() for u in fields.values()), max(u.max() for u in fields.values())
    plane, first = Plane(scene), next(iter(fields.values()))
    sheet, axes = plane.one_map(dpi=80)
    image = axes.tripcolor(plane.triangulation, facecolors=first, cmap=style.U_MAP, vmin=low, vmax=high)
    sheet.bar(axes, image, scene.plot.u_label)
    segments = scene.fields.points[scene.facets.vertices]
    line = axes.add_collection(LineCollection(segments, linewidths=4, clip_on=False, zorder=5))
    groups = {step: scene.with_surface(table=steps.tables[step - 1]).groups for step in fields}
    plane.shape(axes, "")
    colours = {group.name: group.colour for of_step in groups.values() for group in of_step}
    sheet.legend_below([Line2D([], [], color=colour, linewidth=4, label=name) for name, colour in colours.items()])
    canvas, pictures = FigureCanvasAgg(sheet), []
    for step, u in fields.items():
        image.set_array(u)
        of_facets = np.empty((len(segments), 3))
        for group in groups[step]:
            of_facets[group.facets] = to_rgb(group.colour)
        line.set_color(of_facets)
        axes.set_title(f"$t = {style.decimal(steps.times[step - 1])}$")
        canvas.draw()
        pictures.append(Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("P", palette=Image.Palette.ADAPTIVE))
    duration = 1000 * min(SECONDS / len(pictures), SLOW)
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=duration, loop=0)
