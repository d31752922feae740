"""Pictures of a solution, from gathered arrays on rank 0. Only pictures in 3D need VTK."""

import math
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import matplotlib as mpl
import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.cases.case import Case
from signorini_fenicsx.cases.solving import AnySolution
from signorini_fenicsx.certificate.certify import Certificate
from signorini_fenicsx.output.elastic_body import gather_body
from signorini_fenicsx.output.gather import (
    Boundary,
    FacetTable,
    Fields,
    gather_boundary,
    gather_facets,
    gather_fields,
)
from signorini_fenicsx.output.pictures import elastic, plane_files, style
from signorini_fenicsx.output.pictures.curves import draw_bounds, draw_errors, draw_iterations, moves
from signorini_fenicsx.output.pictures.evolution import animate, draw_sets, shown
from signorini_fenicsx.output.pictures.scene import Scene
from signorini_fenicsx.output.pictures.sheet import Sheet
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution

__all__ = [
    "animate",
    "draw_all",
    "draw_bounds",
    "draw_errors",
    "draw_mesh",
    "draw_sets",
    "gathered_scene",
    "overview",
    "scene_of",
    "shown",
    "write_page",
]


def scene_of(
    solution: Solution,
    fields: Fields,
    facets: FacetTable,
    boundary: Boundary,
    certificate: Certificate | None = None,
    phreatic_line: Array | None = None,
) -> Scene:
    """The scene for pictures of a solution, from its gathered arrays (rank 0)."""
    spaces = solution.spaces
    return Scene(
        title=solution.title or solution.name,
        caption=caption(solution, fields, certificate),
        fields=fields,
        facets=replace(facets, vertices=np.searchsorted(fields.ids, facets.vertices)),
        boundary=replace(boundary, vertices=np.searchsorted(fields.ids, boundary.vertices)),
        labels={name: spaces.domain.parts[name].label for name in spaces.part_names},
        contact=solution.method.contact,
        segments=solution.data.laws.names() if solution.data.laws.listed else [],
        history=solution.outcome.history,
        inside=solution.boundary.inner,
        phreatic_line=phreatic_line,
    )


def gathered_scene(solution: AnySolution) -> Scene | None:
    """The scene of a solution of any physics on rank 0; None elsewhere (collective)."""
    if isinstance(solution, ElasticSolution):
        body = gather_body(solution)
        return None if body is None else elastic.scene_of(solution, body)
    cells, facets, boundary = gather_fields(solution), gather_facets(solution), gather_boundary(solution)
    if cells is None or facets is None or boundary is None:
        return None
    return scene_of(solution, cells, facets, boundary)


def caption(solution: Solution, fields: Fields, certificate: Certificate | None) -> str:
    """Algorithm, h, ε, cells and the certified error, in Matplotlib's mathematical type."""
    h = solution.spaces.domain.h
    asked = solution.source.solve.h if isinstance(solution.source, Case) and solution.spaces.domain.is_shape else h
    words = [method(solution), rf"$h = {style.power(asked if asked / 2 < h <= asked * (1 + 1e-12) else h)}$"]
    if solution.method.has_eps:
        words.append(rf"$\varepsilon = {style.power(solution.options.eps)}$")
    words.append(fields.count)
    if certificate is not None and math.isfinite(certificate.bound):
        share = rf" ({100 * certificate.relative:.3g} % of $\|\sigma_h\|$)" if certificate.smaller_than_flux else ""
        words += style.bound_in_words(certificate, rf"${style.power(certificate.bound)}${share}")
    return ", ".join(words)


def method(solution: Solution) -> str:
    """The title of the algorithm, in Matplotlib's mathematical type."""
    return solution.method.title.replace("_h", "$_h$")


@mpl.rc_context(style.STYLE)
def draw_all(folder: Path, scene: Scene) -> None:
    """Draw `overview.png`, `u.png`, `sigma.png`, `signorini.png`, `iterations.png` and `certificate.png` (rank 0).

    Without a certificate there is no `certificate.png`, and without an iteration that changed anything no
    `iterations.png`.
    """
    _files_of(scene).draw_files(folder, scene)
    if moves(scene.history):
        draw_iterations(folder / "iterations.png", scene.history, "iteration errors")


@mpl.rc_context(style.STYLE)
def overview(scene: Scene) -> Sheet:
    """The overview as a figure, which a notebook shows (rank 0)."""
    figure: Sheet = _files_of(scene).overview(scene)
    figure.draw_without_rendering()  # ticks are made here, in this style
    return figure


def write_page(path: Path, scene: Scene) -> None:
    """Write pictures that the mouse can turn, in one file for a browser (rank 0)."""
    from signorini_fenicsx.output.pictures import page  # imports Plotly

    page.write_page(path, scene)


@mpl.rc_context(style.STYLE)
def draw_mesh(path: Path, scene: Scene) -> None:
    """Draw the mesh with Γ_S, in contact and not in contact, in colours (rank 0)."""
    _files_of(scene).draw_mesh_file(path, scene)


def _files_of(scene: Scene) -> ModuleType:
    """The module that draws the files of a scene; the modules for 2D and 3D have the same functions."""
    if scene.dim == 2:
        return plane_files
    from signorini_fenicsx.output.pictures import space_files  # imports VTK

    return space_files
