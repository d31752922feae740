"""The laws of a problem on Γ_S: a chain per facet, from the means of their data over it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.contact.chains import Chains, joined
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.contact.laws import Signorini
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.part_laws import PartLaw, by_ends, chains_of, checked, data_of_law, parts_of_laws
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.problem import Problem


@dataclass(frozen=True)
class BoundaryLaws:
    """The laws on Γ_S.

    Attributes:
        of_parts: Each law with its parts; first ψ and q_S of the problem on the parts that `Boundary.signorini` lists.
        chains: Their graphs per facet, measured from the references.
    """

    of_parts: tuple[PartLaw, ...]
    chains: Chains

    @property
    def listed(self) -> bool:
        """Whether there are laws besides ψ and q_S of the problem."""
        return any(part.name for part in self.of_parts)

    @property
    def leave_open(self) -> Mask:
        """The facets whose law leaves open which of its segments holds; a given u or flux has one segment alone."""
        rows = [part.rows for part in self.of_parts if len(part.law.segments) > 1]
        return np.isin(np.arange(len(self.chains.p)), np.concatenate([*rows, np.empty(0, dtype=np.int64)]))

    def names(self) -> list[str]:
        """Names of all segments, law after law; see `labels`."""
        return [segment for law in {part.name: part.law for part in self.of_parts}.values() for segment in law.segments]

    def titles(self) -> list[str]:
        """What pictures call these segments."""
        return [title for part in {part.name: part for part in self.of_parts}.values() for title in part.titles()]

    def labels(self, segment: np.ndarray) -> np.ndarray:
        """For each facet the row of its segment in `names`."""
        labels = np.array(segment, dtype=np.int64)
        first, laws = 0, dict[str, int]()
        for part in self.of_parts:
            if part.name not in laws:
                laws[part.name], first = first, first + len(part.law.segments)
            labels[part.rows] = part.law.named(labels[part.rows]) + laws[part.name]
        return labels


def boundary_laws(spaces: Spaces, problem: Problem, psi: Datum, q_S: Datum) -> tuple[BoundaryLaws, Array, Array]:
    """The laws of all parts of Γ_S (collective).

    Returns:
        They, and u and κ∇u·n at the reference of each facet: the means of ψ and q_S where these hold.

    Raises:
        InputError: If data are not what their law allows; the message says where.
    """
    given = problem.named_laws
    listed = parts_of_laws(spaces, given)
    plain = [part for part in spaces.part_names if part not in listed]
    laws: list[tuple[str, Law, Mapping[str, Datum]]] = []
    if plain or all(law.region for law in problem.laws):
        laws.append(("", Signorini(plain), {"psi": psi, "q_S": q_S}))
    for name, law in given:
        if not law.region:
            laws.append((name, law, data_of_law(spaces, law, name)))
    number = len(spaces.facets)
    psi_h, q_Sh = np.empty(number), np.empty(number)
    of_parts, chains = [], []
    for name, law, data in laws:
        for some in by_ends(spaces, PartLaw(law, name, spaces.rows_on(*law.parts), data)):
            part, graph = checked(spaces, some)
            psi_h[part.rows], q_Sh[part.rows] = graph.reference
            chains.append((part.rows, chains_of(graph, len(part.rows))))
            of_parts.append(part)
    return BoundaryLaws(tuple(of_parts), joined(chains, number)), psi_h, q_Sh
