"""What is drawn of a viscous flow: the speed with streamlines, the pressure, u_n and σ_nn along laws, over time."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.evolution import draw_over_time
from signorini_fenicsx.pictures.panels import File, Panel, Pictures, Steps, Where, error_panel
from signorini_fenicsx.pictures.scene import Scene
from signorini_fenicsx.pictures.streams import streamlines


def files(scene: Scene) -> dict[str, File]:
    """The pictures of a solution."""
    fields = scene.fields
    speed = np.linalg.norm(fields.at_points["u"], axis=1)
    ends = scene.usual(np.linalg.norm(fields.in_cells["u"], axis=1))
    flow = Panel(speed, Where.MAP, "speed", "$|u_h|$", style.FLUX_MAP, ends=ends)
    streams = replace(flow, where=Where.STREAMS, title="streamlines")  # of û, which end on the boundary only
    panels = [flow, replace(streams, colours=style.STREAM_MAP)]
    if scene.dim == 2:
        lines = streamlines(fields, fields.in_cells["flow"].reshape(-1, 3, 2))
        panels = [replace(streams, title="streamlines on the speed", lines=lines)]
    p = fields.at_points["pressure"][:, 0]
    usual = style.limits(fields.in_cells["pressure"][:, 0], scene.measure)
    pressure: dict[str, Any] = {"label": "$p_h$", "colours": style.U_MAP, "ends": usual}
    return {
        "flow": (f"{scene.title}\n{scene.caption}", [*panels, Panel(p, Where.MAP, "pressure", **pressure)]),
        "laws": (scene.caption, _along(scene) if scene.labels else []),
        "certificate": ("", error_panel(scene)),
    }


def _along(scene: Scene) -> list[Panel]:
    """u_n and σ_nn on parts with laws, and with slip what is along these."""
    line = {"linewidth": 1.6}
    along = [
        Panel("gap", Where.GAMMA, "velocity outwards", curves={"gap": ("$u_n$", line | {"color": "C0"})}),
        Panel("pressure", Where.GAMMA, "traction", curves={"pressure": (r"$\sigma_{nn}$", line | {"color": "C3"})}),
    ]
    if (scene.sites.state >= 0).any():
        slips = {"shear": (r"$\sigma_t$", line | {"color": "C2"})}, {"sliding": ("$u_t$", line | {"color": "C1"})}
        for (what, title), curves in zip((("shear_vector", "shear"), ("sliding_vector", "slip")), slips, strict=True):
            along.append(Panel(what, Where.GAMMA, title, curves=curves, colours=style.SIGNED_MAP))
    return along


def in_time(folder: Path, scene: Scene, steps: Steps) -> None:
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
PICTURES = Pictures(files, in_time=in_time, words=WORDS)
