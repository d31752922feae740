"""`[[quantity]]`: a number that `solve` proves from both sides."""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from signorini_fenicsx.cases.parts import Section
from signorini_fenicsx.cases.values import Expression, choice
from signorini_fenicsx.quantities import Energy, Flux, Force, Integral, Kind, Mean, Moment

KINDS: Mapping[str, tuple[Callable[..., Kind], tuple[str, ...]]] = {
    "integral": (Integral, ("weight", "region", "parts", "direction")),
    "mean": (Mean, ("weight", "region", "parts", "direction")),
    "flux": (Flux, ("parts", "weight")),
    "energy": (Energy, ()),
    "force": (Force, ("parts", "direction")),
    "moment": (Moment, ("parts", "direction")),
}
"""The quantities by the names that case files have for them, with the keys of each."""


class QuantityTexts(Section):
    """A quantity: its name in results, its kind, and where and with which weight it is measured."""

    name: Annotated[str, Field(pattern=r"^\w[\w -]*$", max_length=60)]
    kind: Annotated[str, choice("quantity", tuple(KINDS))]
    region: Annotated[str | list[str] | None, Field(default=None, exclude_if=lambda given: given is None)]
    parts: Annotated[str | list[str] | None, Field(default=None, exclude_if=lambda given: given is None)]
    weight: Annotated[Expression | None, Field(default=None, exclude_if=lambda given: given is None)]
    direction: Annotated[list[float] | None, Field(default=None, exclude_if=lambda given: given is None)]

    @property
    def given(self) -> dict[str, Any]:
        """The keys that are given, but for name and kind."""
        return {key: value for key, value in self if key not in ("name", "kind") and value is not None}

    @model_validator(mode="after")
    def _suits_its_kind(self) -> Self:
        keys = KINDS[self.kind][1]
        for key in self.given:
            if key not in keys:
                raise ValueError(f"a quantity '{self.kind}' has no {key}; it has {', '.join(keys) or 'none'}")
        if self.region and self.parts:
            raise ValueError("region is in the place of parts; leave out one of them")
        if "parts" in keys and "region" not in keys and not self.parts:
            raise ValueError(f"a quantity '{self.kind}' needs parts, those where it is measured")
        return self

    @property
    def measured(self) -> Kind:
        """The quantity."""
        return KINDS[self.kind][0](**self.given)
