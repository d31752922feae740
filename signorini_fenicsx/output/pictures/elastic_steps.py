"""Pictures of loads in steps: force against displacement, pressure and slip over time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.meshes.domain import AXES
from signorini_fenicsx.output.pictures import style
from signorini_fenicsx.output.pictures.scene import Scene
from signorini_fenicsx.output.pictures.sheet import Sheet
from signorini_fenicsx.physics.elasticity.shown import ContactTable

MOVES = 1e-6
"""A part moves if the mean of its displacement changes by more than this share of the largest of all parts."""


@mpl.rc_context(style.STYLE)
def draw_steps(
    folder: Path, scene: Scene, tables: Sequence[ContactTable], times: Sequence[float], rows: Sequence[dict[str, Any]]
) -> None:
    """Draw `forces.png` and, in the plane, `contact.png` (rank 0)."""
    _forces(scene, rows).save(folder / "forces.png")
    if scene.dim == 2:
        _contact(scene, tables, times).save(folder / "contact.png")


def _forces(scene: Scene, rows: Sequence[dict[str, Any]]) -> Sheet:
    """The force on each part that moves against its mean displacement; the contact force over time."""
    axes_of, parts = AXES[: scene.dim], [key.removesuffix("_force_x") for key in rows[0] if key.endswith("_force_x")]
    moved = {part: np.array([[row[f"{part}_u_{axis}"] for axis in axes_of] for row in rows]) for part in parts}
    ranges = {part: np.ptp(path, axis=0) for part, path in moved.items()}
    largest = max((float(size.max()) for size in ranges.values()), default=0.0)
    forces = {part: np.array([[row[f"{part}_force_{axis}"] for axis in axes_of] for row in rows]) for part in parts}
    strongest = max((float(np.abs(force).max()) for force in forces.values()), default=0.0)
    driven = [
        part
        for part in parts
        if ranges[part].max() > MOVES * largest and np.abs(forces[part]).max() > MOVES * strongest
    ]
    sheet = Sheet([4.4], [2.2] * (1 + len(driven)), bars=False, title=scene.title)
    axes = sheet.panel(0, 0)
    axes.plot([row["t"] for row in rows], [row["contact_force"] for row in rows], color=style.CONTACT, marker=".")
    axes.set(xlabel="$t$", ylabel=r"$-\int\sigma_{nn}$", title="contact force")
    for index, part in enumerate(driven, start=1):
        axes, along = sheet.panel(index, 0), int(ranges[part].argmax())
        for k, (axis, colour) in enumerate(zip(axes_of, (style.CONTACT, style.FREE, style.WATER), strict=False)):
            axes.plot(moved[part][:, along], forces[part][:, k], color=colour, marker=".", label=f"${axis}$")
        axes.set(xlabel=f"mean $u_{axes_of[along]}$", ylabel="force", title=f"force on {part}")
    sheet.legend_below(list(axes.lines) if driven else [])
    return sheet


def _contact(scene: Scene, tables: Sequence[ContactTable], times: Sequence[float]) -> Sheet:
    """The pressure and, with friction, the slip on each part of Γ_C over time."""
    rubs = bool((tables[0].state >= 0).any())
    sheet = Sheet([3.6] * (1 + rubs), [2.4] * len(scene.labels), title=scene.title)
    for row, (name, label) in enumerate(scene.labels.items()):
        mine = tables[0].part == row
        along = tables[0].along[mine]
        values = {"pressure $-\\sigma_{nn}$": [table.pressure[mine] for table in tables]}
        if rubs:
            values["slip $u_t$"] = [table.slip[mine] for table in tables]
        for column, (word, lines) in enumerate(values.items()):
            axes, found = sheet.panel(row, column, aspect=1.5), np.array(lines)
            least = max(float(np.abs(found).max(initial=0.0)), 1e-300)
            low, colours = (0.0, style.FLUX_MAP) if column == 0 else (-least, "RdBu_r")
            grid = _edges(along), np.append(2 * times[0] - times[1] if len(times) > 1 else 0.0, times)
            of_facets = found.reshape(len(lines), -1, 2).mean(axis=2)
            image = axes.pcolormesh(*grid, of_facets, cmap=colours, vmin=low, vmax=least, rasterized=True)
            axes.grid(visible=False)
            axes.set(xlabel=f"${label}$", ylabel="$t$", title=name)
            sheet.bar(axes, image, word)
    sheet.legend_below([])
    return sheet


def _edges(along: Array) -> Array:
    """The ends of the facets of a part, of whose vertices these are the coordinates along it, in order."""
    ends = np.sort(along.reshape(-1, 2), axis=1)
    return np.append(ends[:, 0], ends[-1, 1])
