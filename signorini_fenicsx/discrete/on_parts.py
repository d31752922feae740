"""Conditions on parts of the boundary, as the problems of all physics are given by them."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, Self

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.contact.law import Law, OnParts
from signorini_fenicsx.expressions.given import at_time, parsed, with_data
from signorini_fenicsx.meshes.domain import Domain, other_side
from signorini_fenicsx.meshes.paired_parts import named_laws


class OnBoundary:
    """A problem sorted by the kinds of its boundary, as `on` of the problem of a user makes it; a dataclass.

    Attributes:
        boundary: The parts of each kind.
        laws: The laws on parts, of bodies with friction.
        numbers: For each law that of its condition, by which messages call it; () if each has one.
        no_data: The fields that are no data.
    """

    boundary: Any
    laws: Sequence[Law]
    numbers: Sequence[int] = ()
    no_data: ClassVar[Collection[str]]

    @property
    def named_laws(self) -> list[tuple[str, Law]]:
        """All laws with their names in messages."""
        return named_laws(self.laws, self.boundary.pairs, self.numbers)

    def in_time(self, dim: int) -> Self:
        """The problem, with numbers and texts read as trees that may have t in them, also those of the laws.

        Raises:
            InputError: If a text cannot be read.
        """
        return self._changed(lambda key, given: parsed(given, "xyz"[:dim] + "t" + self.of_u(key), key))

    def at(self, t: float) -> Self:
        """The problem at a time, from one that `in_time` has read."""
        return self._changed(lambda _, given: at_time(given, t))

    @staticmethod
    def of_u(_key: str) -> str:
        """The name u for a datum that may depend on it; empty for the others."""
        return ""

    def _changed(self, change: Callable[[str, Any], Any]) -> Self:
        """The problem with changed data, also those of the laws, see `with_data`."""
        laws = tuple(law.with_data(partial(_changed_in, name, change)) for name, law in self.named_laws)
        return replace(with_data(self, change, but=self.no_data), laws=laws)  # type: ignore[type-var]


def _changed_in(law: str, change: Callable[[str, Any], Any], key: str, given: Any) -> Any:
    """A datum of the law with this name, changed under the name of it that messages have."""
    return change(f"{law}.{key.partition('.')[2]}", given)


def check_laws(laws: object, example: str) -> None:
    """Refuse what is no list of laws.

    Raises:
        InputError: If it is none.
    """
    if not isinstance(laws, Sequence) or not all(isinstance(law, Law) for law in laws):
        raise InputError(f"laws: must be a list of laws, such as [{example}]")


def check_conditions(conditions: object, *kinds: Any, example: str) -> None:
    """Refuse what is no list of conditions of these kinds, and parts with two of them.

    A part may be the master of several pairs.

    Raises:
        InputError: If it is.
    """
    if not isinstance(conditions, Sequence):
        raise InputError(f"conditions: must be a list, such as {example}")
    listed, masters = set[str](), set[str]()
    for condition in conditions:
        if not isinstance(condition, kinds):
            names = type(condition).__name__ if isinstance(condition, OnParts) else repr(condition)
            raise InputError(f"conditions: {names} is no condition of this problem; an example is {example}")
        opposite = set(getattr(condition, "master", ()))
        for part in condition.parts:
            if part in listed and part not in masters & opposite:
                raise InputError(f"conditions: part '{part}' has two conditions")
            listed.add(part)
        masters |= opposite


def by_part(conditions: Sequence[Any], *kinds: Any) -> dict[str, Any]:
    """The condition on each part that has one of these kinds."""
    return {part: each for each in conditions if isinstance(each, kinds) for part in each.parts}


def names_all(domain: Domain, conditions: Sequence[Any]) -> bool:
    """Whether the parts of the conditions are the whole boundary (collective).

    Raises:
        InputError: If two of these parts have facets in common.
    """
    parts = dict.fromkeys(part for condition in conditions for part in condition.parts)
    named = [part for part in dict.fromkeys([*parts, *map(other_side, parts)]) if part in domain.facets]
    comm, topology = domain.mesh.comm, domain.mesh.topology
    owner = np.full(topology.index_map(topology.dim - 1).size_local, -1)
    for number, part in enumerate(named):
        before = owner[domain.facets[part]]
        shared, other = comm.allreduce(np.count_nonzero(before >= 0)), comm.allreduce(before.max(initial=-1), MPI.MAX)
        if shared > 0:
            raise InputError(
                f"conditions: parts '{named[other]}' and '{part}' have {counted(shared, 'facet')} in common; each "
                "facet needs one condition"
            )
        owner[domain.facets[part]] = number
    left = owner[dolfinx.mesh.exterior_facet_indices(topology)] < 0
    return not comm.allreduce(bool(left.any()), MPI.LOR)


def same_value(one: object, other: object) -> bool:
    """Whether two data were given as the same: one object, or equal numbers or texts, alone or in lists."""
    if one is other:
        return True
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(same_value, one, other))
    numbers = isinstance(one, int | float) and isinstance(other, int | float)
    return (numbers or (isinstance(one, str) and isinstance(other, str))) and one == other


def one_value(of_parts: Mapping[str, Any], default: Any) -> Any:
    """The value of all parts if they have the same, by part if they do not, and a default if there are none."""
    values = list(of_parts.values())
    if not values:
        return default
    return values[0] if all(same_value(values[0], value) for value in values) else dict(of_parts)
