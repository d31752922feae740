"""The picture files of a solution in space."""

from collections.abc import Mapping
from pathlib import Path

from matplotlib.figure import Figure

from signorini_fenicsx.output.pictures import style
from signorini_fenicsx.output.pictures.curves import draw_steps
from signorini_fenicsx.output.pictures.scene import Scene
from signorini_fenicsx.output.pictures.space import Space


def draw_files(folder: Path, scene: Scene) -> None:
    """Draw all files except `iterations.png` into a folder."""
    space = Space(scene)
    figure, (left, right) = _row(2)
    space.draw_half(figure, left, "(a) $u_h$ on half of the domain")
    space.draw_cuts(figure, right, "(b) $u_h$ on cuts through the middle")
    _finish(figure, space, folder / "u.png")

    figure, (left, right) = _row(2)
    space.draw_sigma(figure, left, r"(a) $|\sigma_h|$ on half of the domain")
    space.draw_streamlines(figure, right, r"(b) streamlines of $\sigma_h$")
    _finish(figure, space, folder / "sigma.png")

    _draw_certificate_file(folder, space)
    if scene.labels:
        _draw_traces(folder / "signorini.png", space, TRACES)
    style.save(_overview(space), folder / "overview.png")


def overview(scene: Scene) -> style.Page:
    """The overview of a solution in space."""
    return _overview(Space(scene))


TRACES = {"p": r"$p_h$ on $\Gamma_S$", "flux": r"$\sigma_h\cdot n$ on $\Gamma_S$"}
OF_BODY = {"flux": r"pressure $-\sigma_{nn}$", "p": "gap $g - u_n$"}


def draw_body_files(folder: Path, scene: Scene, moved: Scene, title: str) -> None:
    """Draw `deformed.png`, `pressure.png` and, with a certificate, `certificate.png` of an elastic body.

    Args:
        folder: Where.
        scene: The body as it was.
        moved: The deformed body.
        title: Title of the deformed body.
    """
    space, after = Space(scene), Space(moved)
    figure, (left, right) = _row(2)
    after.draw_outside(figure, left, "(a) deformed body")
    after.draw_sigma(figure, right, "(b) half of it")
    figure.suptitle(title, fontsize=11)
    style.save(figure, folder / "deformed.png")
    _draw_certificate_file(folder, space)
    _draw_traces(folder / "pressure.png", space, OF_BODY)


def _draw_certificate_file(folder: Path, space: Space) -> None:
    if space.scene.fields.indicator is not None:
        figure, (axes,) = _row(1)
        space.draw_certificate(figure, axes, r"contributions $\eta_T$ to the certified error, half of the domain")
        style.save(figure, folder / "certificate.png")


def _draw_traces(path: Path, space: Space, columns: Mapping[str, str]) -> None:
    """Two columns of the table of facets and the contact set, from all sides that show them."""
    figure = Figure(figsize=(12, 0.6 + 3.8 * len(space.views)), layout="constrained")
    panels = figure.subplots(len(space.views), 3, squeeze=False)
    number = 0
    for row, view in zip(panels, space.views, strict=True):
        for axes, (column, label) in zip(row, columns.items(), strict=False):
            space.draw_trace(figure, axes, column, f"{style.letter(number)} {label}", view)
            number += 1
        space.draw_contact(figure, row[2], f"{style.letter(number)} contact set", view)
        number += 1
    _finish(figure, space, path)


def draw_mesh_file(path: Path, scene: Scene) -> None:
    """Draw `mesh.png`."""
    space = Space(scene)
    figure, panels = _row(len(space.views))
    for axes, view in zip(panels, space.views, strict=True):
        space.draw_mesh(figure, axes, view)
    _finish(figure, space, path)


def _row(panels: int) -> tuple[Figure, list]:
    figure = Figure(figsize=(5.2 * panels, 4.8), layout="constrained")
    return figure, list(figure.subplots(1, panels, squeeze=False)[0])


def _finish(figure: Figure, space: Space, path: Path) -> None:
    style.legend_below(figure, space.handles())
    style.save(figure, path)


def _overview(space: Space) -> style.Page:
    scene = space.scene
    figure = style.Page(figsize=(12.5, 9), layout="constrained")
    panels = figure.subplots(2, 3).ravel()
    space.draw_half(figure, panels[0], "(a) $u_h$ on half of the domain")
    space.draw_streamlines(figure, panels[1], r"(b) streamlines of $\sigma_h$")
    if scene.fields.indicator is None:
        space.draw_sigma(figure, panels[2], r"(c) $|\sigma_h|$ on half of the domain")
    else:
        space.draw_certificate(figure, panels[2], r"(c) contributions $\eta_T$ to the certified error")
    if scene.labels:
        space.draw_trace(figure, panels[3], "p", r"(d) $p_h$ on $\Gamma_S$", space.views[0])
        space.draw_trace(figure, panels[4], "flux", r"(e) $\sigma_h\cdot n$ on $\Gamma_S$", space.views[-1])
    else:
        space.draw_cuts(figure, panels[3], "(d) $u_h$ on cuts through the middle")
        space.draw_contact(figure, panels[4], "(e) edge of the contact", space.views[0])
    draw_steps(panels[5], scene.history, "(f) iteration errors")
    figure.suptitle(f"{scene.title}\n{scene.caption}", fontsize=11)
    style.legend_below(figure, [*space.handles(), *panels[5].get_legend_handles_labels()[0]])
    return figure
