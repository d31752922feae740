"""`solution.html`: one file with pictures that the mouse can turn; the browser needs no network."""

import html
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import plotly.graph_objects as go

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.text import printable
from signorini_fenicsx.cases.plot import with_unit
from signorini_fenicsx.cases.units import read_off, units_of
from signorini_fenicsx.discrete.mesh_spaces import SIGNORINI
from signorini_fenicsx.meshes.domain import FAR
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.geometry import creases, thinned
from signorini_fenicsx.pictures.panels import Panel, Where
from signorini_fenicsx.pictures.scene import Scene
from signorini_fenicsx.solving.solved import by_name

if TYPE_CHECKING:
    from signorini_fenicsx.pictures.space import Space

MOST_TRIANGLES = 40_000
"""Most triangles of a surface, which then takes one or two megabytes."""
ZOOM, ROOM = 1.25, 0.12
"""How large the domain is, and the room around it for what has moved, relative to it."""
HEIGHT = 0.5
"""Height of a surface over the plane, relative to the shorter side of the domain."""
BAR = {"len": 0.7, "thickness": 18}
CAMERA = {"projection": {"type": "orthographic"}, "eye": {"x": 0.9, "y": -1.4, "z": 0.8}}
PAGE = """<!doctype html>
<html>
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{margin: 0; font-family: sans-serif; text-align: center}}
h1 {{font-size: 1.1rem; margin: 0.6rem 0.5rem 0.2rem}}
p {{font-size: 0.8rem; margin: 0 0.5rem}}
#drawn {{height: min(88vh, 115vw)}}
</style>
</head>
<body>
<h1>{title}</h1>
<p>{caption}</p>
<div id="drawn">{drawn}</div>
</body>
</html>
"""
"""The page, on which words break on narrow screens, where the picture is about as high as wide."""
SYMBOLS = {
    r"\leq": "≤",
    r"\varepsilon": "ε",
    r"\|": "‖",
    r"\sigma": "σ",
    r"\times": "×",
    r"\cdot": "·",
    r"\ ": " ",
    r"\Gamma": "Γ",
    r"\partial": "∂",
    "$": "",
}


def write_page(path: Path, scene: Scene) -> None:
    """Write the page: one picture for each panel that can be turned, chosen with a button (rank 0)."""
    panels = [each for _, of_file in scene.files.values() for each in of_file]
    page = Page(scene, _origin(scene.fields.points))
    common, sheets = page.common(), dict[str, list]()
    for panel in panels:
        if panel.title not in sheets and (traces := page.traces(panel)):
            sheets[panel.title] = traces
    figure = go.Figure([*common, *(trace for traces in sheets.values() for trace in traces)])
    owner = np.repeat(np.arange(-1, len(sheets)), [len(common), *map(len, sheets.values())])
    for trace, number in zip(figure.data, owner, strict=True):
        trace.visible = bool(number <= 0)
    buttons = [
        {"label": plain(title), "method": "restyle", "args": ["visible", [bool(n in (-1, number)) for n in owner]]}
        for number, title in enumerate(sheets)
    ]
    figure.update_layout(
        scene=page.axes() | {"camera": CAMERA},
        updatemenus=[
            {"type": "buttons", "direction": "right", "buttons": buttons}
            | {"x": 0.5, "xanchor": "center", "y": 1.0, "yanchor": "bottom"}
        ],
        legend={"orientation": "h", "x": 0.5, "xanchor": "center", "y": 0.0},
        margin={"l": 0, "r": 0, "b": 20, "t": 60},
        template="plotly_white",
    )
    config = {"displaylogo": False, "responsive": True}
    drawn = figure.to_html(include_plotlyjs=True, full_html=False, default_height="100%", config=config)
    text = {"title": html.escape(printable(scene.title)), "caption": plain(scene.caption)}
    path.write_text(PAGE.format(**text, drawn=drawn), encoding="utf-8")


def _origin(points: Array) -> Array:
    """Round numbers near coordinates that are far from 0, and 0 for others: browsers draw in single precision."""
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    far = np.abs(low) > FAR * size
    unit = 10.0 ** np.floor(np.log10(size))
    return np.where(far, np.floor(low / unit) * unit, 0.0)


def plain(caption: str) -> str:
    """Turn Matplotlib's mathematical type into HTML."""
    text = html.escape(caption)
    for symbol, character in SYMBOLS.items():
        text = text.replace(symbol, character)
    text = re.sub(r"\^\{([^}]*)\}", r"<sup>\1</sup>", text).replace("<sup>-", "<sup>−")
    return re.sub(r"_(\w)", r"<sub>\1</sub>", text)


@dataclass(frozen=True)
class Page:
    """What browsers turn, near 0: Γ_S, cuts, surfaces, streamlines; of the plane a scalar u_h as a surface over it.

    Attributes:
        scene: The solution.
        origin: What is subtracted from coordinates.
    """

    scene: Scene
    origin: Array

    @cached_property
    def space(self) -> "Space":
        """The views of the solution in space."""
        from signorini_fenicsx.pictures.space import Space  # imports VTK

        return Space(self.scene)

    def axes(self) -> dict[str, Any]:
        """Axes with equal scales; a surface over the plane is half as high as the shorter side of the domain."""
        low, high = self.scene.fields.points.min(axis=0), self.scene.fields.points.max(axis=0)
        sides, room = (high - low) / (high - low).max(), ROOM * (high - low)
        names = [f"{x} − {a:.15g}".replace("− -", "+ ") if a else x for x, a in zip("xyz", self.origin, strict=False)]
        names = [plain(with_unit(name, self.scene.plot.length_unit)) for name in names]
        ranges = np.stack([low - room, high + room], axis=1) - self.origin[:, None]
        axes: dict[str, Any] = {
            f"{axis}axis": {"title": {"text": name}, "range": ends}
            for axis, name, ends in zip("xyz", names, ranges.tolist(), strict=False)
        }
        if self.scene.dim == 2:
            sides = np.append(sides, HEIGHT * sides.min())
            raised = self.scene.pictures.heights(self.scene) is not None
            axes["zaxis"] = {"title": {"text": plain(self.scene.plot.u_label)}, "visible": raised}
        return axes | {"aspectmode": "manual", "aspectratio": dict(zip("xyz", ZOOM * sides, strict=True))}

    def raised(self, scene: Scene) -> Array:
        """The points in space, those of the plane as high as the physics says."""
        points = scene.fields.points
        if scene.dim == 3:
            return points
        heights = scene.pictures.heights(scene)
        return np.column_stack([points, 0 * points[:, 0] if heights is None else heights])

    def near(self, points: Array) -> Array:
        """Coordinates near 0, in single precision."""
        return (points - np.pad(self.origin, (0, 3 - len(self.origin)))).astype(np.float32)

    def surface(
        self, points: Array, triangles: Indices, panel: Panel | None = None, values: Array | None = None, **look: Any
    ) -> go.Mesh3d:
        """Triangles in one colour, or coloured by a value of a panel per vertex or triangle; fewer of many."""
        in_cells = values is not None and len(values) == len(triangles) != len(points)
        triangles, rows = thinned(points, triangles, MOST_TRIANGLES)
        used, corners = np.unique(triangles, return_inverse=True)
        x, y, z = self.near(points[used]).T
        i, j, k = corners.reshape(-1, 3).astype(np.int32).T
        if panel is not None and values is not None:
            low, high, _ = panel.ends or (float(np.nanmin(values)), float(np.nanmax(values)), "")
            look = {
                "intensity": (values[rows] if in_cells else values[used]).astype(np.float32),
                "intensitymode": "cell" if in_cells else "vertex",
                "colorscale": panel.colours,
                "cmin": low,
                "cmax": high,
                "colorbar": BAR | {"title": {"text": plain(panel.label)}},
            }
        light = {"ambient": 1.0, "diffuse": 0.0, "specular": 0.0}  # colours as in the colour bar
        return go.Mesh3d(x=x, y=y, z=z, i=i, j=j, k=k, lighting=light, showlegend="name" in look, **look)

    def lines(self, points: Array, ends: Iterable[Indices], line: dict[str, Any], name: str = "") -> go.Scatter3d:
        """Lines with gaps between them."""
        gap = np.full((1, 3), np.nan, dtype=np.float32)
        x, y, z = np.concatenate([gap, *(each for rows in ends for each in (self.near(points[rows]), gap))]).T
        return go.Scatter3d(x=x, y=y, z=z, mode="lines", line=line, name=name, showlegend=bool(name), hoverinfo="skip")

    def common(self) -> list:
        """The boundary, that of a surface over the plane in the colours of its contact set."""
        scene, boundary, points = self.scene, self.scene.boundary, self.raised(self.scene)
        if scene.dim == 3:
            hull = self.surface(points, boundary.vertices, color="grey", opacity=0.08)
            edges = self.lines(points, creases(points, boundary.vertices), {"color": "black", "width": 3})
            return [edges, hull, *self.probes()]
        looks = [(boundary.vertices[boundary.kind != SIGNORINI], "black", 3, "Γ<sub>D</sub>, Γ<sub>N</sub>")]
        looks += [(vertices, colour, 8, name) for vertices, colour, name in self.sets() if vertices.shape[1] == 2]
        drawn = [self.lines(points, rows, {"color": c, "width": w}, name) for rows, c, w, name in looks if len(rows)]
        return [*drawn, *self.probes()]

    def probes(self) -> list:
        """The points of probes, which tell what is read off there; in the plane as high as u_h."""
        solution = self.scene.solution
        table = solution.readings.get("probes")
        if table is None:
            return []
        height = table.get("u", np.zeros(len(table["x"])))  # a scalar, over the plane
        x, y, z = self.near(np.column_stack([table["x"], table["y"], table.get("z", height)])).T
        told = read_off({"probes": by_name(table, None)}, units_of(solution))
        words = [html.escape(f"{name}: {values}") for name, values in told.items()]
        look = {"mode": "markers", "marker": {"size": 5, "color": "black"}, "name": "probes", "showlegend": True}
        return [go.Scatter3d(x=x, y=y, z=z, text=words, hoverinfo="text", **look)]

    def sets(self) -> list[tuple[Indices, str, str]]:
        """Γ_S by its groups, and the facets between cells in different states."""
        scene, gamma, (name, between) = self.scene, plain(self.scene.gamma), self.scene.fronts
        groups = [(scene.facets.vertices[each.facets], each.colour, f"{gamma}, {each.name}") for each in scene.groups]
        return [*groups, *([(between, style.CONTACT, name)] if len(between) else [])]

    def traces(self, panel: Panel) -> list:
        """What a panel shows, but for maps on a logarithmic scale or of names, or of a part of the domain."""
        scene = panel.scene or self.scene
        points, facets = self.raised(scene), scene.facets.vertices
        if (panel.log and panel.where is not Where.STREAMS) or panel.names or scene.frame is not None:
            return []
        if panel.where in (Where.SURFACE, Where.STEPS, Where.ACROSS):
            return []
        if scene.dim == 2:
            of_map = panel.where in (Where.MAP, Where.STREAMS)
            return [self.surface(points, scene.fields.cells, panel, panel.what)] if of_map else []
        if panel.where is Where.SETS:
            return [self.surface(points, each, color=colour, name=name) for each, colour, name in self.sets()]
        if panel.where is Where.GAMMA:
            values = scene.on_facets(panel.what)
            return [self.surface(points, facets, panel, values if values.ndim == 1 else np.linalg.norm(values, axis=1))]
        space = self.space.of(panel.scene) if panel.scene else self.space
        if panel.where is Where.STREAMS:
            return self._streamlines(panel, space.streamlines(panel)[0])
        grid = space.with_values(panel)
        cut = grid if panel.where is Where.OUTSIDE else grid.slice_orthogonal().combine()
        shown = cut.extract_surface(algorithm=None).triangulate()
        corners, triangles = np.asarray(shown.points, dtype=np.float64), shown.regular_faces.astype(np.int64)
        return [self.surface(corners, triangles, panel, np.asarray(shown["values"]))]

    def _streamlines(self, panel: Panel, lines: Any) -> list:
        """Streamlines, coloured by the length of the flux, and the contact set, faint."""
        if not lines.n_lines:
            return []
        pieces = np.split(lines.line_connectivity, lines.line_offsets[1:-1])
        colours = np.concatenate([[0.0], *(each for ids in pieces for each in (lines["length"][ids], [0.0]))])
        low, high, _ = panel.ends or (float(colours.min()), float(colours.max()), "")
        line = {"color": colours.astype(np.float32), "width": 5, "colorscale": panel.colours, "cmin": low, "cmax": high}
        bar = {"showscale": True, "colorbar": BAR | {"title": {"text": plain(panel.label)}}}
        faint = [each.update(opacity=0.3) for each in self.traces(Panel("", Where.SETS))]
        return [self.lines(np.asarray(lines.points, dtype=np.float64), pieces, line | bar), *faint]
