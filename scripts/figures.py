"""Draws the tables and figures of the slides from the results of `scripts/reproduce.py`, without any PDE code.

Usage: python scripts/figures.py [FOLDER]      (default: results/reproduction)

Reads `reproduction.json` and the runs in `runs/`, writes a PNG and a PDF per figure, a CSV per table and `index.html`.
"""

import csv
import html
import itertools
import json
import math
import re
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
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation

STYLE = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 10,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "savefig.dpi": 150,
}
SLIDES = {"alg1": "Algorithm 1", "alg2": "Algorithm 2", "alg3": "Algorithm 3", "alg4": "Algorithm 4"}
QUANTILE = 0.99
"""The colour scale of |σ_h| ends here, because a corner may have much larger values."""


@dataclass(frozen=True)
class KeptRun:
    """A finished run on disk.

    Attributes:
        folder: Its folder.
        parameters: All keys of its case, dotted.
        seconds: Its wall time.
    """

    folder: Path
    parameters: dict[str, Any]
    seconds: float

    @property
    def algorithm(self) -> str:
        """Its algorithm."""
        return str(self.parameters["solve.algorithm"])

    def rows(self, name: str) -> list[dict[str, float]]:
        """A CSV file of numbers and of True and False, which are 1 and 0, with NaN for empty cells."""
        words = {"True": "1", "False": "0", "": "nan"}
        with (self.folder / name).open(newline="", encoding="utf-8") as file:
            return [{key: float(words.get(value, value)) for key, value in row.items()} for row in csv.DictReader(file)]

    def solution(self) -> dict[str, Any]:
        """The arrays of its checkpoint, with its JSON part under `about`."""
        place = self.folder / "checkpoint"
        arrays = {path.stem: np.load(path) for path in place.glob("*.npy")}
        order = np.lexsort((arrays["facet_along"], arrays["facet_part"]))  # the ranks have written them one by one
        arrays |= {key: rows[order] for key, rows in arrays.items() if key.startswith("facet_")}
        return arrays | {"about": json.loads((place / "about.json").read_text(encoding="utf-8"))}


def power(value: float) -> str:
    """A number as the slides print it, in mathematical type: 2^{-5}, 10^{-8}, or its digits."""
    for base in (2, 10):
        exponent = round(math.log(value, base))
        if abs(exponent) > 1 and math.isclose(value, float(base) ** exponent, rel_tol=1e-12):
            return f"{base}^{{{exponent}}}"
    return f"{value:.4g}"


def as_html(text: str) -> str:
    """Powers and indices of mathematical type as HTML."""
    text = re.sub(r"\^\{?(-?\w+)\}?", r"<sup>\1</sup>", html.escape(text))
    return re.sub(r"_\{?(\w+)\}?", r"<sub>\1</sub>", text).replace("<sup>-", "<sup>−")


def settings(runs: list[KeptRun]) -> str:
    """Algorithms, h and ε of some runs, and the parameters that studies vary."""
    words = [" and ".join(sorted({SLIDES[run.algorithm] for run in runs}))]
    studies = [run for run in runs if (run.folder / "convergence.csv").exists()]
    if not studies:
        words += [f"h = {power(h)}" for h in sorted({run.parameters["solve.h"] for run in runs})]
        words += [f"ε = {power(eps)}" for eps in sorted(_epsilons(runs), reverse=True)]
    for vary, symbol in (("h", "h"), ("eps", "ε")):
        about = {run.folder: json.loads((run.folder / "summary.json").read_text(encoding="utf-8")) for run in studies}
        shown = [run for run in studies if about[run.folder]["vary"] == vary]
        if shown:
            fixed = {f"h = {power(run.parameters['solve.h'])}" for run in shown}
            fixed = {f"ε = {power(eps)}" for eps in _epsilons(shown)} if vary == "h" else fixed
            at = "".join(f" at {value}" for value in sorted(fixed))
            against = {about[run.folder]["reference"].replace(run.algorithm, "the same algorithm") for run in shown}
            words.append(f"over {symbol}{at} against {' or '.join(sorted(against))}".replace("alg1", SLIDES["alg1"]))
    return ", ".join(words)


def _epsilons(runs: list[KeptRun]) -> set[float]:
    return {run.parameters["solve.eps"] for run in runs if run.algorithm in ("alg3", "alg4")}


def read_runs(folder: Path, names: list[str]) -> list[KeptRun]:
    """Runs by their names."""
    runs = []
    for name in names:
        about = json.loads((folder / "runs" / name / "run.json").read_text(encoding="utf-8"))
        runs.append(KeptRun(folder / "runs" / name, about["parameters"], about["seconds"]))
    return runs


def draw_region(runs: list[KeptRun]) -> Figure:
    """Figure 1: a smooth domain whose boundary consists of Γ_D and Γ_S."""
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
    surface.set(xlabel="$x$", ylabel="$y$", title="(a) $u_h$")
    surface.locator_params(nbins=5)

    arrows = figure.add_subplot(1, 3, 2)
    low, high = points.min(axis=0), points.max(axis=0)
    spacing = (high - low).max() / 22
    x, y = np.meshgrid(*(np.arange(a + spacing / 2, b, spacing) for a, b in zip(low, high, strict=True)))
    cell = triangulation.get_trifinder()(x, y)
    arrows.quiver(x[cell >= 0], y[cell >= 0], *sigma[cell[cell >= 0]].T, color="C0", pivot="mid", width=0.004)
    arrows.set(aspect="equal", xlabel="$x$", ylabel="$y$", title=r"(b) $\sigma_h$")

    magnitude = figure.add_subplot(1, 3, 3)
    magnitude.grid(visible=False)
    norm = np.linalg.norm(sigma, axis=1)
    top, above = float(np.quantile(norm, QUANTILE)), norm.max() > 1.2 * np.quantile(norm, QUANTILE)
    image = magnitude.tripcolor(
        triangulation, norm, cmap="viridis", rasterized=True, vmax=top if above else float(norm.max())
    )
    figure.colorbar(image, ax=magnitude, extend="max" if above else "neither")
    magnitude.set(aspect="equal", xlabel="$x$", ylabel="$y$", title=r"(c) $|\sigma_h|$")
    return figure


TRACES = {"u": ("$u_h$", "C0"), "flux": (r"$\sigma_h\cdot n$", "C3"), "p": ("$p_h$", "C2")}


def draw_traces(runs: list[KeptRun]) -> Figure:
    """u_h, σ_h·n and p_h along Γ_S: one row per part, one column per quantity."""
    arrays = runs[0].solution()
    names = arrays["about"]["part_names"]
    labels = [arrays["about"]["parts"][name] for name in names]
    figure = Figure(figsize=(11, 2.8 * len(names)), layout="constrained")
    panels = figure.subplots(len(names), 3, squeeze=False)
    letters = itertools.count()
    for part, (name, label) in enumerate(zip(names, labels, strict=True)):
        for axes, (key, (title, color)) in zip(panels[part], TRACES.items(), strict=True):
            _trace(axes, arrays, part, key, color)
            axes.set(xlabel=_coordinate(label), title=rf"{_letter(next(letters))} {title} on $\Gamma_S$: {name}")
    return figure


def draw_penalty_traces(runs: list[KeptRun]) -> Figure:
    """u_εh, σ_εh·n and p_εh together: one row per ε, one column per part of Γ_S."""
    solutions = [(run.parameters["solve.eps"], run.solution()) for run in runs]
    names = solutions[0][1]["about"]["part_names"]
    figure = Figure(figsize=(5.4 * len(names), 3.2 * len(solutions)), layout="constrained")
    panels = figure.subplots(len(solutions), len(names), squeeze=False)
    letters = itertools.count()
    for row, (eps, arrays) in zip(panels, solutions, strict=True):
        for part, axes in enumerate(row):
            for key, (title, color) in TRACES.items():
                _trace(axes, arrays, part, key, color, title)
            title = rf"{_letter(next(letters))} {names[part]}, $\varepsilon = {power(eps)}$"
            axes.set(xlabel=_coordinate(arrays["about"]["parts"][names[part]]), title=title)
    _legend_below(figure, panels[0, 0], {r"_h": r"_{\varepsilon h}"})
    return figure


def _letter(number: int) -> str:
    return f"({chr(ord('a') + number)})"


def _coordinate(label: str) -> str:
    return f"${label}$" if len(label) == 1 else label


def _legend_below(figure: Figure, axes: Axes, renamed: dict[str, str] | None = None, columns: int = 3) -> None:
    """One legend below all panels, where it hides nothing."""
    handles, labels = axes.get_legend_handles_labels()
    for old, new in (renamed or {}).items():
        labels = [label.replace(old, new) for label in labels]
    figure.legend(handles, labels, loc="outside lower center", ncols=columns)


def _trace(axes: Axes, arrays: dict[str, Any], part: int, key: str, color: str, label: str | None = None) -> None:
    on = arrays["facet_part"] == part
    style = "--" if key == "p" else "-"  # p_h lies on u_h where both are positive
    axes.plot(arrays["facet_along"][on], arrays[f"facet_{key}"][on], style, color=color, label=label)


def draw_iterations(runs: list[KeptRun]) -> Figure:
    """‖σ^(n+1) − σ^(n)‖_V and ‖u^(n+1) − u^(n)‖_Q, one panel per algorithm."""
    figure = Figure(figsize=(4.6 * len(runs), 3.4), layout="constrained")
    panels = figure.subplots(1, len(runs), squeeze=False)[0]
    for number, (axes, run) in enumerate(zip(panels, runs, strict=True)):
        rows = run.rows("history.csv")
        n = np.array([row["iteration"] for row in rows]) - 1
        for key, label, style in (
            ("sigma_change", r"$\|\sigma^{(n+1)}-\sigma^{(n)}\|_V$", "o-"),
            ("u_change", r"$\|u^{(n+1)}-u^{(n)}\|_Q$", "s--"),
        ):
            values = np.array([row[key] for row in rows])
            axes.semilogy(n[values > 0], values[values > 0], style, label=label)  # a repeated set changes nothing
        eps = rf", $\varepsilon = {power(run.parameters['solve.eps'])}$" if run.algorithm in ("alg3", "alg4") else ""
        axes.set(xlabel="$n$", title=f"{_letter(number)} {SLIDES[run.algorithm]}{eps}")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    _legend_below(figure, panels[0])
    return figure


def draw_errors(runs: list[KeptRun]) -> Figure:
    """Errors of σ, u and p of Algorithms 3 and 4: over h at fixed ε, and over ε at fixed h."""
    figure = Figure(figsize=(11, 4.8), layout="constrained")
    series = {
        "sigma_V": r"$\|\sigma_{\mathrm{ref}}-\sigma_h\|_V$",
        "u_Q": r"$\|u_{\mathrm{ref}}-u_h\|_Q$",
        "p_Lambda": r"$\|p_{\mathrm{ref}}-p_h\|_\Lambda$",
    }
    panels = figure.subplots(1, 2)
    for axes, over in zip(panels, ("h", "eps"), strict=True):
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
        eps, h = (power(shown[0].parameters[f"solve.{name}"]) for name in ("eps", "h"))
        fixed = rf"\varepsilon = {eps}" if over == "h" else f"h = {h}"
        letter, name = ("a", "$h$") if over == "h" else ("b", r"$\varepsilon$")
        axes.set(xlabel=name, title=f"({letter}) fixed ${fixed}$")
    _legend_below(figure, panels[0])
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
    "slides_sigma_V_order": "slides' order",
    "u_Q": "‖u_ref − u_h‖_Q",
    "u_Q_order": "order",
    "slides_u_Q": "slides",
    "slides_u_Q_order": "slides' order",
}


def table_rows(run: KeptRun, slides: dict[str, dict[str, float]]) -> list[list[str]]:
    """The lines of a table: our errors and orders, and those of the slides."""
    lines = []
    for row in run.rows("convergence.csv"):
        theirs, before = slides.get(f"{row['level']:g}", {}), slides.get(f"{row['level'] - 1:g}", {})
        values = row | {f"slides_{key}": value for key, value in theirs.items()}
        for key in theirs.keys() & before.keys():
            values[f"slides_{key}_order"] = math.log2(before[key] / theirs[key])
        cells = [f"2^-{row['level']:g}"]
        for key in list(COLUMNS)[1:]:
            value = values.get(key, float("nan"))
            cells.append("-" if np.isnan(value) else f"{value:.2f}" if key.endswith("order") else f"{value:.3g}")
        lines.append(cells)
    return lines


def make(folder: Path, names: Sequence[str] | None = None) -> None:
    """Draw the items of `reproduction.json`, or some of them, and the page that shows all of them."""
    with mpl.rc_context(STYLE):
        _make(folder, names)


def _make(folder: Path, names: Sequence[str] | None) -> None:
    reproduction = json.loads((folder / "reproduction.json").read_text(encoding="utf-8"))
    sections = []
    for name, item in reproduction["items"].items():
        runs = read_runs(folder, item["runs"])
        if item["draw"] == "table":
            lines = table_rows(runs[0], item["slides"])
            with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
                csv.writer(file).writerows([["h", *list(COLUMNS)[1:]], *lines])  # each name once
            shown = _html_table(lines)
        else:
            if names is None or name in names:
                figure = DRAWN[item["draw"]](runs)
                for suffix in ("png", "pdf"):
                    figure.savefig(folder / f"{name}.{suffix}")
            shown = f'<a href="{name}.pdf"><img src="{name}.png" alt="{html.escape(item["caption"])}"></a>'
        sections.append(_section(name, item, shown, runs))
    (folder / "index.html").write_text(_page(reproduction, sections), encoding="utf-8")


def _html_table(lines: list[list[str]]) -> str:
    head = "".join(f"<th>{as_html(column)}</th>" for column in COLUMNS.values())
    body = "".join("<tr>" + "".join(f"<td>{as_html(cell)}</td>" for cell in line) + "</tr>" for line in lines)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _section(name: str, item: dict[str, Any], shown: str, runs: list[KeptRun]) -> str:
    label = name.replace("table", "Table ").replace("figure", "Figure ")
    caption = item["caption"] + (f" {settings(runs)}." if runs else "")
    seconds = sum(run.seconds for run in runs)
    count = f"{len(item['runs'])} run" + "s" * (len(item["runs"]) != 1)
    return (
        f'<section id="{name}"><h2>{label}</h2>{shown}<p class="caption"><b>{label}.</b> {as_html(caption)}</p>'
        f"<p><code>{html.escape(item['command'])}</code> · {count}, {seconds:.0f} s of one rank</p>"
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
.caption {{ max-width: 60rem; }} sup, sub {{ line-height: 0; }}
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
