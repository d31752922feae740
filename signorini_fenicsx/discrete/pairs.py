"""Pairs of surfaces that share no nodes as conditions of a problem of any physics."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from signorini_fenicsx.base.errors import InputError, names_of
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.expressions.given import Given
from signorini_fenicsx.meshes.paired_parts import PairedParts


@dataclass(frozen=True)
class Tied:
    """Two surfaces that stay as they are to each other, [u] = 0: perfect contact."""


@dataclass(frozen=True)
class Pair:
    """Two surfaces that need not share nodes, and may be apart, with a law for the jump of u between them.

    A point of a slave facet is opposite to the nearest point of a master facet along the direction. Slave facets that
    are not covered by the master are free. The coarser surface should be the slave.

    Usage: `Pair("block.bottom", "plate.top", Tied())`.

    Attributes:
        slave: Name of a part, or a list of names; it has the law, and its normals are those of the law.
        master: Likewise, the other side.
        law: `Tied`, or a law that was made without parts, such as `Wall((), beta=5)`: in diffusion between the jump of
            u, that of the slave less that of the master, and κ∇u·n of the slave; of bodies between opening and
            pressure. Of bodies also `Tresca` or `Coulomb`, or None for contact without friction.
        direction: "normal" for the normals of the slave facets, or a vector.
        within: The largest distance of points that belong to each other; None for half the diameter of the smaller
            body.
        gap: Of bodies: "distance", which is negative where the surfaces overlap; "distance" with something added, as
            "distance - 1e-3"; or what is in its place, a number or a text.
        shift: By how much the master is moved before points are paired: with `Tied` periodic sides; None for none.

    Raises:
        InputError: If the law has parts, or a part is on both sides.
    """

    slave: str | Sequence[str]
    master: str | Sequence[str]
    law: Any = None
    direction: str | Sequence[float] = "normal"
    within: float | None = None
    gap: Given = "distance"
    shift: Sequence[float] | None = None
    side: ClassVar[None] = None

    def __post_init__(self) -> None:
        """Make lists of names, refuse other laws."""
        for key in ("slave", "master"):
            object.__setattr__(self, key, names_of(key, getattr(self, key)))
        if isinstance(self.law, Law) and (self.law.parts or self.law.region):
            raise InputError("pair: law must be one without parts, as Wall((), beta=5); it holds on the slave")
        _ = self.added, self.on_boundary

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts of both sides."""
        return (*self.slave, *self.master)

    @property
    def added(self) -> tuple[bool, Given]:
        """Whether the gap is the distance, and what is given more, or in its place.

        Raises:
            InputError: If the distance is not alone or the first term.
        """
        if not isinstance(self.gap, str) or "distance" not in self.gap:
            return False, self.gap
        begin, rest = self.gap.split("distance", 1)
        rest = rest.strip()
        if begin.strip() or "distance" in rest or rest[:1] not in ("", "+", "-"):
            raise InputError(f'pair: gap is "{self.gap}"; use "distance", or "distance + ..." with what is more')
        return True, 0.0 if rest == "" else f"0 {rest}"

    @property
    def on_boundary(self) -> PairedParts:
        """What the boundary has of it."""
        tied = isinstance(self.law, Tied)
        return PairedParts(self.slave, self.master, self.direction, self.within, tied, self.added[0], self.shift)
