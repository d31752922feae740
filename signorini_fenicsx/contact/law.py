"""What a law is: a monotone, piecewise linear graph on parts of the boundary, or in regions of Ω.

On Γ_S it is a graph between u and κ∇u·n, which falls with u. In regions of Ω it is a graph between u and s, which grows
with u, and −∇·(κ∇u) + s = f holds; laws in the same region add up. What a law says at a point is a `Graph` in the
values of its data there. A law of one's own is a small class:

>>> from dataclasses import dataclass
>>> @dataclass(frozen=True)
... class Spring(Law):
...     stiffness: Given
...     level: Given = 0.0
...     segments = ("spring",)
...     def graph(self, values):
...         return Graph((values["level"], 0.0), [(values["level"], 0.0)], values["stiffness"], values["stiffness"])
>>> Spring("bottom", stiffness=2).parts, Spring(region="rock", stiffness=2).region
(('bottom',), ('rock',))
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from signorini_fenicsx.base.arguments import names_of
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError

type Given = Any
"""A datum: a number, a text in x, y, z, UFL on the mesh, or a function of points, see `expressions.given`."""
type Values = Mapping[str, Array]
"""The data of a law, by their names, at some points or as means over some facets."""
VERTICAL = "vertical"
EVERYWHERE = "all"
"""The name of all of Ω as a region."""
NO_DATA = "parts", "region", "side", "now"
"""The fields of laws that say where they hold and what a step knows."""


@dataclass(frozen=True)
class Graph:
    """A chain of segments in the plane of u and κ∇u·n, or in regions of u and s, at some points.

    Where it ends in a vertical segment, u of that corner is a bound of u: a number, or one of the values that the law
    was given, and no new array, so that the datum is known by it.

    Attributes:
        reference: A point of it, from which u and κ∇u·n are measured, so that values there are exactly 0.
        corners: The corners, u ascending, κ∇u·n descending and s ascending.
        before: How steeply κ∇u·n falls with u, or s grows, before the first corner: ∞ where u cannot be less.
        beyond: How steeply it does beyond the last corner: ∞ where u cannot be larger.
    """

    reference: tuple[Array | float, Array | float]
    corners: Sequence[tuple[Array | float, Array | float]]
    before: Array | float = 0.0
    beyond: Array | float = 0.0

    def mirrored(self) -> "Graph":
        """The graph of −s in the place of s."""
        points = [(u, np.negative(s)) for u, s in (self.reference, *self.corners)]
        corners = points[1:]
        for number, corner in enumerate(self.corners):
            if corner is self.reference:
                corners[number] = points[0]
        return replace(self, reference=points[0], corners=corners)


@dataclass(frozen=True)
class OnParts:
    """What holds on some parts of the boundary, or of those inside the domain.

    Attributes:
        parts: Name of a part, or a list of names.
        side: Of parts inside the domain the named side, out of which n points: a region, or a direction that points to
            it; None for that of the domain.
    """

    parts: Sequence[str]
    side: str | Sequence[float] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        """Make a list of one name."""
        object.__setattr__(self, "parts", names_of("parts", self.parts))


class Placed(type):
    """The class of laws: one is made with parts, or with `region=` in their place."""

    def __call__(cls, *given: Any, region: str | Sequence[str] | None = None, **data: Any) -> Any:
        """Make a law on parts of the boundary, or in regions.

        Raises:
            InputError: If there are parts and regions, or regions are no list of names.
        """
        if region is None:
            return super().__call__(*given, **data)
        if "parts" in data:
            raise InputError("region: is in the place of parts; leave out one of them")
        law = super().__call__((), *given, **data)
        object.__setattr__(law, "region", names_of("region", region))
        return law


@dataclass(frozen=True)
class Law(OnParts, metaclass=Placed):
    """A law on parts of the boundary, or in regions of Ω. Its fields but `parts`, `side` and `region` are data.

    Attributes:
        parts: Name of a part, or a list of names.
        region: Names of the regions where it holds, given by `region=` in the place of `parts`: a name or a list of
            names; "all" is all of Ω. Empty for a law on parts.
        segments: Names of the segments of its graph, in the order of ascending u.
        levels: For each of them the name of the datum with which u varies on it, if it is vertical or steep; None if it
            is not one datum. Empty if all are None.
        weights: For data whose mean is weighted by others: their names, each with that of its weight.
        places: Where it may hold: "parts", "region" or both.
        word: What case files call it; empty for laws of one's own.
    """

    region: tuple[str, ...] = field(default=(), init=False)
    segments: ClassVar[Sequence[str]] = ()
    levels: ClassVar[Sequence[str | None]] = ()
    weights: ClassVar[Mapping[str, str]] = {}
    places: ClassVar[Sequence[str]] = ("parts", "region")
    word: ClassVar[str] = ""

    def data(self) -> dict[str, Given]:
        """The data by their names."""
        return {name: getattr(self, name) for name in self._data_names()}

    def _data_names(self) -> list[str]:
        return names_of_data(type(self))

    def with_data(self, change: Callable[[str, Any], Any]) -> Self:
        """The law with each of its data changed by a function of its name, with the law's in front, and value."""
        data = {name: getattr(self, name) for name in self._data_names()}
        new = {
            name: value if value is None or value == VERTICAL else change(f"{self.name}.{name}", value)
            for name, value in data.items()
        }
        law = replace(self, **new)
        object.__setattr__(law, "region", self.region)
        return law

    def graph(self, values: Values) -> Graph:
        """The graph where the data have these values."""
        raise NotImplementedError

    def falling(self, values: Values) -> Graph:
        """The graph between u and what falls with u: κ∇u·n, or −s in regions."""
        graph = self.graph(values)
        return graph.mirrored() if self.region else graph

    def named(self, segment: Indices) -> Indices:
        """The number of the name of each segment; a line has a corner without a bend, and one name on both sides."""
        return np.minimum(segment, len(self.segments) - 1)

    def level_of(self, segment: int) -> str | None:
        """The name of the datum with which u varies on a vertical or steep segment, see `levels`."""
        return self.levels[segment] if self.levels else None

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """What the data must not be, in words, and where they are: a number > 0 there.

        A graph that is not monotone is refused without it.
        """
        yield from ()

    @property
    def name(self) -> str:
        """What case files and messages call it."""
        return str(vars(type(self)).get("word") or type(self).__name__)


def names_of_data(law: type[Law]) -> list[str]:
    """The names of the data of a kind of law."""
    return [datum.name for datum in fields(law) if datum.name not in (*NO_DATA, "names")]
