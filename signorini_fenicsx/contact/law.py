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

*Laws with memory*: what has happened at a site, its state, changes its law from step to step of a problem in time.

A law of one's own with memory is a small class: it names its state, says its graph in a step from the state at the
beginning of the step, and the state at the end. Here a membrane is fouled by all that flows through it:

>>> from dataclasses import dataclass
>>> @dataclass(frozen=True)
... class Membrane(LawWithMemory):
...     conductance: Given
...     fouling: Given
...     deposit: Given = 0.0
...     segments, state = ("through",), ("deposit",)
...     def graph(self, values):
...         slope = values["conductance"] / (1 + values["fouling"] * values["deposit"])
...         return Graph((0.0, 0.0), [(0.0 * slope, 0.0 * slope)], slope, slope)
...     def after(self, values, u, flux):
...         return {"deposit": values["deposit"] + values["tau"] * abs(flux)}
>>> Membrane("top", conductance=2, fouling=5).data()
{'conductance': 2, 'fouling': 5, 'deposit': 0.0}
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError, names_of

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


@dataclass(frozen=True)
class LawWithMemory(Law):
    """A law on parts that depends on a state of each site, in a problem in time.

    `graph` is that of one step. It gets in `values`, besides the data, the state at the beginning of the step under the
    names that `state` lists, the length of the step as "tau", and "flux": κ∇u·n of the last solution. A law that is no
    chain of segments gives one that touches its curve at this flux. Then a step is solved again until its solution
    is on the curve, which is Newton's method.

    Attributes:
        state: The names of the data that are the state: what is given for them is the state at t = 0.
        titles: What pictures call the states, by their names.
        now: What a step knows besides the data, by the names in `values`; empty outside of steps.
    """

    now: Mapping[str, Any] = field(default_factory=dict, init=False, repr=False, compare=False)
    state: ClassVar[Sequence[str]] = ()
    titles: ClassVar[Mapping[str, str]] = {}
    places = ("parts",)

    def after(self, values: Values, u: Array, flux: Array) -> Mapping[str, Array]:
        """The state at the end of a step, from `values` as for `graph`, and from u and κ∇u·n then."""
        raise NotImplementedError

    def data(self) -> dict[str, Given]:
        """The data by their names, in a step with what the step knows."""
        return {**super().data(), **self.now}

    def in_step(self, now: Mapping[str, Any]) -> Self:
        """The law of a step that knows this."""
        law = replace(self)
        object.__setattr__(law, "now", now)
        return law


@dataclass(frozen=True)
class Film(LawWithMemory):
    """u = −r h κ∇u·n across a film whose thickness grows: ∂h/∂t = k (−κ∇u·n − j)₊; electropainting, or a deposit.

    n is the outer normal of the domain, so q = −κ∇u·n is the current that leaves it into the film, and u the potential
    on the film when the metal below is at 0. A step is one of implicit Euler, u = r q (h + τk (q − j)₊) with the h
    before: a line up to q = j, vertical on bare metal, then a parabola.

    Attributes:
        parts: Name of a part, or a list of names, as in `Film("body", r=1e6, k=1e-4, j=0.5)`.
        r: Resistance of the film per thickness, > 0.
        k: What the thickness grows by per charge, ≥ 0.
        j: The current below which nothing is deposited, ≥ 0.
        h: The thickness at t = 0, ≥ 0.
    """

    r: Given
    k: Given
    j: Given = 0.0
    h: Given = 0.0
    segments = ("resting", "growing")
    state = ("h",)
    titles: ClassVar[Mapping[str, str]] = {"h": "thickness $h$ of the film"}
    word = "film"

    def graph(self, values: Values) -> Graph:
        """The line, and the tangent of the parabola at the last current; they meet in the reference."""
        r, k, j, h, tau = (values[name] for name in ("r", "k", "j", "h", "tau"))
        q = np.maximum(-values["flux"], j)
        steep = 2 * q - j  # of q (q − j)
        meeting = np.divide(q**2, steep, out=np.zeros_like(q), where=steep > 0)
        corner = r * h * meeting, -meeting
        with np.errstate(divide="ignore"):
            return Graph(corner, [corner], before=1 / (r * h), beyond=1 / (r * (h + tau * k * steep)))

    def after(self, values: Values, u: Array, flux: Array) -> Mapping[str, Array]:
        """The thickness: it never falls."""
        return {"h": values["h"] + values["tau"] * values["k"] * np.maximum(-flux - values["j"], 0.0)}

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """An r that is not positive, negative k, j and h."""
        yield "r must be positive", np.where(values["r"] > 0, 0.0, 1.0)
        for name in ("k", "j", "h"):
            yield f"{name} must not be negative", -values[name]
