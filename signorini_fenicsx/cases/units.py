"""Units of what is read off a solution, as `[plot]` names them, and probes and sections in words."""

from collections.abc import Mapping
from typing import Any

from signorini_fenicsx.base.text import named
from signorini_fenicsx.cases.plot import plot_of
from signorini_fenicsx.meshes.domain import AXES
from signorini_fenicsx.solving.solved import Columns, Solved

TABLES = ("probes", "sections")
"""The tables whose columns have units."""


def units_of(solution: Solved) -> dict[str, str]:
    """The units of the columns of probes and sections; of vectors and matrices by what all components begin with."""
    plot, dim = plot_of(solution.source), solution.spaces.mesh.geometry.dim
    of_u, of_sigma = (getattr(plot, key) for key in solution.unit_keys)
    units = dict.fromkeys(AXES[:dim], plot.length_unit) | {"u": of_u, "pressure": of_u, "sigma": of_sigma}
    units |= {"flux": plot.over_facets(of_sigma, dim), "measure": plot.over_facets("1", dim).removeprefix("1 ")}
    return {column: unit for column, unit in units.items() if unit}


def unit_of(column: str, units: Mapping[str, str]) -> str:
    """The unit of a column such as u or sigma_xy; empty if it has none."""
    return units.get(column.partition("_")[0], "")


def with_units(table: Columns, units: Mapping[str, str]) -> Columns:
    """A table whose columns are named with their units, such as "u (°C)"."""
    return {f"{name} ({unit})" if (unit := unit_of(name, units)) else name: each for name, each in table.items()}


def read_off(summary: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, str]:
    """What a summary has of probes and sections, in words."""
    tables = {key.removesuffix("s"): summary.get(key, {}) for key in TABLES}
    return {
        f"{key} {name}": named({column: value for column, value in row.items() if column not in AXES}, ".6g", units)
        for key, rows in tables.items()
        for name, row in rows.items()
    }


def summary_of(solution: Solved) -> dict[str, Any]:
    """The summary of a solution, with the units of its probes and sections where `[plot]` has some (collective)."""
    summary, units = solution.summary(), units_of(solution)
    return summary | {"units": units} if units and any(name in summary for name in TABLES) else summary
