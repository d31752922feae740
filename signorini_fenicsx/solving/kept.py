"""What a physics says of the files in which its solutions are kept, and how it makes a solution of them again."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy.typing as npt
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.base.owned import original_cells
from signorini_fenicsx.base.rows import fetch_rows
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import SiteConditions
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.solving.options import Options

type Arrays = dict[str, npt.NDArray]
type Layout = Mapping[str, tuple[type, *tuple[str, ...]]]
"""Type and shape of arrays; a word stands for the same number everywhere: "cells", "facets", "dim", "corners"."""


@dataclass(frozen=True)
class Stored:
    """A solution in a file, of which each rank has read a share.

    Attributes:
        options: Algorithm, backend and their parameters.
        arrays: The rows of its arrays that this rank has read.
        rows: For each facet of Γ_S of this rank its row.
        outcome: How the solve ended, from the last solution and its conditions.
        about: Fields of `Solved`: problem, options, step, name, title, source, timings, peak_memory.
        numbers: The lists of numbers that `Keeping.numbers` names.
        step: Number of the step of a problem in time; None for others.
    """

    options: Options
    arrays: Arrays
    rows: Indices
    outcome: Callable[[Iterate, SiteConditions], Outcome]
    about: Mapping[str, Any]
    numbers: Mapping[str, Sequence[float]]
    step: int | None

    def in_cells(self, spaces: MeshSpaces, key: str) -> npt.NDArray:
        """An array for the cells of this rank (collective)."""
        return fetch_rows(spaces.mesh.comm, original_cells(spaces.mesh), self.arrays[key])

    def on_facets(self, comm: MPI.Comm, *keys: str) -> list[npt.NDArray]:
        """Arrays for the facets of Γ_S of this rank (collective)."""
        return [fetch_rows(comm, self.rows, self.arrays[f"facet_{key}"]) for key in keys]


@dataclass(frozen=True)
class Keeping:
    """How a physics keeps its solutions in files.

    Attributes:
        boundary: The class of its boundaries, whose first attribute is the parts in contact.
        problem: The class of its problems.
        laws: The classes of its laws, by the names that files have for them.
        layout: The arrays without which there is no solution, beside those of the mesh.
        codes: Those of them that are numbers below another number.
        in_cells: The arrays of a solution for the cells of this rank (collective).
        on_facets: Those for the facets of Γ_S, their vertices among them, by their names without "facet_".
        read: Makes the solution from the problem and the spaces (collective).
        numbers: Attributes of a solution that are lists of numbers, kept beside the arrays.
        of_step: The arrays that a step in time has besides: what it takes from those before.
        of_some: The arrays that only some solutions have; `read` refuses a file without what it needs.
    """

    boundary: type
    problem: type[Any]
    laws: Mapping[str, type]
    layout: Layout
    codes: Mapping[str, int]
    in_cells: Callable[[Any], Arrays]
    on_facets: Callable[[Any], Arrays]
    read: Callable[[Any, Any, Stored], Any]
    numbers: Sequence[str] = ()
    of_step: Layout = field(default_factory=dict)
    of_some: Layout = field(default_factory=dict)
