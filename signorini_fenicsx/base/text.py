"""Results as text: tables in CSV, summaries in JSON; and suggestions for misspelt names."""

import csv
import difflib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def write_table[Row: DataclassInstance](path: Path, kind: type[Row], rows: Iterable[Row]) -> None:
    """Write dataclasses as CSV, one row for each and one column for each field (rank 0).

    Args:
        path: The file.
        kind: Their type; its fields are the header, also if there are no rows.
        rows: The dataclasses.
    """
    write_rows(path, [field.name for field in fields(kind)], map(asdict, rows))


def write_rows(path: Path, header: Iterable[str], rows: Iterable[Mapping[str, Any]]) -> None:
    """Write mappings from the names of the header as CSV, one row for each (rank 0)."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(header))
        writer.writeheader()
        writer.writerows(rows)


def place_in_words(x: Iterable[float], digits: int = 4) -> str:
    """The coordinates of a point in words."""
    return "(" + ", ".join(f"{entry:.{digits}g}" for entry in x) + ")"


def did_you_mean(wrong: str, names: Iterable[str]) -> str:
    """A question in brackets with the closest of the known names, after a space; empty if none is close."""
    close = difflib.get_close_matches(wrong, list(names), 1)
    return f" (did you mean '{close[0]}'?)" if close else ""


def printable(text: str) -> str:
    """A text from outside, safe to print on a terminal: what is not printable is shown as Python writes it."""
    return "".join(character if character.isprintable() else repr(character)[1:-1] for character in text)


def printable_lines(text: str) -> str:
    """A text of several lines, each of them printable."""
    return "\n".join(map(printable, text.split("\n")))


def counted(number: int, noun: str) -> str:
    """A number with its noun, in the plural but for one."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def named(values: Mapping[str, float | None], form: str, units: Mapping[str, str] | None = None) -> str:
    """Names and numbers in this form, in one line; "none" for the null of JSON.

    A unit is that of the names that begin with its own, up to a `_`.
    """
    known = units or {}
    return "  ".join(
        f"{name} {'none' if value is None else format(value, form)} {known.get(name.partition('_')[0], '')}".rstrip()
        for name, value in values.items()
    )


def json_text(values: Mapping[str, Any]) -> str:
    """Values as JSON, with null for numbers that are not finite."""
    return json.dumps(_without_nan(values), indent=2, allow_nan=False)


def _without_nan(value: Any) -> Any:
    """Replace numbers that are not finite by None, at any depth; a failed state may contain them."""
    if isinstance(value, Mapping):
        return {key: _without_nan(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_without_nan(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
