"""Pictures of an elastic solution in the plane: the deformed body, and the contact pressure."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.certificate.certify import Certificate
from signorini_fenicsx.output.pictures import style
from signorini_fenicsx.solving.elastic_solution import ElasticSolution

if TYPE_CHECKING:
    from signorini_fenicsx.output.elastic import ContactTable, Deformed

SHARE = 0.1
"""Of the body's size that the largest displacement is drawn as."""


@mpl.rc_context(style.STYLE)
def draw(
    folder: Path,
    solution: ElasticSolution,
    table: "ContactTable",
    deformed: "Deformed",
    certificate: Certificate | None,
) -> None:
    """Draw `deformed.png` and `pressure.png` (rank 0)."""
    caption = f"{solution.title or solution.name}, {len(deformed.vertices)} cells"
    if certificate is not None and np.isfinite(certificate.bound):
        caption += rf", energy error $\leq$ {100 * certificate.relative:.3g} %"
    style.save(_deformed(deformed, caption), folder / "deformed.png")
    style.save(_pressure(solution.boundary.contact, solution, table, caption), folder / "pressure.png")


def _deformed(deformed: "Deformed", caption: str) -> Figure:
    """The deformed body, coloured by the equivalent stress, over the outline of its cells."""
    size = np.ptp(deformed.vertices.reshape(-1, 2), axis=0)
    largest = float(np.linalg.norm(deformed.u, axis=2).max(initial=0.0))
    factor = _rounded(SHARE * size.max() / largest) if largest > 0 else 1.0
    figure = Figure(figsize=(6.4, 1.4 + 5.0 * min(max(size[1] / size[0], 0.3), 1.6)), layout="constrained")
    axes = figure.add_subplot()
    axes.add_collection(PolyCollection(deformed.vertices, facecolors="none", edgecolors="0.85", linewidths=0.3))
    low, high, extend = style.limits(deformed.von_mises, _areas(deformed.vertices))
    moved = PolyCollection(deformed.vertices + factor * deformed.u, cmap=style.FLUX_MAP, edgecolors="face")
    moved.set(array=deformed.von_mises, clim=(low, high), linewidth=0.3, rasterized=True)
    axes.add_collection(moved)
    style.colour_bar(figure, axes, moved, "von Mises stress", extend)
    style.shape_axes(axes, f"{caption}\ndisplacement × {factor:g}")
    axes.autoscale_view()
    return figure


def _pressure(parts: Sequence[str], solution: ElasticSolution, table: "ContactTable", caption: str) -> Figure:
    """−σ_nn along each part of Γ_C, linear on each facet, and the gap."""
    figure = Figure(figsize=(6.4, 0.6 + 2.9 * len(parts)), layout="constrained")
    for index, name in enumerate(parts):
        mine = table.part == index
        axes = figure.add_subplot(len(parts), 1, index + 1)
        axes.plot(table.along[mine], table.pressure[mine], color=style.CONTACT, label=r"pressure $-\sigma_{nn}$")
        axes.set(xlabel=f"${solution.spaces.domain.parts[name].label}$", ylabel="pressure", title=f"{name}: {caption}")
        other = axes.twinx()
        other.grid(False)
        other.plot(table.along[mine], table.gap[mine], color=style.FREE, label=r"gap $g - u_n$")
        other.set_ylabel("gap")
        lines = [*axes.lines, *other.lines]
        axes.legend(handles=lines, loc="upper center", ncols=2)
    return figure


def _areas(vertices: Array) -> Array:
    edges = vertices[:, 1:] - vertices[:, :1]
    return np.abs(np.linalg.det(edges)) / 2


def _rounded(value: float) -> float:
    """The nearest smaller one of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 5) if step <= value / power * (1 + 1e-12)) * power)
