"""`[[law]]`: a law on some parts of the boundary, or in some regions, as text."""

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import did_you_mean
from signorini_fenicsx.cases.complaints import shown
from signorini_fenicsx.cases.values import choice, text_of
from signorini_fenicsx.contact.law import Law, names_of_data
from signorini_fenicsx.contact.laws import LAWS, LAWS_INSIDE

OWN_KEYS = ("kind", "parts", "region")


class LawTexts(BaseModel):
    """A `Law`: its kind, its parts or its regions, and its data as text in x, y, z under the law's names for them."""

    model_config = ConfigDict(extra="allow", frozen=True)

    kind: Annotated[str, choice("law", (*LAWS, *(name for name in LAWS_INSIDE if name not in LAWS)))]
    parts: Annotated[list[str], Field(default=[], exclude_if=lambda parts: not parts)]
    region: Annotated[str | list[str] | None, Field(default=None, exclude_if=lambda region: region is None)]

    @model_validator(mode="before")
    @classmethod
    def _as_texts(cls, value: Any) -> Any:
        if not isinstance(value, Mapping):
            return value
        return {key: given if key in OWN_KEYS else _texts(key, given) for key, given in value.items()}

    @model_validator(mode="after")
    def _suits_its_kind(self) -> Self:
        if bool(self.parts) == bool(self.region):
            raise ValueError(
                f"the law '{self.kind}' needs parts, a list of parts of the boundary, or region, \"all\" or names of "
                "regions; not both"
            )
        if self.kind not in self._kinds:
            place, key = ("regions", "parts") if self.region else ("parts", "region")
            raise ValueError(f"the law '{self.kind}' has {key}; the laws with {place} are {', '.join(self._kinds)}")
        kind, given = self._kinds[self.kind], self.model_extra or {}
        names = names_of_data(kind)
        for key in given:
            if key not in names:
                meant = did_you_mean(key, names)
                raise ValueError(f"unknown key '{key}' of the law '{self.kind}'; known are {', '.join(names)}{meant}")
        for datum in fields(kind):
            if datum.name in names and datum.default is MISSING and datum.name not in given:
                raise ValueError(f"missing key '{datum.name}' of the law '{self.kind}'")
        try:
            self.law()
        except InputError as error:
            raise ValueError(str(error)) from None
        return self

    @property
    def _kinds(self) -> Mapping[str, type[Law]]:
        return LAWS_INSIDE if self.region else LAWS

    def law(self) -> Law:
        """The law."""
        place: dict[str, Any] = {"region": self.region} if self.region else {"parts": self.parts}
        return self._kinds[self.kind](**place, **(self.model_extra or {}))

    def texts(self) -> list[tuple[str, str]]:
        """Each expression with the name of its key."""
        return [(name, given) for name, given in self.law().data().items() if isinstance(given, str)]


def _texts(key: str, value: object) -> object:
    """Numbers and texts as texts, in lists too."""
    if isinstance(value, list):
        return [_texts(key, entry) for entry in value]
    text = text_of(value)
    if not isinstance(text, str):
        raise ValueError(f"{key}: must be an expression, not {shown(value)}")
    return text
