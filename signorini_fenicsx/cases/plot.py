"""`[plot]`: names and units in pictures, what u is of water, and the level lines that they draw."""

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from signorini_fenicsx.cases.complaints import shown
from signorini_fenicsx.cases.parts import Section

MOST_LEVELS = 100

WATER = ("head", "minus head", "pressure head")
"""What u may be of water."""


def _water(value: object) -> object:
    if value is not None and not isinstance(value, bool) and value not in WATER:
        raise ValueError(f"must be true, false, or one of {', '.join(WATER)}, not {shown(value)}")
    return value


OF_BODIES = ("length_unit", "stress_unit", "time_unit")
OF_FLOWS = ("unit", *OF_BODIES)
"""The keys of bodies and of flows."""

type Word = Annotated[str, Field(max_length=30)]


class Plot(Section):
    """`[plot]`: names and units of u and of the flux; the sign of the physical flux, −1 where it is −σ; levels of u.

    Of bodies and flows it has units alone. `water` says what u is of water, true that it is a head if laws do not tell,
    false that it is none.
    """

    u: Word = ""
    unit: Word = ""
    flux: Word = ""
    flux_unit: Word = ""
    stress_unit: Word = ""
    length_unit: Word = ""
    time_unit: Word = ""
    sign: Literal[1, -1] = 1
    water: Annotated[bool | str | None, BeforeValidator(_water)] = None
    levels: list[Annotated[float, Field(allow_inf_nan=False)]] = Field(default=[], max_length=MOST_LEVELS)

    @model_validator(mode="after")
    def _can_be_drawn(self) -> Self:
        for key in ("u", "flux", "flux_unit", *OF_FLOWS):
            if not getattr(self, key).isprintable():
                raise ValueError(f"{key}: must be one line of text")
        if any(one >= other for one, other in zip(self.levels, self.levels[1:], strict=False)):
            raise ValueError("levels: must ascend")
        return self

    @property
    def u_label(self) -> str:
        """The name of u with its unit, in Matplotlib's mathematical type."""
        return with_unit(_plain(self.u) or "$u_h$", self.unit)

    @property
    def flux_name(self) -> str:
        """The physical flux."""
        return _plain(self.flux) or (r"$\sigma_h$" if self.sign > 0 else r"$-\sigma_h$")

    @property
    def flux_label(self) -> str:
        """The length of the flux, with its unit."""
        return with_unit(_plain(self.flux) or r"$|\sigma_h|$", self.flux_unit)

    def along(self, axis: str) -> str:
        """What is written beside the axis of a coordinate, of another length, or of time."""
        name = f"${axis}$" if len(axis) == 1 else axis
        return with_unit(name, "" if axis == "angle" else self.time_unit if axis == "t" else self.length_unit)

    def over_facets(self, unit: str, dim: int) -> str:
        """The unit of what is summed up over facets, such as a force; empty where one of both has none.

        Of m/s it is m²/s, in space m³/s, and of W/m² it is W/m, in space W.
        """
        length, power = self.length_unit, dim - 1
        if not unit or not length:
            return ""
        if unit.startswith(f"{length}/"):
            return f"{length}{'²³'[power - 1]}/{unit.removeprefix(f'{length}/')}"
        if unit.endswith(f"/{length}²"):
            return unit.removesuffix(f"/{length}²") + f"/{length}" * (power == 1)
        return f"{unit} {length}{'²' * (power == 2)}"


UNNAMED = Plot()
"""Of problems that name nothing."""


def plot_of(source: object) -> Plot:
    """The names and units of what a problem was read from."""
    return getattr(source, "plot", None) or UNNAMED


def in_unit(value: str, unit: str, power: int = 1) -> str:
    """A number with a unit, perhaps squared, if there is one."""
    return f"{value} {unit}{'²' * (power == 2)}" if unit else value


def with_unit(name: str, unit: str) -> str:
    """A name in Matplotlib's mathematical type with a unit, if there is one."""
    return f"{name} ({_plain(unit)})" if unit else name


def _plain(text: str) -> str:
    """A text in which Matplotlib sees no mathematics."""
    return text.replace("$", r"\$")
