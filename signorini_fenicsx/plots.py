"""Pictures of a solution, from gathered arrays on rank 0: the panels of the slides' figures."""

import os
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pyvista
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from signorini_fenicsx.active_set import Step
from signorini_fenicsx.adaptive import AdaptRow
from signorini_fenicsx.conditions import Condition
from signorini_fenicsx.convergence import ERRORS, ErrorRow, Vary
from signorini_fenicsx.gather import FacetTable, Fields
from signorini_fenicsx.solution import Solution

if "DISPLAY" not in os.environ:
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")  # else VTK looks for an X server and warns

mpl.rcParams.update({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "savefig.dpi": 150})


def draw_all(folder: Path, solution: Solution, fields: Fields, facets: FacetTable) -> None:
    """Draw `u.png`, `sigma.png`, `signorini.png`, `iterations.png` and, with one, `certificate.png` into a folder."""
    draw_u(folder / "u.png", fields)
    if fields.points.shape[1] == 2:
        draw_sigma(folder / "sigma.png", fields)
        labels = {name: solution.spaces.domain.parts[name].label for name in solution.spaces.part_names}
        draw_traces(folder / "signorini.png", facets, labels)
    else:
        draw_sigma_3d(folder / "sigma.png", fields)
        draw_traces_3d(folder / "signorini.png", fields, facets, solution.algorithm.contact)
    draw_iterations(folder / "iterations.png", solution.history, solution.case.solve.algorithm)
    if fields.indicator is not None:
        draw_certificate(folder / "certificate.png", fields, fields.indicator)


def nodal_average(fields: Fields) -> np.ndarray:
    """u_h at the vertices: the mean over the cells around each."""
    vertices = fields.cells.ravel()
    weights = np.repeat(fields.u, fields.cells.shape[1])
    return np.bincount(vertices, weights) / np.bincount(vertices)


def draw_u(path: Path, fields: Fields) -> None:
    """u_h as a surface over the domain (2D) or on the boundary and a cut (3D)."""
    dim = fields.points.shape[1]
    u = nodal_average(fields)
    plotter = pyvista.Plotter(off_screen=True, window_size=(1200, 900))
    bar = {"title": "u_h", "vertical": True, "position_x": 0.91, "position_y": 0.25, "height": 0.5}
    grid = _grid(fields)
    grid["u"] = u
    if dim == 2:
        extent = np.ptp(fields.points, axis=0).max()
        grid.points[:, 2] = u * 0.5 * extent / max(np.ptp(u), 1e-300)
        plotter.add_mesh(grid, scalars="u", cmap="viridis", scalar_bar_args=bar)
        plotter.add_mesh(_outline(grid), color="black", line_width=2)
    else:
        plotter.add_mesh(grid.clip("y"), scalars="u", cmap="viridis", lighting=False, scalar_bar_args=bar)
        plotter.add_mesh(grid.outline(), color="black")
    plotter.add_axes()
    plotter.view_isometric()
    plotter.screenshot(path)
    plotter.close()


def draw_sigma(path: Path, fields: Fields) -> None:
    """|σ_h| per cell with arrows of σ_h on a regular grid."""
    triangulation = Triangulation(*fields.points.T, fields.cells)
    low, high = fields.points.min(axis=0), fields.points.max(axis=0)
    width, height = high - low
    figure = Figure(figsize=(6.4, 1.0 + 4.8 * height / width), layout="constrained")
    axes = figure.add_subplot()
    axes.grid(False)
    image = axes.tripcolor(triangulation, np.linalg.norm(fields.sigma, axis=1), cmap="viridis", rasterized=True)
    figure.colorbar(image, ax=axes, label="|σ_h|")
    spacing = (high - low).max() / 24
    x, y = np.meshgrid(*(np.arange(a + spacing / 2, b, spacing) for a, b in zip(low, high, strict=True)))
    cell = triangulation.get_trifinder()(x, y)
    inside = cell >= 0
    axes.quiver(x[inside], y[inside], *fields.sigma[cell[inside]].T, color="white", pivot="mid", width=0.003)
    axes.set(aspect="equal", xlabel="x", ylabel="y", title="Flux σ_h")
    figure.savefig(path)


def draw_sigma_3d(path: Path, fields: Fields) -> None:
    """Arrows of σ_h in 3D, coloured by |σ_h|, at up to 2000 cells spread over the mesh."""
    some = np.linspace(0, len(fields.cells) - 1, min(len(fields.cells), 2000)).astype(np.int64)
    cloud = pyvista.PolyData(fields.points[fields.cells[some]].mean(axis=1))
    cloud["sigma"] = fields.sigma[some]
    cloud["|σ_h|"] = np.linalg.norm(fields.sigma[some], axis=1)
    size = 0.12 * np.ptp(fields.points, axis=0).max() / max(cloud["|σ_h|"].max(), 1e-300)
    plotter = pyvista.Plotter(off_screen=True, window_size=(1200, 900))
    plotter.add_mesh(cloud.glyph(orient="sigma", scale="|σ_h|", factor=size), scalars="|σ_h|", cmap="viridis")
    plotter.add_mesh(_grid(fields).outline(), color="black")
    plotter.add_axes()
    plotter.view_isometric()
    plotter.screenshot(path)
    plotter.close()


def draw_certificate(path: Path, fields: Fields, indicator: np.ndarray) -> None:
    """η_T, what each cell contributes to the certified error, on a logarithmic scale; 3D: half the domain."""
    largest = max(indicator.max(), 1e-300)
    norm = LogNorm(max(indicator.min(), 1e-4 * largest), largest)
    if fields.points.shape[1] == 2:
        low, high = fields.points.min(axis=0), fields.points.max(axis=0)
        width, height = high - low
        figure = Figure(figsize=(6.4, 1.0 + 4.8 * height / width), layout="constrained")
        axes = figure.add_subplot()
        axes.grid(False)
        triangulation = Triangulation(*fields.points.T, fields.cells)
        image = axes.tripcolor(
            triangulation, np.maximum(indicator, norm.vmin), norm=norm, cmap="magma", rasterized=True
        )
        figure.colorbar(image, ax=axes, label="η_T")
        axes.set(aspect="equal", xlabel="x", ylabel="y", title="Contributions η_T to the certified error")
        figure.savefig(path)
        return
    grid = _grid(fields)
    grid.cell_data["η_T"] = np.maximum(indicator, norm.vmin)
    plotter = pyvista.Plotter(off_screen=True, window_size=(1200, 900))
    bar = {"title": "eta_T", "vertical": True, "position_x": 0.88, "position_y": 0.25, "height": 0.5, "fmt": "%.1e"}
    half = grid.clip("y")
    plotter.add_mesh(half, scalars="η_T", cmap="magma", log_scale=True, lighting=False, scalar_bar_args=bar)
    plotter.add_mesh(grid.outline(), color="black")
    plotter.add_axes()
    plotter.view_isometric()
    plotter.screenshot(path)
    plotter.close()


def draw_traces(path: Path, facets: FacetTable, labels: dict[str, str]) -> None:
    """u_h, σ_h·n and p_h along each part of Γ_S: one row of panels per part."""
    figure = Figure(figsize=(9, 2.6 * len(labels)), layout="constrained")
    panels = figure.subplots(len(labels), 3, squeeze=False)
    for index, (name, label) in enumerate(labels.items()):
        rows = facets.part == index
        along = facets.along[rows]
        columns = {"u_h": facets.u, "σ_h·n": facets.flux, "p_h": facets.p}
        for axes, (quantity, values) in zip(panels[index], columns.items(), strict=True):
            axes.plot(along, values[rows], color="C0", linewidth=1.2)
            axes.set(xlabel=label, title=f"{quantity} on {name}")
            if label == "angle":
                axes.set_xticks(*_pi_ticks(along))
    figure.savefig(path)


def draw_traces_3d(path: Path, fields: Fields, facets: FacetTable, contact: Condition) -> None:
    """p_h, σ_h·n and the contact zone, the facets with that condition, on the triangles of Γ_S."""
    view = _towards(facets, fields)
    plotter = pyvista.Plotter(off_screen=True, shape=(1, 3), window_size=(2100, 700))
    quantities = {"p_h": facets.p, "sigma_h.n": facets.flux}
    for column, (name, values) in enumerate(quantities.items()):
        plotter.subplot(0, column)
        plotter.add_mesh(
            _surface(fields, facets), scalars=values, cmap="viridis", lighting=False, scalar_bar_args={"title": name}
        )
        plotter.add_axes()
        plotter.view_vector(view, (0, 0, 1))
        plotter.camera.zoom(0.85)  # room for the bar
    plotter.subplot(0, 2)
    add_contact(plotter, fields, facets, contact)
    plotter.view_vector(view, (0, 0, 1))
    plotter.camera.zoom(0.85)
    plotter.screenshot(path)
    plotter.close()


def draw_iterations(path: Path, history: list[Step], algorithm: str) -> None:
    """The iteration errors ‖σ^(n+1) − σ^(n)‖_V and ‖u^(n+1) − u^(n)‖_Q on a logarithmic scale."""
    figure = Figure(figsize=(4.8, 3.6), layout="constrained")
    axes = figure.add_subplot()
    n = np.array([step.iteration - 1 for step in history])
    few = len(n) <= 25
    series = {
        "‖σ⁽ⁿ⁺¹⁾ − σ⁽ⁿ⁾‖_V": ([step.sigma_change for step in history], "o-" if few else "-"),
        "‖u⁽ⁿ⁺¹⁾ − u⁽ⁿ⁾‖_Q": ([step.u_change for step in history], "s--" if few else "--"),
    }
    for label, (values, style) in series.items():
        positive = np.array(values) > 0  # a repeated set changes nothing, and 0 has no logarithm
        axes.semilogy(n[positive], np.array(values)[positive], style, label=label)
    axes.set(xlabel="n", title=f"Iteration errors, {algorithm}")
    if few:
        axes.set_xticks(n)
    axes.legend()
    figure.savefig(path)


def draw_errors(path: Path, rows: list[ErrorRow], vary: Vary, title: str) -> None:
    """Errors over h or ε on logarithmic axes, with the slides' and lines of slope 1 and ½ (rank 0)."""
    figure = Figure(figsize=(5.6, 4.4), layout="constrained")
    axes = figure.add_subplot()
    base = 10.0 if vary is Vary.EPS else 2.0
    x = np.array([base**-row.level for row in rows])
    for index, (name, label) in enumerate(ERRORS.items()):
        drawn = [getattr(row, name) or np.nan for row in rows]
        if not np.all(np.isnan(drawn)):
            axes.loglog(x, drawn, "o-", color=f"C{index}", label=label)
        theirs = [getattr(row, f"slides_{name}", None) or np.nan for row in rows]
        if not np.all(np.isnan(theirs)):
            axes.loglog(x, theirs, "x:", color=f"C{index}", label=f"{label}, slides")
    for slope, style in ((1.0, "k--"), (0.5, "k:")):
        axes.loglog(x, rows[0].sigma_V * 0.5 * (x / x[0]) ** slope, style, linewidth=0.8, label=f"slope {slope:g}")
    axes.set_xscale("log", base=int(base))
    axes.set(xlabel="ε" if vary is Vary.EPS else "h", title=title)
    axes.legend(fontsize=8)
    figure.savefig(path)


def draw_bounds(path: Path, rows: list[AdaptRow], dim: int, title: str) -> None:
    """The certified error over the unknowns, adaptive beside uniform, with a line of the best possible slope −1/d."""
    figure = Figure(figsize=(5.6, 4.4), layout="constrained")
    axes = figure.add_subplot()
    for refinement, style in (("adaptive", "o-"), ("uniform", "s--")):
        chosen = [row for row in rows if row.refinement == refinement]
        if chosen:
            axes.loglog([row.unknowns for row in chosen], [row.bound for row in chosen], style, label=refinement)
    x = np.array([rows[0].unknowns, max(row.unknowns for row in rows)])
    axes.loglog(x, 0.6 * rows[0].bound * (x / x[0]) ** (-1 / dim), "k:", label=f"slope −1/{dim}")
    axes.set(xlabel="unknowns", ylabel="certified energy error", title=title)
    axes.legend()
    figure.savefig(path)


def draw_mesh(path: Path, fields: Fields, facets: FacetTable, contact: Condition) -> None:
    """The mesh, with the facets of Γ_S in contact and not in contact in colours."""
    if fields.points.shape[1] == 3:
        plotter = pyvista.Plotter(off_screen=True, window_size=(1200, 1000))
        plotter.add_mesh(_other_surface(fields, facets), color="white", lighting=False, show_edges=True, line_width=0.5)
        add_contact(plotter, fields, facets, contact)
        plotter.view_vector(_towards(facets, fields), (0, 0, 1))
        plotter.screenshot(path)
        plotter.close()
        return
    width, height = np.ptp(fields.points, axis=0)
    figure = Figure(figsize=(6.4, 0.6 + 6.0 * height / width), layout="constrained")
    axes = figure.add_subplot()
    axes.grid(False)
    axes.triplot(Triangulation(*fields.points.T, fields.cells), color="grey", linewidth=0.3)
    touching = facets.condition == contact
    for label, chosen, color in (("contact", touching, "firebrick"), ("no contact", ~touching, "C0")):
        axes.add_collection(
            LineCollection(list(fields.points[facets.vertices[chosen]]), colors=color, linewidths=2.5, label=label)
        )
    axes.set(aspect="equal", title=f"{len(fields.cells)} cells")
    axes.legend()
    figure.savefig(path)


def _grid(fields: Fields) -> pyvista.UnstructuredGrid | pyvista.PolyData:
    points = np.zeros((len(fields.points), 3))
    points[:, : fields.points.shape[1]] = fields.points
    if fields.points.shape[1] == 2:
        return pyvista.PolyData.from_regular_faces(points, fields.cells)
    return pyvista.UnstructuredGrid({pyvista.CellType.TETRA: fields.cells}, points)


def _surface(fields: Fields, facets: FacetTable) -> pyvista.PolyData:
    """The triangles of Γ_S."""
    return pyvista.PolyData.from_regular_faces(fields.points, facets.vertices)


def _other_surface(fields: Fields, facets: FacetTable) -> pyvista.PolyData:
    """The triangles of the boundary that are not on Γ_S."""
    faces = np.sort(np.concatenate([np.delete(fields.cells, vertex, axis=1) for vertex in range(4)]), axis=1)
    triangles, times = np.unique(np.concatenate([faces, facets.vertices]), axis=0, return_counts=True)
    return pyvista.PolyData.from_regular_faces(fields.points, triangles[times == 1])


def add_contact(plotter: pyvista.Plotter, fields: Fields, facets: FacetTable, contact: Condition) -> None:
    """Colour the triangles of Γ_S by whether they are in contact."""
    touching = facets.condition == contact
    for label, chosen, color in (("contact", touching, "firebrick"), ("no contact", ~touching, "lightsteelblue")):
        if chosen.any():
            triangles = _surface(fields, facets).extract_cells(np.flatnonzero(chosen))
            plotter.add_mesh(triangles, color=color, lighting=False, show_edges=True, line_width=0.5, label=label)
    plotter.add_legend(bcolor=None, face="rectangle", size=(0.4, 0.1), loc="lower center")


def _towards(facets: FacetTable, fields: Fields) -> np.ndarray:
    """Where to look from to see Γ_S: its side of the domain, off the axes and rather from above."""
    away = np.average(facets.x, axis=0, weights=facets.measure) - fields.points.mean(axis=0)
    clearly = 0.05 * np.ptp(fields.points, axis=0).max()  # opposite sides of the domain cancel
    return away / max(np.linalg.norm(away), clearly) + np.array([0.3, -0.2, 0.45])


def _outline(surface: pyvista.PolyData) -> pyvista.PolyData:
    return surface.extract_feature_edges(
        boundary_edges=True, feature_edges=False, manifold_edges=False, non_manifold_edges=False
    )


def _pi_ticks(angles: np.ndarray) -> tuple[list[float], list[str]]:
    names = {-2: "−π", -1: "−π/2", 0: "0", 1: "π/2", 2: "π"}
    low, high = angles.min() - 0.1, angles.max() + 0.1
    inside = {k: name for k, name in names.items() if low <= k * np.pi / 2 <= high}
    return [k * np.pi / 2 for k in inside], list(inside.values())
