"""Traces along the parts of Γ_S in the plane: p_h, u_h and ψ, σ_h·n and q_S, contact shaded."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.output.pictures import style
from signorini_fenicsx.output.pictures.scene import Group, Scene, chains

PANELS: dict[str, dict[str, tuple[str, dict[str, Any]]]] = {
    "u": {
        "p": ("$p_h$", {"color": "C0", "linewidth": 1.6}),
        "u": ("$u_h$ in the cell behind", {"color": "C1", "linestyle": "", "marker": "o", "markersize": 2.8}),
        "psi": (r"$\psi$", {"color": "black", "linewidth": 1.0, "linestyle": "--"}),
    },
    "flux": {
        "flux": (r"$\sigma_h\cdot n$", {"color": "C2", "linewidth": 1.6}),
        "q_S": ("$q_S$", {"color": "black", "linewidth": 1.0, "linestyle": "--"}),
    },
}
"""For each panel the columns of the table, with their labels and styles."""
BOUNDS = ("psi", "q_S")
MARKERS = 40
"""Largest number of markers on a line."""
SHADE = 0.13
TITLES = {"u": "trace of $u$", "flux": "flux"}


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


def draw_trace(scene: Scene, axes: Axes, part: int, panel: str, title: str) -> None:
    """One panel: the traces of `PANELS` along a part."""
    lines, label = pieces(scene, part)
    for line in lines:
        for group in shaded(scene):
            inside = group.facets[line.rows]
            for run in np.split(np.arange(len(line.rows)), np.flatnonzero(np.diff(inside)) + 1):
                if inside[run[0]]:
                    ends = line.ends[run[0]], line.ends[run[-1] + 1]
                    axes.axvspan(*ends, color=group.colour, alpha=SHADE, linewidth=0)
        for column, (_, look) in columns_of(scene, panel).items():
            values = getattr(scene.facets, column)[line.rows]
            if "marker" in look:
                some = slice(None, None, 1 + len(values) // MARKERS)
                axes.plot(((line.ends[1:] + line.ends[:-1]) / 2)[some], values[some], **look)
            else:
                axes.stairs(values, line.ends, baseline=None, **look)
    axes.set(title=title, xlabel="angle" if label == "angle" else f"${label}$" if len(label) == 1 else label)
    axes.margins(x=0)
    if label == "angle":
        axes.set_xticks(*_pi_ticks(np.concatenate([line.ends for line in lines])))


def shaded(scene: Scene) -> list[Group]:
    """What is shaded in the panels: contact, or the segments of all laws."""
    return scene.groups if scene.segments else [Group("contact", style.CONTACT, scene.touching)]


def columns_of(scene: Scene, panel: str) -> dict[str, tuple[str, dict[str, Any]]]:
    """The columns of a panel that the table has; under laws with segments of their own there are no ψ and q_S."""
    known = vars(scene.facets).keys() - (BOUNDS if scene.segments else ())
    return {name: column for name, column in PANELS[panel].items() if name in known}


def handles(scene: Scene, *, shades: bool = True) -> list:
    """The entries of the legend of these panels; without shades beside lines of the same colours."""
    columns = {name: column for panel in PANELS for name, column in columns_of(scene, panel).items()}
    if "psi" in columns:
        columns["psi"] = (r"$\psi$, $q_S$", columns.pop("q_S")[1])  # they look alike, each in its panel
    lines = [Line2D([], [], label=label, **look) for label, look in columns.values()]
    groups = shaded(scene) if shades else []
    return [*lines, *(Patch(color=group.colour, alpha=SHADE, label=group.name) for group in groups)]


def _pi_ticks(angles: Array) -> tuple[list[float], list[str]]:
    names = {-2: r"$-\pi$", -1: r"$-\pi/2$", 0: "$0$", 1: r"$\pi/2$", 2: r"$\pi$"}
    low, high = angles.min() - 0.1, angles.max() + 0.1
    inside = {k: name for k, name in names.items() if low <= k * np.pi / 2 <= high}
    return [k * np.pi / 2 for k in inside], list(inside.values())
