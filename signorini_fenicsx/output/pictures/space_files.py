"""The picture files of a solution in space."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.site_table import FacetTable
from signorini_fenicsx.output.pictures import style
from signorini_fenicsx.output.pictures.curves import draw_iterations, draw_steps, moves
from signorini_fenicsx.output.pictures.scene import Scene
from signorini_fenicsx.output.pictures.sheet import Sheet
from signorini_fenicsx.output.pictures.space import HULL, Space

SIDE, WIDE_SIDE = 2.5, 3.4
"""Inches of a view in a sheet of three columns and of fewer."""


def draw_files(folder: Path, scene: Scene) -> None:
    """Draw `overview.png`, `u.png`, `sigma.png`, `signorini.png`, `iterations.png` and `certificate.png`."""
    space = Space(scene)
    sheet, (left, right) = _row(2)
    space.draw_u(sheet, left, f"(a) {space.scene.plot.u_label} on a cut")
    space.draw_u(sheet, right, f"(b) {space.scene.plot.u_label} on a cut across (a)", number=1)
    _finish(sheet, space, folder / "u.png")

    sheet, (left, right) = _row(2)
    space.draw_sigma(sheet, left, rf"(a) {space.scene.strength} on a cut")
    space.draw_streamlines(sheet, right, f"(b) streamlines of {space.scene.plot.flux_name}")
    _finish(sheet, space, folder / "sigma.png")

    _draw_certificate_file(folder, space)
    if scene.labels:
        _draw_traces(folder / "signorini.png", space, TRACES)
    _overview(space).save(folder / "overview.png")
    draw_iterations(folder / "iterations.png", scene.history, "iteration errors")


def overview(scene: Scene) -> Sheet:
    """The overview of a solution in space."""
    return _overview(Space(scene))


TRACES = {"p": r"$p_h$ on $\Gamma_S$", "flux": r"$\sigma_h\cdot n$ on $\Gamma_S$"}
OF_BODY = {"flux": r"pressure $-\sigma_{nn}$", "p": "gap $g - u_n$"}
OF_FRICTION = {"shear": r"shear $|\sigma_t|$", "slip": "slip $|u_t|$"}


def deformed(moved: Scene, foundation: Array, title: str) -> Sheet:
    """A deformed body on its foundation, and half of it; facets of the foundation have shape (facets, 3, 3)."""
    after = Space(moved)
    sheet, (left, right) = _row(2, title)
    beside = " on its foundation" if len(foundation) else ""  # bodies that touch each other alone have none
    after.draw_outside(sheet, left, f"(a) deformed body{beside}", foundation)
    after.draw_sigma(sheet, right, "(b) on a cut")
    sheet.legend_below(after.handles())
    return sheet


def draw_files_of_body(folder: Path, scene: Scene, *, rubs: bool) -> None:
    """Draw with Γ_C `pressure.png`, if it rubs with its shear, and with a certificate `certificate.png` of a body."""
    space = Space(scene)
    _draw_certificate_file(folder, space)
    if scene.labels:
        _draw_traces(folder / "pressure.png", space, OF_BODY | (OF_FRICTION if rubs else {}))


def contact_over_time(scene: Scene, tables: Sequence[FacetTable], times: Sequence[float]) -> Sheet:
    """Pressure and, with friction, shear and slip on Γ_C at some times, in one scale of colours for each.

    Args:
        scene: The solution at the end.
        tables: Γ_C at each time, NaN where there is nothing to show.
        times: As many times.
    """
    spaces = [Space(replace(scene, facets=table)) for table in tables]
    columns = {"flux": OF_BODY["flux"]} | OF_FRICTION
    shown = [name for name in columns if any(np.isfinite(getattr(table, name)).any() for table in tables)]
    panels = [(view, name) for view in spaces[-1].views for name in shown]
    sheet = Sheet(len(tables) * [SIDE], len(panels) * [SIDE], title=scene.title)
    for row, (view, name) in enumerate(panels):
        for column, (space, t) in enumerate(zip(spaces, times, strict=True)):
            title = f"{columns[name]}, $t = {style.power(t)}$"
            space.draw_trace(sheet, sheet.view(row, column), name, title, view, tables)
    rim = [Line2D([], [], color=style.CONTACT, linewidth=2.5, label="around the contact set")]
    blank = any(np.isnan(getattr(table, name)).any() for table in tables for name in shown)
    sheet.legend_below(
        rim * any(len(each.rim.lines) > 0 for each in spaces)
        + blank * [Patch(color=HULL, label="apart or without friction")]
    )
    return sheet


def _draw_certificate_file(folder: Path, space: Space) -> None:
    if space.scene.fields.indicator is not None:
        _draw_half(folder / "certificate.png", space, r"contributions $\eta_T$ to the error bound")


def draw_field_file(path: Path, scene: Scene) -> None:
    """Draw `field.png`, the indicator of the scene as the error of a function."""
    _draw_half(path, Space(scene), r"error of the field, estimated by $\eta_T$")


def _draw_half(path: Path, space: Space, title: str) -> None:
    sheet, (axes,) = _row(1)
    space.draw_certificate(sheet, axes, f"{title}, behind a cut")
    sheet.legend_below([])
    sheet.save(path)


def _draw_traces(path: Path, space: Space, columns: Mapping[str, str]) -> None:
    """Columns of the table of facets and, after two of them, the contact set, from all sides that show them."""
    panels: list[tuple[str, str]] = [*columns.items()]
    panels.insert(2, ("", "contact set"))
    rows = -(-len(panels) // 3)
    sheet = Sheet(3 * [SIDE], rows * len(space.views) * [SIDE])
    for number, view in enumerate(space.views):
        for place, (column, label) in enumerate(panels):
            axes = sheet.view(rows * number + place // 3, place % 3)
            title = f"{style.letter(len(panels) * number + place)} {label}"
            if column:
                space.draw_trace(sheet, axes, column, title, view)
            else:
                space.draw_contact(axes, title, view)
    _finish(sheet, space, path)


def draw_mesh_file(path: Path, scene: Scene) -> None:
    """Draw `mesh.png`."""
    space = Space(scene)
    sheet, panels = _row(len(space.views))
    for axes, view in zip(panels, space.views, strict=True):
        space.draw_mesh(axes, view)
    _finish(sheet, space, path)


def _row(panels: int, title: str = "") -> tuple[Sheet, list[Axes]]:
    sheet = Sheet(panels * [WIDE_SIDE], [WIDE_SIDE], title=title)
    return sheet, [sheet.view(0, column) for column in range(panels)]


def _finish(sheet: Sheet, space: Space, path: Path) -> None:
    sheet.legend_below(space.handles())
    sheet.save(path)


def _overview(space: Space) -> Sheet:
    scene = space.scene
    sheet = Sheet(3 * [SIDE], 2 * [SIDE], title=f"{scene.title}\n{scene.caption}")
    panels = [sheet.view(0, 0), sheet.view(0, 1), sheet.view(0, 2), sheet.view(1, 0)]
    space.draw_u(sheet, panels[0], f"(a) {space.scene.plot.u_label} on a cut")
    space.draw_streamlines(sheet, panels[1], f"(b) streamlines of {space.scene.plot.flux_name}")
    if scene.fields.indicator is None:
        space.draw_sigma(sheet, panels[2], rf"(c) {scene.strength} on a cut")
    else:
        space.draw_certificate(sheet, panels[2], r"(c) error contributions $\eta_T$")
    if scene.labels:
        space.draw_trace(sheet, panels[3], "p", r"(d) $p_h$ on $\Gamma_S$", space.views[0])
        space.draw_trace(sheet, sheet.view(1, 1), "flux", r"(e) $\sigma_h\cdot n$ on $\Gamma_S$", space.view_of_contact)
    else:
        space.draw_u(sheet, panels[3], f"(d) {space.scene.plot.u_label} on a cut across (a)", number=1)
        if scene.fields.states is not None:
            space.draw_contact(sheet.view(1, 1), f"(e) {scene.edges}", space.views[0])
    handles = space.handles()
    if moves(scene.history):
        axes = sheet.panel(1, 2)
        draw_steps(axes, scene.history, "(f) iteration errors")
        handles = [*handles, *axes.get_legend_handles_labels()[0]]
    sheet.legend_below(handles)
    return sheet
