"""Pictures of loads in steps: force against displacement, pressure, shear and slip over time."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.patches import Patch

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.rows import in_digits
from signorini_fenicsx.meshes.domain import AXES, other_side
from signorini_fenicsx.output.pictures import style
from signorini_fenicsx.output.pictures.evolution import three_of
from signorini_fenicsx.output.pictures.scene import Scene
from signorini_fenicsx.output.pictures.sheet import Sheet
from signorini_fenicsx.physics.elasticity.show.shown import STATES, BodyFacets, ContactTable

MOVES = 0.01
"""A part moves if the mean of its displacement changes by more than this share of the largest of all parts."""
LOADED = 1e-6
"""A part is loaded if the force on it is larger than this share of the largest of all parts."""
OPEN = STATES.index("open")


@mpl.rc_context(style.STYLE)
def draw_steps(
    folder: Path, scene: Scene, tables: Sequence[ContactTable], times: Sequence[float], rows: Sequence[dict[str, Any]]
) -> None:
    """Draw `forces.png` and `contact.png` (rank 0)."""
    _forces(scene, rows).save(folder / "forces.png")
    if not scene.labels:
        return
    draw = _contact if scene.dim == 2 else _contact_in_space
    draw(scene, tables, times).save(folder / "contact.png")


def _forces(scene: Scene, rows: Sequence[dict[str, Any]]) -> Sheet:
    """The contact force over time; the force on each part that moves against its mean displacement, inner ones once."""
    axes_of, others = AXES[: scene.dim], {other_side(part) for part in scene.inside}
    parts = [key.removesuffix("_force_x") for key in rows[0] if key.endswith("_force_x")]
    moved = {part: np.array([[row[f"{part}_u_{axis}"] for axis in axes_of] for row in rows]) for part in parts}
    ranges = {part: np.ptp(path, axis=0) for part, path in moved.items()}
    largest = max((float(size.max()) for size in ranges.values()), default=0.0)
    forces = {part: np.array([[row[f"{part}_force_{axis}"] for axis in axes_of] for row in rows]) for part in parts}
    strongest = max((float(np.abs(force).max()) for force in forces.values()), default=0.0)
    driven = [
        part
        for part in parts
        if part not in others
        and ranges[part].max() > MOVES * largest
        and np.abs(forces[part]).max() > LOADED * strongest
    ]
    first = 1 if scene.labels else 0
    sheet = Sheet([4.4], [2.2] * (first + len(driven)), bars=False, title=scene.title)
    if scene.labels:
        axes = sheet.panel(0, 0)
        axes.plot([row["t"] for row in rows], [row["contact_force"] for row in rows], color=style.CONTACT, marker=".")
        axes.set(xlabel="$t$", ylabel=r"$-\int\sigma_{nn}$", title="contact force")
        axes.set_ylim(0, 1.05 * max(row["contact_force"] for row in rows) or None)  # what hardly changes looks so
    for index, part in enumerate(driven, start=first):
        axes, along = sheet.panel(index, 0), int(ranges[part].argmax())
        for k, (axis, colour) in enumerate(zip(axes_of, (style.CONTACT, style.FREE, style.WATER), strict=False)):
            look = {"color": colour, "linestyle": ("-", "--", ":")[k], "marker": ".os"[k], "markersize": 4}
            axes.plot(moved[part][:, along], forces[part][:, k], label=f"${axis}$", **look)
        axes.set(xlabel=f"mean $u_{axes_of[along]}$", ylabel="force", title=f"force on {part}")
    sheet.legend_below(list(axes.lines) if driven else [])
    return sheet


def _contact(scene: Scene, tables: Sequence[ContactTable], times: Sequence[float]) -> Sheet:
    """The pressure and, with friction, the shear and the slip on each part of Γ_C over time, where it ever touches."""
    rubs = bool((tables[0].state >= 0).any())
    sheet = Sheet([2.8 if rubs else 3.6] * (1 + 2 * rubs), [2.4] * len(scene.labels), title=scene.title)
    for row, (name, label) in enumerate(scene.labels.items()):
        mine = tables[0].part == row
        along, rough = tables[0].along[mine], tables[0].state[mine] >= 0
        together = np.array([_together(table)[mine] for table in tables])
        values = {"pressure $-\\sigma_{nn}$": np.array([table.pressure[mine] for table in tables])}
        if rough.any():
            values["shear $\\sigma_t$"] = np.array([table.shear[mine] for table in tables])
            slip = np.array([table.slip[mine] for table in tables])
            values["slip $u_t$"] = np.where(together, slip, np.nan)
        ends = along[together.any(axis=0)] if together.any() else along
        room = 0.1 * (np.ptp(ends) or np.ptp(along))  # one vertex may touch
        limits = max(along.min(), ends.min() - room), min(along.max(), ends.max() + room)
        for column, (word, over_time) in enumerate(values.items()):
            axes = sheet.panel(row, column, aspect=2.8 / 2.4 if rubs else 1.5)
            largest = max(float(np.abs(np.nan_to_num(over_time)).max(initial=0.0)), 1e-300)
            low, colours = (0.0, style.FLUX_MAP) if column == 0 else (-largest, "RdBu_r")
            grid = _edges(along), np.append(2 * times[0] - times[1] if len(times) > 1 else 0.0, times)
            of_facets = over_time.reshape(len(tables), -1, 2).mean(axis=2)
            image = axes.pcolormesh(*grid, of_facets, cmap=colours, vmin=low, vmax=largest, rasterized=True)
            axes.set_facecolor("0.85")
            axes.grid(visible=False)
            axes.set(xlabel=f"${label}$", ylabel="$t$", title=name, xlim=limits)
            sheet.bar(axes, image, word)
    has_open = rubs and any((table.state == OPEN).any() for table in tables)
    sheet.legend_below([Patch(color="0.85", label="apart")] if has_open else [])
    return sheet


def _contact_in_space(scene: Scene, tables: Sequence[ContactTable], times: Sequence[float]) -> Sheet:
    """Pressure and, with friction, shear and slip on Γ_C early, in the middle and at the end."""
    from signorini_fenicsx.output.pictures.space_files import contact_over_time  # imports VTK

    assert isinstance(scene.facets, BodyFacets)
    steps = three_of(len(tables))
    facets = [_of_facets(scene.facets, tables[step]) for step in steps]
    return contact_over_time(scene, facets, [times[step] for step in steps])


def _of_facets(facets: BodyFacets, table: ContactTable) -> BodyFacets:
    """The facets with the means of a table; slip is NaN where they are apart."""
    ordered = np.lexsort((*in_digits(facets.x).T, facets.part))
    rows = np.empty((len(ordered), facets.vertices.shape[1]), dtype=np.int64)
    rows[ordered] = np.lexsort((*in_digits(table.facet).T, table.part)).reshape(rows.shape)
    together = _together(table)[rows].any(axis=1)
    return replace(
        facets,
        flux=table.pressure[rows].mean(axis=1),
        condition=table.touching[rows].any(axis=1).astype(np.int64),
        shear=table.shear_vector[rows].mean(axis=1),
        slip=np.where(together[:, None], table.slip_vector[rows].mean(axis=1), np.nan),
    )


def _together(table: ContactTable) -> Mask:
    """Mask of the vertices that are in contact, or have a bound of the shear though they are not."""
    return table.touching | ((table.state >= 0) & (table.state != OPEN))


def _edges(along: Array) -> Array:
    """The ends of the facets of a part, of whose vertices these are the coordinates along it, in order."""
    ends = np.sort(along.reshape(-1, 2), axis=1)
    return np.append(ends[:, 0], ends[-1, 1])
