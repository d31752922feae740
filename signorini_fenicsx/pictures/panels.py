"""What a physics declares of its pictures: panels, what is drawn over maps, files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, auto
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy.typing as npt
from matplotlib.colors import Colormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.cases.plot import with_unit
from signorini_fenicsx.discrete.site_table import Surfaces
from signorini_fenicsx.pictures.gather import Known
from signorini_fenicsx.pictures.style import ERROR_MAP, U_MAP

if TYPE_CHECKING:
    from signorini_fenicsx.pictures.scene import Scene


class Where(Enum):
    """Where a panel shows values; the dimension that has no such panel leaves it out."""

    MAP = auto()
    """On the cells: a map of the plane, a cut in space."""
    CUT = auto()
    """On a cut in space alone."""
    ACROSS = auto()
    """On a second cut in space."""
    SURFACE = auto()
    """In the plane as a surface over it."""
    OUTSIDE = auto()
    """On the surface of a domain in space."""
    STREAMS = auto()
    """On streamlines of the flux, in the plane on a map below these."""
    GAMMA = auto()
    """Along each part of Γ_S in the plane, on Γ_S in space."""
    SETS = auto()
    """The contact set on Γ_S in space."""
    STEPS = auto()
    """Over the iterations."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One panel of a picture.

    Attributes:
        what: Values at the points of the scene, or in its cells; on Γ_S the name of a column of its table.
        where: Where they are shown.
        title: What is shown.
        label: What the colour bar says.
        colours: Its colours.
        in_cells: Whether values are those of cells.
        ends: The ends of the colours, and of the bar to extend; those of the values if None.
        log: Whether colours are on a logarithmic scale.
        levels: Values on which maps have lines.
        lines: In the plane streamlines, and the corners of their arrow heads.
        flow: In space the field of streamlines, at the points, or if it jumps at the corners of cells.
        only: The triangles that a map shows, if not all.
        curves: On Γ_S in the plane the columns of the table, each with its label and look.
        of_jump: The title on parts inside the domain, if it is another one.
        peak: Whether the title in the plane tells the largest value.
        names: The colours of what values count, by their names, which the legend has in the place of a bar.
        scene: What it shows, if not the solution as it is.
    """

    what: Any
    where: Where
    title: str = ""
    label: str = ""
    colours: str | Colormap = U_MAP
    in_cells: bool = False
    ends: tuple[float, float, str] | None = None
    log: bool = False
    levels: Sequence[float] = ()
    lines: tuple[Sequence[Array], Sequence[Array] | Array] = (), ()
    flow: Array | None = None
    only: Mask | None = None
    curves: Mapping[str, tuple[str, dict[str, Any]]] = field(default_factory=dict)
    of_jump: str = ""
    peak: bool = False
    names: Mapping[str, str] = field(default_factory=dict)
    scene: Scene | None = None


def error_panel(scene: Scene, title: str = r"contributions $\eta_T$ to the error bound") -> list[Panel]:
    """Where the error is, on a logarithmic scale; nothing if no bound is known."""
    eta = scene.fields.in_cells.get("indicator")
    return [] if eta is None else [Panel(eta, Where.MAP, title, r"$\eta_T$", ERROR_MAP, in_cells=True, log=True)]


def named_colours(panels: Iterable[Panel]) -> list[Patch]:
    """The entries of the legend for what values of panels count."""
    names = {name: colour for panel in panels for name, colour in panel.names.items()}
    return [Patch(color=colour, label=name) for name, colour in names.items()]


def on_gamma(what: str, title: str, unit: str, curve: tuple[str, str, str], **look: Any) -> Panel:
    """A column along Γ_S, of vectors in space their lengths.

    Args:
        what: The column.
        title: What it is.
        unit: Its unit, or empty.
        curve: In the plane the column, what the legend calls it, and its colour.
        look: What else the panel has.
    """
    name, (column, label, colour) = with_unit(title, unit), curve
    curves = {column: (label, {"linewidth": 1.6, "color": colour})}
    return Panel(what, Where.GAMMA, name, name, curves=curves, **look)


@dataclass(frozen=True)
class Overlay:
    """Lines or polygons over maps.

    Attributes:
        label: What the legend calls them, if they are in it.
        points: The points of each, of shape (points, dim); in space triangles.
        look: How Matplotlib draws them; in space their colour and opacity.
        filled: Whether they are polygons; in space what is beside the outside alone.
    """

    label: str
    points: Sequence[Array]
    look: dict[str, Any]
    filled: bool = False

    def handle(self) -> Line2D | Patch:
        """The entry of the legend."""
        if self.filled:
            return Patch(label=self.label, **self.look)
        return Line2D([], [], label=self.label, **self.look | {"linewidth": max(self.look["linewidth"], 1.0)})


@dataclass(frozen=True)
class Drawn:
    """A solution for pictures, on each rank its own share.

    Attributes:
        corners: Values at the corners of each cell by their names, in the order of the geometry, shape
            (cells, dim + 1, k).
        cells: Values of each cell by their names.
        boundary: The facets of each kind of boundary, with what is known there.
        surfaces: Γ_S, and what is opposite to it and has a table.
        states: Numbers of cells by what lines between different ones are called.
        over: What is drawn over maps besides, on rank 0.
        words: What captions add.
    """

    corners: Mapping[str, Array]
    cells: Mapping[str, npt.NDArray]
    boundary: Mapping[int, Known]
    surfaces: Sequence[Surfaces]
    states: Mapping[str, npt.NDArray] = field(default_factory=dict)
    over: Sequence[Overlay] = ()
    words: Sequence[str] = ()


type File = tuple[str, Sequence[Panel]]
"""Title and panels of a picture."""


@dataclass(frozen=True)
class Pictures:
    """What is drawn of the solutions of a physics (rank 0, but for `drawn`).

    Attributes:
        drawn: What pictures need of a solution (collective).
        files: Panels of each file by its name; the first is what a notebook shows.
        over: What is drawn over maps, from what usually is: the boundary and the regions.
        kept: For a scene at the end of a run in time and the number of its steps the names of what steps keep in cells
            and pictures need, with the steps.
        in_time: Draws a run in time into a folder, from its scene at the end, tables, times and rows of all steps, and
            what steps kept by names and steps.
        words: What legends say in the place of letters, such as Γ_C, and of words for bodies.
        heights: Heights at points of the plane that a page gives to it, None where it is flat.
    """

    drawn: Callable[[Any], Drawn]
    files: Callable[[Scene], Mapping[str, File]]
    over: Callable[[Scene, list[Overlay]], list[Overlay]] = lambda scene, usual: usual
    kept: Callable[[Any, int], Mapping[str, Sequence[int]]] = lambda solution, steps: {}
    in_time: Callable[[Path, Scene, DrawnSteps], None] = lambda folder, scene, steps: None
    words: Mapping[str, str] = field(default_factory=dict)
    heights: Callable[[Scene], Array | None] = lambda scene: None


@dataclass(frozen=True)
class DrawnSteps:
    """A run in time (rank 0).

    Attributes:
        times: The time of each step.
        tables: Its table of sites.
        rows: Its numbers.
        kept: What steps kept in cells, by name and number of the step.
        readings: What was read off after each step, by the name of its table.
        opposite: The table of what is opposite to Γ_S after each step, if there is such.
    """

    times: Sequence[float]
    tables: Sequence[Any]
    rows: Sequence[Mapping[str, Any]]
    kept: Mapping[str, Mapping[int, Any]]
    readings: Mapping[str, Sequence[Mapping[str, Any]]] = field(default_factory=dict)
    opposite: Sequence[Any] = ()
