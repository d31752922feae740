"""The picture files of a solution in the plane."""

from pathlib import Path

from matplotlib.axes import Axes

from signorini_fenicsx.output.pictures import style, traces
from signorini_fenicsx.output.pictures.curves import draw_iterations, draw_steps, moves
from signorini_fenicsx.output.pictures.plane import Plane
from signorini_fenicsx.output.pictures.scene import Scene
from signorini_fenicsx.output.pictures.sheet import Sheet

OVERVIEW_PARTS = 3
"""Most parts of Γ_S that an overview shows; `signorini.png` shows all."""


def draw_files(folder: Path, scene: Scene) -> None:
    """Draw `overview.png`, `u.png`, `sigma.png`, `signorini.png`, `iterations.png` and `certificate.png`."""
    plane = Plane(scene)
    _draw_u(folder / "u.png", plane)
    sheet, axes = one_map(plane)
    plane.draw_sigma(sheet, axes, f"streamlines of {plane.flux_title}")
    sheet.legend_below(plane.handles())
    sheet.save(folder / "sigma.png")
    draw_certificate_file(folder / "certificate.png", plane)
    if scene.labels:
        _draw_traces(folder / "signorini.png", scene)
    _overview(plane).save(folder / "overview.png")
    draw_iterations(folder / "iterations.png", scene.history, "iteration errors")


def overview(scene: Scene) -> Sheet:
    """The overview of a solution in the plane."""
    return _overview(Plane(scene))


def draw_mesh_file(path: Path, scene: Scene) -> None:
    """Draw `mesh.png`."""
    plane = Plane(scene)
    sheet, axes = one_map(plane, bars=False)
    plane.draw_mesh(axes)
    sheet.legend_below(plane.handles())
    sheet.save(path)


def draw_certificate_file(path: Path, plane: Plane) -> None:
    """Draw `certificate.png`, if there is a certificate."""
    if plane.scene.fields.indicator is not None:
        _draw_map(path, plane, r"contributions $\eta_T$ to the error bound")


def draw_field_file(path: Path, scene: Scene) -> None:
    """Draw `field.png`, the indicator of the scene as the error of a function."""
    _draw_map(path, Plane(scene), r"error of the field, estimated by $\eta_T$")


def one_map(plane: Plane, *, bars: bool = True, dpi: float | None = None) -> tuple[Sheet, Axes]:
    """A sheet with the panel of a map."""
    width = 7.0 if plane.wide else min(4.4, 6.0 * plane.aspect)
    sheet = Sheet([width], [width / plane.aspect], bars=bars, dpi=dpi)
    return sheet, sheet.panel(0, 0, aspect=plane.aspect)


def _draw_u(path: Path, plane: Plane) -> None:
    title = f"head of water {plane.u_label}" if plane.water and not plane.scene.plot.u else plane.u_label
    if plane.wide:
        sheet, axes = one_map(plane)
    else:
        title = f"(a) {title}"
        width = min(4.4, 6.0 * plane.aspect)
        sheet = Sheet([width, 3.8], [width / plane.aspect])
        axes = sheet.panel(0, 0, aspect=plane.aspect)
        plane.draw_surface(sheet.panel(0, 1, aspect=1.1, projection="3d"), f"(b) {plane.u_label} as a surface")
    plane.draw_u(sheet, axes, title)
    sheet.legend_below(plane.handles())
    sheet.save(path)


def _draw_map(path: Path, plane: Plane, title: str) -> None:
    sheet, axes = one_map(plane)
    plane.draw_certificate(sheet, axes, title)
    sheet.legend_below(plane.handles())
    sheet.save(path)


def _draw_traces(path: Path, scene: Scene) -> None:
    sheet = Sheet([3.6, 3.6], [1.55] * len(scene.labels), bars=False)
    for part in range(len(scene.labels)):
        _draw_part(sheet, scene, part, part, 2 * part)
    sheet.legend_below(traces.handles(scene))
    sheet.save(path)


def _draw_part(sheet: Sheet, scene: Scene, part: int, row: int, number: int) -> None:
    """Both panels of a part of Γ_S, side by side in a row."""
    name = list(scene.labels)[part]
    titles = traces.TITLES | ({"u": "jump of $u$"} if name in scene.inside else {})
    for column, (panel, title) in enumerate(titles.items()):
        named = f"{style.letter(number + column)} {title} on {name}"
        traces.draw_trace(scene, sheet.panel(row, column), part, panel, named)


def _overview(plane: Plane) -> Sheet:
    """Maps above, traces and iterations below; a wide domain has two maps in a row."""
    scene = plane.scene
    parts = range(min(len(scene.labels), OVERVIEW_PARTS))
    columns, maps, width = (2, 2, 4.4) if plane.wide else (3, 1, 2.45)
    with_steps = moves(scene.history)
    below = [1.5] * len(parts) if parts else [2.4] * (with_steps and not plane.wide)
    heights = [width / max(plane.aspect, 0.7)] * maps + below
    sheet = Sheet([width] * columns, heights, title=f"{scene.title}\n{scene.caption}")
    slots = [(row, column) for row in range(maps) for column in range(columns)]

    def panel(number: int) -> Axes:
        return sheet.panel(*slots[number], aspect=plane.aspect)

    plane.draw_u(sheet, panel(0), f"(a) {plane.u_label}")
    plane.draw_sigma(sheet, panel(1), f"(b) {plane.flux_title}")
    number = 2
    if scene.fields.indicator is not None:
        plane.draw_certificate(sheet, panel(2), r"(c) error contributions $\eta_T$")
        number = 3
    first, last = (number + 1, number) if plane.wide else (number, number + 2 * len(parts))
    for part in parts:
        _draw_part(sheet, scene, part, maps + part, first + 2 * part)
    handles = [*plane.handles(), *(traces.handles(scene, shades=False) if scene.labels else [])]
    if with_steps:
        if plane.wide:
            axes = sheet.panel(*slots[3])
        else:
            axes = sheet.panel(maps, 2, rows=len(parts)) if parts else sheet.panel(maps, 0, columns=3)
        draw_steps(axes, scene.history, f"{style.letter(last)} iteration errors")
        handles += axes.get_legend_handles_labels()[0]
    sheet.legend_below(handles)
    return sheet
