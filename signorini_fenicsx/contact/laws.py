"""The laws on Γ_S as the user gives them: monotone, piecewise linear graphs between u and κ∇u·n.

They are those of Duvaut and Lions: Inequalities in Mechanics and Physics (1976), chapter I. What a law says at a point
is a `Graph` in the values of its data there. A law of one's own is a small class:

>>> from dataclasses import dataclass
>>> @dataclass(frozen=True)
... class Spring(Law):
...     stiffness: Given
...     level: Given = 0.0
...     segments = ("spring",)
...     def graph(self, values):
...         return Graph((values["level"], 0.0), [(values["level"], 0.0)], values["stiffness"], values["stiffness"])
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np

from signorini_fenicsx.base.arguments import names_of
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError

type Given = Any
"""A datum: a number, a text in x, y, z, UFL on the mesh, or a function of points, see `expressions.given`."""
type Values = Mapping[str, Array]
"""The data of a law, by their names, at some points or as means over some facets."""
VERTICAL = "vertical"


@dataclass(frozen=True)
class Graph:
    """A chain of segments in the plane of u and κ∇u·n, at some points.

    Where it ends in a vertical segment, u of that corner is a bound of u: a number, or one of the values that the law
    was given, and no new array, so that the datum is known by it.

    Attributes:
        reference: A point of it, from which u and κ∇u·n are measured, so that values there are exactly 0.
        corners: The corners, u ascending and κ∇u·n descending.
        before: How steeply κ∇u·n falls with u before the first corner: ∞ where u cannot be less.
        beyond: The same beyond the last corner: ∞ where u cannot be larger.
    """

    reference: tuple[Array | float, Array | float]
    corners: Sequence[tuple[Array | float, Array | float]]
    before: Array | float = 0.0
    beyond: Array | float = 0.0


@dataclass(frozen=True)
class OnParts:
    """What holds on some parts of the boundary.

    Attributes:
        parts: Name of a part, or a list of names.
    """

    parts: Sequence[str]

    def __post_init__(self) -> None:
        """Make a list of one name."""
        object.__setattr__(self, "parts", names_of("parts", self.parts))


@dataclass(frozen=True)
class Law(OnParts):
    """A law on some parts of the boundary. Its fields but `parts` are data.

    Attributes:
        parts: Name of a part, or a list of names.
        segments: Names of the segments of its graph, in the order of ascending u.
        weights: For data whose mean is weighted by others: their names, each with that of its weight.
    """

    segments: ClassVar[Sequence[str]] = ()
    weights: ClassVar[Mapping[str, str]] = {}

    def data(self) -> dict[str, Given]:
        """The data by their names."""
        return {name: getattr(self, name) for name in self._data_names()}

    def _data_names(self) -> list[str]:
        return [field.name for field in fields(self) if field.name != "parts"]

    def with_data(self, change: Callable[[str, Any], Any]) -> Self:
        """The law with each of its data changed by a function of its name, with the law's in front, and value."""
        given = {name: getattr(self, name) for name in self._data_names()}
        new = {
            name: value if value == VERTICAL else change(f"{self.name}.{name}", value) for name, value in given.items()
        }
        return replace(self, **new)

    def graph(self, values: Values) -> Graph:
        """The graph where the data have these values."""
        raise NotImplementedError

    def level_of(self, segment: int) -> str | None:
        """The name of the datum with which u varies on a vertical or steep segment; None if it is not one datum."""
        return None

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """What the data must not be, in words, and where they are: a number > 0 there.

        A graph that is not monotone is refused without it.
        """
        yield from ()

    @property
    def name(self) -> str:
        """What case files and messages call it."""
        return next((name for name, kind in LAWS.items() if type(self) is kind), type(self).__name__)


@dataclass(frozen=True)
class Dirichlet(Law):
    """u is given. Seen as a law, it has a vertical graph.

    Attributes:
        parts: Name of a part, or a list of names.
        value: The trace u, continuous; a displacement has one for each component.
        components: Of a displacement only these are given: letters of "xyz", or "n" for the normal one; None for all.
    """

    value: Given = 0.0
    components: str | None = None
    segments = ("given",)

    def _data_names(self) -> list[str]:
        return ["value"]

    def graph(self, values: Values) -> Graph:
        """A vertical line."""
        point = values["value"], np.zeros_like(values["value"])
        return Graph(point, [point], np.inf, np.inf)

    def level_of(self, segment: int) -> str | None:
        """The value."""
        return "value"


@dataclass(frozen=True)
class Neumann(Law):
    """The flux κ∇u·n, or the traction σn, is given. Seen as a law, it has a horizontal graph.

    Attributes:
        parts: Name of a part, or a list of names.
        value: The flux; a traction has a value for each component.
    """

    value: Given = 0.0
    segments = ("given",)

    def graph(self, values: Values) -> Graph:
        """A horizontal line."""
        point = np.zeros_like(values["value"]), values["value"]
        return Graph(point, [point])


@dataclass(frozen=True)
class Signorini(Law):
    """u ≥ ψ and κ∇u·n ≥ q_S, one of them equal.

    Attributes:
        parts: Name of a part, or a list of names.
        psi: ψ, continuous.
        q_S: q_S.
    """

    psi: Given = 0.0
    q_S: Given = 0.0
    segments = ("contact", "open")

    def graph(self, values: Values) -> Graph:
        """The corner is the reference."""
        corner = values["psi"], values["q_S"]
        return Graph(corner, [corner], before=np.inf)

    def level_of(self, segment: int) -> str | None:
        """ψ in contact."""
        return "psi" if segment == 0 else None


@dataclass(frozen=True)
class Friction(Law):
    """|κ∇u·n| ≤ g; u = 0 where it is less, κ∇u·n = −g where u > 0, g where u < 0 (Tresca).

    Attributes:
        parts: Name of a part, or a list of names.
        g: g ≥ 0.
    """

    g: Given = 0.0
    segments = ("slip+", "stick", "slip-")

    def graph(self, values: Values) -> Graph:
        """The reference is in the middle of the vertical segment."""
        g = values["g"]
        return Graph((0.0, 0.0), [(0.0, g), (0.0, -g)])

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """A negative g."""
        yield "g must not be negative", -values["g"]


@dataclass(frozen=True)
class TwoSided(Law):
    """ψ ≤ u ≤ ψ_upper; κ∇u·n = q_S where u is in between, ≥ q_S where u = ψ, ≤ q_S where u = ψ_upper.

    Attributes:
        parts: Name of a part, or a list of names.
        psi_upper: ψ_upper ≥ ψ, continuous.
        psi: ψ, continuous.
        q_S: q_S.
    """

    psi_upper: Given
    psi: Given = 0.0
    q_S: Given = 0.0
    segments = ("lower", "open", "upper")

    def graph(self, values: Values) -> Graph:
        """The reference is the lower corner."""
        lower = values["psi"], values["q_S"]
        return Graph(lower, [lower, (values["psi_upper"], values["q_S"])], np.inf, np.inf)

    def level_of(self, segment: int) -> str | None:
        """The bound that holds u."""
        return ("psi", None, "psi_upper")[segment]

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """Bounds in the wrong order."""
        yield "psi must not be above psi_upper", values["psi"] - values["psi_upper"]


@dataclass(frozen=True)
class Wall(Law):
    """κ∇u·n = β [level − u]_+: a thick wall that lets through what flows inwards only.

    Attributes:
        parts: Name of a part, or a list of names.
        beta: β ≥ 0.
        level: Level outside.
    """

    beta: Given
    level: Given = 0.0
    segments = ("inflow", "closed")
    weights: ClassVar[Mapping[str, str]] = {"level": "beta"}

    def graph(self, values: Values) -> Graph:
        """The corner is the reference."""
        corner = values["level"], np.zeros_like(values["level"])
        return Graph(corner, [corner], before=values["beta"])

    def level_of(self, segment: int) -> str | None:
        """The level outside, where water flows in."""
        return "level" if segment == 0 else None

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """A negative β."""
        yield "beta must not be negative", -values["beta"]


@dataclass(frozen=True)
class Regulator(Law):
    """κ∇u·n = −k (u − a), cut off at g_low and g_high: a regulator of temperature.

    Attributes:
        parts: Name of a part, or a list of names.
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
    weights: ClassVar[Mapping[str, str]] = {"a": "k"}

    def graph(self, values: Values) -> Graph:
        """The reference is where nothing is left to do, or the corner nearest to it."""
        k, a, low, high = (values[name] for name in ("k", "a", "g_low", "g_high"))
        flux = np.clip(0.0, low, high)
        return Graph((a - flux / k, flux), [(a - high / k, high), (a - low / k, low)])

    def level_of(self, segment: int) -> str | None:
        """The temperature that is wanted, where the regulator is not at a limit."""
        return "a" if segment == 1 else None

    def refused(self, values: Values) -> Iterator[tuple[str, Array]]:
        """A k that is not positive, bounds in the wrong order."""
        yield "k must be positive", np.where(values["k"] > 0, 0.0, 1.0)
        yield "g_low must not be above g_high", values["g_low"] - values["g_high"]


@dataclass(frozen=True)
class Corners(Law):
    """A graph by its corners.

    Attributes:
        parts: Name of a part, or a list of names.
        corners: Pairs of u and κ∇u·n, u ascending and κ∇u·n descending.
        before: How steeply κ∇u·n falls before the first corner, a number ≥ 0; "vertical" if u cannot be less.
        beyond: The same beyond the last corner.
    """

    corners: Sequence[tuple[Given, Given]]
    before: Given | Literal["vertical"] = 0.0
    beyond: Given | Literal["vertical"] = 0.0

    def __post_init__(self) -> None:
        """Refuse what are no corners."""
        super().__post_init__()
        if not self.corners or any(not isinstance(pair, list | tuple) or len(pair) != 2 for pair in self.corners):
            raise InputError("corners: must be pairs of u and κ∇u·n, such as [[0, 1], [0.5, 0]]")
        object.__setattr__(self, "corners", tuple(map(tuple, self.corners)))

    def data(self) -> dict[str, Given]:
        """The data by their names: those of the corners are corners.0.0 for u and corners.0.1 for κ∇u·n."""
        ends = {name: getattr(self, name) for name in ("before", "beyond") if getattr(self, name) != VERTICAL}
        return {f"corners.{i}.{j}": given for i, pair in enumerate(self.corners) for j, given in enumerate(pair)} | ends

    @property
    def segments(self) -> Sequence[str]:  # type: ignore[override]
        """Numbers."""
        return [f"segment {i}" for i in range(len(self.corners) + 1)]

    def graph(self, values: Values) -> Graph:
        """The first corner is the reference."""
        corners = [(values[f"corners.{i}.0"], values[f"corners.{i}.1"]) for i in range(len(self.corners))]
        before, beyond = (values.get(name, np.inf) for name in ("before", "beyond"))
        return Graph(corners[0], corners, before, beyond)

    def level_of(self, segment: int) -> str | None:
        """That of the corner before it, or of the first."""
        return f"corners.{max(segment - 1, 0)}.0"


LAWS: Mapping[str, type[Law]] = {
    "signorini": Signorini,
    "friction": Friction,
    "two-sided": TwoSided,
    "wall": Wall,
    "regulator": Regulator,
    "graph": Corners,
}
"""The laws by the names that case files have for them."""
