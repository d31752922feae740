"""The common style of all pictures: fonts, colours, colour limits, numbers in mathematical type."""

import contextlib
import itertools
import math
import re
from collections.abc import Collection, Iterable
from functools import cache

import numpy as np
from matplotlib.colors import hsv_to_rgb, to_hex
from matplotlib.mathtext import MathTextParser

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.text import printable_lines
from signorini_fenicsx.certificate.certificate import Certificate

STYLE = {
    "font.family": ["STIXGeneral", "DejaVu Sans"],  # the second one has more letters
    "mathtext.fontset": "stix",
    "font.size": 10,
    "axes.titlesize": 10.5,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.axisbelow": True,
    "figure.dpi": 150,
    "axes.formatter.limits": (-3, 5),  # so numbers beside an axis are short
}
"""Settings of Matplotlib; `mpl.rc_context(STYLE)` applies them to a function only, not to the process."""

CONTACT, FREE, WATER, LOAD = "#d62728", "#5ab4e6", "#4a90c2", "#0072b2"
SEGMENTS = ("#e69f00", "#009e73", "#cc79a7", "#0072b2", "#7f7f7f", "#f0e442")
OF_SEGMENT = {"contact": CONTACT, "stick": CONTACT, "upper": "#0072b2", "open": FREE}
"""Colours of the segments of laws; those without one of their own take the colours of `SEGMENTS` in turn, which are
those of Okabe and Ito: colour-blind readers tell them apart."""
OTHERS = 0.15, 0.618, 0.6, 0.75
"""The hue of the first of more colours, the step between the hues of two, and their saturation and value."""
U_MAP, FLUX_MAP, STREAM_MAP, ERROR_MAP, SIGNED_MAP = "viridis", "cividis", "plasma", "magma", "RdBu_r"
WET_MAP, PRESSURE_MAP, WATER_MAP, DRY_MAP = "YlGnBu", "RdBu", "Blues", "Reds_r"

DOLLARS = re.compile(r"((?<!\\)\$.*?(?<!\\)\$)")
"""Mathematics in a line."""
FLAT = 1e-3
"""Values that differ by less than this share of the largest have a scale from 0."""
MOST, SMALL = 0.75, 0.1
"""Values have a logarithmic scale if this share of the domain has less than this share of the usual largest one."""
QUANTILE = 0.99
"""The colour scale ends at the value below which this share of the domain is, so a corner singularity is beyond it."""


def power(value: float) -> str:
    """A number for mathematical type: 2^{-5}, 10^{-8}, 0.03, 3 × 10^{-7}."""
    for base in (2, 10):
        exponent = round(math.log(value, base)) if value > 0 else 0
        if value > 0 and abs(exponent) > 1 and math.isclose(value, float(base) ** exponent, rel_tol=1e-12):
            return f"{base}^{{{exponent}}}"
    return decimal(value)


def decimal(value: float) -> str:
    """A number with three digits for mathematical type, without powers of 2 for it."""
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
    return (low, high, "neither") if high - low > FLAT * high else (0.0, high or 1.0, "neither")


def spans_decades(values: Array, weights: Array) -> bool:
    """Whether most of values, which are not negative, would have one colour on a scale up to the usual largest one.

    Args:
        values: The values.
        weights: The measure of the cell of each value.
    """
    order = np.argsort(values)
    measure = np.cumsum(weights[order])
    most, usual = (values[order[np.searchsorted(measure, share * measure[-1])]] for share in (MOST, QUANTILE))
    return bool(0 < most < SMALL * usual)


def around_0(values: Array) -> tuple[float, float]:
    """Colour limits with 0 in the middle for values of both signs, and at one end for others."""
    low, high = float(values.min()), float(values.max())
    most = max(-low, high, 1e-300)
    down, up = low < -FLAT * most, high > FLAT * most
    return -most if down else 0.0, most if up or not down else 0.0


def colours_of(names: Iterable[str], taken: Collection[str] = ()) -> dict[str, str]:
    """The colour of each segment of laws by its name, in alphabetical order; no two have the same.

    Args:
        names: The names.
        taken: Colours that others have in the same picture.
    """
    found = dict[str, str]()
    for name in sorted(set(names)):  # "contact" and "stick" have one colour, but not in one picture
        if (colour := OF_SEGMENT.get(name)) and colour not in (*found.values(), *taken):
            found[name] = colour
    first, step, *rest = OTHERS
    many = (to_hex(hsv_to_rgb(((first + step * i) % 1, *rest))) for i in itertools.count())
    used = {*found.values(), *taken}
    free = (colour for colour in itertools.chain(SEGMENTS, many) if colour not in used)
    return {name: found.get(name) or next(free) for name in sorted(set(names))}


def readable(text: str) -> str:
    """A text, perhaps of several lines, as Matplotlib can show it: mathematics that it cannot read as it is written.

    Texts of users are among those of pictures, so none of them may fail.
    """
    return "\n".join("".join(map(_piece, DOLLARS.split(line))) for line in printable_lines(text).split("\n"))


@cache
def _piece(text: str) -> str:
    """A part of a line as it is if it is mathematics that can be read, and without mathematics otherwise."""
    if DOLLARS.fullmatch(text):
        with contextlib.suppress(Exception):
            MathTextParser("path").parse(text)
            return text
    return re.sub(r"(?<!\\)\$", r"\$", text)


def letter(number: int) -> str:
    """The letter of a panel: (a), (b) and so on."""
    return f"({chr(ord('a') + number)})"


def bound_in_words(certificate: Certificate | None) -> list[str]:
    """A bound for a caption: certified only if it is proved, and to which solution the error is."""
    if certificate is None or not math.isfinite(certificate.bound):
        return []
    words = f"certified {certificate.error}" if certificate.proved else certificate.error
    share = rf" ({100 * certificate.relative:.3g} % of $\|\sigma_h\|$)" if certificate.smaller_than_flux else ""
    bound = rf"{words} $\leq$ ${power(certificate.bound)}${share}"
    return [bound, *([] if certificate.proved else ["not guaranteed"])]
