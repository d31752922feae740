"""Types of the values in a case file: numbers, names, expressions, matrices of these."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.text import did_you_mean
from signorini_fenicsx.cases.complaints import shown
from signorini_fenicsx.expressions import parse_number
from signorini_fenicsx.meshes.shapes import full_name

MAX_BITS = 1000
"""Largest size of an integer."""


def number(value: object) -> object:
    """A number, also one written as `1/16` or `2^-4`."""
    if isinstance(value, bool):
        raise ValueError("must be a number, not true or false")
    if isinstance(value, str):
        try:
            value = parse_number(value)
        except InputError as error:
            raise ValueError(str(error)) from None
    return _not_huge(value)


def text_of(value: object) -> object:
    """A number as text; all else as it is."""
    return str(_not_huge(value)) if isinstance(value, int | float) and not isinstance(value, bool) else value


def _expression(value: object) -> object:
    text = text_of(value)
    if not isinstance(text, str):
        raise ValueError(f"must be an expression, not {shown(value)}")
    return text


def _vector(value: object) -> object:
    """A list of numbers or texts."""
    if not isinstance(value, list):
        raise ValueError(
            f'must be a list with an expression for each component, such as ["0", "-1"], not {shown(value)}'
        )
    return [_expression(entry) for entry in value]


def _entries(value: object) -> object:
    """Numbers and texts as texts, in lists too."""
    return [_entries(entry) for entry in value] if isinstance(value, list) else _expression(value)


def _vector_by_part(value: object) -> object:
    """A list of numbers or texts, or a table with one per part."""
    return {part: _vector(entry) for part, entry in value.items()} if isinstance(value, dict) else _vector(value)


def _not_huge(value: object) -> object:
    """Refuse integers of TOML that are too large for a float; some are even too large for Python to print."""
    if isinstance(value, int) and value.bit_length() > MAX_BITS:
        raise ValueError(f"must be a number of at most {MAX_BITS} bits")
    return value


def choice(kind: str, names: tuple[str, ...]) -> BeforeValidator:
    """Accept one of the known names; for other values the error lists them."""

    def check(value: object) -> object:
        if value not in names:
            meant = did_you_mean(value, names) if isinstance(value, str) else ""
            raise ValueError(f"unknown {kind} {shown(value)}; use one of {', '.join(names)}{meant}")
        return value

    return BeforeValidator(check)


def _shape(value: object) -> str:
    try:
        return full_name(value if isinstance(value, str) and len(value) < 100 and value.isprintable() else shown(value))
    except InputError as error:
        raise ValueError(str(error)) from None


def within(low: float, high: float) -> AfterValidator:
    """Accept numbers in this closed interval."""

    def check(value: float) -> float:
        if not low <= value <= high:
            raise ValueError(f"must be between {low:g} and {high:g}, not {value:g}")
        return value

    return AfterValidator(check)


def _in_regions(read: Callable[[object], object]) -> BeforeValidator:
    """Accept what this reads, or a table with one per region."""

    def check(value: object) -> object:
        if not isinstance(value, dict):
            return read(value)
        if not value:
            raise ValueError("the table of regions is empty")
        return {region: read(entry) for region, entry in value.items()}

    return BeforeValidator(check)


def _modulus(value: object) -> object:
    """A number or text, or three along the axes of a material."""
    if isinstance(text := text_of(value), str):
        return text
    if not isinstance(value, list):
        raise ValueError("must be an expression, a list of three, or a table with one per region")
    if len(value) != 3:
        raise ValueError(f"must be an expression, or a list of three along axes of the material, not of {len(value)}")
    return _vector(value)


def _directions(value: object) -> object:
    """A list with one direction in the plane, or two in space."""
    directions = value if isinstance(value, list) else []
    if [len(entry) if isinstance(entry, list) else 0 for entry in directions] not in ([2], [3, 3]):
        raise ValueError(f"must list one direction in the plane, as [[1, 1]], or two in space, not {shown(value)}")
    return [_vector(entry) for entry in directions]


def _matrix_or_text(value: object) -> object:
    value = text_of(value)
    if isinstance(value, list):
        rows = [[text_of(entry) for entry in row] if isinstance(row, list) else [] for row in value]
        if len(rows) not in (2, 3) or any(len(row) != len(rows) for row in rows):
            raise ValueError("a matrix must have 2 rows of 2 expressions, in 3D 3 of 3")
        if all(isinstance(entry, str) for row in rows for entry in row):
            return rows
    elif isinstance(value, str):
        return value
    raise ValueError("must be an expression, a matrix such as [[2, 0], [0, 1]], or a table with one per region")


def text_by_region(value: object, place: str = "region") -> object:
    """A number or text, or a table with one per region, or another place."""
    by_place = value if isinstance(value, dict) else {"": value}
    texts = {name: text_of(entry) for name, entry in by_place.items()}
    if not texts or not all(isinstance(text, str) for text in texts.values()):
        raise ValueError(f"must be an expression, or a table with one per {place}")
    return texts if isinstance(value, dict) else texts[""]


def _by_part(read: Callable[[object], object], what: str) -> BeforeValidator:
    """A table whose value for each part is read by a function."""

    def check(value: object) -> object:
        if not isinstance(value, dict):
            raise ValueError(f"must be a table with {what}")
        return {part: read(entry) for part, entry in value.items()}

    return BeforeValidator(check)


def _stiffness(value: object) -> object:
    flat = isinstance(value, list) and len(value) == 2 and not any(isinstance(entry, list) for entry in value)
    return _vector(value) if flat else _matrix_or_text(value)


type Text = str | list[str] | list[list[str]]
type ConductivityText = Text | dict[str, Text]


def texts_of(name: str, given: Text | Mapping[str, Text]) -> list[tuple[str, str]]:
    """Each expression with its name, to which that of its region or part is added; entries of a list share a name."""
    values = {f"{name}.{key}": text for key, text in given.items()} if isinstance(given, Mapping) else {name: given}
    return [(key, text) for key, value in values.items() for text in _leaves(value)]


def _leaves(value: Text | str) -> list[str]:
    return [value] if isinstance(value, str) else [text for entry in value for text in _leaves(entry)]


Positive = Annotated[float, BeforeValidator(number), Field(gt=0, allow_inf_nan=False)]
Whole = Annotated[int, BeforeValidator(number)]
Expression = Annotated[str, BeforeValidator(_expression)]
Vector = Annotated[list[str], BeforeValidator(_vector)]
VectorByPart = Annotated[list[str] | dict[str, list[str]], BeforeValidator(_vector_by_part)]
Entries = Annotated[list[Any], BeforeValidator(_entries)]
ShapeName = Annotated[str, BeforeValidator(_shape)]
ExpressionByPart = Annotated[dict[str, str], _by_part(_expression, 'one expression per part, such as {top = "0.1"}')]
ExpressionByRegion = Annotated[str | dict[str, str], BeforeValidator(text_by_region)]
ExpressionOrByPart = Annotated[str | dict[str, str], BeforeValidator(partial(text_by_region, place="part"))]
Conductivity = Annotated[ConductivityText, _in_regions(_matrix_or_text)]
Moduli = Annotated[str | list[str] | dict[str, str | list[str]], _in_regions(_modulus)]
Stiffnesses = Annotated[dict[str, Text], _by_part(_stiffness, "a stiffness per part, such as {bottom = [10, 5]}")]
Directions = Annotated[list[list[str]] | dict[str, list[list[str]]], _in_regions(_directions)]
