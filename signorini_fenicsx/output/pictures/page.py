"""`solution.html`: one file with pictures that the mouse can turn; the browser needs no network."""

import html
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.text import printable
from signorini_fenicsx.discrete.mesh_spaces import SIGNORINI
from signorini_fenicsx.meshes.domain import FAR
from signorini_fenicsx.output.pictures import style
from signorini_fenicsx.output.pictures.scene import Scene, creases, thinned

MOST_TRIANGLES = 40_000
"""Most triangles of a surface, which then takes one or two megabytes."""
ZOOM = 1.25
HEIGHT = 0.5
"""Height of a surface over the plane, relative to the shorter side of the domain."""
CAMERA = {"projection": {"type": "orthographic"}, "eye": {"x": 0.9, "y": -1.4, "z": 0.8}}
SYMBOLS = {
    r"\leq": "≤",
    r"\varepsilon": "ε",
    r"\|": "‖",
    r"\sigma": "σ",
    r"\times": "×",
    r"\cdot": "·",
    r"\ ": " ",
    "$": "",
}


@dataclass(frozen=True)
class Sheet:
    """A picture that the user chooses with a button.

    Attributes:
        name: Text of the button.
        traces: What it shows in addition to the common parts of all pictures.
    """

    name: str
    traces: list


def write_page(path: Path, scene: Scene) -> None:
    """Write the page (rank 0)."""
    origin, points = _origin(scene.fields.points), scene.fields.points
    scene = replace(scene, fields=replace(scene.fields, points=points - origin))
    common, sheets = _plane(scene) if scene.dim == 2 else _space(scene)
    figure = go.Figure([*common, *(trace for sheet in sheets for trace in sheet.traces)])
    owner = np.concatenate([[-1] * len(common), *([number] * len(sheet.traces) for number, sheet in enumerate(sheets))])
    for trace, number in zip(figure.data, owner, strict=True):
        trace.visible = bool(number <= 0)
    buttons = [
        {"label": sheet.name, "method": "restyle", "args": ["visible", [bool(n in (-1, number)) for n in owner]]}
        for number, sheet in enumerate(sheets)
    ]
    text = f"{html.escape(printable(scene.title))}<br><sub>{plain(scene.caption)}</sub>"
    figure.update_layout(
        title={"text": text, "x": 0.5, "y": 0.98, "yanchor": "top"},
        scene=_axes(scene, origin) | {"camera": CAMERA},
        updatemenus=[
            {"type": "buttons", "direction": "right", "buttons": buttons}
            | {"x": 0.5, "xanchor": "center", "y": 1.0, "yanchor": "bottom"}
        ],
        legend={"orientation": "h", "x": 0.5, "xanchor": "center", "y": 0.0},
        margin={"l": 0, "r": 0, "b": 20, "t": 120},
        template="plotly_white",
    )
    figure.write_html(path, include_plotlyjs=True, full_html=True, default_height="94vh", config={"displaylogo": False})


def _origin(points: Array) -> Array:
    """Round numbers near coordinates that are far from 0, and 0 for others: browsers draw in single precision."""
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    far = np.abs(low) > FAR * size
    unit = 10.0 ** np.floor(np.log10(size))
    return np.where(far, np.floor(low / unit) * unit, 0.0)


def _axes(scene: Scene, origin: Array) -> dict[str, Any]:
    """Axes with equal scales; a surface over the plane is half as high as the shorter side of the domain."""
    low, high = scene.fields.points.min(axis=0), scene.fields.points.max(axis=0)
    sides = (high - low) / (high - low).max()
    third = (HEIGHT * sides.min(),) if scene.dim == 2 else ()
    names = [f"{x} − {a:.15g}".replace("− -", "+ ") if a else x for x, a in zip("xyz", origin.tolist(), strict=False)]
    names += ["u<sub>h</sub>"] if scene.dim == 2 else []
    axes: dict[str, Any] = {f"{axis}axis": {"title": {"text": name}} for axis, name in zip("xyz", names, strict=True)}
    for axis, *ends in zip("xyz", low.tolist(), high.tolist(), strict=False):
        room = 0.02 * (ends[1] - ends[0])
        axes[f"{axis}axis"]["range"] = [ends[0] - room, ends[1] + room]
    return axes | {
        "aspectmode": "manual",
        "aspectratio": dict(zip("xyz", ZOOM * np.array([*sides, *third]), strict=True)),
    }


def plain(caption: str) -> str:
    """Turn Matplotlib's mathematical type into HTML."""
    text = html.escape(caption)
    for symbol, character in SYMBOLS.items():
        text = text.replace(symbol, character)
    text = re.sub(r"\^\{([^}]*)\}", r"<sup>\1</sup>", text).replace("<sup>-", "<sup>−")
    return re.sub(r"_(\w)", r"<sub>\1</sub>", text)


def _plane(scene: Scene) -> tuple[list, list[Sheet]]:
    """u_h as a surface, coloured by u_h or |σ_h|."""
    fields, boundary = scene.fields, scene.boundary
    points = np.column_stack([fields.points, scene.u])
    triangles, _ = thinned(fields.points, fields.cells, MOST_TRIANGLES)
    low, high, _ = style.limits(scene.sigma_norm, scene.measure)
    norm = np.linalg.norm(scene.fields.sigma_at_points, axis=1)
    coloured = {
        "u<sub>h</sub>": _surface(points, triangles, scene.u, style.U_MAP),
        "|σ<sub>h</sub>|": _surface(points, triangles, norm, style.FLUX_MAP, (low, high)),
    }
    return _rims(scene, points, boundary.vertices[boundary.kind != SIGNORINI]), [
        Sheet(name, [trace]) for name, trace in coloured.items()
    ]


def _space(scene: Scene) -> tuple[list, list[Sheet]]:
    """Γ_S with its contact set, p_h and σ_h·n, cuts with u_h, streamlines."""
    from signorini_fenicsx.output.pictures.space import Space

    space = Space(scene)
    points, facets = scene.fields.points, scene.facets
    triangles, rows = thinned(points, facets.vertices, MOST_TRIANGLES)
    contact = [
        _surface(points, triangles[group.facets[rows]], None, group.colour, name=f"Γ<sub>S</sub>, {group.name}")
        for group in scene.groups
        if group.facets[rows].any()
    ]
    cuts = space.grid.slice_orthogonal().combine().extract_surface(algorithm=None).triangulate()
    cut_points, cut_triangles = np.asarray(cuts.points, dtype=np.float64), cuts.regular_faces.astype(np.int64)
    cut_triangles, _ = thinned(cut_points, cut_triangles, MOST_TRIANGLES)
    if len(edge := scene.free_boundary()) > 0:
        edge, _ = thinned(points, edge, MOST_TRIANGLES)
        contact.append(_surface(points, edge, None, style.CONTACT, name=scene.edges))
    on_gamma = {"p<sub>h</sub>": facets.p, "σ<sub>h</sub>·n": facets.flux} if scene.labels else {}
    sheets = [
        Sheet("contact", contact),
        *(Sheet(name, [_surface(points, triangles, each[rows], style.U_MAP)]) for name, each in on_gamma.items()),
        Sheet("u<sub>h</sub>", [_surface(cut_points, cut_triangles, np.asarray(cuts["u"]), style.U_MAP)]),
    ]
    lines = space.streamlines
    if lines.n_lines:
        sheets.append(Sheet("streamlines", [_streamlines(scene, lines), *_faint(contact)]))
    hull = _surface(points, thinned(points, scene.boundary.vertices, MOST_TRIANGLES)[0], None, "grey")
    return [_edges(points, creases(points, scene.boundary.vertices), "black", 3, ""), *_faint([hull], 0.08)], sheets


def _surface(
    points: Array,
    triangles: Indices,
    values: Array | None,
    colours: str,
    ends: tuple[float, float] | None = None,
    name: str = "",
) -> go.Mesh3d:
    """Triangles in one colour, or coloured by a value per vertex or triangle."""
    used, corners = np.unique(triangles, return_inverse=True)
    x, y, z = points[used].astype(np.float32).T
    i, j, k = corners.reshape(-1, 3).astype(np.int32).T
    look: dict[str, Any] = {"color": colours, "name": name, "showlegend": bool(name)}
    if values is not None:
        per_triangle = len(values) == len(triangles) != len(points)
        low, high = (float(values.min()), float(values.max())) if ends is None else ends
        look = {
            "intensity": (values if per_triangle else values[used]).astype(np.float32),
            "intensitymode": "cell" if per_triangle else "vertex",
            "colorscale": colours,
            "cmin": low,
            "cmax": high,
            "colorbar": {"len": 0.7, "thickness": 18},
        }
    light = {"ambient": 1.0, "diffuse": 0.0, "specular": 0.0}  # colours as in the colour bar
    return go.Mesh3d(x=x, y=y, z=z, i=i, j=j, k=k, lighting=light, **look)


def _rims(scene: Scene, points: Array, others: Indices) -> list:
    """The boundary of a surface over the plane, Γ_S in the colours of its contact set."""
    looks = [(others, "black", 3, "Γ<sub>D</sub>, Γ<sub>N</sub>")]
    looks += [
        (scene.facets.vertices[group.facets], group.colour, 8, f"Γ<sub>S</sub>, {group.name}") for group in scene.groups
    ]
    return [_edges(points, *look) for look in looks if len(look[0])]


def _edges(points: Array, edges: Indices, color: str, width: float, name: str) -> go.Scatter3d:
    """Edges as lines with gaps between them."""
    path = np.full((len(edges), 3, 3), np.nan, dtype=np.float32)
    path[:, :2] = points[edges]
    x, y, z = path.reshape(-1, 3).T
    line = {"color": color, "width": width}
    return go.Scatter3d(x=x, y=y, z=z, mode="lines", line=line, name=name, showlegend=bool(name), hoverinfo="skip")


def _streamlines(scene: Scene, lines: Any) -> go.Scatter3d:
    """Streamlines, coloured by |σ_h|."""
    low, high, _ = style.limits(scene.sigma_norm, scene.measure)
    pieces, colours = [], []
    gap = np.full((1, 3), np.nan)
    for ids in np.split(lines.line_connectivity, lines.line_offsets[1:-1]):
        pieces += [lines.points[ids], gap]
        colours += [lines["sigma_norm"][ids], [0.0]]
    x, y, z = np.concatenate(pieces).astype(np.float32).T
    bar = {"len": 0.7, "thickness": 18, "title": {"text": "|σ<sub>h</sub>|"}}
    line = {"color": np.concatenate(colours).astype(np.float32), "width": 5, "colorscale": style.STREAM_MAP}
    line |= {"cmin": low, "cmax": high, "showscale": True, "colorbar": bar}
    return go.Scatter3d(x=x, y=y, z=z, mode="lines", line=line, hoverinfo="skip", showlegend=False)


def _faint(surfaces: list[go.Mesh3d], opacity: float = 0.3) -> list[go.Mesh3d]:
    return [go.Mesh3d(surface).update(opacity=opacity) for surface in surfaces]
