"""What is drawn of an elastic solution: the deformed body, pressure and friction, and both over time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.rows import joined
from signorini_fenicsx.cases.plot import with_unit
from signorini_fenicsx.discrete.linear_traces import linear_from_means
from signorini_fenicsx.discrete.mesh_spaces import NEUMANN
from signorini_fenicsx.discrete.site_table import Facets, Surfaces, along_parts
from signorini_fenicsx.meshes.domain import AXES, other_side
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.show.shown import in_space
from signorini_fenicsx.physics.elasticity.show.tables import STATES, middles, segment_names, vertex_numbers
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.evolution import draw_over_time
from signorini_fenicsx.pictures.gather import PARTLY_FIXED, whole_boundary
from signorini_fenicsx.pictures.geometry import arrows
from signorini_fenicsx.pictures.panels import (
    Drawn,
    DrawnSteps,
    File,
    Overlay,
    Panel,
    Pictures,
    Where,
    error_panel,
    on_gamma,
)
from signorini_fenicsx.pictures.scene import Scene
from signorini_fenicsx.pictures.sheet import Sheet
from signorini_fenicsx.solving.fields import von_mises

SHARE = 0.05
"""Of the body's size that the largest displacement is drawn as."""
FADES = 0.5
"""Of the body's size: how far the shape that a given gap means reaches into bodies."""
SMALL = 0.25
"""Of the body's size: parts inside it that are smaller have a panel of their own."""
AROUND = 0.75
"""Of the size of these parts: how far the panel reaches from their middle."""
TOUCHES = 1e-3
"""Of the body's size: bodies that are drawn this deep in one another touch."""
NEAR = 0.05
"""Of the body's size: where the gap is drawn larger than this, the foundation is not drawn."""
LONG, WIDE, SPACING = 0.09, 0.02, 0.035
"""Of the body's size: the longest arrow of a traction, the width of its head, the least distance of two."""
WEAK = 0.1
"""Tractions of less than this share of the largest one have no arrow."""

MOVES = 0.01
"""A part moves if the mean of its displacement changes by more than this share of the largest of all parts."""
LOADED = 1e-6
"""A part is loaded if the force on it is larger than this share of the largest of all parts."""


@dataclass(frozen=True)
class BodyFacets(Facets):
    """One row per facet of Γ_C.

    Attributes:
        normals: The outer unit normals, shape (facets, d).
        gaps: The gap at the vertices of each facet, linear on it, shape (facets, d).
        apart: The gap before any displacement there, 0 but for parts inside the domain and slaves of pairs.
        opposite: The number of a vertex opposite to a slave of a pair, else −1.
    """

    normals: Array
    gaps: Array
    apart: Array
    opposite: Indices


def drawn(solution: Any) -> Drawn:
    """The solution for pictures: for σ the largest von Mises stress of each cell (collective)."""
    spaces, nothing = solution.spaces, np.empty(0, dtype=np.int32)
    by_geometry = np.argsort(spaces.order, axis=1)[:, :, None]
    fixed = np.concatenate([nothing, *(spaces.domain.facets[part] for part in solution.boundary.fixed)])
    free = np.setdiff1d(spaces.neumann_facets, fixed)
    kinds = {kind: facets for kind, (facets, _) in whole_boundary(spaces).items()}
    kinds |= {NEUMANN: free, PARTLY_FIXED: fixed}
    unknown = {kind: np.full((len(facets), spaces.dim), np.nan) for kind, facets in kinds.items()}
    given = spaces.tractions(spaces.boundary_facets(free), solution.stresses).mean(axis=1)
    sides = [name for pair in solution.boundary.pairs for name in (*pair.slave, *pair.master)]
    given[np.isin(free, np.concatenate([nothing, *(spaces.domain.facets[side] for side in sides)]))] = 0.0
    u = np.take_along_axis(spaces.displacement_values(solution.u), by_geometry, axis=1)
    stress = von_mises(in_space(spaces, solution.data, solution.stresses)).max(axis=(1, 2))[:, None]
    named = solution.data.laws.of_parts or solution.data.friction
    gamma_c = Surfaces(
        spaces.part_names,
        _facets(solution),
        solution.table(),
        solution.columns,
        [*segment_names(solution), *STATES] if named else (),
        [*solution.boundary.inner, *(part for pair in solution.boundary.pairs for part in pair.slave)],
    )
    return Drawn(
        corners={"u": u, "stress": np.repeat(stress[:, None], spaces.dim + 1, axis=1)},
        cells={"u": u.mean(axis=1), "stress": stress},
        boundary={kind: (facets, (unknown | {NEUMANN: given})[kind]) for kind, facets in kinds.items()},
        surfaces=[gamma_c, *([] if solution.opposite is None else [solution.opposite])],
    )


def _facets(solution: Any) -> BodyFacets:
    spaces, contact = solution.spaces, solution.spaces.contact
    part = spaces.part_of_facet.astype(np.int64)
    middle = middles(contact)
    apart = np.zeros((len(middle), spaces.dim))
    normal = spaces.site_kinds["normal"]
    means = normal.rows_of(solution.data.lift[normal.unknown] + solution.data.laws.p_h)
    between = np.concatenate([spaces.inner.rows, spaces.slave_rows])
    apart[between] = linear_from_means(means)[between]
    numbers, ascending = vertex_numbers(spaces, contact)
    return BodyFacets(
        part=part,
        along=along_parts(spaces, part, middle),
        x=middle,
        measure=contact.measure,
        vertices=numbers,
        normals=contact.normals,
        gaps=np.take_along_axis(solution.linear_gap, ascending, axis=1),
        apart=np.take_along_axis(apart, ascending, axis=1),
        opposite=_opposite(spaces),
    )


def _opposite(spaces: ElasticSpaces) -> Indices:
    """The number of a vertex in the mesh that is opposite to each facet of Γ_C in a pair, −1 elsewhere (collective)."""
    numbers = np.full(len(spaces.contact.facets), -1)
    for pair in spaces.pairs:
        rows, pieces = spaces.rows_of(pair), pair.pieces
        masters, _ = vertex_numbers(spaces, spaces.boundary_facets(pair.masters))
        of_pieces = pair.of_masters(spaces.mesh.comm, masters)[pieces.master, 0]
        numbers[rows] = of_pieces[np.searchsorted(pieces.slave, np.arange(len(rows)))]
    return numbers


def files(scene: Scene) -> dict[str, File]:
    """The pictures of a solution."""
    fields, u = scene.fields, scene.fields.at_points["u"]
    size, largest = float(np.ptp(fields.points, axis=0).max()), float(np.linalg.norm(u, axis=1).max(initial=0.0))
    factor, shape = _placed(scene, size, largest)
    moved = fields.points + factor * (u + shape)
    what = "displacement and gap" if {*scene.labels} - {*scene.surface.inside} or shape.any() else "displacement"
    told = f"{what} × {factor:g}"
    body = scene.at(moved, _beside(scene, moved, factor, NEAR * size))
    foundation = (
        " on its foundation" if scene.dim == 3 and any(each.filled and len(each.points) for each in body.over) else ""
    )
    title, near = f"{scene.title}\n{scene.caption}\n{told}", _near(scene)
    plot = scene.plot
    named = {
        "deformed": ("stress", "von Mises stress", plot.stress_unit),
        "displacement": ("u", "$|u_h|$", plot.length_unit),
    }
    found: dict[str, File] = {}
    for name, (field, label, unit) in named.items():
        in_cells = np.linalg.norm(fields.in_cells[field], axis=1)
        look: dict[str, Any] = {
            "label": with_unit(label, unit),
            "colours": style.FLUX_MAP,
            "ends": scene.usual(in_cells),
        }
        at_points, plane = np.linalg.norm(fields.at_points[field], axis=1), scene.dim == 2
        if near is not None:
            look |= {"ends": style.limits(in_cells[near[1]], scene.measure[near[1]])}
        panels = [
            Panel(at_points, Where.OUTSIDE, f"{label}, deformed body{foundation}", scene=body, **look),
            Panel(in_cells if plane else at_points, Where.MAP, label, scene=body, in_cells=plane, **look),
        ]
        if near is not None:
            few, cells, by = near
            words = rf"{label}, less the mean displacement, $\times$ {by:g}"
            panels.append(Panel(in_cells[cells], Where.MAP, words, scene=few, in_cells=True, **look))
        found[name] = title, panels
    return found | {"pressure": (scene.caption, _on_gamma(scene)), "certificate": ("", error_panel(scene))}


def _on_gamma(scene: Scene) -> list[Panel]:
    """Pressure, gap, the contact set and, where it rubs, shear and slip; in pairs what acts on the other side."""
    in_space, sites = scene.dim == 3, scene.sites
    length, stress = scene.plot.length_unit, scene.plot.stress_unit
    pressed = on_gamma("pressure", "pressure", stress, ("pressure", r"$-\sigma_{nn}$", "C3"), peak=True)
    look: dict[str, Any] = {"colours": style.U_MAP if in_space else style.SIGNED_MAP}
    shear, slip = (r"shear $|\sigma_t|$", "slip $|u_t|$") if in_space else ("shear", "slip")
    sheared = on_gamma("shear_vector", shear, stress, ("shear", r"$\sigma_t$", "C2"), **look)
    panels = []
    if scene.labels:
        gap = on_gamma("gap", "gap", length, ("gap", "$g - u_n$", "C0"))
        slid = on_gamma("sliding_vector", slip, length, ("sliding", "$u_t$", "C1"), **look)
        panels = [pressed, *([] if sites.touching.all() else [gap]), Panel("", Where.SETS, "contact set")]
        panels += [sheared] if (sites.state >= 0).any() else []
        panels += [slid] if np.isfinite(sites.slip).any() else []
    if (other := scene.opposite) is not None:
        panels.append(replace(pressed, scene=other))
        panels += [replace(sheared, scene=other)] if other.sites.shear.any() else []
    return panels


def _beside(scene: Scene, moved: Array, factor: float, most: float) -> list[Overlay]:
    """Over the deformed body: the mesh before, the foundation, in the plane parts inside."""
    facets = foundation_of(scene, moved, factor, most)
    look = {"facecolor": "0.75", "edgecolor": "0.75", "linewidth": 0.3, "zorder": 0.5}
    if scene.dim == 3:
        return [Overlay("foundation", list(facets[:, :3]), {"color": "grey"}, filled=True)]
    return [
        Overlay("before", *_mesh(scene)),
        Overlay("foundation", list(facets), look, filled=True),
        Overlay("", list(facets[:, :2]), {"color": "black", "linewidth": 1.2}),
        _surfaces(scene, moved),
        _arrows(scene, moved, given=True),
        _arrows(scene, moved, given=False),
    ]


def _mesh(scene: Scene) -> tuple[list[Array], dict[str, Any]]:
    """The mesh as it was."""
    around = scene.fields.points[scene.fields.cells]
    return list(np.concatenate([around, around[:, :1]], axis=1)), {"color": "0.85", "linewidth": 0.3, "zorder": 0.4}


def _placed(scene: Scene, size: float, largest: float) -> tuple[float, Array]:
    """How many times displacements are drawn, and the shape that gaps between meshes that fit together give to bodies.

    Bodies in contact are drawn in contact. Distances of meshes are not enlarged: where they would be drawn as gaps, or
    bodies in one another, displacements are not enlarged either.
    """
    enlarged, shape = max(_rounded(SHARE * size / largest), 1.0) if largest > 0 else 1.0, _shape(scene, FADES * size)
    if (most := float(np.linalg.norm(shape, axis=1).max(initial=0.0))) > 0:
        enlarged = min(enlarged, _rounded(FADES * size / (2 * most)))
    return enlarged if _is_true(scene, enlarged, TOUCHES * size) else min(enlarged, 1.0), shape


def _is_true(scene: Scene, factor: float, near: float) -> bool:
    """Whether bodies with meshes of their own are drawn in contact where they are, and nowhere in one another."""
    facets = scene.facets
    assert isinstance(facets, BodyFacets)
    pair = facets.opposite >= 0
    drawn = (factor * facets.gaps - (factor - 1) * facets.apart)[pair]
    held = facets.gaps[pair] <= near / max(factor, 1.0)
    return bool(drawn.min(initial=0.0) >= -near and drawn[held].max(initial=0.0) <= 2 * near)


def _shape(scene: Scene, reach: float) -> Array:
    """How far points are moved so that two bodies, whose meshes fit together, have the gap that is given between them.

    Each has one half of it, which fades within some distance from where they meet.
    """
    facets, points = scene.facets, scene.fields.points
    assert isinstance(facets, BodyFacets)
    two = _inside(scene) & (facets.opposite < 0)
    if not facets.apart[two].any():
        return np.zeros_like(points)
    from scipy.spatial import cKDTree  # slow to import

    body, vertices = joined(len(points), scene.fields.cells), facets.vertices[two].ravel()
    distance, nearest = cKDTree(points[vertices]).query(points)
    side = np.where(body == body[vertices[nearest]], -0.5, 0.5)  # normals point out of the named side
    moves = side * np.maximum(1 - distance / reach, 0.0) * facets.apart[two].ravel()[nearest]
    return np.asarray(moves[:, None] * np.repeat(facets.normals[two], points.shape[1], axis=0)[nearest])


def _arrows(scene: Scene, moved: Array, given: bool) -> Overlay:
    """The tractions that are given, or those of the foundation, as arrows on a deformed body of the plane."""
    facets, boundary, size = scene.facets, scene.boundary, float(np.ptp(scene.fields.points, axis=0).max())
    assert isinstance(facets, BodyFacets)
    if given:
        loaded = boundary.kind == NEUMANN
        vertices, pulls, inwards = boundary.vertices[loaded], boundary.known[loaded], boundary.middles[loaded]
        inwards = inwards - scene.fields.points[vertices].mean(axis=1)
    else:
        free = ~_inside(scene)
        shear = np.nan_to_num(scene.on_facets("shear_vector")[:, :2])
        pulls = (shear - scene.on_facets("pressure")[:, None] * facets.normals)[free]
        vertices, inwards = facets.vertices[free], -facets.normals[free]
    x, strength = moved[vertices].mean(axis=1), np.linalg.norm(pulls, axis=1)
    kept: list[int] = []
    weak = max(WEAK * float(strength.max(initial=0.0)), LOADED * _strongest(scene))
    for row in [row for row in np.argsort(-strength, kind="stable") if strength[row] > weak]:
        between, way = x[kept] - x[row], pulls[row] / strength[row]
        ahead = np.abs(between @ way)
        beside = np.linalg.norm(between - (between @ way)[:, None] * way, axis=1)
        clear = np.all((ahead > 1.2 * LONG * size) | (beside > SPACING * size))
        kept += [row] if clear else []
    along = LONG * size * pulls[kept] / max(float(strength.max(initial=0.0)), 1e-300)
    push = (np.einsum("ni,ni->n", along, inwards[kept]) > 0)[:, None]
    label, colour = ("given traction", style.LOAD) if given else ("contact", style.CONTACT)
    look = {"facecolor": colour, "linewidth": 0.0, "zorder": 6}
    return Overlay(label, list(arrows(x[kept] - push * along, along, WIDE * size)), look, filled=True)


def _strongest(scene: Scene) -> float:
    """The largest stress."""
    return float(np.abs(scene.fields.in_cells["stress"]).max(initial=0.0))


def _inside(scene: Scene) -> Mask:
    """Mask of the facets of Γ_C inside the domain, where two bodies touch."""
    surface = scene.surface
    return np.isin(surface.facets.part, [index for index, name in enumerate(surface.names) if name in surface.inside])


def _surfaces(scene: Scene, moved: Array) -> Overlay:
    """The lines along which two bodies, or the sides of a crack, touch or may touch, in the plane."""
    lines = list(moved[scene.facets.vertices[_inside(scene)]])
    return Overlay("contact surfaces", lines, {"color": "black", "linewidth": 0.8})


def _at_points(vertices: Indices, values: Array, size: int) -> Array:
    """The means of vectors at the vertices of facets, shape (facets, d, d), over the facets around each point."""
    points, columns = vertices.ravel(), np.moveaxis(values, 2, 0).reshape(values.shape[2], -1)
    count = np.maximum(np.bincount(points, minlength=size), 1)
    return np.column_stack([np.bincount(points, column, minlength=size) / count for column in columns])


def foundation_of(scene: Scene, moved: Array, factor: float, most: float) -> Array:
    """The facets of the foundation where it is drawn nearer to the deformed body than `most`, and their undersides.

    Args:
        scene: The body as it was.
        moved: Where its points are drawn.
        factor: Displacements and gaps are drawn larger by this factor.
        most: See above.

    Returns:
        The vertices of each facet, on the surface and then below it, shape (facets, 2 dim, dim).
    """
    facets = scene.facets
    assert isinstance(facets, BodyFacets)
    lift = _at_points(facets.vertices, factor * facets.gaps[:, :, None] * facets.normals[:, None], len(moved))
    surface = (moved + lift)[facets.vertices]
    under = surface + 0.2 * most * facets.normals[:, None]
    return np.concatenate([surface, under[:, ::-1]], axis=1)[~_inside(scene) & (factor * scene.on_facets("gap") < most)]


def _near(scene: Scene) -> tuple[Scene, Mask, float] | None:
    """The surroundings of small parts inside the domain; None if there are none, or they are not small.

    Returns:
        The cells there, moved by the displacement less the mean one of these parts; which ones they are; the factor by
        which this is drawn larger.
    """
    fields, of_parts = scene.fields, np.unique(scene.facets.vertices[_inside(scene)])
    if not len(of_parts) or scene.dim == 3:
        return None
    low, high = fields.points[of_parts].min(axis=0), fields.points[of_parts].max(axis=0)
    size = float((high - low).max())
    if size > SMALL * np.ptp(fields.points, axis=0).max():
        return None
    moves = fields.at_points["u"] - fields.at_points["u"][of_parts].mean(axis=0)
    largest = float(np.linalg.norm(moves[of_parts], axis=1).max())
    facets = scene.facets
    assert isinstance(facets, BodyFacets)
    factor = _rounded(2 * SHARE * size / largest) if largest > 0 else 1.0
    factor = min(factor, 1.0) if facets.apart.any() else factor  # distances are not enlarged
    frame = np.stack([(low + high) / 2 - AROUND * size, (low + high) / 2 + AROUND * size])
    moved = fields.points + factor * moves
    shown = [places[fields.cells] for places in (fields.points, moved)]
    reaches = [(each.max(axis=1) > frame[0]).all(axis=1) & (each.min(axis=1) < frame[1]).all(axis=1) for each in shown]
    cells = reaches[0] | reaches[1]
    few = replace(scene, fields=replace(fields, cells=fields.cells[cells]))
    over = [Overlay("", *_mesh(few)), _surfaces(scene, moved)]
    return replace(few.at(moved, over), frame=frame), cells, factor


def _rounded(value: float) -> float:
    """The nearest smaller one of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 5) if step <= value / power * (1 + 1e-12)) * power)


def in_time(folder: Path, scene: Scene, steps: DrawnSteps) -> None:
    """Draw `forces.png`, where there is Γ_C `contact.png`, and where there are pairs `pairs.png`."""
    _forces(scene, steps.rows).save(folder / "forces.png")
    shown = [each for each in _on_gamma(scene) if each.where is Where.GAMMA and each.what != "gap"]
    if scene.labels:
        draw_over_time(folder / "contact.png", scene, steps, [each for each in shown if each.scene is None])
    if scene.opposite is not None:
        panels = [replace(each, scene=None) for each in shown if each.scene is not None]
        draw_over_time(folder / "pairs.png", scene.opposite, replace(steps, tables=steps.opposite), panels)


def _forces(scene: Scene, rows: Sequence[Mapping[str, Any]]) -> Sheet:
    """The contact force over time; the force on each part that moves against its mean displacement, inner ones once."""
    axes_of, others = AXES[: scene.dim], {other_side(part) for part in scene.surface.inside}
    parts = [key.removesuffix("_force_x") for key in rows[0] if key.endswith("_force_x")]
    moved = {part: np.array([[row[f"{part}_u_{axis}"] for axis in axes_of] for row in rows]) for part in parts}
    ranges = {part: np.ptp(path, axis=0) for part, path in moved.items()}
    largest = max((float(size.max()) for size in ranges.values()), default=0.0)
    forces = {part: np.array([[row[f"{part}_force_{axis}"] for axis in axes_of] for row in rows]) for part in parts}
    strongest = max((float(np.abs(force).max()) for force in forces.values()), default=0.0)
    driven = [
        part
        for part in parts
        if part not in others
        and ranges[part].max() > MOVES * largest
        and np.abs(forces[part]).max() > LOADED * strongest
    ]
    first = 1 if scene.labels else 0
    sheet = Sheet([4.4], [2.2] * (first + len(driven)), bars=False, title=scene.title)
    if scene.labels:
        axes = sheet.panel(0, 0)
        axes.plot([row["t"] for row in rows], [row["contact_force"] for row in rows], color=style.CONTACT, marker=".")
        axes.set(xlabel=scene.plot.along("t"), ylabel=r"$-\int\sigma_{nn}$", title="contact force")
        axes.set_ylim(0, 1.05 * max(row["contact_force"] for row in rows) or None)  # what hardly changes looks so
    for index, part in enumerate(driven, start=first):
        axes, along = sheet.panel(index, 0), int(ranges[part].argmax())
        for k, (axis, colour) in enumerate(zip(axes_of, (style.CONTACT, style.FREE, style.WATER), strict=False)):
            look = {"color": colour, "linestyle": ("-", "--", ":")[k], "marker": ".os"[k], "markersize": 4}
            axes.plot(moved[part][:, along], forces[part][:, k], label=f"${axis}$", **look)
        axes.set(xlabel=scene.plot.along(f"mean $u_{axes_of[along]}$"), ylabel="force", title=f"force on {part}")
    sheet.legend_below(list(axes.lines) if driven else [])
    return sheet


PICTURES = Pictures(drawn, files, in_time=in_time)
