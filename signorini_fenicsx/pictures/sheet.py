"""Figures of panels in rows and columns, placed in inches: room for labels is known beforehand, nothing is measured."""

import io
import logging
import re
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from signorini_fenicsx.pictures import style

LEFT, RIGHT, ABOVE, BELOW = 0.75, 0.2, 0.36, 0.54
"""Room around a panel: for its numbers and label on the left, for its title, for its numbers and label below."""
BAR = 1.05
"""Room for a colour bar with its numbers and label on the right of a panel."""
EDGE = 0.1
LINE, ENTRY = 0.25, 0.21
"""Height of a line of the title and of a row of the legend."""
LINES = 10
"""Most lines of the title."""
WORDS = 1.85
"""Width of an entry of the legend."""
LETTER = 0.082
"""Mean width of a letter of the title."""
SPACE = r" (?!%)(?=(?:[^$]*\$[^$]*\$)*[^$]*$)"
"""A space outside of mathematics and not before "%"."""
FLAT = 0.4
"""Rows of views are at least this share of their width high."""
NOTEBOOK_DPI = 75
"""A figure that is as wide as a page is as wide as the column of a notebook then."""

type Place = tuple[float, float, float, float]
"""Left and upper edge, width and height, in inches."""


class Sheet(Figure):
    """Panels in rows and columns, a title above and a legend below.

    A constrained layout of Matplotlib measures each text twice before it draws, which takes longer than drawing.

    Args:
        widths: Inches for each column, without its labels.
        heights: Inches for each row, likewise; rows of views grow.
        bars: Whether the columns have room for colour bars.
        title: A title of the sheet, perhaps of several lines.
        dpi: Points per inch, if not those of the style.
    """

    def __init__(
        self,
        widths: Sequence[float],
        heights: Sequence[float],
        *,
        bars: bool = True,
        title: str = "",
        dpi: float | None = None,
    ) -> None:
        super().__init__(dpi=dpi)
        self.widths, self.heights, self._bar = widths, list(heights), BAR if bars else RIGHT
        self._across = EDGE + sum(LEFT + width + self._bar for width in widths)
        self._lines = _wrapped(title, self._across - 1)[:LINES] if title else []
        self._places: dict[Axes, Callable[[], Place]] = {}
        self.legend_below([])

    def panel(
        self, row: int, column: int, *, rows: int = 1, columns: int = 1, aspect: float | None = None, **options: Any
    ) -> Axes:
        """Axes in a cell.

        Args:
            row: Of the cell, from above.
            column: Of the cell.
            rows: How many rows it covers.
            columns: How many columns it covers.
            aspect: Width over height of a map, beside which there is room for a colour bar. Other panels fill the cell.
            options: Those of `add_axes`.
        """
        axes = self.add_axes((0, 0, 1, 1), **options)
        self._places[axes] = lambda: self._place(row, column, rows, columns, aspect)
        return axes

    def _place(self, row: int, column: int, rows: int, columns: int, aspect: float | None) -> Place:
        left = EDGE + LEFT + sum(LEFT + width + self._bar for width in self.widths[:column])
        top = self._top + ABOVE + sum(ABOVE + height + BELOW for height in self.heights[:row])
        width = sum(self.widths[column : column + columns]) + (columns - 1) * (LEFT + self._bar)
        height = sum(self.heights[row : row + rows]) + (rows - 1) * (ABOVE + BELOW)
        if aspect is None:
            return left, top, width + self._bar - RIGHT, height
        fitting = min(width, height * aspect)
        return left + (width - fitting) / 2, top + (height - fitting / aspect) / 2, fitting, fitting / aspect

    def view(self, row: int, column: int, aspect: float) -> Axes:
        """Axes for an image without labels, which also takes their room in its cell; the row is made as high.

        Args:
            row: Of the cell, from above.
            column: Of the cell.
            aspect: Width over height of the image.
        """
        axes, width = self.add_axes((0, 0, 1, 1)), self.widths[column]
        high = (width + LEFT - EDGE) / aspect - (BELOW - EDGE)
        self.heights[row] = max(self.heights[row], min(width, max(high, FLAT * width)))

        def place() -> Place:
            left, top, _, height = self._place(row, column, 1, 1, None)
            return left - LEFT + EDGE, top, width + LEFT - EDGE, height + BELOW - EDGE

        self._places[axes] = place
        return axes

    def bar(self, axes: Axes, image: object, label: str, extend: str = "neither") -> Colorbar:
        """A colour bar beside a map."""
        of_map, beside = self._places[axes], self.add_axes((0, 0, 1, 1))

        def place() -> Place:
            left, top, width, height = of_map()
            return left + width + 0.12, top + 0.06 * height, min(0.13, 0.1 * height), 0.88 * height

        self._places[beside] = place
        bar = self.colorbar(image, cax=beside, label=label, extend=extend)
        beside.yaxis.set_offset_position("left")  # a power of ten starts above the bar, not above the map
        return bar

    def legend_below(self, handles: list) -> None:
        """Place all panels, and a legend below them, where it hides nothing."""
        longest = max((len(handle.get_label()) for handle in handles), default=0)
        columns = max(1, min(len(handles), int(self._across / max(WORDS, 0.45 + 0.75 * LETTER * longest))))
        legend = EDGE + ENTRY * -(-len(handles) // columns)
        down = self._top + sum(ABOVE + height + BELOW for height in self.heights) + legend
        self.set_size_inches(self._across, down)
        for axes, place in self._places.items():
            left, top, width, height = place()
            axes.set_position((left / self._across, 1 - (top + height) / down, width / self._across, height / down))
        if self._lines:
            self.suptitle("\n".join(self._lines), fontsize=11, y=1 - EDGE / down)
        if handles:
            self.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 0), ncols=columns, borderpad=0.3)

    @property
    def _top(self) -> float:
        return EDGE + LINE * len(self._lines)

    def draw(self, renderer: Any) -> None:
        """Draw the figure with all texts as they can be shown; letters that no font has are boxes."""
        for text in self.findobj(Text):
            text.set_text(style.readable(text.get_text()))
        of_mathematics = logging.getLogger("matplotlib.mathtext")
        before, of_mathematics.disabled = of_mathematics.disabled, True
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "Glyph .* missing")
                super().draw(renderer)
        finally:
            of_mathematics.disabled = before

    def save(self, path: Path) -> None:
        """Write a PNG."""
        canvas = FigureCanvasAgg(self)
        canvas.draw()
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        picture.save(path, dpi=(self.dpi, self.dpi), compress_type=3)  # run lengths: half the time, no larger

    def _repr_png_(self) -> bytes:
        """For notebooks, whether pyplot is there or not."""
        png = io.BytesIO()
        self.savefig(png, format="png", dpi=NOTEBOOK_DPI)
        return png.getvalue()


def _wrapped(title: str, width: float) -> list[str]:
    """The lines of a title, broken after commas where they are too long, and at spaces if that is not enough."""
    lines = []
    for text in title.split("\n"):
        *others, last = _filled(text.split(", "), ", ", width)
        for line in (*(f"{line}," for line in others), last):
            lines += _filled(re.split(SPACE, line), " ", width)
    return lines


def _filled(pieces: Sequence[str], joint: str, width: float) -> list[str]:
    """Lines of pieces, each as long as the width permits."""
    lines = [pieces[0]]
    for piece in pieces[1:]:
        longer = f"{lines[-1]}{joint}{piece}"
        if LETTER * len(re.sub(r"\\[a-z]+|[{}$^_]", "", longer)) > width:
            lines.append(piece)
        else:
            lines[-1] = longer
    return lines
