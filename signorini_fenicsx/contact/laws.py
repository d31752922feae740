"""The laws that there are, on parts of the boundary and in regions of Ω; see `law` for what a law is.

They are those of Duvaut and Lions: Inequalities in Mechanics and Physics (1976), chapter I, and what hydrologists ask
for on Γ_S: seepage faces and rivers.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, Literal

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.law import VERTICAL, Film, Given, Graph, Law, Values


@dataclass(frozen=True)
class Dirichlet(Law):
    """u is given. Seen as a law, it has a vertical graph.

    Usage: `Dirichlet("left", "0.1*y")`, of a body `Dirichlet("left", 0, components="n")`.

    Attributes:
        parts: Name of a part, or a list of names.
        value: The trace u, continuous; a displacement has one for each component.
        components: Of a displacement only these are given: letters of "xyz", or "n" for the normal one; None for all.
    """

    value: Given = 0.0
    components: str | None = None
    segments = ("given",)
    levels = ("value",)
    places = ("parts",)

    def _data_names(self) -> list[str]:
        return ["value"]

    def graph(self, values: Values) -> Graph:
        """A vertical line."""
        point = values["value"], np.zeros_like(values["value"])
        return Graph(point, [point], np.inf, np.inf)


@dataclass(frozen=True)
class Neumann(Law):
    """The flux κ∇u·n, or the traction σn, is given. Seen as a law, it has a horizontal graph.

    Usage: `Neumann(["left", "right"], 1)`, of a body `Neumann("top", [0, -1])`.

    Attributes:
        parts: Name of a part, or a list of names.
        value: The flux; a traction has a value for each component.
    """

    value: Given = 0.0
    segments = ("given",)
    places = ("parts",)

    def graph(self, values: Values) -> Graph:
        """A horizontal line."""
        point = np.zeros_like(values["value"]), values["value"]
        return Graph(point, [point])


@dataclass(frozen=True)
class Signorini(Law):
    """u ≥ ψ and κ∇u·n ≥ q_S, one of them equal.

    Attributes:
        parts: Name of a part, or a list of names, as in `Signorini("bottom", psi="0.1*x")`.
        psi: ψ, continuous.
        q_S: q_S.
    """

    psi: Given = 0.0
    q_S: Given = 0.0
    segments = ("contact", "open")
    levels = ("psi", None)
    places = ("parts",)
    word = "signorini"

    def graph(self, values: Values) -> Graph:
        """The corner is the reference."""
        corner = values["psi"], values["q_S"]
        return Graph(corner, [corner], before=np.inf)


@dataclass(frozen=True)
class Friction(Law):
    """|κ∇u·n| ≤ g; u = 0 where it is less, κ∇u·n = −g where u > 0, g where u < 0 (Tresca).

    Attributes:
        parts: Name of a part, or a list of names, as in `Friction("right", g="0.2*y")`.
        g: g ≥ 0.
    """

    g: Given = 0.0
    segments = ("slip+", "stick", "slip-")
    places = ("parts",)
    word = "friction"

    def graph(self, values: Values) -> Graph:
        """The reference is in the middle of the vertical segment."""
        g = values["g"]
        return Graph((0.0, 0.0), [(0.0, g), (0.0, -g)])

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """Tell where g is negative."""
        yield "g must not be negative", -values["g"]


@dataclass(frozen=True)
class TwoSided(Law):
    """ψ ≤ u ≤ ψ_upper; κ∇u·n = q_S where u is in between, ≥ q_S where u = ψ, ≤ q_S where u = ψ_upper.

    Attributes:
        parts: Name of a part, or a list of names, as in `TwoSided("bottom", psi_upper=1, psi=-1)`.
        psi_upper: ψ_upper ≥ ψ, continuous.
        psi: ψ, continuous.
        q_S: q_S.
    """

    psi_upper: Given
    psi: Given = 0.0
    q_S: Given = 0.0
    segments = ("lower", "open", "upper")
    levels = ("psi", None, "psi_upper")
    places = ("parts",)
    word = "two-sided"

    def graph(self, values: Values) -> Graph:
        """The reference is the lower corner."""
        lower = values["psi"], values["q_S"]
        return Graph(lower, [lower, (values["psi_upper"], values["q_S"])], np.inf, np.inf)

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """Tell where the bounds are in the wrong order."""
        yield "psi must not be above psi_upper", values["psi"] - values["psi_upper"]


@dataclass(frozen=True)
class Wall(Law):
    """κ∇u·n = β [level − u]_+: a thick wall that lets through what flows inwards only.

    Attributes:
        parts: Name of a part, or a list of names, as in `Wall("left", beta=2, level="20 - y")`.
        beta: β ≥ 0.
        level: Level outside.
    """

    beta: Given
    level: Given = 0.0
    segments = ("inflow", "closed")
    levels = ("level", None)
    places = ("parts",)
    word = "wall"
    weights: ClassVar[Mapping[str, str]] = {"level": "beta"}

    def graph(self, values: Values) -> Graph:
        """The corner is the reference."""
        corner = values["level"], np.zeros_like(values["level"])
        return Graph(corner, [corner], before=values["beta"])

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """Tell where β is negative."""
        yield "beta must not be negative", -values["beta"]


@dataclass(frozen=True)
class Regulator(Law):
    """κ∇u·n = −k (u − a), cut off at g_low and g_high: a regulator of temperature.

    Attributes:
        parts: Name of a part, or a list of names, as in `Regulator("top", k=5, g_low=-1, g_high=1, a=20)`.
        k: k > 0.
        g_low: Least κ∇u·n.
        g_high: Largest κ∇u·n.
        a: The temperature that is wanted.
    """

    k: Given
    g_low: Given
    g_high: Given
    a: Given = 0.0
    segments = ("high", "regulated", "low")
    levels = (None, "a", None)
    places = ("parts",)
    word = "regulator"
    weights: ClassVar[Mapping[str, str]] = {"a": "k"}

    def graph(self, values: Values) -> Graph:
        """The reference is where nothing is left to do, or the corner nearest to it."""
        k, a, low, high = (values[name] for name in ("k", "a", "g_low", "g_high"))
        flux = np.clip(0.0, low, high)
        return Graph((a - flux / k, flux), [(a - high / k, high), (a - low / k, low)])

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """A k that is not positive, bounds in the wrong order."""
        yield "k must be positive", np.where(values["k"] > 0, 0.0, 1.0)
        yield "g_low must not be above g_high", values["g_low"] - values["g_high"]


@dataclass(frozen=True)
class Seepage(Law):
    """u ≤ level and κ∇u·n ≤ rain, one of them equal: the surface of a soil, with the pressure head or the head as u.

    κ∇u·n is what flows in. Below the level all rain flows in; at the level water may leave.

    Attributes:
        parts: Name of a part, or a list of names, as in `Seepage("slope", rain=1e-8, level="y")`.
        rain: What falls on the surface, per area and time; evaporation where it is negative.
        level: The largest u: 0 for a pressure head, the height of the surface for a head; continuous.
    """

    rain: Given = 0.0
    level: Given = 0.0
    segments = ("open", "seepage")
    levels = (None, "level")
    places = ("parts",)
    word = "seepage"

    def graph(self, values: Values) -> Graph:
        """The corner is the reference."""
        corner = values["level"], values["rain"]
        return Graph(corner, [corner], beyond=np.inf)


@dataclass(frozen=True)
class River(Law):
    """κ∇u·n = q + r (level − u) where u ≥ bed, q + r (level − bed) where u < bed, with the head as u.

    κ∇u·n is what flows in: out of a river through a bed that leaks, cut where the head falls below the bed.

    Attributes:
        parts: Name of a part, or a list of names, as in `River("bed", r=0.1, level=12, bed=10)`.
        r: Conductance of the bed per area, > 0.
        level: Level of the river.
        bed: Height of its bed, at most the level.
        q: What flows in besides.
    """

    r: Given
    level: Given
    bed: Given
    q: Given = 0.0
    segments = ("below", "leaking")
    levels = (None, "level")
    places = ("parts",)
    word = "river"

    def graph(self, values: Values) -> Graph:
        """The reference is where the river and the soil have one level: at the bed κ∇u·n may be huge."""
        r, level, bed, q = (values[name] for name in ("r", "level", "bed", "q"))
        return Graph((level, q), [(bed, q + r * (level - bed))], beyond=r)

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """An r that is not positive, a bed above the level."""
        yield "r must be positive", np.where(values["r"] > 0, 0.0, 1.0)
        yield "bed must not be above level", values["bed"] - values["level"]


@dataclass(frozen=True)
class Obstacle(Law):
    """ψ ≤ u ≤ ψ_upper in a region: s = 0 where u is in between, ≤ 0 where u = ψ, ≥ 0 where u = ψ_upper.

    Attributes:
        parts: Left out; `region` is in its place, as in `Obstacle(region="all", psi="0.1 - x^2")`.
        psi: ψ, continuous; None for no lower bound.
        psi_upper: ψ_upper, continuous; None for no upper bound. One of both is given.
    """

    psi: Given | None = None
    psi_upper: Given | None = None
    places = ("region",)
    word = "obstacle"

    def __post_init__(self) -> None:
        """Refuse an obstacle without a bound."""
        super().__post_init__()
        if self.psi is None and self.psi_upper is None:
            raise InputError("obstacle: needs psi, psi_upper or both")

    def data(self) -> dict[str, Given]:
        """The bounds that are given."""
        return {name: given for name, given in super().data().items() if given is not None}

    @property
    def segments(self) -> Sequence[str]:  # type: ignore[override]
        """Names of the segments: contact and open; with two bounds lower, open and upper."""
        if self.psi_upper is None:
            return "contact", "open"
        return ("open", "contact") if self.psi is None else ("lower", "open", "upper")

    def graph(self, values: Values) -> Graph:
        """The first corner is the reference."""
        corners = [(values[name], np.zeros_like(values[name])) for name in ("psi", "psi_upper") if name in values]
        ends = (np.inf if name in values else 0.0 for name in ("psi", "psi_upper"))
        return Graph(corners[0], corners, *ends)

    def level_of(self, segment: int) -> str | None:
        """The bound that holds u."""
        held = {"lower": "psi", "upper": "psi_upper", "contact": next(iter(self.data()))}
        return held.get(self.segments[segment])

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """Tell where the bounds are in the wrong order."""
        if self.psi is not None and self.psi_upper is not None:
            yield "psi must not be above psi_upper", values["psi"] - values["psi_upper"]


@dataclass(frozen=True)
class Reaction(Law):
    """s = cu in a region.

    Attributes:
        parts: Left out; `region` is in its place, as in `Reaction(region="core", c=2)`.
        c: c ≥ 0.
    """

    c: Given
    segments = ("reaction",)
    places = ("region",)
    word = "reaction"

    def graph(self, values: Values) -> Graph:
        """A line through 0."""
        c = values["c"]
        return Graph((0.0, 0.0), [(np.zeros_like(c), np.zeros_like(c))], c, c)


@dataclass(frozen=True)
class Corners(Law):
    """A graph by its corners.

    Attributes:
        parts: Name of a part, or a list of names, as in `Corners("left", [(0, 1), (1, 0)], before="vertical")`.
        corners: Pairs of u and κ∇u·n, u ascending and κ∇u·n descending; in regions pairs of u and s, both ascending.
        before: How steeply κ∇u·n falls, or s grows, before the first corner, a number ≥ 0; "vertical" if u cannot be
            less.
        beyond: How steeply it does beyond the last corner; "vertical" if u cannot be larger.
        names: What the segments are called, from the smallest u on, such as ["ice", "mush", "water"]; else they have
            numbers.
    """

    corners: Sequence[tuple[Given, Given]]
    before: Given | Literal["vertical"] = 0.0
    beyond: Given | Literal["vertical"] = 0.0
    names: Sequence[str] = ()
    word = "graph"

    def __post_init__(self) -> None:
        """Refuse what are no corners."""
        super().__post_init__()
        if not self.corners or any(not isinstance(pair, list | tuple) or len(pair) != 2 for pair in self.corners):
            raise InputError(
                "corners: must be pairs of u and κ∇u·n, or of u and s in regions, such as [[0, 1], [0.5, 0]]"
            )
        object.__setattr__(self, "corners", tuple(map(tuple, self.corners)))
        segments = len(self.corners) + 1
        if self.names and (isinstance(self.names, str) or len(set(self.names)) != segments):
            raise InputError(f"names: must be {segments} different names, one for each segment of the graph")
        object.__setattr__(self, "names", tuple(self.names))

    def data(self) -> dict[str, Given]:
        """The data by their names: those of the corners are corners.0.0 for u and corners.0.1 for κ∇u·n."""
        ends = {name: getattr(self, name) for name in ("before", "beyond") if getattr(self, name) != VERTICAL}
        return {f"corners.{i}.{j}": given for i, pair in enumerate(self.corners) for j, given in enumerate(pair)} | ends

    @property
    def segments(self) -> Sequence[str]:  # type: ignore[override]
        """The given names, or names with the numbers of the segments."""
        return list(self.names) or [f"segment {i}" for i in range(len(self.corners) + 1)]

    def graph(self, values: Values) -> Graph:
        """The reference is the point between the corners where least flows: far from it digits would be lost.

        It is the first corner, if κ∇u·n varies.
        """
        corners = [(values[f"corners.{i}.0"], values[f"corners.{i}.1"]) for i in range(len(self.corners))]
        before, beyond = (values.get(name, np.inf) for name in ("before", "beyond"))
        return Graph(self._reference(corners), corners, before, beyond)

    @property
    def has_numbers(self) -> bool:
        """Whether κ∇u·n, in regions s, of all corners are numbers: then they are the same everywhere."""
        return all(isinstance(flux, int | float) for _, flux in self.corners)

    def _reference(self, corners: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
        if len(corners) == 1 or not self.has_numbers:
            return corners[0]
        (u, first), last = corners[0], corners[-1][1]
        for (begin, flux), (end, following) in pairwise(corners):
            share = np.clip(np.divide(flux, flux - following, out=np.zeros_like(flux), where=flux != following), 0, 1)
            u = np.where(share == 1, end, u + share * (end - begin))
        return u, np.clip(0.0, np.minimum(first, last), np.maximum(first, last))

    def level_of(self, segment: int) -> str | None:
        """The name of u of a segment that is vertical everywhere."""
        beside = self.corners[max(segment - 1, 0) : segment + 1]
        end = self.before if segment == 0 else self.beyond if segment == len(self.corners) else None
        vertical = beside[0][0] == beside[-1][0] if end is None else end == VERTICAL
        return f"corners.{max(segment - 1, 0)}.0" if vertical else None

    def level(self, first: int, last: int, values: Values) -> Array:
        """The u at which κ∇u·n, in regions s, is nearest to 0 on some segments in a row, also of complex data."""
        corners = self.falling(values).corners[max(first - 1, 0) : last + 1]
        u, top = corners[0]
        if first == 0 and self.before != VERTICAL:
            u = u + np.minimum(top, 0.0) / values["before"]
        for (begin, flux), (end, below) in pairwise(corners):
            fall, passed = flux - below, flux - np.maximum(np.minimum(flux, 0.0), below)
            u = u + np.divide(passed, fall, out=np.zeros_like(fall), where=fall.real > 0) * (end - begin)
        if last == len(self.corners) and self.beyond != VERTICAL:
            u = u + np.maximum(corners[-1][1], 0.0) / values["beyond"]
        return np.asarray(u)


@dataclass(frozen=True)
class Storage(Corners):
    """What a volume holds in a problem in time, θ(u): ∂θ(u)/∂t − ∇·(κ∇u) + … = f in a region, by the corners of θ.

    Where the graph of θ is vertical, u stays while θ changes, as ice does that melts.

    Usage: `Storage(region="all", corners=[(0, 0), (0, 1)], before=1, beyond=2)`.

    Attributes:
        parts: Left out; `region` is in its place.
        corners: Pairs of u and θ, both ascending.
        before: How steeply θ grows before the first corner, a number ≥ 0.
        beyond: How steeply it grows beyond the last one.
    """

    word = "storage"
    places = ("region",)


LAWS: Mapping[str, type[Law]] = {
    law.word: law for law in (Signorini, Friction, TwoSided, Wall, Regulator, Seepage, River, Film, Corners)
}
"""The laws on parts of the boundary by the names that case files have for them."""
LAWS_INSIDE: Mapping[str, type[Law]] = {law.word: law for law in (Obstacle, Reaction, Corners, Storage)}
"""The laws in regions by the names that case files have for them."""
