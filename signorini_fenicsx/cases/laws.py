"""`[[law]]`: a law on some parts of the boundary, as text."""

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import did_you_mean
from signorini_fenicsx.cases.complaints import shown
from signorini_fenicsx.cases.values import choice, text_of
from signorini_fenicsx.contact.law import Law
from signorini_fenicsx.contact.laws import LAWS

OWN_KEYS = ("kind", "parts")


class LawTexts(BaseModel):
    """A `laws.Law`: its kind, its parts, and its data as text in x, y, z under the names that the law has for them."""

    model_config = ConfigDict(extra="allow", frozen=True)

    kind: Annotated[str, choice("law", tuple(LAWS))]
    parts: list[str] = Field(min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _as_texts(cls, value: Any) -> Any:
        if not isinstance(value, Mapping):
            return value
        return {key: given if key in OWN_KEYS else _texts(key, given) for key, given in value.items()}

    @model_validator(mode="after")
    def _suits_its_kind(self) -> Self:
        known = [field for field in fields(LAWS[self.kind]) if field.name != "parts"]
        names, given = [field.name for field in known], self.model_extra or {}
        for key in given:
            if key not in names:
                meant = did_you_mean(key, names)
                raise ValueError(f"unknown key '{key}' of the law '{self.kind}'; known are {', '.join(names)}{meant}")
        for field in known:
            if field.default is MISSING and field.name not in given:
                raise ValueError(f"missing key '{field.name}' of the law '{self.kind}'")
        try:
            self.law()
        except InputError as error:
            raise ValueError(str(error)) from None
        return self

    def law(self) -> Law:
        """The law."""
        return LAWS[self.kind](self.parts, **(self.model_extra or {}))

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
