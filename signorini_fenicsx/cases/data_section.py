"""Sections of case files that follow the fields of a dataclass: a new datum of a problem needs no change here."""

from collections.abc import Mapping
from dataclasses import MISSING, Field, fields
from types import NoneType
from typing import Any, ClassVar, get_args, get_type_hints

from pydantic import create_model

from signorini_fenicsx.cases.parts import Section
from signorini_fenicsx.cases.values import Conductivity, Expression, ExpressionByRegion, texts_of
from signorini_fenicsx.expressions.given import Given, GivenByRegion, GivenMatrix

READERS: dict[object, Any] = {Given: Expression, GivenByRegion: ExpressionByRegion, GivenMatrix: Conductivity}
"""How a case file has data of these types."""


class DataSection(Section):
    """A section with data as text in x, y, z."""

    words: ClassVar[tuple[str, ...]] = ()
    """Keys whose values are no expressions."""

    def texts(self) -> list[tuple[str, str]]:
        """Each expression with the name of its key."""
        given = [(name, value) for name, value in self if value is not None and name not in self.words]
        return [entry for name, value in given for entry in texts_of(name, value)]


def data_section(kind: type, readers: Mapping[object, Any] = READERS, **own: Any) -> Any:
    """A `DataSection` with a key for each field of a dataclass, but for those that other sections have.

    Args:
        kind: The dataclass.
        readers: Pydantic's types by the types of fields; None as well is allowed where a field may be None.
        own: Pydantic's types of single keys, or None for those that other sections have.
    """
    hints = get_type_hints(kind)
    keys: dict[str, Any] = {}
    for field in fields(kind):
        if field.name not in own:
            hint = hints[field.name]
            one, *others = get_args(hint) if NoneType in get_args(hint) else (hint,)
            keys[field.name] = (readers[one] | None if others else readers[one]), _default(field)
        elif own[field.name] is not None:
            keys[field.name] = own[field.name], _default(field)
    return create_model(f"{kind.__name__}Section", __base__=DataSection, **keys)


def _default(field: Field[Any]) -> Any:
    """The default of a field as a case file would have it; pydantic's `...` where there is none."""
    if field.default_factory is not MISSING:
        return field.default_factory()
    default = ... if field.default is MISSING else field.default
    return f"{default:g}" if isinstance(default, float) else default
