"""Curves over iterations and time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from signorini_fenicsx.cases.plot import with_unit
from signorini_fenicsx.cases.units import unit_of
from signorini_fenicsx.contact.history import Step
from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.sheet import Sheet
from signorini_fenicsx.quantities.bracket import QUANTITY, VALUE

FEW = 25
"""Up to this many points have markers."""
MOST_PROBES = 10
"""Most points of probes that are drawn, in as many colours."""


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
def draw_quantities(
    path: Path, rows: Sequence[Mapping[str, Any]], title: str, labels: Mapping[str, str], time: str
) -> None:
    """Draw quantities with their intervals over time, if the steps have some; their labels by name (rank 0)."""
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
        axes.set(xlabel=time, title=labels.get(name, name) + passes)
    sheet.legend_below([])
    sheet.save(path)


@mpl.rc_context(style.STYLE)
def draw_probes(
    path: Path,
    times: Sequence[float],
    tables: Sequence[Mapping[str, Any]],
    units: Mapping[str, str],
    title: str,
    time: str,
) -> None:
    """Draw u, or the pressure head of water, at the first points of probes over time, with units (rank 0)."""
    columns = [key for key in tables[0] if key.startswith("u")]
    columns = ["pressure"] if "pressure" in tables[0] else columns
    sheet, handles = Sheet([5.4], [2.6] * len(columns), bars=False, title=title), []
    for place, column in enumerate(columns):
        axes = sheet.panel(place, 0)
        for i, name in enumerate(tables[0]["probe"][:MOST_PROBES]):
            values = [table[column][i] for table in tables]
            handles += axes.plot(times, values, marker="." if len(times) <= FEW else "", color=f"C{i}", label=str(name))
        name = "pressure head" if column == "pressure" else column
        axes.set(xlabel=time, title=with_unit(name, unit_of(column, units)))
    sheet.legend_below(handles[:MOST_PROBES])
    sheet.save(path)
