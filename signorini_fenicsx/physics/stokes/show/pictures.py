"""What is drawn of a viscous flow: the speed with streamlines, the pressure, u_n and σ_nn along laws, over time."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from signorini_fenicsx.cases.plot import with_unit
from signorini_fenicsx.physics.elasticity.show import pictures as of_bodies
from signorini_fenicsx.physics.stokes.show.readings import pressure_of, traces, velocities
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.evolution import draw_over_time
from signorini_fenicsx.pictures.panels import Drawn, DrawnSteps, File, Panel, Pictures, Where, error_panel, on_gamma
from signorini_fenicsx.pictures.scene import Scene
from signorini_fenicsx.pictures.streams import streamlines


def drawn(solution: Any) -> Drawn:
    """The flow for pictures: the speed and the pressure (collective)."""
    found = of_bodies.drawn(solution)
    spaces, pressure = solution.spaces, pressure_of(solution.stresses)
    by_geometry = np.argsort(spaces.order, axis=1)
    of_vertex = np.empty((len(pressure), spaces.dim + 1))
    for vertex in range(spaces.dim + 1):
        others = [s for s in range(spaces.dim + 1) if s != vertex]
        of_vertex[:, vertex] = np.mean([pressure[:, s, vertex - (vertex > s)] for s in others], axis=0)
    at_corners = np.take_along_axis(of_vertex, by_geometry, axis=1)[:, :, None]
    mean = pressure.mean(axis=(1, 2))[:, None]
    u = found.corners["u"]
    flow = np.take_along_axis(velocities(solution, traces(solution)), by_geometry[:, :, None], axis=1)
    return replace(
        found,
        corners={"u": u, "pressure": at_corners},
        cells={"u": found.cells["u"], "pressure": mean, "flow": flow.reshape(len(flow), -1)},
    )


def files(scene: Scene) -> dict[str, File]:
    """The pictures of a solution."""
    fields, plot = scene.fields, scene.plot
    speed = np.linalg.norm(fields.at_points["u"], axis=1)
    ends = scene.usual(np.linalg.norm(fields.in_cells["u"], axis=1))
    flow = Panel(speed, Where.MAP, "speed", with_unit("$|u_h|$", plot.unit), style.FLUX_MAP, ends=ends)
    streams = replace(flow, where=Where.STREAMS, title="streamlines")  # of û, which end on the boundary only
    at_corners = fields.in_cells["flow"].reshape(-1, scene.dim + 1, scene.dim)
    panels = [flow, replace(streams, colours=style.STREAM_MAP, flow=at_corners)]
    if scene.dim == 2:
        panels = [replace(streams, title="streamlines on the speed", lines=streamlines(fields, at_corners))]
    p = fields.at_points["pressure"][:, 0]
    usual = style.limits(fields.in_cells["pressure"][:, 0], scene.measure)
    pressure: dict[str, Any] = {"label": with_unit("$p_h$", plot.stress_unit), "colours": style.U_MAP, "ends": usual}
    return {
        "flow": (f"{scene.title}\n{scene.caption}", [*panels, Panel(p, Where.MAP, "pressure", **pressure)]),
        "laws": (scene.caption, _along(scene) if scene.labels else []),
        "certificate": ("", error_panel(scene)),
    }


def _along(scene: Scene) -> list[Panel]:
    """u_n and σ_nn on parts with laws, and with slip what is along these."""
    plot, signed = scene.plot, {"colours": style.SIGNED_MAP}
    along = [
        on_gamma("gap", "velocity outwards", plot.unit, ("gap", "$u_n$", "C0")),
        on_gamma("pressure", "traction", plot.stress_unit, ("pressure", r"$\sigma_{nn}$", "C3")),
    ]
    if (scene.sites.state >= 0).any():
        along.append(on_gamma("shear_vector", "shear", plot.stress_unit, ("shear", r"$\sigma_t$", "C2"), **signed))
        along.append(on_gamma("sliding_vector", "slip", plot.unit, ("sliding", "$u_t$", "C1"), **signed))
    return along


def in_time(folder: Path, scene: Scene, steps: DrawnSteps) -> None:
    """Draw `steps.png`: u_n and σ_nn on parts with laws, and what flows out through each part, over time."""
    flows = {part: ([row[f"{part}_flow"] for row in steps.rows], None) for part in scene.solution.spaces.domain.parts}
    speed = {"speed": ([row["speed"] for row in steps.rows], "C0")}
    curves = {("flow outwards", r"$\int u\cdot n$"): flows, ("largest speed", "$|u_h|$"): speed}
    along = [replace(panel, colours=style.SIGNED_MAP) for panel in _along(scene)] if scene.labels else []
    draw_over_time(folder / "steps.png", scene, steps, along, curves)


WORDS = {
    r"$\Gamma_C$": "parts with laws",
    r"$\Gamma_D$": "$u$ given",
    r"$\Gamma_N$": r"$\sigma n$ given",
    "apart": "open",
    "partly fixed": "$u_n$ or $u_t$ given",
    "around the contact set": "around what is closed",
    "apart or without friction": "open or without slip",
}
PICTURES = Pictures(drawn, files, in_time=in_time, words=WORDS)
