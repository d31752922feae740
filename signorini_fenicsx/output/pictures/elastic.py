"""Pictures of an elastic solution: the deformed body, the contact pressure, where the error is."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.tri import Triangulation

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.rows import joined
from signorini_fenicsx.base.tolerances import TIE
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.contact.laws import Friction
from signorini_fenicsx.output.gather import Fields
from signorini_fenicsx.output.pictures import load_steps, plane_files, style
from signorini_fenicsx.output.pictures.plane import WIDE, Plane, framed
from signorini_fenicsx.output.pictures.scene import Pictures, Scene
from signorini_fenicsx.output.pictures.sheet import Sheet
from signorini_fenicsx.physics.elasticity.show.shown import BodyFacets, ContactTable
from signorini_fenicsx.solving.solved import Solved

SHARE = 0.1
"""Of the body's size that the largest displacement is drawn as."""
APART = 0.08
"""Of the body's size: the distance of bodies that are drawn apart."""
SMALL = 0.25
"""Of the body's size: parts inside it that are smaller have a panel of their own."""
AROUND = 0.75
"""Of the size of these parts: how far the panel reaches from their middle."""
NEAR_WIDTH = 4.4
"""Inches of this panel."""
NEAR = 0.12
"""Of the body's size: where the gap is drawn larger than this, the foundation is not drawn."""


def caption(solution: Solved, fields: Fields, certificate: Certificate | None) -> str:
    """Title, cells and the certified error."""
    words = [f"{solution.title or solution.name}, {fields.count}"]
    if certificate is not None and np.isfinite(certificate.bound):
        share = f"{100 * certificate.relative:.3g} %" if certificate.smaller_than_flux else f"{certificate.bound:.3g}"
        words += style.bound_in_words(certificate, share)
    return ", ".join(words)


def draw_files(folder: Path, scene: Scene) -> None:
    """Draw `deformed.png`, `displacement.png`, with Γ_C `pressure.png`, with a certificate `certificate.png`."""
    overview(scene).save(folder / "deformed.png")
    overview(_by_displacement(scene)).save(folder / "displacement.png")
    if scene.dim == 2:
        if scene.labels:
            _pressure(scene).save(folder / "pressure.png")
        plane_files.draw_certificate_file(folder / "certificate.png", Plane(scene))
        return
    from signorini_fenicsx.output.pictures import space_files  # imports VTK

    assert isinstance(scene.facets, BodyFacets)
    space_files.draw_files_of_body(folder, scene, rubs=bool(np.isfinite(scene.facets.shear).any()))


def overview(scene: Scene) -> Sheet:
    """The deformed body on its foundation."""
    fields = scene.fields
    assert fields.displacement is not None
    size = float(np.ptp(fields.points, axis=0).max())
    largest = float(np.linalg.norm(fields.displacement, axis=1).max(initial=0.0))
    factor = _rounded(SHARE * size / largest) if largest > 0 else 1.0
    apart = _apart(scene, APART * size)
    places = fields.points + factor * fields.displacement + apart
    moved = replace(scene, fields=replace(fields, points=places))
    foundation = foundation_of(scene, moved.fields.points, factor, NEAR * size)
    what = "displacement and gap" if scene.labels else "displacement"
    title = f"{scene.caption}\n{what} × {factor:g}" + (", bodies drawn apart" if apart.any() else "")
    if scene.dim == 2:
        return _deformed_plane(scene, moved, foundation, title)
    from signorini_fenicsx.output.pictures import space_files  # imports VTK

    return space_files.deformed(moved, foundation[:, : scene.dim], title)


def _by_displacement(scene: Scene) -> Scene:
    """The scene with u for its stress, and |u| for what its cells are coloured by."""
    fields = scene.fields
    assert fields.displacement is not None
    of_cells = fields.displacement[fields.cells].mean(axis=1)
    return replace(
        scene, fields=replace(fields, sigma=of_cells, sigma_at_points=fields.displacement), strength="$|u_h|$"
    )


def _apart(scene: Scene, distance: float) -> Array:
    """How far the points of each body are moved so that bodies with a gap between them are this far from each other.

    Their meshes fit together, so that they would cover each other where they are pressed over the gap.
    """
    facets, points, inside = scene.facets, scene.fields.points, _inside(scene)
    assert isinstance(facets, BodyFacets)
    if not facets.apart.any():
        return np.zeros_like(points)
    size = len(points)
    body = joined(size, scene.fields.cells)
    _, place = np.unique(points, axis=0, return_inverse=True)
    other = np.full(size, -1)
    for point in np.setdiff1d(np.arange(size), facets.vertices[inside]):
        other[place[point]] = body[point]
    named_body, other_body = body[facets.vertices[inside, 0]], other[place[facets.vertices[inside]]].max(axis=1)
    two = (named_body != other_body) & (other_body >= 0)
    rows, each = np.zeros((int(two.sum()), int(body.max()) + 1)), np.arange(int(two.sum()))
    rows[each, named_body[two]], rows[each, other_body[two]] = 1.0, -1.0
    moved = np.linalg.lstsq(rows, -distance * facets.normals[inside][two], rcond=None)[0]
    return np.asarray(moved[body])


def _inside(scene: Scene) -> Mask:
    """Mask of the facets of Γ_C inside the domain, where two bodies touch."""
    return np.isin(scene.facets.part, [index for index, name in enumerate(scene.labels) if name in scene.inside])


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
    return np.concatenate([surface, under[:, ::-1]], axis=1)[~_inside(scene) & (factor * facets.p < most)]


def _deformed_plane(scene: Scene, moved: Scene, foundation: Array, title: str) -> Sheet:
    """The deformed body, coloured by the equivalent stress, over its mesh before, and the foundation."""
    frame = framed(np.concatenate([scene.fields.points, moved.fields.points, foundation.reshape(-1, 2)]))
    aspect = float(np.divide(*np.ptp(frame, axis=0)))
    width, near = 7.0 if aspect > WIDE else min(5.4, 6.0 * aspect), _near(scene)
    sheet = Sheet([width, NEAR_WIDTH] if near else [width], [width / aspect], title=title)
    axes = sheet.panel(0, 0, aspect=aspect)
    _draw_body(sheet, axes, scene, moved.fields.points)
    axes.add_collection(PolyCollection(foundation, facecolors="0.75", edgecolors="face", linewidths=0.3, zorder=0.5))
    axes.add_collection(LineCollection(foundation[:, :2], colors="black", linewidths=1.2))
    style.shape_axes(axes, "", frame)
    if near:
        axes = sheet.panel(0, 1, aspect=1.0)
        _draw_body(sheet, axes, near.scene, near.moved)
        style.shape_axes(axes, rf"less the mean displacement, $\times$ {near.factor:g}", near.frame)
    below = [Patch(color="0.75", label="foundation")] if len(foundation) else []
    sheet.legend_below([*below, Patch(color="0.9", label="before")])
    return sheet


def _draw_body(sheet: Sheet, axes: Axes, scene: Scene, moved: Array) -> None:
    """The cells where they are drawn, coloured by the equivalent stress, over the mesh before, and parts inside."""
    fields = scene.fields
    axes.triplot(Triangulation(*fields.points.T, fields.cells), color="0.85", linewidth=0.3)
    low, high, extend = style.limits(scene.sigma_norm, scene.measure)
    look = {"cmap": style.FLUX_MAP, "vmin": low, "vmax": high, "edgecolors": "face", "linewidth": 0.3}
    after = Triangulation(*moved.T, fields.cells)
    image = axes.tripcolor(after, facecolors=scene.sigma_norm, rasterized=True, **look)
    touching = moved[scene.facets.vertices[_inside(scene)]]
    axes.add_collection(LineCollection(touching, colors="black", linewidths=0.8))
    sheet.bar(axes, image, scene.strength, extend)


class Near(NamedTuple):
    """What a panel shows of the surroundings of parts inside the domain that are small beside it.

    Attributes:
        scene: The cells there.
        moved: Where points are drawn: by the displacement less the mean one of these parts.
        factor: This is drawn larger by this factor.
        frame: Smallest and largest coordinates of what is shown, shape (2, 2).
    """

    scene: Scene
    moved: Array
    factor: float
    frame: Array


def _near(scene: Scene) -> Near | None:
    """The surroundings of the parts inside the domain; None if there are none, or they are not small."""
    fields, own = scene.fields, np.unique(scene.facets.vertices[_inside(scene)])
    assert fields.displacement is not None
    if not len(own):
        return None
    low, high = fields.points[own].min(axis=0), fields.points[own].max(axis=0)
    size = float((high - low).max())
    if size > SMALL * np.ptp(fields.points, axis=0).max():
        return None
    moves = fields.displacement - fields.displacement[own].mean(axis=0)
    largest = float(np.linalg.norm(moves[own], axis=1).max())
    factor = _rounded(SHARE * size / largest) if largest > 0 else 1.0
    frame = np.stack([(low + high) / 2 - AROUND * size, (low + high) / 2 + AROUND * size])
    moved = fields.points + factor * moves
    shown = [places[fields.cells] for places in (fields.points, moved)]
    reaches = [(each.max(axis=1) > frame[0]).all(axis=1) & (each.min(axis=1) < frame[1]).all(axis=1) for each in shown]
    cells = reaches[0] | reaches[1]
    few = replace(fields, cells=fields.cells[cells], sigma=fields.sigma[cells])
    return Near(replace(scene, fields=few), moved, factor, frame)


def _pressure(scene: Scene) -> Sheet:
    """−σ_nn along each part of Γ_C, linear on each facet, and the gap."""
    table, parts = scene.sites, list(scene.labels)
    assert isinstance(table, ContactTable)
    sheet = Sheet([4.6], [2.0] * len(parts), title=scene.caption)
    lines: dict[object, Line2D] = {}
    pressure = without_rounding(table.pressure)
    for index, name in enumerate(parts):
        mine = table.part == index
        axes = sheet.panel(index, 0, aspect=4.6 / 2)
        axes.plot(table.along[mine], pressure[mine], color=style.CONTACT, label=r"pressure $-\sigma_{nn}$")
        axes.set(xlabel=f"${scene.labels[name]}$", ylabel="pressure", title=_with_peak(name, pressure[mine]))
        other = axes.twinx()
        other.grid(False)
        other.plot(table.along[mine], table.gap[mine], color=style.FREE, label=r"gap $g - u_n$")
        other.set_ylabel("gap")
        if (table.state[mine] >= 0).any():
            axes.plot(table.along[mine], table.shear[mine], color=style.SEGMENTS[1], label=r"shear $\sigma_t$")
            axes.set_ylabel("pressure, shear")
            _mark_states(axes, table, mine)
        _align_zero(axes, other, table.gap[mine])
        lines |= {line.get_label(): line for line in (*axes.lines, *other.lines)}
    sheet.legend_below(list(lines.values()))
    return sheet


def _align_zero(axes: Axes, other: Axes, values: Array) -> None:
    """Put 0 of the second axis, which shows these values, at the height of 0 of the first one."""
    low, high = axes.get_ylim()
    if low < 0 < high:
        top = 1.05 * max(values.max(initial=0.0), values.min(initial=0.0) * high / low) or 1.0
        axes.set_ylim(low, high)
        other.set_ylim(top * low / high, top)


def _with_peak(part: str, pressure: Array) -> str:
    """The title of a part: its name and its largest pressure."""
    largest = pressure.max(initial=0.0)
    return f"{part}, pressure at most {largest:.4g}" if largest > 0 else f"{part}, no contact"


def without_rounding(values: Array) -> Array:
    """The values with 0 for what is rounding beside the largest; else it fills the panel of a part without contact."""
    return np.where(np.abs(values) > TIE * np.abs(values).max(initial=0.0), values, 0.0)


def _mark_states(axes: Axes, table: ContactTable, rows: Mask) -> None:
    """Marks at the lower edge where the body slips in contact, to where it moves; none where it sticks or is open."""
    along, forward = table.along[rows], table.forward[rows]
    state = np.where(table.touching[rows], table.state[rows], -1)
    for name, sign in (("slip+", -1), ("slip-", 1)):
        for way, look in ((-1, "<"), (1, ">")):
            slipping = along[(state == Friction.segments.index(name)) & (sign * forward == way)]
            if len(slipping):
                place, label = np.full(len(slipping), 0.03), f"{name}, $u_t {'<' if sign < 0 else '>'} 0$"
                look_of = {"color": "black", "markersize": 3, "transform": axes.get_xaxis_transform(), "label": label}
                axes.plot(slipping, place, look, **look_of)


def _rounded(value: float) -> float:
    """The nearest smaller one of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 5) if step <= value / power * (1 + 1e-12)) * power)


PICTURES = Pictures(caption, draw_files, overview, load_steps.draw_steps)
