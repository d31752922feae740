"""Traces along the parts of Γ_S in the plane, contact shaded."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.polylines import chains
from signorini_fenicsx.base.tolerances import TIE
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.panels import Panel
from signorini_fenicsx.pictures.scene import Group, Scene

MARKERS = 40
"""Largest number of markers on a line."""
SHADE = 0.13


@dataclass(frozen=True)
class Line:
    """A connected piece of a part.

    Attributes:
        rows: Its facets in order.
        ends: Coordinates of their ends, one more than facets.
    """

    rows: Indices
    ends: Array


def pieces(scene: Scene, part: int) -> tuple[list[Line], str]:
    """The connected pieces of a part with the coordinate along it and its name.

    The coordinate is that of the part. If one of its values belongs to several points, as on a closed curve, it is the
    arc length.
    """
    facets = scene.facets
    rows = np.flatnonzero(facets.part == part)
    edges = facets.vertices[rows]
    joined = np.any(edges[1:, :, None] == edges[:-1, None, :], axis=(1, 2))
    connected = chains(edges)
    if np.count_nonzero(~joined) < len(connected):
        lines = [
            Line(run, _ends(facets.along[run], facets.measure[run]))
            for run in np.split(rows, np.flatnonzero(~joined) + 1)
        ]
        return lines, list(scene.labels.values())[part]
    start, lines = 0.0, []
    for order, _ in connected:
        ends = start + np.concatenate([[0.0], np.cumsum(facets.measure[rows[order]])])
        lines.append(Line(rows[order], ends))
        start = float(ends[-1])
    return lines, "arc length"


def _ends(along: Array, measure: Array) -> Array:
    """The ends of facets with these midpoints, halfway between them."""
    if len(along) == 1:
        return along[0] + measure[0] * np.array([-0.5, 0.5])
    middle = (along[1:] + along[:-1]) / 2
    return np.concatenate([[2 * along[0] - middle[0]], middle, [2 * along[-1] - middle[-1]]])


def draw_trace(scene: Scene, axes: Axes, name: str, panel: Panel, named: Callable[[str], str]) -> None:
    """The curves of a panel along a part, constant on each facet, or linear if its vertices are sites.

    They are, too, if the table has values `…_at` the vertices `x_at` of each facet, and x or y is along the part.
    """
    part, table, rows = list(scene.labels).index(name), scene.sites, scene.rows
    lines, label = pieces(scene, part)
    title = f"{panel.of_jump if panel.of_jump and name in scene.surface.inside else panel.title} on {name}"
    for line in lines:
        for group in shaded(scene):
            inside = group.facets[line.rows]
            for run in np.split(np.arange(len(line.rows)), np.flatnonzero(np.diff(inside)) + 1):
                if inside[run[0]]:
                    ends = line.ends[run[0]], line.ends[run[-1] + 1]
                    axes.axvspan(*ends, color=group.colour, alpha=SHADE, linewidth=0)
    for column, (_, look) in panel.curves.items():
        values, on_part = getattr(table, column), table.part == part
        if rows.shape[1] > 1:
            values = without_rounding(values)
            axes.plot(table.along[on_part], values[on_part], **look)
        for line in lines if rows.shape[1] == 1 else ():
            of_line, at = values[rows[line.rows, 0]], getattr(table, f"{column}_at", None)
            if at is not None and label in ("x", "y"):
                x = table.x_at[line.rows][:, :, "xy".index(label)]
                ordered = (np.take_along_axis(each, np.argsort(x, axis=1), axis=1) for each in (x, at[line.rows]))
                axes.plot(*(each.ravel() for each in ordered), **look)
            elif "marker" in look:
                some = slice(None, None, 1 + len(of_line) // MARKERS)
                axes.plot(((line.ends[1:] + line.ends[:-1]) / 2)[some], of_line[some], **look)
            else:
                axes.stairs(of_line, line.ends, baseline=None, **look)
        if panel.peak:
            largest = float(values[on_part].max(initial=0.0))
            title += f", at most {largest:.4g}" if largest > 0 else ", none"
    axes.set(title=named(title), xlabel=scene.plot.along(label))
    axes.margins(x=0)
    if label == "angle":
        axes.set_xticks(*_pi_ticks(np.concatenate([line.ends for line in lines])))


def without_rounding(values: Array) -> Array:
    """The values with 0 for what is rounding beside the largest; else it fills the panel of a part without contact."""
    largest = np.abs(np.nan_to_num(values)).max(initial=0.0)
    return np.where(np.abs(values) <= TIE * largest, 0.0, values)


def shaded(scene: Scene) -> list[Group]:
    """What is shaded in the panels: contact, or the segments of all laws."""
    return scene.groups if scene.surface.segments else [Group("contact", style.CONTACT, scene.touching)]


def handles(scene: Scene, panels: Sequence[Panel], *, shades: bool = True) -> list:
    """The entries of the legend of these panels; without shades beside lines of the same colours."""
    looks = {label: look for panel in panels for label, look in panel.curves.values()}
    groups = shaded(scene) if shades and panels else []
    return [
        *(Line2D([], [], label=label, **look) for label, look in looks.items()),
        *(Patch(color=group.colour, alpha=SHADE, label=group.name) for group in groups),
    ]


def _pi_ticks(angles: Array) -> tuple[list[float], list[str]]:
    names = {-2: r"$-\pi$", -1: r"$-\pi/2$", 0: "$0$", 1: r"$\pi/2$", 2: r"$\pi$"}
    low, high = angles.min() - 0.1, angles.max() + 0.1
    inside = {k: name for k, name in names.items() if low <= k * np.pi / 2 <= high}
    return [k * np.pi / 2 for k in inside], list(inside.values())
