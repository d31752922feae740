"""Arguments from Python that are of the wrong kind: they are refused in one sentence."""

from collections.abc import Iterable, Mapping
from numbers import Real
from types import NoneType

from signorini_fenicsx.base.errors import InputError

WORDS = {str: "string", Real: "number", int: "whole number", Mapping: "dict", NoneType: "None"}
"""What classes are called; others have their own name."""


def check_kind(name: str, value: object, *kinds: type, hint: str = "") -> None:
    """Refuse a value of another class.

    Args:
        name: Name of the argument.
        value: What was given.
        kinds: The classes that are right.
        hint: What the user may have meant.

    Raises:
        InputError: If the value is of none of them.
    """
    if not isinstance(value, kinds):
        right = " or ".join(_word(kind) for kind in kinds)
        article = "an" if right[0] in "AEIOUaeiou" else "a"
        raise InputError(f"{name}: must be {article} {right}, not {_word(type(value))}{hint}")


def check_names(name: str, value: object) -> None:
    """Refuse what is no list of names.

    Raises:
        InputError: If it is a string or no list.
    """
    if isinstance(value, str):
        raise InputError(f"{name}: must be a list of names, such as ['{value}']")
    if not isinstance(value, Iterable):
        raise InputError(f"{name}: must be a list of names, such as ['bottom'], not {_word(type(value))}")


def names_of(name: str, value: object) -> tuple[str, ...]:
    """Names that were given as one or as a list.

    Raises:
        InputError: If they are neither.
    """
    if isinstance(value, str):
        return (value,)
    check_names(name, value)
    assert isinstance(value, Iterable)
    return tuple(value)


def _word(kind: type) -> str:
    return WORDS.get(kind, kind.__name__)
