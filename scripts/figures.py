"""Draw the slides' tables and figures from a folder that `scripts/reproduce.py` has filled; no PDE code is needed.

Usage: python scripts/figures.py [FOLDER]      (default: results/reproduction)

Reads `reproduction.json` and the runs in `runs/`, writes a PNG and a PDF per figure, a CSV per table and `index.html`.
"""

import csv
import html
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.tri import Triangulation

mpl.rcParams.update({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "savefig.dpi": 150})

SLIDES = {"alg1": "Alg. 1", "alg2": "Alg. 2", "alg3": "Algorithm 3", "alg4": "Algorithm 4"}


@dataclass(frozen=True)
class KeptRun:
    """A finished run on disk.

    Attributes:
        folder: Its folder.
        parameters: All keys of its case, dotted.
        seconds: What it took.
    """

    folder: Path
    parameters: dict[str, Any]
    seconds: float

    @property
    def algorithm(self) -> str:
        """Its algorithm."""
        return str(self.parameters["solve.algorithm"])

    def rows(self, name: str) -> list[dict[str, float]]:
        """A CSV file of numbers; what is empty is not a number."""
        with (self.folder / name).open(newline="", encoding="utf-8") as file:
            return [{key: float(value or "nan") for key, value in row.items()} for row in csv.DictReader(file)]

    def solution(self) -> dict[str, Any]:
        """The arrays of its checkpoint, with its JSON part under `about`."""
        with np.load(self.folder / "checkpoint.npz", allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        return arrays | {"about": json.loads(str(arrays["about"]))}


def read_runs(folder: Path, names: list[str]) -> list[KeptRun]:
    """Runs by their names."""
    runs = []
    for name in names:
        about = json.loads((folder / "runs" / name / "run.json").read_text(encoding="utf-8"))
        runs.append(KeptRun(folder / "runs" / name, about["parameters"], about["seconds"]))
    return runs


def draw_region(runs: list[KeptRun]) -> Figure:
    """Figure 1: a smooth domain whose boundary is part Γ_D, part Γ_S."""
    t = np.linspace(0, 2 * np.pi, 400)
    r = 1 + 0.12 * np.cos(2 * t + 0.4) + 0.08 * np.sin(3 * t)
    x, y = 1.5 * r * np.cos(t), r * np.sin(t)
    figure = Figure(figsize=(4.2, 3.2), layout="constrained")
    axes = figure.add_subplot()
    axes.add_patch(Polygon(np.column_stack([x, y]), closed=True, color="C0", alpha=0.12))
    below = (t > np.pi * 1.1) & (t < np.pi * 1.9)
    axes.plot(np.where(below, np.nan, x), np.where(below, np.nan, y), "C0", linewidth=2)
    axes.plot(x[below], y[below], "C3", linewidth=3)
    for text, place in {"Ω": (0, 0.1), "Γ_D": (0.1, 1.12), "Γ_S": (0.1, -1.22)}.items():
        axes.text(*place, f"${text}$" if text[0] == "Γ" else text, fontsize=14, ha="center")
    axes.set(aspect="equal", xlim=(-1.9, 1.9), ylim=(-1.45, 1.45))
    axes.set_axis_off()
    return figure


def draw_solution(runs: list[KeptRun]) -> Figure:
    """u_h as a surface, σ_h as arrows, |σ_h| in colour."""
    arrays = runs[0].solution()
    points, cells, u, sigma = (arrays[key] for key in ("points", "cells", "u", "sigma"))
    triangulation = Triangulation(*points.T, cells)
    figure = Figure(figsize=(13, 4), layout="constrained")
    surface = figure.add_subplot(1, 3, 1, projection="3d")
    weights = np.bincount(cells.ravel())
    nodal = np.bincount(cells.ravel(), np.repeat(u, 3)) / weights
    surface.plot_trisurf(triangulation, nodal, cmap="viridis", linewidth=0, antialiased=False, rasterized=True)
    surface.set(xlabel="x", ylabel="y", title="(a) $u_h$")
    surface.locator_params(nbins=5)

    arrows = figure.add_subplot(1, 3, 2)
    low, high = points.min(axis=0), points.max(axis=0)
    spacing = (high - low).max() / 22
    x, y = np.meshgrid(*(np.arange(a + spacing / 2, b, spacing) for a, b in zip(low, high, strict=True)))
    cell = triangulation.get_trifinder()(x, y)
    arrows.quiver(x[cell >= 0], y[cell >= 0], *sigma[cell[cell >= 0]].T, color="C0", pivot="mid", width=0.004)
    arrows.set(aspect="equal", xlabel="x", ylabel="y", title=r"(b) $\sigma_h$")

    magnitude = figure.add_subplot(1, 3, 3)
    magnitude.grid(visible=False)
    image = magnitude.tripcolor(triangulation, np.linalg.norm(sigma, axis=1), cmap="viridis", rasterized=True)
    figure.colorbar(image, ax=magnitude)
    magnitude.set(aspect="equal", xlabel="x", ylabel="y", title=r"(c) $|\sigma_h|$")
    return figure


TRACES = {"u": ("$u_h$", "C0"), "flux": (r"$\sigma_h\cdot n$", "C3"), "p": ("$p_h$", "C2")}


def draw_traces(runs: list[KeptRun]) -> Figure:
    """u_h, σ_h·n and p_h along Γ_S: a row per part, a column per quantity."""
    arrays = runs[0].solution()
    names = arrays["about"]["part_names"]
    labels = [arrays["about"]["parts"][name] for name in names]
    figure = Figure(figsize=(11, 2.8 * len(names)), layout="constrained")
    panels = figure.subplots(len(names), 3, squeeze=False)
    for part, (name, label) in enumerate(zip(names, labels, strict=True)):
        for axes, (key, (title, color)) in zip(panels[part], TRACES.items(), strict=True):
            _trace(axes, arrays, part, key, color)
            axes.set(xlabel=label, title=rf"{title} on $\Gamma_S$: {name}")
    return figure


def draw_penalty_traces(runs: list[KeptRun]) -> Figure:
    """u_εh, σ_εh·n and p_εh together: a row per ε, a column per part of Γ_S."""
    solutions = [(run.parameters["solve.eps"], run.solution()) for run in runs]
    names = solutions[0][1]["about"]["part_names"]
    figure = Figure(figsize=(5.4 * len(names), 3.2 * len(solutions)), layout="constrained")
    panels = figure.subplots(len(solutions), len(names), squeeze=False)
    for row, (eps, arrays) in zip(panels, solutions, strict=True):
        for part, axes in enumerate(row):
            for key, (title, color) in TRACES.items():
                _trace(axes, arrays, part, key, color, title)
            axes.set(xlabel=arrays["about"]["parts"][names[part]], title=f"{names[part]}, ε = {eps:.4g}")
            axes.legend()
    return figure


def _trace(axes: Axes, arrays: dict[str, Any], part: int, key: str, color: str, label: str | None = None) -> None:
    on = arrays["facet_part"] == part
    style = "--" if key == "p" else "-"  # p_h lies on u_h where both are positive
    axes.plot(arrays["facet_along"][on], arrays[f"facet_{key}"][on], style, color=color, label=label)


def draw_iterations(runs: list[KeptRun]) -> Figure:
    """‖σ^(n+1) − σ^(n)‖_V and ‖u^(n+1) − u^(n)‖_Q, a panel per algorithm."""
    figure = Figure(figsize=(4.6 * len(runs), 3.4), layout="constrained")
    for axes, run in zip(figure.subplots(1, len(runs), squeeze=False)[0], runs, strict=True):
        rows = run.rows("history.csv")
        n = np.array([row["iteration"] for row in rows]) - 1
        for key, label, style in (
            ("sigma_change", r"$\|\sigma^{(n+1)}-\sigma^{(n)}\|_V$", "o-"),
            ("u_change", r"$\|u^{(n+1)}-u^{(n)}\|_Q$", "s--"),
        ):
            values = np.array([row[key] for row in rows])
            axes.semilogy(n[values > 0], values[values > 0], style, label=label)  # a repeated set changes nothing
        axes.set(xlabel="n", xticks=n, title=SLIDES[run.algorithm])
        axes.legend()
    return figure


def draw_errors(runs: list[KeptRun]) -> Figure:
    """Errors of σ, u and p of Algorithms 3 and 4: over h at fixed ε, and over ε at fixed h."""
    figure = Figure(figsize=(11, 4), layout="constrained")
    series = {
        "sigma_V": r"$\|\sigma_{ref}-\sigma_h\|_V$",
        "u_Q": r"$\|u_{ref}-u_h\|_Q$",
        "p_Lambda": r"$\|p_{ref}-p_h\|_\Lambda$",
    }
    for axes, over in zip(figure.subplots(1, 2), ("h", "eps"), strict=True):
        shown = [run for run in runs if json.loads((run.folder / "summary.json").read_text())["vary"] == over]
        base = 2.0 if over == "h" else 10.0
        for run, style in zip(shown, ("o-", "x--"), strict=True):
            rows = run.rows("convergence.csv")
            x = np.array([base ** -row["level"] for row in rows])
            for index, (key, label) in enumerate(series.items()):
                values = [row[key] for row in rows]
                axes.loglog(x, values, style, color=f"C{index}", label=f"{label}, {SLIDES[run.algorithm]}")
        guide = shown[0].rows("convergence.csv")[0]["sigma_V"] * 0.5
        axes.loglog(x, guide * x / x[0], "k:", linewidth=0.8, label="slope 1")
        axes.set_xscale("log", base=int(base))
        fixed = (
            f"ε = {shown[0].parameters['solve.eps']:g}" if over == "h" else f"h = {shown[0].parameters['solve.h']:g}"
        )
        letter, name = ("a", "h") if over == "h" else ("b", "ε")
        axes.set(xlabel=name, title=f"({letter}) fixed {fixed}")
        axes.legend(fontsize=7)
    return figure


DRAWN: dict[str, Callable[[list[KeptRun]], Figure]] = {
    "region": draw_region,
    "solution": draw_solution,
    "traces": draw_traces,
    "penalty_traces": draw_penalty_traces,
    "iterations": draw_iterations,
    "errors": draw_errors,
}

COLUMNS = {
    "level": "h",
    "sigma_V": "‖σ_ref − σ_h‖_V",
    "sigma_V_order": "order",
    "slides_sigma_V": "slides",
    "u_Q": "‖u_ref − u_h‖_Q",
    "u_Q_order": "order",
    "slides_u_Q": "slides",
}


def table_rows(run: KeptRun, slides: dict[str, dict[str, float]]) -> list[list[str]]:
    """The lines of a table: our errors and orders with the slides' errors beside them."""
    lines = []
    for row in run.rows("convergence.csv"):
        theirs = slides.get(f"{row['level']:g}", {})
        values = row | {f"slides_{key}": value for key, value in theirs.items()}
        cells = [f"2^-{row['level']:g}"]
        for key in list(COLUMNS)[1:]:
            value = values.get(key, float("nan"))
            cells.append("-" if np.isnan(value) else f"{value:.2f}" if key.endswith("order") else f"{value:.3g}")
        lines.append(cells)
    return lines


def make(folder: Path, names: Sequence[str] | None = None) -> None:
    """Draw what `reproduction.json` lists, or some of it, and the page that shows all of it."""
    reproduction = json.loads((folder / "reproduction.json").read_text(encoding="utf-8"))
    sections = []
    for name, item in reproduction["items"].items():
        runs = read_runs(folder, item["runs"])
        if item["draw"] == "table":
            lines = table_rows(runs[0], item["slides"])
            with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
                csv.writer(file).writerows([list(COLUMNS.values()), *lines])
            shown = _html_table(lines)
        else:
            if names is None or name in names:
                figure = DRAWN[item["draw"]](runs)
                for suffix in ("png", "pdf"):
                    figure.savefig(folder / f"{name}.{suffix}")
            shown = f'<a href="{name}.pdf"><img src="{name}.png" alt="{html.escape(item["caption"])}"></a>'
        seconds = sum(run.seconds for run in runs)
        sections.append(_section(name, item, shown, seconds))
    (folder / "index.html").write_text(_page(reproduction, sections), encoding="utf-8")


def _html_table(lines: list[list[str]]) -> str:
    head = "".join(f"<th>{html.escape(column)}</th>" for column in COLUMNS.values())
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in line) + "</tr>" for line in lines)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _section(name: str, item: dict[str, Any], shown: str, seconds: float) -> str:
    label = name.replace("table", "Table ").replace("figure", "Figure ")
    return (
        f'<section id="{name}"><h2>{label}</h2><p>{html.escape(item["caption"])}</p>{shown}'
        f"<p><code>{html.escape(item['command'])}</code> · {len(item['runs'])} runs, {seconds:.0f} s of one rank</p>"
        "</section>"
    )


def _page(reproduction: dict[str, Any], sections: list[str]) -> str:
    versions = ", ".join(f"{key} {value}" for key, value in reproduction["versions"].items())
    links = " ".join(f'<a href="#{name}">{name}</a>' for name in reproduction["items"])
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>The slides' tables and figures</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; color: #222; }}
img {{ max-width: 100%; }} code {{ background: #f3f3f3; padding: 0.1rem 0.3rem; }} nav a {{ margin-right: 0.5rem; }}
table {{ border-collapse: collapse; }}
th, td {{ padding: 0.2rem 0.8rem; border-bottom: 1px solid #ddd; text-align: right; }}
</style></head><body>
<h1>The slides' tables and figures</h1>
<p>{html.escape(reproduction["remark"])}</p><p>{html.escape(versions)}</p><nav>{links}</nav>
{"".join(sections)}
</body></html>
"""


if __name__ == "__main__":
    make(Path(sys.argv[1] if len(sys.argv) > 1 else "results/reproduction"))
