"""The tables and figures that `scripts/reproduce.py` makes of runs of studies, and the page that shows them."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import html
import itertools
import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation

from signorini_fenicsx.base.versions import versions
from signorini_fenicsx.pictures.style import limits, power
from signorini_fenicsx.studies.folder import Record
from signorini_fenicsx.studies.study import Run

SLIDES = {"alg1": "Algorithm 1", "alg2": "Algorithm 2", "alg3": "Algorithm 3", "alg4": "Algorithm 4"}


@dataclass(frozen=True)
class Kept:
    """A finished run on disk.

    Attributes:
        run: The run.
        folder: Its folder.
        record: How it ended.
    """

    run: Run
    folder: Path
    record: Record

    @property
    def algorithm(self) -> str:
        """Its algorithm, as the slides call it."""
        return SLIDES[self.run.case.solve.algorithm]

    @property
    def numbers(self) -> dict[str, float]:
        """H, and ε if there is a penalty, by their symbols."""
        solving = self.run.case.solve
        return {"h": solving.h} | ({"ε": solving.eps} if self.run.case.method.has_eps else {})

    @property
    def varies(self) -> str:
        """The symbol of what varies from row to row; empty if it is one solve."""
        return {"h": "h", "eps": "ε"}[self.record.summary["vary"]] if self.run.convergence else ""

    def rows(self, name: str) -> list[dict[str, Any]]:
        """The rows of one of its tables, with None for empty cells."""
        rows: list[dict[str, Any]] = pyarrow.csv.read_csv(self.folder / name).to_pylist()
        return rows

    def solution(self) -> dict[str, Any]:
        """The arrays of its checkpoint, with its JSON part under `about`."""
        place = self.folder / "checkpoint"
        arrays = {path.stem: np.load(path) for path in place.glob("*.npy")}
        order = np.lexsort((arrays["facet_along"], arrays["facet_part"]))  # the ranks have written them one by one
        arrays |= {key: rows[order] for key, rows in arrays.items() if key.startswith("facet_")}
        return arrays | {"about": json.loads((place / "about.json").read_text(encoding="utf-8"))}


def as_html(text: str) -> str:
    """Powers and indices of mathematical type as HTML."""
    text = re.sub(r"\^\{?(-?\w+)\}?", r"<sup>\1</sup>", html.escape(text))
    return re.sub(r"_\{?(\w+)\}?", r"<sub>\1</sub>", text).replace("<sup>-", "<sup>−")


def settings(runs: Sequence[Kept]) -> str:
    """Algorithms, h and ε of some runs, and of studies what varies, and against which reference."""
    words = [" and ".join(sorted({run.algorithm for run in runs}))]
    for symbol in ("", "h", "ε"):
        some = [run for run in runs if run.varies == symbol]
        words += [f"over {symbol}"] if some and symbol else []
        fixed = {(name, value) for run in some for name, value in run.numbers.items() if name != symbol}
        words += [f"{name} = {power(value)}" for name, value in sorted(fixed)]
        references = sorted({run.record.summary["reference"] for run in some if symbol})
        words += [re.sub(r"alg\d", lambda name: SLIDES[name[0]], f"against {reference}") for reference in references]
    return ", ".join(words)


def draw_solution(runs: Sequence[Kept]) -> Figure:
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
    norm, (a, b) = np.linalg.norm(sigma, axis=1), np.moveaxis(points[cells[:, 1:]] - points[cells[:, :1]], 1, 0)
    bottom, top, beyond = limits(norm, np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    image = magnitude.tripcolor(triangulation, norm, cmap="viridis", rasterized=True, vmin=bottom, vmax=top)
    figure.colorbar(image, ax=magnitude, extend=beyond, label=r"$|\sigma_h|$")
    magnitude.set(aspect="equal", xlabel="$x$", ylabel="$y$", title=r"(c) $|\sigma_h|$")
    return figure


TRACES = {"u": ("$u_h$", "C0"), "flux": (r"$\sigma_h\cdot n$", "C3"), "p": ("$p_h$", "C2")}


def draw_traces(runs: Sequence[Kept]) -> Figure:
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


def draw_penalty_traces(runs: Sequence[Kept]) -> Figure:
    """u_εh, σ_εh·n and p_εh together: one row per ε, one column per part of Γ_S."""
    solutions = [(run.numbers["ε"], run.solution()) for run in runs]
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


def draw_iterations(runs: Sequence[Kept]) -> Figure:
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
            values = np.array([row[key] for row in rows], dtype=float)
            axes.semilogy(n[values > 0], values[values > 0], style, label=label)  # a repeated set changes nothing
        eps = "".join(rf", $\varepsilon = {power(value)}$" for name, value in run.numbers.items() if name == "ε")
        axes.set(xlabel="$n$", title=f"{_letter(number)} {run.algorithm}{eps}")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    _legend_below(figure, panels[0])
    return figure


def draw_errors(runs: Sequence[Kept]) -> Figure:
    """Errors of σ, u and p of Algorithms 3 and 4: over h at fixed ε, and over ε at fixed h."""
    figure = Figure(figsize=(11, 4.8), layout="constrained")
    series = {
        "sigma_V": r"$\|\sigma_{\mathrm{ref}}-\sigma_h\|_V$",
        "u_Q": r"$\|u_{\mathrm{ref}}-u_h\|_Q$",
        "p_Lambda": r"$\|p_{\mathrm{ref}}-p_h\|_\Lambda$",
    }
    panels = figure.subplots(1, 2)
    for axes, over in zip(panels, ("h", "ε"), strict=True):
        shown = [run for run in runs if run.varies == over]
        base = 2.0 if over == "h" else 10.0
        for run, style in zip(shown, ("o-", "x--"), strict=True):
            rows = run.rows("convergence.csv")
            x = np.array([base ** -row["level"] for row in rows])
            for index, (key, label) in enumerate(series.items()):
                values = [row[key] for row in rows]
                axes.loglog(x, values, style, color=f"C{index}", label=f"{label}, {run.algorithm}")
        guide = shown[0].rows("convergence.csv")[0]["sigma_V"] * 0.5
        axes.loglog(x, guide * x / x[0], "k:", linewidth=0.8, label="slope 1")
        axes.set_xscale("log", base=int(base))
        eps, h = (power(shown[0].numbers[name]) for name in ("ε", "h"))
        fixed = rf"\varepsilon = {eps}" if over == "h" else f"h = {h}"
        letter, name = ("a", "$h$") if over == "h" else ("b", r"$\varepsilon$")
        axes.set(xlabel=name, title=f"({letter}) fixed ${fixed}$")
    _legend_below(figure, panels[0])
    return figure


DRAWN: dict[str, Callable[[Sequence[Kept]], Figure]] = {
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


def table_rows(run: Kept) -> list[list[str]]:
    """The lines of a table: our errors and orders, and those of the slides."""
    lines, before = [], dict[str, Any]()
    for row in run.rows("convergence.csv"):
        for key in ("slides_sigma_V", "slides_u_Q"):
            row[f"{key}_order"] = math.log2(before[key] / row[key]) if before.get(key) and row[key] else None
        before, cells = row, [f"2^-{row['level']:g}"]
        for key in list(COLUMNS)[1:]:
            value = row[key]
            cells.append("-" if value is None else f"{value:.2f}" if key.endswith("order") else f"{value:.3g}")
        lines.append(cells)
    return lines


def table(lines: list[list[str]]) -> str:
    """Lines of a table in HTML."""
    head = "".join(f"<th>{as_html(column)}</th>" for column in COLUMNS.values())
    body = "".join("<tr>" + "".join(f"<td>{as_html(cell)}</td>" for cell in line) + "</tr>" for line in lines)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def picture(name: str, caption: str) -> str:
    """A figure in HTML."""
    return f'<a href="{name}.pdf"><img src="{name}.png" alt="{html.escape(caption)}"></a>'


def section(name: str, shown: str, caption: str, command: str, runs: Sequence[Kept]) -> str:
    """A table or figure with its caption, its command and its time in HTML."""
    label = name.replace("table", "Table ").replace("figure", "Figure ")
    text = as_html(f"{caption} {settings(runs)}.")
    seconds = sum(run.record.seconds for run in runs)
    count = f"{len(runs)} run" + "s" * (len(runs) != 1)
    return (
        f'<section id="{name}"><h2>{label}</h2>{shown}<p class="caption"><b>{label}.</b> {text}</p>'
        f"<p><code>{html.escape(command)}</code> · {count}, {seconds:.0f} s of one rank</p>"
        "</section>"
    )


def page(remark: str, sections: dict[str, str]) -> str:
    """The page with some sections, by name."""
    used = ", ".join(f"{key} {value}" for key, value in versions().items())
    links = " ".join(f'<a href="#{name}">{name}</a>' for name in sections)
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
<p>{html.escape(remark)}</p><p>{html.escape(used)}</p><nav>{links}</nav>
{"".join(sections.values())}
</body></html>
"""
