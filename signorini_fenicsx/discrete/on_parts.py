"""Conditions on parts of the boundary, as the problems of all physics are given by them."""

from collections.abc import Mapping, Sequence
from typing import Any

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.contact.law import OnParts
from signorini_fenicsx.meshes.domain import Domain, other_side


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
