"""The picture files of a solution in the plane."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from signorini_fenicsx.output.pictures import style, traces
from signorini_fenicsx.output.pictures.curves import draw_steps
from signorini_fenicsx.output.pictures.plane import Plane
from signorini_fenicsx.output.pictures.scene import Scene

OVERVIEW_PARTS = 3
"""Most parts of Γ_S that an overview shows; `signorini.png` shows all."""


def draw_files(folder: Path, scene: Scene) -> None:
    """Draw all files except `iterations.png` into a folder."""
    plane = Plane(scene)
    _draw_u(folder / "u.png", plane)
    _draw_map(folder / "sigma.png", plane, "sigma")
    draw_certificate_file(folder / "certificate.png", plane)
    if scene.labels:
        _draw_traces(folder / "signorini.png", scene)
    style.save(_overview(plane), folder / "overview.png")


def overview(scene: Scene) -> style.Page:
    """The overview of a solution in the plane."""
    return _overview(Plane(scene))


def draw_mesh_file(path: Path, scene: Scene) -> None:
    """Draw `mesh.png`."""
    plane = Plane(scene)
    figure, axes = _one_map(plane)
    plane.draw_mesh(axes)
    style.legend_below(figure, plane.handles())
    style.save(figure, path)


def draw_certificate_file(path: Path, plane: Plane) -> None:
    """Draw `certificate.png`, if there is a certificate."""
    if plane.scene.fields.indicator is not None:
        _draw_map(path, plane, "certificate")


def _one_map(plane: Plane) -> tuple[Figure, Axes]:
    width = 8.5 if plane.wide else 5.4
    figure = Figure(figsize=(width, 1.3 + 0.82 * width / max(plane.aspect, 0.6)), layout="constrained")
    return figure, figure.add_subplot()


def _draw_u(path: Path, plane: Plane) -> None:
    if plane.wide:
        figure, axes = _one_map(plane)
    else:
        figure = Figure(figsize=(10.5, 1.0 + 4.1 / max(plane.aspect, 0.6)), layout="constrained")
        axes = figure.add_subplot(1, 2, 1)
        plane.draw_surface(figure.add_subplot(1, 2, 2, projection="3d"), "(b) $u_h$ as a surface")
    title = "head of water $H = -u_h$" if plane.water else "$u_h$"
    plane.draw_u(figure, axes, title if plane.wide else f"(a) {title}")
    style.legend_below(figure, plane.handles())
    _lay_out(figure)
    style.save(figure, path)


def _draw_map(path: Path, plane: Plane, which: str) -> None:
    figure, axes = _one_map(plane)
    if which == "sigma":
        plane.draw_sigma(figure, axes, r"flux $\sigma_h$: streamlines on $|\sigma_h|$")
    else:
        plane.draw_certificate(figure, axes, r"contributions $\eta_T$ to the certified error")
    style.legend_below(figure, plane.handles())
    style.save(figure, path)


def _draw_traces(path: Path, scene: Scene) -> None:
    figure = Figure(figsize=(9, 0.7 + 2.4 * len(scene.labels)), layout="constrained")
    panels = figure.subplots(len(scene.labels), 2, squeeze=False)
    for part, row in enumerate(panels):
        _draw_part(scene, row, part, 2 * part)
    style.legend_below(figure, traces.handles(scene), 6)
    style.save(figure, path)


def _draw_part(scene: Scene, row: list[Axes], part: int, number: int) -> None:
    """Both panels of a part of Γ_S."""
    name = list(scene.labels)[part]
    titles = traces.TITLES | ({"u": "jump of $u$"} if name in scene.inside else {})
    for axes, (panel, title) in zip(row, titles.items(), strict=True):
        traces.draw_trace(scene, axes, part, panel, f"{style.letter(number)} {title} on {name}")
        number += 1


def _overview(plane: Plane) -> style.Page:
    """Maps above, traces and iterations below; a wide domain has two maps in a row."""
    scene = plane.scene
    parts = range(min(len(scene.labels), OVERVIEW_PARTS))
    columns, maps = (2, 2) if plane.wide else (3, 1)
    height = 11 / columns * 0.85 / max(plane.aspect, 0.6) + 0.5
    rows = max(len(parts), 1)
    figure = style.Page(figsize=(12.5, 1.2 + maps * height + 2.2 * rows), layout="constrained")
    grid = figure.add_gridspec(maps + rows, columns, height_ratios=[height] * maps + [2.2] * rows)
    slots = [grid[row, column] for row in range(maps) for column in range(columns)]
    plane.draw_u(figure, figure.add_subplot(slots[0]), "(a) $H = -u_h$" if plane.water else "(a) $u_h$")
    plane.draw_sigma(figure, figure.add_subplot(slots[1]), r"(b) $\sigma_h$ on $|\sigma_h|$")
    number = 2
    if scene.fields.indicator is not None:
        plane.draw_certificate(
            figure, figure.add_subplot(slots[2]), r"(c) contributions $\eta_T$ to the certified error"
        )
        number = 3
    first, last = (number + 1, number) if plane.wide else (number, number + 2 * len(parts))
    for part in parts:
        row = [figure.add_subplot(grid[maps + part, column]) for column in range(2)]
        _draw_part(scene, row, part, first + 2 * part)
    axes = figure.add_subplot(slots[3] if plane.wide else grid[maps:, 2 if len(parts) > 0 else slice(None)])
    draw_steps(axes, scene.history, f"{style.letter(last)} iteration errors")
    figure.suptitle(f"{scene.title}\n{scene.caption}", fontsize=11)
    of_traces = traces.handles(scene) if scene.labels else []
    style.legend_below(figure, [*plane.handles(), *of_traces, *axes.get_legend_handles_labels()[0]], 6)
    _lay_out(figure)
    return figure


def _lay_out(figure: Figure) -> None:
    """Arrange the panels once before they are drawn: the layout makes room for the ticks of the sizes before."""
    figure.get_layout_engine().execute(figure)
