"""Pictures of a solution, from gathered arrays on rank 0. Only pictures in 3D need VTK."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import matplotlib as mpl

from signorini_fenicsx.base.extras import check_installed
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.discrete.site_table import SiteTable
from signorini_fenicsx.output.gather import Fields, Gathered, gather
from signorini_fenicsx.output.pictures import plane_files, style
from signorini_fenicsx.output.pictures.curves import draw_quantities
from signorini_fenicsx.output.pictures.evolution import draw_sets
from signorini_fenicsx.output.pictures.scene import UNNAMED, Pictures, Scene
from signorini_fenicsx.output.pictures.sheet import Sheet
from signorini_fenicsx.solving.physics import PHYSICS
from signorini_fenicsx.solving.solved import Solved


def is_animated(solution: Solved) -> bool:
    """Whether a run in time that ends with this solution has an animation."""
    return _of(solution.physics).animated and solution.spaces.mesh.topology.dim == 2


def draw_steps(
    folder: Path,
    scene: Scene,
    tables: Sequence[SiteTable],
    times: Sequence[float],
    rows: Sequence[Mapping[str, Any]],
) -> None:
    """Draw the pictures of a run in time, but for the animation (rank 0)."""
    _of(scene.physics).draw_steps(folder, scene, tables, times, rows)
    draw_quantities(folder / "quantities.png", rows, scene.title)


def scene_of(
    solution: Solved,
    gathered: Gathered,
    certificate: Certificate | None = None,
) -> Scene:
    """The scene for pictures of a solution, from its gathered arrays (rank 0)."""
    spaces, physics = solution.spaces, solution.physics
    return Scene(
        title=solution.title or solution.name,
        caption=_of(physics).caption(solution, gathered.fields, certificate),
        fields=gathered.fields,
        facets=gathered.facets,
        boundary=gathered.boundary,
        labels={name: spaces.domain.parts[name].label for name in spaces.part_names},
        contact=solution.method.contact,
        segments=gathered.of.segments,
        history=solution.outcome.history,
        strength=gathered.of.strength,
        gamma=gathered.of.gamma,
        edges=gathered.of.edges,
        columns=gathered.of.columns,
        inside=gathered.of.inside,
        phreatic_line=gathered.of.phreatic_line,
        physics=physics,
        sites=gathered.sites,
        plot=getattr(solution.source, "plot", None) or UNNAMED,
    )


def gathered_scene(solution: Solved, certificate: Certificate | None = None) -> Scene | None:
    """The scene of a solution on rank 0; None elsewhere (collective)."""
    gathered = gather(solution, None if certificate is None else certificate.indicator)
    return None if gathered is None else scene_of(solution, gathered, certificate)


def caption(solution: Solved, fields: Fields, certificate: Certificate | None) -> str:
    """Algorithm, h, ε, cells and the certified error, in Matplotlib's mathematical type."""
    h = solution.spaces.domain.h
    asked = solution.source.solve.h if isinstance(solution.source, CaseFile) and solution.spaces.domain.is_shape else h
    words = [method(solution), rf"$h = {style.power(asked if asked / 2 < h <= asked * (1 + 1e-12) else h)}$"]
    if solution.method.has_eps:
        words.append(rf"$\varepsilon = {style.power(solution.options.eps)}$")
    words.append(fields.count)
    if share := max((about["above_table"] for about in getattr(solution, "water", {}).values()), default=0.0):
        words.append(f"{100 * share:.3g} % of the discharge at negative pressure")
    if certificate is not None and math.isfinite(certificate.bound):
        share = rf" ({100 * certificate.relative:.3g} % of $\|\sigma_h\|$)" if certificate.smaller_than_flux else ""
        words += style.bound_in_words(certificate, rf"${style.power(certificate.bound)}${share}")
    return ", ".join(words)


def method(solution: Solved) -> str:
    """The title of the algorithm, in Matplotlib's mathematical type."""
    return solution.method.title.replace("_h", "$_h$")


@mpl.rc_context(style.STYLE)
def draw_all(folder: Path, scene: Scene) -> None:
    """Draw all files of a scene (rank 0).

    Without a certificate there is no `certificate.png`, and without an iteration that changed anything no
    `iterations.png`.
    """
    _of(scene.physics).draw_files(folder, scene)


@mpl.rc_context(style.STYLE)
def overview(scene: Scene) -> Sheet:
    """The overview as a figure, which a notebook shows (rank 0)."""
    figure = _of(scene.physics).overview(scene)
    figure.draw_without_rendering()  # ticks are made here, in this style
    return figure


def write_page(path: Path, scene: Scene) -> None:
    """Write pictures that the mouse can turn, in one file for a browser (rank 0)."""
    check_installed("--html")
    from signorini_fenicsx.output.pictures import page  # imports Plotly

    page.write_page(path, scene)


@mpl.rc_context(style.STYLE)
def draw_mesh(path: Path, scene: Scene) -> None:
    """Draw the mesh with Γ_S, in contact and not in contact, in colours (rank 0)."""
    _files_in(scene.dim).draw_mesh_file(path, scene)


@mpl.rc_context(style.STYLE)
def draw_field(path: Path, scene: Scene) -> None:
    """Draw the indicator of a scene as the error of a function (rank 0)."""
    _files_in(scene.dim).draw_field_file(path, scene)


def _of(physics: str) -> Pictures:
    """How the solutions of a physics are drawn."""
    return PHYSICS[physics].pictures or Pictures(
        caption,
        lambda folder, scene: _files_in(scene.dim).draw_files(folder, scene),
        lambda scene: _files_in(scene.dim).overview(scene),
        draw_sets,
        animated=True,
    )


def _files_in(dim: int) -> ModuleType:
    """The module that draws files in 2D or in 3D; both have the same functions."""
    if dim == 2:
        return plane_files
    from signorini_fenicsx.output.pictures import space_files  # imports VTK

    return space_files
