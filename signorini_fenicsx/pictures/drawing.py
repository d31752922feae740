"""Files of pictures, from gathered arrays on rank 0. Only pictures in 3D need VTK."""

from pathlib import Path
from typing import Any

import matplotlib as mpl

from signorini_fenicsx.base.extras import check_installed
from signorini_fenicsx.cases.units import units_of
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.curves import draw_probes, draw_quantities
from signorini_fenicsx.pictures.panels import DrawnSteps, error_panel
from signorini_fenicsx.pictures.plane import Plane
from signorini_fenicsx.pictures.scene import Scene
from signorini_fenicsx.pictures.sheet import Sheet


@mpl.rc_context(style.STYLE)
def draw_all(folder: Path, scene: Scene) -> None:
    """Draw all files of a scene that have a panel (rank 0)."""
    sheets = _sheets(scene)
    for name, (title, panels) in scene.files.items():
        if panels:
            sheets.sheet(panels, title).save(folder / f"{name}.png")


@mpl.rc_context(style.STYLE)
def overview(scene: Scene) -> Sheet:
    """The first file as a figure, which a notebook shows (rank 0)."""
    title, panels = next(iter(scene.files.values()))
    figure = _sheets(scene).sheet(panels, title)
    figure.draw_without_rendering()  # ticks are made here, in this style
    return figure


@mpl.rc_context(style.STYLE)
def draw_steps(folder: Path, scene: Scene, steps: DrawnSteps) -> None:
    """Draw the pictures of a run in time (rank 0)."""
    scene.pictures.in_time(folder, scene, steps)
    labels = {each.name: each.label for each in getattr(scene.solution.source, "quantity", ())}
    draw_quantities(folder / "quantities.png", steps.rows, scene.title, labels, scene.plot.along("t"))
    if probes := steps.readings.get("probes"):
        units = units_of(scene.solution)
        draw_probes(folder / "probes.png", steps.times, probes, units, scene.title, scene.plot.along("t"))


def write_page(path: Path, scene: Scene) -> None:
    """Write pictures that the mouse can turn, in one file for a browser (rank 0)."""
    check_installed("--html")
    from signorini_fenicsx.pictures import page  # imports Plotly

    page.write_page(path, scene)


@mpl.rc_context(style.STYLE)
def draw_mesh(path: Path, scene: Scene) -> None:
    """Draw the mesh with Γ_S, in contact and not in contact, in colours (rank 0)."""
    _sheets(scene).mesh().save(path)


@mpl.rc_context(style.STYLE)
def draw_field(path: Path, scene: Scene) -> None:
    """Draw the indicator of a scene as the error of a function (rank 0)."""
    _sheets(scene).sheet(error_panel(scene, r"error of the field, estimated by $\eta_T$")).save(path)


def _sheets(scene: Scene) -> Any:
    """What draws panels in 2D or in 3D."""
    if scene.dim == 2:
        return Plane(scene)
    from signorini_fenicsx.pictures.space import Space  # imports VTK

    return Space(scene)
