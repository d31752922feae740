"""What laws with memory remember from step to step: states on the facets of Γ_S of this rank.

They are columns of an array: for each law with memory its states in a row, then "flux", κ∇u·n of the last solution, and
"tau", the length of the step. A facet has 0 for the states of laws of other parts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.tolerances import STEP
from signorini_fenicsx.contact.law import Law, LawWithMemory
from signorini_fenicsx.discrete.contact_sets import near_facets
from signorini_fenicsx.discrete.datum import OnFacets, datum_of
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.part_laws import PartLaw, chains_of, means_of
from signorini_fenicsx.expressions.given import at_time, parsed

FLUX, TAU = "flux", "tau"
ZERO = ufl.as_ufl(0.0)


@dataclass(frozen=True)
class Remembered:
    """The laws with memory among some laws.

    Attributes:
        spaces: The spaces.
        laws: They, by their number among all laws.
    """

    spaces: MeshSpaces
    laws: Mapping[int, LawWithMemory]

    @classmethod
    def among(cls, spaces: MeshSpaces, laws: Sequence[Law]) -> "Remembered":
        """The laws with memory among these."""
        return cls(spaces, {i: law for i, law in enumerate(laws) if isinstance(law, LawWithMemory)})

    @property
    def names(self) -> list[tuple[int, str]]:
        """The columns of states, each by the number of its law and its name."""
        return [(i, name) for i, law in self.laws.items() for name in law.state]

    def start(self, tau: float, before: Any = None) -> Array:
        """The columns at t = 0, with no flux; states are those after another solution that has the same (collective).

        Raises:
            InputError: If a state is not finite, or a text cannot be read.
        """
        columns = np.zeros((len(self.spaces.facets), len(self.names) + 2))
        columns[:, -1] = tau
        axes = "xyz"[: self.spaces.mesh.geometry.dim]
        for column, (i, name) in zip(columns.T, self.names, strict=False):
            place, law = f"law.{i}.{name}", self.laws[i]
            given = at_time(parsed(getattr(law, name), axes + "t", place), 0.0)
            rows, data = self.spaces.rows_on(*law.parts), {name: datum_of(self.spaces, place, given)}
            column[rows] = means_of(self.spaces, PartLaw(law, f"law.{i}", rows, data))[name]
        known = None if before is None else Remembered.among(before.spaces, before.problem.laws)
        if known is not None and known.names == self.names != []:
            left = known.left_by(before)[:, :-2].T
            columns[:, :-2] = np.column_stack(near_facets(list(left), before.spaces, self.spaces))
        return columns

    def left_by(self, solution: Any) -> Array:
        """The columns after a step with this solution (collective)."""
        flux = solution.spaces.normal_flux(solution.sigma)
        return self.after(solution.data.laws.of_parts, solution.p_means, flux)

    def in_step(self, laws: Sequence[Law], columns: Array) -> tuple[Law, ...]:
        """All laws of a problem, those with memory as laws of a step that knows these columns."""
        data = [OnFacets(ZERO, self.spaces.facets, column) for column in columns.T]

        def of(i: int) -> dict[str, Any]:
            state = {name: datum for (number, name), datum in zip(self.names, data, strict=False) if number == i}
            return {**state, FLUX: data[-2], TAU: data[-1]}

        return tuple(law.in_step(of(i)) if isinstance(law, LawWithMemory) else law for i, law in enumerate(laws))

    def known(self, laws: Sequence[Law]) -> Array:
        """The columns that the laws of a step know, see `in_step`."""
        columns = np.zeros((len(self.spaces.facets), len(self.names) + 2))
        for i, law in Remembered.among(self.spaces, laws).laws.items():
            of_law = [number == i for number, _ in self.names] + [True, True]
            columns[:, of_law] = np.column_stack([law.now[name].numbers for name in (*law.state, FLUX, TAU)])
        return columns

    def after(self, parts: Sequence[PartLaw], u: Array, flux: Array) -> Array:
        """The columns after a step, from the laws of the step, u and κ∇u·n on all facets (collective)."""
        columns = np.zeros((len(self.spaces.facets), len(self.names) + 2))
        columns[:, -2] = flux
        for part in parts:
            if isinstance(part.law, LawWithMemory):
                means = means_of(self.spaces, part)
                columns[part.rows, -1] = means[TAU]
                for name, values in part.law.after(means, u[part.rows], flux[part.rows]).items():
                    columns[part.rows, self.names.index((int(part.name.removeprefix("law.")), name))] = values
        return columns

    def on_curves(self, parts: Sequence[PartLaw], u: Array, flux: Array, unit: float) -> bool:
        """Whether u and κ∇u·n are on the curves that laws touch; one unit of u is so many of κ∇u·n (collective)."""
        off, size = [0.0], [0.0]
        for part in parts:
            if isinstance(part.law, LawWithMemory):
                trace, its_flux = u[part.rows], flux[part.rows]
                graph = part.law.falling({**means_of(self.spaces, part), FLUX: its_flux})
                reference = graph.reference
                away = trace - reference[0], its_flux - reference[1]
                distances = chains_of(graph, len(part.rows)).distances(*away, np.full(len(part.rows), unit))
                fluxes = unit * distances[0], *distances[1:]
                off += [float(np.abs(each).max(initial=0.0)) for each in fluxes]
                size.append(float(np.abs(its_flux).max(initial=0.0)))
        most, largest = (self.spaces.mesh.comm.allreduce(max(each), MPI.MAX) for each in (off, size))
        return bool(most <= STEP * largest)
