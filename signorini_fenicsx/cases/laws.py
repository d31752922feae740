"""`[[law]]`: a law on some parts of the boundary, or in some regions, as text."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from signorini_fenicsx.cases.data_section import READERS, KindSection, data_section
from signorini_fenicsx.cases.values import Entries, Expression, choice
from signorini_fenicsx.contact.law import NO_DATA, Given, Law
from signorini_fenicsx.contact.laws import LAWS, LAWS_INSIDE

KINDS = {**LAWS, **LAWS_INSIDE}
OF_LAWS = READERS | {
    Given: Expression,
    Given | Literal["vertical"]: Expression,
    Sequence[tuple[Given, Given]]: Entries,
    Sequence[str]: list[str],
}
OF_KIND = {
    name: data_section(kind, OF_LAWS, words=("names",), **dict.fromkeys(NO_DATA)) for name, kind in KINDS.items()
}
"""The data of each kind of law as text in x, y, z."""


class LawTexts(KindSection):
    """A `Law`: its kind, its parts or its regions, and its data as text in x, y, z under the law's names for them."""

    word = "law"
    of_kind = OF_KIND
    kind: Annotated[str, choice("law", tuple(KINDS))]
    parts: Annotated[list[str], Field(default=[], exclude_if=lambda parts: not parts)]
    region: Annotated[str | list[str] | None, Field(default=None, exclude_if=lambda region: region is None)]

    @model_validator(mode="after")
    def _has_its_place(self) -> Self:
        if bool(self.parts) == bool(self.region):
            raise ValueError(
                f"the law '{self.kind}' needs parts, a list of parts of the boundary, or region, \"all\" or names of "
                "regions; not both"
            )
        kinds, place, key = (LAWS_INSIDE, "regions", "parts") if self.region else (LAWS, "parts", "region")
        if self.kind not in kinds:
            raise ValueError(f"the law '{self.kind}' has {key}; the laws with {place} are {', '.join(kinds)}")
        return self

    def made(self) -> Law:
        """The law that the section describes."""
        place: dict[str, Any] = {"region": self.region} if self.region else {"parts": self.parts}
        return KINDS[self.kind](**place, **(self.model_extra or {}))
