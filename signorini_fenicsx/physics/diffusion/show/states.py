"""What laws with memory have at the end of a step: their states, such as the thickness of a film, on Γ_S."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.discrete.remembered import Remembered

if TYPE_CHECKING:  # it shows this
    from signorini_fenicsx.physics.diffusion.solution import Solution


def states(solution: Solution) -> dict[str, Array]:
    """The states by their names on the facets of Γ_S, NaN on other parts; laws may share a name (collective)."""
    found: dict[str, Array] = {}
    for _, name, rows, values in _of_laws(solution):
        found.setdefault(name, np.full(len(solution.spaces.facets), np.nan))[rows] = values
    return found


def titles(solution: Any) -> dict[str, str]:
    """What pictures call the states, by their names."""
    laws = Remembered.among(solution.spaces, solution.problem.laws).laws.values()
    return {name: law.titles.get(name, name) for law in laws for name in law.state}


def sizes(solution: Solution) -> dict[str, dict[str, float]]:
    """The mean and the largest value of each state, by "law.0 h" and so on (collective)."""
    comm, found = solution.spaces.mesh.comm, {}
    for law, name, rows, values in _of_laws(solution):
        measure = solution.spaces.facet_measure[rows]
        integral, area = comm.allreduce(np.array([measure @ values, measure.sum()])).tolist()
        largest = comm.allreduce(float(values.max(initial=-np.inf)), MPI.MAX)
        found[f"{law} {name}"] = {"mean": integral / area, "largest": largest}
    return found


def _of_laws(solution: Solution) -> list[tuple[str, str, Indices, Array]]:
    """The name of each law, those of its states, its facets and the values there (collective)."""
    remembered = Remembered.among(solution.spaces, solution.problem.laws)
    if not remembered.laws:
        return []
    columns = remembered.left_by(solution)
    rows = {i: solution.spaces.rows_on(*law.parts) for i, law in remembered.laws.items()}
    return [
        (f"law.{i}", name, rows[i], column[rows[i]])
        for (i, name), column in zip(remembered.names, columns.T, strict=False)
    ]
