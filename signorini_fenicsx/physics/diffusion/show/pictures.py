"""What is drawn of a solution of a diffusion problem: u, the flux, both on Γ_S, and in time the sets and fronts."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.colors import ListedColormap

from signorini_fenicsx.base.owned import owned_values
from signorini_fenicsx.cases.plot import with_unit
from signorini_fenicsx.contact.law import EVERYWHERE
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.site_table import Surfaces
from signorini_fenicsx.physics.diffusion.show.phreatic import lines_in
from signorini_fenicsx.physics.diffusion.show.pools import Pools, u_at_points, water_lines
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
from signorini_fenicsx.pictures.panels import Drawn, DrawnSteps, File, Overlay, Panel, Pictures, Where, error_panel
from signorini_fenicsx.pictures.plane import levels_between
from signorini_fenicsx.pictures.scene import Scene
from signorini_fenicsx.pictures.streams import of_means, streamlines

LINE: dict[str, Any] = {"linewidth": 1.6}
DASHED = {"color": "black", "linewidth": 1.0, "linestyle": "--"}
DOTS = {"color": "C1", "linestyle": "", "marker": "o", "markersize": 2.8}
FLUX = LINE | {"color": "C2"}
IN_SPACE = {"color": "black", "opacity": 0.25}
SETS = Panel("", Where.SETS, "contact set")
SEGMENTS = "segments of "


def drawn(solution: Any) -> Drawn:
    """See `Pictures.drawn`."""
    flux, u, laws, inside = solution.cell_flux, solution.u_vertices, solution.data.laws, solution.data.inside
    if (
        inside
        and solution.order == 1
        and all(given.number is not None for part in inside.of_regions for given in part.data.values())
    ):  # u is constant where it is held, and a line of this level is to end there
        u = np.where(solution.held_cells[:, None], owned_values(solution.u)[:, None], u)
    sigma, of_u, x = flux.centroid, solution.data.quasilinear, corners(solution.spaces.mesh)
    at_corners = {"u": u[:, :, None], "sigma": np.repeat(sigma[:, None], u.shape[1], axis=1)}
    if of_u is not None and of_u.has_soils:
        wet = np.stack([of_u.saturation(x[:, k], u[:, k]) for k in range(u.shape[1])], axis=1)
        at_corners["saturation"] = wet[:, :, None]
    slaves = [part for pair in solution.boundary.pairs for part in pair.slave]
    table, segments = solution.table(), laws.titles() if laws.listed else ()
    gamma_s = Surfaces(
        solution.spaces.part_names, table, table, solution.columns, segments, [*solution.boundary.inner, *slaves]
    )
    fronts = "edge of the contact" if inside.bounds_alone else "fronts"
    above = max((about.get("above_table", 0.0) for about in solution.water.values()), default=0.0)
    return Drawn(
        corners=at_corners,
        cells={"sigma": sigma, "divergence": solution.divergences, **_held(solution)},
        boundary=solution.traces(),
        surfaces=[gamma_s],
        states={fronts: solution.cell_segments} if inside else {},
        over=_phreatic(solution),
        words=[f"{100 * above:.3g} % of the discharge at negative pressure"] if above else [],
    )


def _held(solution: Any) -> dict[str, npt.NDArray]:
    """Of laws in Ω where u is held, and of each law its segment, 0 elsewhere (collective)."""
    laws = solution.data.inside
    found = {"contact": solution.held_cells} if laws else {}
    for part in laws.of_regions if laws else ():
        segment = np.sort(part.law.named(solution.segments_of_law(part)).reshape(len(part.rows), -1), axis=1)
        labels = np.zeros(len(solution.held_cells), dtype=np.int64)
        labels[part.rows] = 1 + segment[:, segment.shape[1] // 2]  # with RT1 that of most vertices
        found[SEGMENTS + part.name] = labels
    return found


def _phreatic(solution: Any) -> list[Overlay]:
    """The phreatic line, in space a surface (collective)."""
    if solution.water_kind is None:
        return []
    if solution.spaces.mesh.topology.dim == 3:
        return [Overlay("phreatic surface", solution.phreatic, IN_SPACE)]
    return [Overlay("phreatic line", solution.phreatic, {"color": "black", "linewidth": 1.8})]


def files(scene: Scene) -> dict[str, File]:
    """The pictures of a solution."""
    water = Pools.of(scene)
    u, streams = _u(scene, water), _streams(scene, water)
    sigma = np.linalg.norm(scene.fields.at_points["sigma"], axis=1)
    cut = Panel(sigma, Where.CUT, r"$|\sigma_h|$", r"$|\sigma_h|$", style.FLUX_MAP, ends=streams.ends)
    across = replace(u, where=Where.ACROSS)
    on_gamma = [*_on_gamma(scene, water), *of_states(scene)] if scene.labels else []
    by_laws = [] if water is not None and water.only is not None else segments(scene)
    in_cells = [across, *(replace(SETS, title=name) for name in scene.fields.states)]
    error, steps = error_panel(scene, r"error contributions $\eta_T$"), Panel("", Where.STEPS, "iteration errors")
    of_water = [] if water is None else wetness(scene, water)
    surface = [] if water is not None else [replace(u, where=Where.SURFACE, title=f"{u.label} as a surface")]
    overview = [u, streams, *(of_water[-1:] or error or [cut]), *by_laws, *(on_gamma or in_cells), steps]
    return {
        "overview": (f"{scene.title}\n{scene.caption}", overview),
        "u": ("", [u, across, *surface, *by_laws]),
        "water": ("", [u, streams, *of_water] if of_water else []),
        "sigma": ("", [cut, streams]),
        "certificate": ("", error_panel(scene)),
        "signorini": ("", [*on_gamma, SETS] if on_gamma else []),
        "iterations": ("", [steps] if moves(scene.history) else []),
    }


def _u(scene: Scene, water: Pools | None) -> Panel:
    """U, or the head of water, with level lines."""
    name, only = (scene.plot.u_label, None) if water is None else (with_unit("head $H$", scene.plot.unit), water.only)
    values = u_at_points(scene) if water is None else water.head
    seen = values if only is None else values[scene.fields.cells[only]]
    levels = scene.plot.levels or levels_between(float(seen.min()), float(seen.max()))
    return Panel(values, Where.MAP, name, name, levels=levels, only=only)


def _streams(scene: Scene, water: Pools | None) -> Panel:
    """Streamlines of the physical flux, coloured by its length; those of Baiocchi's dam by the head."""
    fields, named = scene.fields, bool(scene.plot.flux or water is not None)
    label = scene.plot.flux_label
    if water is not None and not scene.plot.flux:
        label = with_unit("Darcy velocity", scene.plot.flux_unit)
    title = f"streamlines of {scene.plot.flux_name if water is None else 'the water'}"
    strength = np.linalg.norm(fields.at_points["sigma"], axis=1)
    in_cells = np.linalg.norm(fields.in_cells["sigma"], axis=1)
    ends, log = scene.usual(in_cells), style.spans_decades(in_cells, scene.measure)
    streams = Panel(strength, Where.STREAMS, title, label, style.STREAM_MAP, ends=ends, log=log)
    if scene.dim == 3:
        return replace(streams, flow=sign_of(scene) * fields.at_points["sigma"])
    if water is not None and water.only is not None:
        head = _u(scene, water)
        return replace(head, where=Where.STREAMS, title=title, levels=(), lines=water_lines(fields))
    lines = streamlines(fields, sign_of(scene) * of_means(fields))
    title = title if named else f"{title} on {label}"
    return replace(streams, lines=lines, title=title, colours=style.FLUX_MAP)


def _on_gamma(scene: Scene, water: Pools | None) -> list[Panel]:
    """Along Γ_S the trace of u, or of water the head, and the physical flux outwards."""
    plot, sign, bounded = scene.plot, sign_of(scene), not scene.surface.segments  # other laws have neither ψ nor q_S
    seen = {key: sign * values for key, values in vars(scene.sites).items() if key in ("flux", "flux_at", "q_S")}
    p, u, bound, title = "$p_h$", "$u_h$", r"$\psi$, $q_S$", plot.u_label if plot.u else "trace of $u$"
    if water is not None and not scene.surface.inside:  # there are jumps
        p, u, bound, title = "$H$", "$H$", "height, $q_S$", with_unit("head $H$", plot.unit)
        seen |= water.heads_on(scene.sites, scene.dim)
    shown = scene.with_surface(table=replace(scene.sites, **seen)) if water is not None or sign < 0 else None
    flux = r"$\sigma_h\cdot n$" if sign > 0 else r"$-\sigma_h\cdot n$"
    name = f"{plot.flux_name} outwards" if plot.flux else f"flux {flux}" if water is None else "outflow"
    curves = {"p": (p, LINE | {"color": "C0"}), "u": (f"{u} in the cell behind", DOTS)}
    psi, q_S = ({key: (bound, DASHED)} if bounded else {} for key in ("psi", "q_S"))
    jump = f"jump of {plot.u_label if plot.u else '$u$'}"
    return [
        Panel("p", Where.GAMMA, title, curves=curves | psi, of_jump=jump, scene=shown),
        Panel("flux", Where.GAMMA, with_unit(name, plot.flux_unit), curves={"flux": (flux, FLUX)} | q_S, scene=shown),
    ]


def segments(scene: Scene) -> list[Panel]:
    """The cells of each law in Ω by its segments."""
    laws, found = getattr(scene.solution.data, "inside", None), []
    for part in laws.of_regions if laws else ():
        of_cells, where = scene.fields.in_cells[SEGMENTS + part.name], " and ".join(part.law.region)
        colours = {"no law": "0.92", **scene.colours_in_cells(part.titles())}
        names = ["no law", *part.titles()]
        title = f"cells by the law in {r'$\Omega$' if EVERYWHERE in part.law.region else where}"
        look: dict[str, Any] = {"in_cells": True, "ends": (-0.5, len(names) - 0.5, "neither")}
        look |= {"colours": ListedColormap([colours[name] for name in names])}
        present = {names[int(each)]: colours[names[int(each)]] for each in np.unique(of_cells)}
        found.append(Panel(of_cells, Where.MAP, title, names=present, **look))
    return found


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


def wetness(scene: Scene, water: Pools) -> list[Panel]:
    """The pressure head, on a scale with 0 in its middle if it has both signs, and of soils the saturation."""
    title, label = f"pressure head $H - {'xyz'[scene.dim - 1]}$", with_unit("pressure head", scene.plot.unit)
    seen = water.pressure if water.only is None else water.pressure[scene.fields.cells[water.only]]
    low, high = style.around_0(seen)
    colours = style.WATER_MAP if low == 0 else style.DRY_MAP if high == 0 else style.PRESSURE_MAP
    ends = (low, high, "neither")
    panels = [Panel(water.pressure, Where.MAP, title, label, colours, ends=ends, only=water.only)]
    saturation = scene.fields.at_points.get("saturation")
    if saturation is not None:
        ends = 0.0, 1.0, "neither"
        panels.append(Panel(saturation[:, 0], Where.MAP, "saturation", "saturation", style.WET_MAP, ends=ends))
    return panels


def over(scene: Scene, usual: list[Overlay]) -> list[Overlay]:
    """Over maps: the water outside, what is dry, fronts."""
    points, water = scene.fields.points, Pools.of(scene)
    if water is not None:
        face = f"{scene.gamma}, contact"
        seepage = {face: f"{face} (seepage face)"}
        usual = [replace(each, label=seepage.get(each.label, each.label)) for each in usual]
        usual = [*water.overlays(), *usual]
    if water is not None and water.only is not None:
        dry = {"facecolor": "0.9", "linewidth": 0, "rasterized": True}
        usual += [Overlay("dry", list(points[scene.fields.cells[~water.only]]), dry, filled=True)]
    elif scene.dim == 2:
        fronts = {"color": style.CONTACT, "linewidth": 1.8}
        name, between = scene.fronts
        usual += [Overlay(name, list(points[between]), fronts)]
    return usual


def kept(solution: Any, steps: int) -> Mapping[str, Sequence[int]]:
    """Steps whose u is in the animation, and whose fronts are drawn."""
    if solution.spaces.mesh.topology.dim == 3:
        return {}
    return {"u": shown(steps)} | ({"own": chosen_for_fronts(steps)} if columns_of_cells(solution) else {})


def in_time(folder: Path, scene: Scene, steps: DrawnSteps) -> None:
    """Draw `contact.png`, and in the plane `fronts.png` of laws in Ω and `animation.gif`."""
    titles = {key: name for key, name in columns_of_cells(scene.solution).items() if key in steps.rows[-1]}
    colours = scene.colours_in_cells(titles.values())
    in_cells = {name: ([row[key] for row in steps.rows], colours[name]) for key, name in titles.items()}
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
        draw_fronts(folder / "fronts.png", scene, lines, scene.fronts[0])
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
    if not laws:
        return {}
    if laws.is_obstacle:
        return {"cells_measure": "contact with the obstacle"}
    several = len(laws.of_regions) > 1
    return {
        f"{part.name} {segment}": f"{title} by the law in {' and '.join(part.law.region)}" if several else title
        for part in laws.of_regions
        for segment, title in zip(part.law.segments, part.titles(), strict=True)
    }


PICTURES = Pictures(drawn, files, over, kept, in_time, heights=u_at_points)
