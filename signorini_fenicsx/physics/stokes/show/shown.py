"""What is shown of a viscous flow: fields, tables, pictures, lines of a report."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from signorini_fenicsx.cases.plot import in_unit, plot_of
from signorini_fenicsx.physics.elasticity.show import shown as of_bodies
from signorini_fenicsx.physics.elasticity.show import tables
from signorini_fenicsx.physics.elasticity.show.shown import forces_in_words, segments_in_words, value_at
from signorini_fenicsx.physics.elasticity.show.tables import ContactTable
from signorini_fenicsx.physics.stokes.show.readings import pressure_of, traces, velocities
from signorini_fenicsx.solving.fields import IN_CELLS, Field, Fields
from signorini_fenicsx.solving.solved import Columns

NAMES = {"pressure": "sigma_nn", "gap": "u_n", "contact": "closed"}
"""What bodies have in contact, and what that is under laws of a flow, which are from the other side."""
VALUES = {"contact": "closed"}
"""Of the conditions of bodies."""


def fields(solution: Any) -> Fields:
    """The fields, see `Solved.fields`: u_h, σ_h, p and û as they are, and what is missing in the balance (collective).

    On parts with laws they are u_h, u_n, σ_nn, and the states.
    """
    found = {place: list(some) for place, some in of_bodies.fields(solution).items()}
    flow = velocities(solution, traces(solution))
    found[IN_CELLS] += [Field("pressure", pressure_of(solution.stresses)), Field("flow", flow, order=1)]
    for place in [place for place in found if place != IN_CELLS]:
        found[place] = [
            replace(each, name=NAMES.get(each.name, each.name), names=[VALUES.get(word, word) for word in each.names])
            for each in found[place]
        ]
    return found


def columns(solution: Any, table: ContactTable) -> Columns:
    """The columns of `contact.csv`, see `fields`."""
    found = dict(tables.columns(solution, table))
    found["condition"] = np.where(table.touching, "closed", "open")
    return {NAMES.get(name, name): values for name, values in found.items()}


def lines(solution: Any, summary: Mapping[str, Any]) -> dict[str, str]:
    """The lines of a report, see `Solved.lines`."""
    about, flows, plot = summary["quantities"], summary["flows"], plot_of(solution.source)
    length, dim = plot.length_unit, solution.spaces.dim
    measure = in_unit(f"{summary['contact_measure']:.6g}", length, dim - 1)
    out = in_unit(", ".join(f"{part} {flow:.5g}" for part, flow in flows.items()), plot.over_facets(plot.unit, dim))
    texts = {
        **(
            {"closed": f"{summary['touching_vertices']} facet vertices, measure {measure}"}
            if solution.spaces.part_names
            else {}
        ),
        "forces": forces_in_words(summary["resultants"], dim, plot),
        "speed": f"at most {value_at(about['speed'], plot.unit, length)}",
        "pressure": _between(about["pressure"], plot.stress_unit, length),
        "flow": f"out of {out}",
    }
    units = {"u_n": plot.unit, "sigma_nn": plot.stress_unit}
    for part, of_law in about["laws"].items():
        u_n, sigma_nn = (_between(of_law[key], unit, length) for key, unit in units.items())
        texts[f"on {part}"] = f"u_n {u_n}; σ_nn {sigma_nn}"
    for part, segments in summary.get("segments", {}).items():
        texts[f"on {part}"] += f"; facet vertices on each segment: {segments_in_words(segments)}"
    if "friction" in summary:
        texts["slip"] = f"facet vertices: {segments_in_words(summary['friction'])}"
    return texts


def _between(ends: Mapping[str, Any], unit: str, length: str) -> str:
    """The least and the largest value with their places."""
    least = {"largest": ends["least"], "at": ends["least_at"]}
    return f"{value_at(least, unit, length)} to {value_at(ends, unit, length)}"
