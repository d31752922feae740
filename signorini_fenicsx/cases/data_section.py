"""Sections of case files that follow the fields of a dataclass: a new datum of a problem needs no change here."""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, fields
from types import NoneType
from typing import Any, ClassVar, get_args, get_type_hints

from pydantic import ConfigDict, ValidationError, create_model, model_validator

from signorini_fenicsx.base.text import did_you_mean
from signorini_fenicsx.cases.complaints import complaint, keys_of
from signorini_fenicsx.cases.parts import Description, Section
from signorini_fenicsx.cases.values import Conductivity, Expression, ExpressionByRegion, VectorByPart, texts_of
from signorini_fenicsx.contact.law import VERTICAL
from signorini_fenicsx.expressions.given import Given, GivenByRegion, GivenMatrix, GivenVectorByRegion

PLAIN: dict[object, Any] = {
    str: str,
    Sequence[str]: list[str],
    Sequence[float]: list[float],
    str | Sequence[str]: str | list[str],
}
"""How a case file has data of these types, which are no expressions."""
READERS: dict[object, Any] = PLAIN | {
    Given: Expression,
    GivenByRegion: ExpressionByRegion,
    GivenMatrix: Conductivity,
    GivenVectorByRegion: VectorByPart,
}
"""The same of all types."""


class DataSection(Section):
    """A section with data as text in x, y, z."""

    words: ClassVar[tuple[str, ...]] = ()
    """Keys whose values are no expressions."""

    def texts(self) -> list[tuple[str, str]]:
        """Each expression with the name of its key."""
        data = [(name, value) for name, value in self if value is not None and name not in self.words]
        return [entry for name, value in data for entry in texts_of(name, value)]


class KindSection(Description):
    """A section with the data of the dataclass that its `kind` names, under the names of the fields.

    A subclass has `kind`, and keys that there are for all kinds.
    """

    model_config = ConfigDict(extra="allow", frozen=True)
    word: ClassVar[str]
    """What such a section is, such as a law."""
    of_kind: ClassVar[Mapping[str, type[DataSection]]]
    """The keys of each kind."""
    kind: str

    @model_validator(mode="before")
    @classmethod
    def _with_data(cls, value: Any) -> Any:
        kind = value.get("kind") if isinstance(value, Mapping) else None
        if not isinstance(kind, str) or kind not in cls.of_kind:
            return value  # which the check of `kind` refuses
        section, of = cls.of_kind[kind], f"of the {cls.word} '{kind}'"
        of_all = {key: entry for key, entry in value.items() if key in cls.model_fields}
        keys = [*keys_of(cls), *keys_of(section)]
        for key in [key for key in value if key not in keys]:
            others = [name for name, other in cls.of_kind.items() if key in other.model_fields]
            hint = f"; a {cls.word} with it is {' or '.join(others)}" if others else did_you_mean(key, keys)
            raise ValueError(f"unknown key '{key}' {of}; known are {', '.join(keys)}{hint}")
        try:
            own = section.model_validate({key: entry for key, entry in value.items() if key not in of_all})
        except ValidationError as error:
            raise ValueError(complaint(error, section, of=of)) from None
        return of_all | own.model_dump(exclude_unset=True)

    @property
    def data(self) -> DataSection:
        """The data of the kind."""
        return self.of_kind[self.kind].model_validate(self.model_extra or {})

    def texts(self) -> list[tuple[str, str]]:
        """Each expression with the name of its key."""
        return [(key, text) for key, text in self.data.texts() if text != VERTICAL]  # as ends of graphs may be


def data_section(
    kind: type, readers: Mapping[object, Any] = READERS, words: tuple[str, ...] = (), **own: Any
) -> type[DataSection]:
    """A `DataSection` with a key for each field of a dataclass, but for those that other sections have.

    Args:
        kind: The dataclass.
        readers: Pydantic's types by the types of fields; None as well is allowed where a field may be None.
        words: Keys whose values are no expressions, besides those of types in `PLAIN`.
        own: Pydantic's types of single keys, or None for those that other sections have.
    """
    hints = get_type_hints(kind)
    keys: dict[str, Any] = {}
    for field in fields(kind):
        if field.name not in own:
            hint = hints[field.name]
            one, *others = get_args(hint) if NoneType in get_args(hint) else (hint,)
            keys[field.name] = (readers[one] | None if others else readers[one]), _default(field)
            words = (*words, field.name) if one in PLAIN else words
        elif own[field.name] is not None:
            keys[field.name] = own[field.name], _default(field)
    section = create_model(f"{kind.__name__}Section", __base__=DataSection, **keys)
    section.words = words
    return section


def _default(field: Field[Any]) -> Any:
    """The default of a field as a case file would have it; pydantic's `...` where there is none."""
    if field.default_factory is not MISSING:
        return field.default_factory()
    default = ... if field.default is MISSING else field.default
    return f"{default:g}" if isinstance(default, float) else default
