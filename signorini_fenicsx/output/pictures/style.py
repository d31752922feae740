"""The common style of all pictures: fonts, colours, colour limits, numbers in mathematical type."""

import io
import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure, SubFigure

from signorini_fenicsx.base.arrays import Array

STYLE = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 10,
    "axes.titlesize": 10.5,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.axisbelow": True,
    "figure.dpi": 150,
    "figure.constrained_layout.h_pad": 0.08,
    "figure.constrained_layout.w_pad": 0.08,
}
"""Settings of Matplotlib; `mpl.rc_context(STYLE)` applies them to a function only, not to the process."""

CONTACT, FREE, WATER = "#d62728", "#5ab4e6", "#4a90c2"
SEGMENTS = ("#ff9f1c", "#2a9d8f", "#8d5bb5", "#b08968", "#e377c2", "#7f7f7f")
OF_SEGMENT = {"contact": CONTACT, "stick": CONTACT, "lower": CONTACT, "upper": "#8c1d40", "open": FREE}
"""Colours of the segments of laws; those without one of their own take the colours of `SEGMENTS` in turn."""
U_MAP, FLUX_MAP, STREAM_MAP, ERROR_MAP = "viridis", "cividis", "plasma", "magma"

NOTEBOOK_DPI = 75
"""A figure that is as wide as a page is as wide as the column of a notebook then."""
QUANTILE = 0.99
"""The colour scale ends at the value below which this share of the domain is, so a corner singularity is beyond it."""


class Page(Figure):
    """A figure that notebooks show whether pyplot is there or not."""

    def _repr_png_(self) -> bytes:
        png = io.BytesIO()
        self.savefig(png, format="png", dpi=NOTEBOOK_DPI)
        return png.getvalue()


def power(value: float) -> str:
    """A number for mathematical type: 2^{-5}, 10^{-8}, 0.03, 3 × 10^{-7}."""
    for base in (2, 10):
        exponent = round(math.log(value, base)) if value > 0 else 0
        if value > 0 and abs(exponent) > 1 and math.isclose(value, float(base) ** exponent, rel_tol=1e-12):
            return f"{base}^{{{exponent}}}"
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.3g}"
    mantissa, exponent_text = f"{value:.2e}".split("e")
    return rf"{mantissa} \times 10^{{{int(exponent_text)}}}"


def limits(values: Array, weights: Array) -> tuple[float, float, str]:
    """Colour limits for values that may have peaks, and the ends of the colour bar to extend.

    Args:
        values: The values, not negative.
        weights: The measure of the cell of each value.
    """
    order = np.argsort(values)
    measure = np.cumsum(weights[order])
    low, high = float(values[order[0]]), float(values[order[-1]])
    usual = float(values[order[np.searchsorted(measure, QUANTILE * measure[-1])]])
    if high > 1.2 * usual > 0:
        return min(low, usual), usual, "max"
    return low, high if high > low else low + (abs(low) or 1.0), "neither"


def letter(number: int) -> str:
    """The letter of a panel: (a), (b) and so on."""
    return f"({chr(ord('a') + number)})"


def shape_axes(axes: Axes, title: str) -> None:
    """Axes of a picture of the plane."""
    axes.grid(False)
    axes.set(aspect="equal", xlabel="$x$", ylabel="$y$", title=title)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def colour_bar(figure: Figure | SubFigure, axes: Axes, image: object, label: str, extend: str = "neither") -> Colorbar:
    """A colour bar beside a panel, with the height of the panel."""
    return figure.colorbar(image, ax=axes, label=label, extend=extend, shrink=0.85, aspect=25, pad=0.02)


def legend_below(figure: Figure | SubFigure, handles: list, columns: int = 4) -> None:
    """A legend below all panels, where it hides nothing."""
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=columns)


def save(figure: Figure, path: Path) -> None:
    """Write a figure."""
    # `savefig` would draw twice, once for the layout. Level 3 takes half the time; files are a few per cent larger.
    FigureCanvasAgg(figure).print_png(path, pil_kwargs={"compress_level": 3})
