"""Pairs of surfaces that share no nodes, by the names of their parts, as a boundary has them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from signorini_fenicsx.base.errors import InputError, check_names


@dataclass(frozen=True)
class PairedParts:
    """Two surfaces that share no nodes, as a boundary has them.

    Attributes:
        slave: Names of the parts that carry the pressure.
        master: Names of those opposite to them.
        direction: Along which points are paired: "normal" for the normal of each slave facet, or a vector.
        within: The largest distance; None for half the diameter of the smaller body.
        tied: Whether nothing may move.
        distance: Whether the gap is the distance, and what else is given more.
        shift: By how much the master is moved before points are paired, as for periodic sides; None for not at all.
    """

    slave: Sequence[str]
    master: Sequence[str]
    direction: str | Sequence[float] = "normal"
    within: float | None = None
    tied: bool = False
    distance: bool = True
    shift: Sequence[float] | None = None

    def __post_init__(self) -> None:
        """Make lists, as they are read from files; refuse what is no direction.

        Raises:
            InputError: If it is none, or a part is on both sides.
        """
        for key in ("slave", "master"):
            check_names(key, getattr(self, key))
            object.__setattr__(self, key, [str(part) for part in getattr(self, key)])
            if not getattr(self, key):
                raise InputError(f"pair: {key} must not be empty")
        if both := sorted({*self.slave} & {*self.master}):
            raise InputError(f"pair: part '{both[0]}' is slave and master")
        if not isinstance(self.direction, str) or self.direction != "normal":
            vector = np.asarray(self.direction)
            if vector.ndim != 1 or vector.dtype.kind not in "if" or not np.isfinite(vector).all() or not vector.any():
                raise InputError(f"pair: direction is {self.direction!r}; use normal or a vector such as [0, -1]")
            object.__setattr__(self, "direction", (vector / np.abs(vector).max()).tolist())
        if self.shift is not None:
            shift = np.asarray(self.shift)
            if shift.ndim != 1 or shift.dtype.kind not in "if" or not np.isfinite(shift).all() or not self.tied:
                raise InputError(
                    f"pair: shift is {self.shift!r}; it is a vector such as [1, 0], of a pair that is tied"
                )
            object.__setattr__(self, "shift", shift.tolist())
        if self.within is not None:
            if not (isinstance(self.within, int | float | np.number) and 0 < self.within < np.inf):
                raise InputError(f"pair: within is {self.within!r}; it must be a length above 0")
            object.__setattr__(self, "within", float(self.within))

    @property
    def words(self) -> str:
        """Both sides in words."""
        return f"{', '.join(self.slave)} on {', '.join(self.master)}"


def without_law(pairs: Sequence[PairedParts]) -> list[str]:
    """The parts of pairs with no law on them: masters, each once, and slaves that are tied."""
    return [*dict.fromkeys(part for pair in pairs for part in (*(pair.slave if pair.tied else ()), *pair.master))]


def named_laws(laws: Sequence[Any], pairs: Sequence[PairedParts], numbers: Sequence[int] = ()) -> list[tuple[str, Any]]:
    """Laws with their names in messages: "law.0" for the first one that is listed, "pair.0" for that of the first pair.

    Args:
        laws: All laws of a problem; that of a pair is on the slave.
        pairs: The pairs.
        numbers: For each law that of its condition, if not each has one.
    """
    of_slaves = {part: f"pair.{number}" for number, pair in enumerate(pairs) for part in pair.slave}
    counted = zip(numbers or range(len(laws)), laws, strict=True)
    return [(of_slaves.get(next(iter(law.parts), ""), f"law.{i}"), law) for i, law in counted]


def paired_parts(given: Sequence[PairedParts | Mapping[str, Any]], with_law: Sequence[str]) -> list[PairedParts]:
    """Pairs, some of which are as a file has them.

    Args:
        given: The pairs.
        with_law: The parts with laws; masters and tied slaves are not among them.

    Raises:
        InputError: If they are, or what is given is something else.
    """
    known, pairs = {each.name for each in fields(PairedParts)}, list[PairedParts]()
    for each in given if isinstance(given, list | tuple) else [given]:
        if isinstance(each, Mapping) and {"slave", "master"} <= {*each} <= known:
            pairs.append(PairedParts(**each))
        elif isinstance(each, PairedParts):
            pairs.append(each)
        else:
            raise InputError(f"pairs: {each!r} is no pair of surfaces")
        if both := [part for part in without_law(pairs[-1:]) if part in with_law]:
            raise InputError(f"pair {pairs[-1].words}: '{both[0]}' is in a law, too")
    return pairs
