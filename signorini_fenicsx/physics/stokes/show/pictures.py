"""What is drawn of a viscous flow: the speed with streamlines, the pressure, u_n and σ_nn along laws."""

from dataclasses import replace
from typing import Any

import numpy as np

from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.panels import File, Panel, Pictures, Where
from signorini_fenicsx.pictures.scene import Scene
from signorini_fenicsx.pictures.streams import streamlines


def files(scene: Scene) -> dict[str, File]:
    """The pictures of a solution."""
    fields, line = scene.fields, {"linewidth": 1.6}
    speed = np.linalg.norm(fields.at_points["u"], axis=1)
    ends = scene.usual(np.linalg.norm(fields.in_cells["u"], axis=1))
    flow = Panel(speed, Where.MAP, "speed", "$|u_h|$", style.FLUX_MAP, ends=ends)
    panels = [flow]
    if scene.dim == 2:
        lines = streamlines(fields, fields.in_cells["flow"].reshape(-1, 3, 2))  # of û, which end on the boundary only
        panels = [replace(flow, where=Where.STREAMS, title="streamlines on the speed", lines=lines)]
    p = fields.at_points["pressure"][:, 0]
    usual = style.limits(fields.in_cells["pressure"][:, 0], scene.measure)
    pressure: dict[str, Any] = {"label": "$p_h$", "colours": style.U_MAP, "ends": usual}
    along = [
        Panel("gap", Where.GAMMA, "velocity outwards", curves={"gap": ("$u_n$", line | {"color": "C0"})}),
        Panel("pressure", Where.GAMMA, "traction", curves={"pressure": (r"$\sigma_{nn}$", line | {"color": "C3"})}),
    ]
    if (scene.sites.state >= 0).any():
        slips = {"shear": (r"$\sigma_t$", line | {"color": "C2"})}, {"sliding": ("$u_t$", line | {"color": "C1"})}
        for (what, title), curves in zip((("shear_vector", "shear"), ("sliding_vector", "slip")), slips, strict=True):
            along.append(Panel(what, Where.GAMMA, title, curves=curves, colours=style.SIGNED_MAP))
    return {
        "flow": (f"{scene.title}\n{scene.caption}", [*panels, Panel(p, Where.MAP, "pressure", **pressure)]),
        "laws": (scene.caption, along if scene.labels else []),
    }


PICTURES = Pictures(files)
