"""Curves over mesh sizes, ε and unknowns."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np

from signorini_fenicsx.certificate.adaptive import AdaptRow
from signorini_fenicsx.comparing.convergence import ErrorRow, Vary
from signorini_fenicsx.output.latex import formula
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.sheet import Sheet

GUIDES = {"sigma_V": (1.0, 0.5), "energy": (2.0, 1.5)}
"""Slopes to compare with, by the error that is named first."""


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
                label = (formula(name) or name) + suffix
                axes.loglog(x, values, look, color=f"C{index}", label=label, markersize=5)
    for slope, look in zip(GUIDES.get(first, ()), ("k--", "k:"), strict=False):
        guide = (tables[0][first] or np.nan) * 0.5 * (x / x[0]) ** slope
        axes.loglog(x, guide, look, linewidth=0.8, label=f"slope {slope:g}")
    axes.set_xscale("log", base=base)
    axes.set(xlabel=r"$\varepsilon$" if vary is Vary.EPS else "$h$", ylabel="error", title=title)
    sheet.legend_below(axes.get_legend_handles_labels()[0])
    sheet.save(path)


@mpl.rc_context(style.STYLE)
def draw_bounds(path: Path, rows: Sequence[AdaptRow], best: float, title: str) -> None:
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
