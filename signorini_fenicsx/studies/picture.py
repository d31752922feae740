"""The picture of a study: curves over one number that varies, or a map over two."""

import contextlib
import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from signorini_fenicsx.pictures import style
from signorini_fenicsx.pictures.sheet import Sheet
from signorini_fenicsx.quantities.bracket import QUANTITY, VALUE
from signorini_fenicsx.studies.varied import SOLVE, follows, short, value_in_words

type Row = Mapping[str, Any]

SHOWN = {
    "contact_measure": "measure of the contact set",
    "certificate.relative": "bound of the relative error",
    "norms.contact_force": "contact force",
    "iterations": "iterations",
}
"""Results that are drawn, where runs have them."""
ERRORS = {"sigma_V": "error of σ in V", "energy": "error of σ", "u_Q": "error of u", "u_L2": "error of u"}
"""Results of runs that measure errors; then they are drawn over h or ε."""
MOST_PANELS, MOST_CURVES = 3, 12
SPREAD = 8
"""Numbers are on a logarithmic axis if the largest is this many times the smallest."""
SAME = 1e-9
"""Results that differ relatively by less are drawn as equal."""
SIZE = 3.2, 2.8
"""Inches of a panel."""
LINES = ("-", "--", ":", "-.")


@dataclass(frozen=True)
class Plan:
    """The plan of a picture of a study.

    Attributes:
        keys: What varies.
        x: The key of the horizontal axis.
        y: The key of the vertical axis of maps; None for curves.
        curves: Keys whose values tell curves apart.
        panels: Titles by the keys of results.
    """

    keys: Sequence[str]
    x: str
    y: str | None
    curves: Sequence[str]
    panels: Mapping[str, str]


def plan(rows: Sequence[Row], keys: Sequence[str]) -> Plan | None:
    """What to draw of the rows of a table in which these keys vary; None if there is nothing to see."""
    measured = [key for key in ERRORS if any(_is_number(row.get(key)) for row in rows)]
    if measured:
        over = "eps" if len({row.get("h") for row in rows}) == 1 else "h"
        keys = [over, *(key for key in keys if key.removeprefix(SOLVE) != over)]
    titles = {key: ERRORS[key] for key in measured} or _quantities(rows) | SHOWN
    panels = {key: title for key, title in titles.items() if any(_is_number(row.get(key)) for row in rows)}
    numbers = [key for key in keys if all(_is_number(row.get(key)) for row in rows)]
    if not keys or not panels or len(rows) < 2:
        return None
    x, curves = next(iter([*numbers, *keys])), list[str]()
    for key in keys:
        if key != x and not any(follows(rows, key, other) for other in ([] if measured else [x]) + curves):
            curves.append(key)
    panels = dict(itertools.islice(panels.items(), MOST_PANELS))
    if not measured and len(curves) == 1 and curves[0] in numbers:
        points = {(row[x], row[curves[0]]) for row in rows}
        if len(points) == len(rows) and all(len({point[axis] for point in points}) > 2 for axis in (0, 1)):
            return Plan(keys, x, curves[0], [], panels)
    return Plan(keys, x, None, curves, panels)


def _quantities(rows: Sequence[Row]) -> dict[str, str]:
    """The names of quantities by the keys of their values, in the order of the rows; only those with an interval.

    They are drawn before other results.
    """
    keys = dict.fromkeys(key for row in rows for key in row if key.startswith(QUANTITY) and key.endswith(VALUE))
    return {key: key[len(QUANTITY) : -len(VALUE)] for key in keys if any(_interval(row, key) for row in rows)}


def _interval(row: Row, key: str) -> tuple[float, float] | None:
    """The ends of the interval of a quantity whose value has this key, if both are numbers; None for other results."""
    ends = [row.get(key.removesuffix(VALUE) + end) for end in (".lower", ".upper")]
    return (ends[0], ends[1]) if all(map(_is_number, ends)) else None  # type: ignore[return-value]


def told_of(rows: Sequence[Row], keys: Sequence[str]) -> tuple[dict[str, str], list[Row]]:
    """The columns of a short table with their heads, what varies and what is drawn, and its rows."""
    done = [numbers(row, keys) for row in rows if row.get("status") == "done"]
    wanted = plan(done, keys)
    return {key: short(key, keys) for key in keys} | ({} if wanted is None else dict(wanted.panels)), done


@mpl.rc_context(style.STYLE)
def draw_study(path: Path, rows: Sequence[Row], keys: Sequence[str], title: str) -> bool:
    """Draw the finished runs of a study into a file (rank 0).

    Args:
        path: The file.
        rows: The rows of its table.
        keys: What varies.
        title: The title.

    Returns:
        Whether there was anything to draw.
    """
    done = [numbers(row, keys) for row in rows if row.get("status") == "done"]
    wanted = plan(done, keys)
    if wanted is None:
        return False
    count = len(wanted.panels)
    sheet, handles = Sheet([SIZE[0]] * count, [SIZE[1]], bars=wanted.y is not None, title=title), dict[str, Any]()
    for column, (key, name) in enumerate(wanted.panels.items()):
        axes = sheet.panel(0, column, aspect=None if wanted.y is None else SIZE[0] / SIZE[1])
        axes.set(title=name, xlabel=short(wanted.x, wanted.keys))
        if wanted.y is None:
            handles |= _curves(axes, done, wanted, key)
        else:
            _map(sheet, axes, done, wanted, key)
    sheet.legend_below(list(handles.values()) if wanted.curves and len(handles) <= MOST_CURVES else [])
    sheet.save(path)
    return True


def _curves(axes: Axes, rows: Sequence[Row], wanted: Plan, key: str) -> dict[str, Any]:
    """A result over x, one curve for each combination of the other values; those that have it by their labels.

    Curves differ not by colour alone.
    """
    groups: dict[str, list[Row]] = {}
    for row in rows:
        values = [f"{short(name, wanted.keys)} = {value_in_words(row.get(name))}" for name in wanted.curves]
        groups.setdefault(", ".join(values), []).append(row)
    numeric = all(_is_number(row.get(wanted.x)) for row in rows)
    handles = {}
    for index, (label, own) in enumerate(groups.items()):
        if numeric:
            own = sorted(own, key=lambda row: row[wanted.x])
        x = [row[wanted.x] if numeric else style.readable(value_in_words(row.get(wanted.x))) for row in own]
        y = [row[key] if _is_number(row.get(key)) else np.nan for row in own]
        (curve,) = axes.plot(
            x, y, marker="os^Dv"[index % 5], markersize=4, linestyle=LINES[index % 4] if numeric else "", label=label
        )
        proved = [(place, *ends) for place, row in zip(x, own, strict=True) if (ends := _interval(row, key))]
        if proved:
            axes.vlines(*zip(*proved, strict=True), color=curve.get_color(), linewidth=3, alpha=0.4)
        if np.isfinite(y).any():
            handles[label] = curve
    if numeric and _spreads([row[wanted.x] for row in rows]):
        axes.set_xscale("log")
    results = [row[key] for row in rows if _is_number(row.get(key))]
    results += [end for row in rows for end in _interval(row, key) or ()]
    if _spreads(results):
        axes.set_yscale("log")
    elif np.ptp(results) <= SAME * max(map(abs, results)):  # else differences by rounding fill the axis
        around = 0.5 * abs(results[0]) or 0.5
        axes.set_ylim(min(results) - around, max(results) + around)
    return handles


def _map(sheet: Sheet, axes: Axes, rows: Sequence[Row], wanted: Plan, key: str) -> None:
    """A result over two numbers: a field for each run, with white where one is missing."""
    x, y = wanted.x, wanted.y or ""
    across, up = (sorted({row[name] for row in rows}) for name in (x, y))
    values = np.full((len(up), len(across)), np.nan)
    for row in rows:
        if _is_number(row.get(key)):
            values[up.index(row[y]), across.index(row[x])] = row[key]
    image = axes.pcolormesh(values, cmap="viridis")
    axes.grid(False)
    axes.set_xticks(np.arange(len(across)) + 0.5, [f"{value:.3g}" for value in across])
    axes.set_yticks(np.arange(len(up)) + 0.5, [f"{value:.3g}" for value in up])
    axes.set_ylabel(short(y, wanted.keys))
    bar = sheet.bar(axes, image, "")
    if (values[np.isfinite(values)] % 1 == 0).all():  # such as iterations
        bar.ax.yaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


def numbers(row: Row, keys: Iterable[str]) -> Row:
    """A row in which texts of these keys that are numbers are numbers."""
    columns = dict(row)
    for key in keys:
        with contextlib.suppress(ValueError):
            columns[key] = float(row[key]) if isinstance(row.get(key), str) else row.get(key)
    return columns


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _spreads(values: Sequence[float]) -> bool:
    return len(values) > 2 and min(values) > 0 and max(values) > SPREAD * min(values)
