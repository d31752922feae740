"""What is drawn of a solution of a diffusion problem: u, the flux, both on Γ_S, and in time the sets and fronts."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from signorini_fenicsx.physics.diffusion.show.phreatic import lines_in
from signorini_fenicsx.physics.diffusion.show.pools import Pools, water_lines, wet
from signorini_fenicsx.physics.diffusion.show.shown import STATE
from signorini_fenicsx.physics.diffusion.show.states import titles
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.curves import moves
from signorini_fenicsx.pictures.evolution import (
    animate,
    chosen_for_fronts,
    draw_fronts,
    draw_over_time,
    fronts_of,
    shown,
)
from signorini_fenicsx.pictures.panels import File, Overlay, Panel, Pictures, Steps, Where, error_panel
from signorini_fenicsx.pictures.plane import levels_between
from signorini_fenicsx.pictures.scene import Scene
from signorini_fenicsx.pictures.streams import of_means, streamlines

LINE: dict[str, Any] = {"linewidth": 1.6}
DASHED = {"color": "black", "linewidth": 1.0, "linestyle": "--"}
TRACE = {
    "p": ("$p_h$", LINE | {"color": "C0"}),
    "u": ("$u_h$ in the cell behind", {"color": "C1", "linestyle": "", "marker": "o", "markersize": 2.8}),
}
FLUX = {"flux": (r"$\sigma_h\cdot n$", LINE | {"color": "C2"})}
BOUND = r"$\psi$, $q_S$", DASHED
SETS = Panel("", Where.SETS, "contact set")


def files(scene: Scene) -> dict[str, File]:
    """The pictures of a solution."""
    plot, water, bounded = scene.plot, Pools.of(scene), not scene.segments  # other laws have neither ψ nor q_S
    name, unit = plot.u_label, f" ({plot.unit})" * bool(plot.unit)
    values = scene.u if water is None else water.head
    if water is not None:
        name = f"head $H${unit}"
    levels = plot.levels or levels_between(float(values.min()), float(values.max()))
    u = Panel(values, Where.MAP, name if water is None else "head of the water $H$", name, levels=levels)
    across = replace(u, where=Where.ACROSS)
    surface = replace(u, where=Where.SURFACE, title=f"{name} as a surface")
    sigma = scene.fields.at_points["sigma"]
    ends = scene.usual(np.linalg.norm(scene.fields.in_cells["sigma"], axis=1))
    label, strength = plot.flux_label, np.linalg.norm(sigma, axis=1)
    cut = Panel(strength, Where.CUT, r"$|\sigma_h|$", r"$|\sigma_h|$", style.FLUX_MAP, ends=ends)
    title = f"streamlines of {plot.flux_name}"
    streams = Panel(strength, Where.STREAMS, title, label, style.STREAM_MAP, ends=ends)
    if water is not None:
        title = "streamlines of the water"
        streams = replace(streams, title=title)
    if scene.dim == 2:
        lines, title = (
            streamlines(scene.fields, sign_of(scene) * of_means(scene.fields)),
            title if plot.flux else f"{title} on {label}",
        )
        streams = replace(streams, lines=lines, title=title, colours=style.FLUX_MAP)
    if water is None and scene.lines:  # of Baiocchi's dam
        head, only = scene.fields.points[:, 1] - sigma[:, 1], wet(scene.fields)
        seen = head[scene.fields.cells[only]]
        title, ends = (
            r"streamlines of water on its head $y - \partial_y u_h$",
            (float(seen.min()), float(seen.max()), "neither"),
        )
        streams = replace(
            streams, what=head, title=title, lines=water_lines(scene.fields), ends=ends, only=only, label="head"
        )
    trace = TRACE | ({"psi": BOUND} if bounded else {})
    on_gamma = [
        Panel("p", Where.GAMMA, "trace of $u$", curves=trace, of_jump="jump of $u$"),
        Panel("flux", Where.GAMMA, r"flux $\sigma_h\cdot n$", curves=FLUX | ({"q_S": BOUND} if bounded else {})),
        *of_states(scene),
    ]
    in_cells = [across, *([replace(SETS, title=scene.edges)] if "states" in scene.fields.in_cells else [])]
    error, steps = error_panel(scene, r"error contributions $\eta_T$"), Panel("", Where.STEPS, "iteration errors")
    of_water = [] if water is None else wetness(scene, water, unit)
    shown = [u, streams, *(of_water[-1:] or error or [cut])]
    overview = [*shown, *(on_gamma if scene.labels else in_cells), steps]
    return {
        "overview": (f"{scene.title}\n{scene.caption}", overview),
        "u": ("", [u, across, surface]),
        "water": ("", of_water),
        "sigma": ("", [cut, streams]),
        "certificate": ("", error_panel(scene)),
        "signorini": ("", [*on_gamma, SETS] if scene.labels else []),
        "iterations": ("", [steps] if moves(scene.history) else []),
    }


def of_states(scene: Scene) -> list[Panel]:
    """The states of laws with memory."""
    return [
        Panel(STATE + name, Where.GAMMA, title, title, curves={STATE + name: (title, LINE | {"color": "C3"})})
        for name, title in titles(scene.solution).items()
    ]


def sign_of(scene: Scene) -> int:
    """The sign of the physical flux by σ: as `[plot]` says, else that of the velocity of water."""
    water = getattr(scene.solution, "water_kind", None)
    return scene.plot.sign if water is None or "sign" in scene.plot.model_fields_set else -int(water.inflow)


def wetness(scene: Scene, water: Pools, unit: str) -> list[Panel]:
    """The pressure head, with its level 0, and of soils the saturation."""
    title = "pressure head $H - z$" if scene.dim == 3 else "pressure head $H - y$"
    most = max(float(np.abs(water.pressure).max()), 1e-300)
    ends = (-most, most, "neither")
    panels = [Panel(water.pressure, Where.MAP, title, f"pressure head{unit}", style.PRESSURE_MAP, ends=ends)]
    saturation = scene.fields.at_points.get("saturation")
    if saturation is not None:
        ends = 0.0, 1.0, "neither"
        panels.append(Panel(saturation[:, 0], Where.MAP, "saturation", "saturation", style.WET_MAP, ends=ends))
    return panels


def over(scene: Scene, usual: list[Overlay]) -> list[Overlay]:
    """Over maps: the water outside, cells in contact, fronts, the phreatic line."""
    points, contact = scene.fields.points, scene.fields.in_cells.get("contact")
    water, colour = Pools.of(scene), style.WATER
    if water is not None:
        colour = "black"
        face = f"{scene.gamma}, contact"
        seepage = {face: f"{face} (seepage face)"}
        usual = [replace(each, label=seepage.get(each.label, each.label)) for each in usual]
        usual = [*water.overlays(), *usual]
    if contact is not None:
        tint = {"facecolors": style.CONTACT, "alpha": 0.25, "linewidths": 0, "rasterized": True}
        fronts = {"color": style.CONTACT, "linewidth": 1.8}
        usual += [Overlay("", list(points[scene.fields.cells[contact]]), tint, filled=True)]
        usual += [Overlay(scene.edges, list(points[scene.free_boundary()]), fronts)]
    return [
        *usual,
        *(Overlay(name, lines, {"color": colour, "linewidth": 1.8}) for name, lines in scene.lines.items()),
    ]


def kept(solution: Any, steps: int) -> Mapping[str, Sequence[int]]:
    """Steps whose u is in the animation, and whose fronts are drawn."""
    if solution.spaces.mesh.topology.dim == 3:
        return {}
    return {"u": shown(steps)} | ({"own": chosen_for_fronts(steps)} if columns_of_cells(solution) else {})


def in_time(folder: Path, scene: Scene, steps: Steps) -> None:
    """Draw `contact.png`, and in the plane `fronts.png` of laws in Ω and `animation.gif`."""
    titles = columns_of_cells(scene.solution)
    in_cells = {name: ([row[key] for row in steps.rows], None) for key, name in titles.items() if key in steps.rows[-1]}
    size = r"cells by the laws in $\Omega$", "area" if scene.dim == 2 else "volume"
    draw_over_time(
        folder / "contact.png",
        scene,
        steps,
        [replace(SETS, title="sets"), *of_states(scene)],
        {size: in_cells} if in_cells else {},
    )
    if fronts := steps.kept.get("own"):
        lines = {steps.times[step - 1]: fronts_of(scene, each) for step, each in fronts.items()}
        draw_fronts(folder / "fronts.png", scene, lines, scene.edges)
    if scene.dim == 2 and (tables := steps.readings.get("phreatic")):
        chosen = chosen_for_fronts(len(tables))
        draw_fronts(
            folder / "phreatic.png",
            scene,
            {steps.times[step - 1]: lines_in(tables[step - 1]) for step in chosen},
            "phreatic lines",
        )
    if fields := steps.kept.get("u"):
        animate(folder / "animation.gif", scene, steps, {step: each.ravel() for step, each in fields.items()})


def columns_of_cells(solution: Any) -> dict[str, str]:
    """What the measures of cells are called that `Solution.of_step` gives."""
    laws = getattr(solution.data, "inside", None)
    if laws is None:
        return {}
    if laws.is_obstacle:
        return {"cells_measure": "contact with the obstacle"}
    several = len(laws.of_regions) > 1
    return {
        f"{part.name} {segment}": f"{title} by the law in {' and '.join(part.law.region)}" if several else title
        for part in laws.of_regions
        for segment, title in zip(part.law.segments, part.titles(), strict=True)
    }


PICTURES = Pictures(files, over, kept, in_time)
