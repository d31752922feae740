"""Curves over iterations, mesh sizes, ε and unknowns."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from signorini_fenicsx.certificate.adaptive import AdaptRow
from signorini_fenicsx.comparing.convergence import ErrorRow, Vary
from signorini_fenicsx.contact.history import Step
from signorini_fenicsx.output.pictures import style
from signorini_fenicsx.output.pictures.sheet import Sheet
from signorini_fenicsx.quantities.bracket import QUANTITY, VALUE

FEW = 25
"""Up to this many points have markers."""

ERROR_LABELS = {
    "sigma_V": r"$\|\sigma_{\mathrm{ref}}-\sigma_h\|_V$",
    "u_Q": r"$\|u_{\mathrm{ref}}-u_h\|_Q$",
    "p_Lambda": r"$\|p_{\mathrm{ref}}-p_h\|_\Lambda$",
    "p_half": r"$\|p_{\mathrm{ref}}-p_h\|_{1/2}$",
    "flux_scaled": r"$\sqrt{\varepsilon}\,\|(\sigma_{\mathrm{ref}}-\sigma_h)\cdot n\|_\Lambda$",
    "energy": r"$|\sigma_{\mathrm{ref}}-\sigma_h|$",
    "u_L2": r"$\|u_{\mathrm{ref}}-u_h\|$",
    "pressure_L2": r"$\|(\sigma_{\mathrm{ref}}-\sigma_h)_{nn}\|_{\Gamma_C}$",
    "gap_L2": r"$\|(u_{\mathrm{ref}}-u_h)_n\|_{\Gamma_C}$",
}
GUIDES = {"sigma_V": (1.0, 0.5), "energy": (2.0, 1.5)}
"""Slopes to compare with, by the error that is named first."""


def moves(history: list[Step]) -> bool:
    """Whether any iteration changed something: without that there are no iteration errors to draw."""
    return any(step.sigma_change > 0 or step.u_change > 0 for step in history)


def draw_steps(axes: Axes, history: list[Step], title: str) -> None:
    """The iteration errors ‖σ^(n+1) − σ^(n)‖_V and ‖u^(n+1) − u^(n)‖_Q on a logarithmic scale.

    Those of rough steps are hollow.
    """
    axes.set(title=title)
    n, rough = np.array([[step.iteration - 1, step.rough] for step in history]).T
    axes.set(xlabel="$n$, hollow where solves are rough" if rough.any() else "$n$")
    few = len(n) <= FEW
    for key, label, marker, line in (
        ("sigma_change", r"$\|\sigma_h^{(n+1)}-\sigma_h^{(n)}\|_V$", "o", "-"),
        ("u_change", r"$\|u_h^{(n+1)}-u_h^{(n)}\|_Q$", "s", "--"),
    ):
        values = np.array([getattr(step, key) for step in history])
        positive = values > 0  # 0 for a repeated set has no logarithm
        look = {"marker": marker if few else "", "linestyle": line, "markersize": 4, "label": label}
        (curve,) = axes.semilogy(n[positive], values[positive], **look)
        hollow = positive & (rough > 0)
        axes.plot(n[hollow], values[hollow], marker, color=curve.get_color(), markerfacecolor="white", markersize=4)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


@mpl.rc_context(style.STYLE)
def draw_iterations(path: Path, history: list[Step], title: str) -> None:
    """Draw the iteration errors into a file, if an iteration changed anything (rank 0)."""
    if not moves(history):
        return
    sheet = Sheet([3.8], [2.8], bars=False)
    axes = sheet.panel(0, 0)
    draw_steps(axes, history, title)
    sheet.legend_below(axes.get_legend_handles_labels()[0])
    sheet.save(path)


@mpl.rc_context(style.STYLE)
def draw_errors(path: Path, rows: list[ErrorRow], vary: Vary, title: str) -> None:
    """Draw errors over h or ε on logarithmic axes, with those of the slides and lines of slopes to expect (rank 0)."""
    sheet = Sheet([5.6], [3.6], bars=False)
    axes = sheet.panel(0, 0)
    base = 10 if vary is Vary.EPS else 2
    x = np.array([float(base) ** -row.level for row in rows])
    tables = [row.columns() for row in rows]
    first = next(iter(rows[0].errors))
    for index, name in enumerate(rows[0].errors):
        for key, look, suffix in ((name, "o-", ""), (f"slides_{name}", "x:", ", slides")):
            values = [table.get(key) or np.nan for table in tables]
            if not np.all(np.isnan(values)):
                label = ERROR_LABELS.get(name, name) + suffix
                axes.loglog(x, values, look, color=f"C{index}", label=label, markersize=5)
    for slope, look in zip(GUIDES.get(first, ()), ("k--", "k:"), strict=False):
        guide = (tables[0][first] or np.nan) * 0.5 * (x / x[0]) ** slope
        axes.loglog(x, guide, look, linewidth=0.8, label=f"slope {slope:g}")
    axes.set_xscale("log", base=base)
    axes.set(xlabel=r"$\varepsilon$" if vary is Vary.EPS else "$h$", ylabel="error", title=title)
    sheet.legend_below(axes.get_legend_handles_labels()[0])
    sheet.save(path)


@mpl.rc_context(style.STYLE)
def draw_quantities(path: Path, rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Draw quantities with their intervals over time, if the steps have some (rank 0)."""
    keys = dict.fromkeys(key for row in rows for key in row if key.startswith(QUANTITY) and key.endswith(VALUE))
    names = [key[len(QUANTITY) : -len(VALUE)] for key in keys]
    if not names:
        return
    sheet, times = Sheet([4.4], [2.2] * len(names), bars=False, title=title), [row["t"] for row in rows]
    for place, name in enumerate(names):
        axes = sheet.panel(place, 0)
        value, lower, upper = (
            np.array([row.get(f"{QUANTITY}{name}.{key}", np.nan) for row in rows])
            for key in ("value", "lower", "upper")
        )
        bounded = np.isfinite(lower) & np.isfinite(upper)
        axes.fill_between(times, lower, upper, where=bounded, color=style.CONTACT, alpha=0.3, linewidth=0)
        axes.plot(times, value, color=style.CONTACT, marker="." if len(times) <= FEW else "")
        share = rows[-1].get(f"{QUANTITY}{name}.above_table", 0.0)
        passes = f", in the end {100 * share:.3g} % of it at negative pressure" if share else ""
        axes.set(xlabel="$t$", title=name + passes)
    sheet.legend_below([])
    sheet.save(path)


@mpl.rc_context(style.STYLE)
def draw_bounds(path: Path, rows: list[AdaptRow], best: float, title: str) -> None:
    """Draw the error bound over the unknowns, with a line of the best possible slope (rank 0)."""
    sheet = Sheet([4.8], [3.6], bars=False)
    axes = sheet.panel(0, 0)
    for refinement, look in (("adaptive", "o-"), ("uniform", "s--")):
        chosen = [row for row in rows if row.refinement == refinement]
        if chosen:
            x, bounds = [row.unknowns for row in chosen], [row.bound for row in chosen]
            axes.loglog(x, bounds, look, label=refinement, markersize=4)
    ends = np.array([rows[0].unknowns, max(row.unknowns for row in rows)])
    axes.loglog(ends, 0.6 * rows[0].bound * (ends / ends[0]) ** best, "k:", label=f"slope ${best:.2g}$")
    if not any(0 < row.bound < np.inf for row in rows):  # a bound of 0, or none, has no logarithm
        axes.set_yscale("linear")
    axes.set(xlabel="unknowns", ylabel="bound of the energy error", title=title)
    sheet.legend_below(axes.get_legend_handles_labels()[0])
    sheet.save(path)
