"""`[problem]`, `[time]` and `[exact]`: the data of a scalar problem as text."""

from typing import Annotated, Any

from pydantic import BeforeValidator

from signorini_fenicsx.cases.data_section import DataSection, data_section
from signorini_fenicsx.cases.laws import LawTexts
from signorini_fenicsx.cases.values import (
    ExpressionByRegion,
    Positive,
    Whole,
    choice,
    text_by_region,
    within,
)
from signorini_fenicsx.contact.law import EVERYWHERE
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.solving.evolution import SCHEMES, Evolution

type CapacityText = str | dict[str, Any]


def _capacity(value: object) -> object:
    """A number or text, a table with one per region, or the graph of a storage."""
    if value is None or not isinstance(value, dict) or "corners" not in value:
        return value if value is None else text_by_region(value)
    graph = LawTexts.model_validate({"kind": "storage", "region": EVERYWHERE, **value})
    return dict(graph.model_extra or {})


class ProblemTexts(data_section(Problem, exact=None, laws=None)):  # type: ignore[misc]
    """`[problem]`: the data of a `Problem` as text in x, y, z.

    κ is a text, a matrix, or one of them per region; f and c are texts, or one per region.
    """

    def read(self, names: str) -> Problem:
        """The data as trees in these variables.

        Raises:
            InputError: If an expression cannot be read.
        """
        return Problem(**{key: parsed(value, names, f"[problem] {key}") for key, value in self})


class Times(DataSection):
    """`[time]`: the steps of an `Evolution`. With it t is known to all expressions but those of this section."""

    words = ("end", "steps", "scheme")
    end: Annotated[Positive, within(1e-90, 1e90)]
    steps: Annotated[Whole, within(1, 10**6)]

    def evolution(self) -> Evolution:
        """The times for `evolve`."""
        return Evolution(**dict(self))


class Time(Times):
    """`[time]` of diffusion."""

    initial: ExpressionByRegion = "0"
    capacity: Annotated[CapacityText | None, BeforeValidator(_capacity)] = None
    scheme: Annotated[str, choice("scheme", tuple(SCHEMES))] = "implicit-euler"

    @property
    def is_storage(self) -> bool:
        """Whether the capacity is the graph of a storage."""
        return isinstance(self.capacity, dict) and "corners" in self.capacity


class Exact(DataSection):
    """`[exact]`: the exact solution u, if it is known, as text in x, y, z, or one per region."""

    u: ExpressionByRegion | None = None
