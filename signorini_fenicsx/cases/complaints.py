"""Errors that pydantic finds in a file, in one sentence with key and reason."""

import contextlib
from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import did_you_mean


def complaint(error: ValidationError, root: type[BaseModel], section: str = "", of: str = "") -> str:
    """The first error that pydantic finds in a file, as one sentence with the place in TOML's notation.

    Args:
        error: What pydantic found.
        root: The model of the file, or of a section of it.
        section: Name of this section.
        of: Of what the keys are, in words, in the place of the section.
    """
    errors = error.errors(include_url=False)
    first = next((each for each in errors if each["type"] == "extra_forbidden"), errors[0])  # a key that is misspelt
    above = [section] if section else []
    *sections, last = above + [str(step) for step in first["loc"]] or [""]
    place = "".join(f"[{section}] " for section in sections[:1]) + ".".join([*sections[1:], last])
    if any(isinstance(step, int) for step in first["loc"]):  # of a list of sections, such as [[law]]
        place = ".".join([*sections, last])
    owner = f" {of}" if of else f" in [{sections[0]}]" if sections else ""
    match first["type"]:
        case "extra_forbidden":
            keys = _known_keys(root, sections[len(above) :], last)
            others = [name for name in root.model_fields if not owner and last in _section(root, name).model_fields]
            hint = f"; '{last}' is a key of [{others[0]}]" if others else ""
            return f"unknown key '{last}'{owner}; known are {keys}{hint}"
        case "missing":
            return f"missing {'key' if owner else 'section or key'} '{last}'{owner}"
        case "model_type" | "model_attributes_type":
            name, header = (place, f"[[{sections[-1]}]]") if last.isdigit() else (f"'{last}'", f"[{last}]")
            return f"{name} must be a section, {header}, not {shown(first['input'])}"
        case "value_error":
            message = str(first["ctx"]["error"])
            where = f"{place}:" if owner else f"[{last}]"
            return f"{where} {message}" if last else message
        case "dict_type":
            return f"{place}: must be a table, {{name = value}}, not {shown(first['input'])}"
        case "string_type":
            return f"{place}: must be a text, not {shown(first['input'])}"
        case "too_short":
            return f"{place}: must not be empty"
    message = first["msg"][0].lower() + first["msg"][1:]
    return f"{place}: {message}, not {shown(first['input'])}"


def shown(value: object) -> str:
    """A value as Python writes it, in at most 60 characters."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # integers of many digits, deep lists
        text = f"this {type(value).__name__}"
    return text if len(text) <= 60 else text[:57] + "..."


@contextlib.contextmanager
def told(where: str = "") -> Iterator[None]:
    """Tell pydantic what is refused: for an InputError there is a ValueError with the same words behind this place."""
    try:
        yield
    except InputError as error:
        raise ValueError(f"{where}{error}") from None


@contextlib.contextmanager
def naming(case: str) -> Iterator[None]:
    """Name the case in messages about its keys that only what solves it can find."""
    try:
        yield
    except InputError as error:
        words = str(error)
        if words.startswith(("[", "h = ", "element: ")):
            error.args = (f"case {case}: {'' if words[0] == '[' else '[solve] '}{words}",)
        raise


def _known_keys(model: type[BaseModel], sections: list[str], wrong: str) -> str:
    for section in sections:
        if section in model.model_fields:  # else which one of a list or table of sections it is
            model = _section(model, section)
    keys = keys_of(model)
    return ", ".join(keys) + did_you_mean(wrong, keys)


def _section(model: type[BaseModel], name: str) -> type[BaseModel]:
    """The model of a section of a file; one without keys for what is none."""
    kinds: list[Any] = [model.model_fields[name].annotation]
    for kind in kinds:  # a union with None of a section that may be left out; a table with a section for each name
        kinds += get_args(kind)
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), BaseModel)


def keys_of(model: type[BaseModel]) -> list[str]:
    """The keys of a section that a file may contain."""
    return [key for key, field in model.model_fields.items() if not field.exclude]
