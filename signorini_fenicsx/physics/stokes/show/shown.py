"""What is shown of a viscous flow: fields, tables, pictures, lines of a report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.physics.elasticity.show import shown as of_bodies
from signorini_fenicsx.physics.elasticity.show.shown import ContactTable
from signorini_fenicsx.solving.drawn import Drawn
from signorini_fenicsx.solving.fields import IN_CELLS, Field, Fields
from signorini_fenicsx.solving.solved import Columns

NAMES = {"pressure": "sigma_nn", "gap": "u_n", "contact": "closed"}
"""What bodies have in contact, and what that is under laws of a flow, which are from the other side."""


def pressure_of(stresses: Array) -> Array:
    """P = −tr σ/d at the vertices of the subcells."""
    return -np.einsum("nsaii->nsa", stresses) / stresses.shape[-1]


def fields(solution: Any) -> Fields:
    """The fields, see `Solved.fields`: u_h, σ_h and p as they are, and what is missing in the balance.

    On parts with laws they are u_h, u_n, σ_nn, and the states.
    """
    found = dict(of_bodies.fields(solution))
    found[IN_CELLS] = [*found[IN_CELLS], Field("pressure", pressure_of(solution.stresses))]
    for place in [place for place in found if place != IN_CELLS]:
        found[place] = [replace(each, name=NAMES.get(each.name, each.name)) for each in found[place]]
    return found


def columns(solution: Any, table: ContactTable) -> Columns:
    """The columns of `contact.csv`, see `fields`."""
    return {NAMES.get(name, name): values for name, values in of_bodies.columns(solution, table).items()}


def drawn(solution: Any) -> Drawn:
    """The flow for pictures: the speed and the pressure (collective)."""
    found = of_bodies.drawn(solution)
    spaces, pressure = solution.spaces, pressure_of(solution.stresses)
    by_geometry = np.argsort(spaces.order, axis=1)
    of_vertex = np.empty((len(pressure), spaces.dim + 1))
    for vertex in range(spaces.dim + 1):
        others = [s for s in range(spaces.dim + 1) if s != vertex]
        of_vertex[:, vertex] = np.mean([pressure[:, s, vertex - (vertex > s)] for s in others], axis=0)
    at_corners = np.take_along_axis(of_vertex, by_geometry, axis=1)[:, :, None]
    mean = pressure.mean(axis=(1, 2))[:, None]
    u = found.corners["u"]
    return replace(
        found,
        corners={"u": u, "pressure": at_corners},
        cells={"u": found.cells["u"], "pressure": mean},
    )


def lines(solution: Any, summary: Mapping[str, Any]) -> dict[str, str]:
    """The lines of a report, see `Solved.lines`."""
    texts = of_bodies.lines(solution, summary)
    if "contact" in texts:
        texts["closed"] = texts.pop("contact")
    flows = ", ".join(f"{part} {flow:.5g}" for part, flow in summary["flows"].items())
    return {name: text for name, text in texts.items() if name != "gap"} | {"flow": f"out of {flows}"}
