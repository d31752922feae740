"""Types of the values in a case file: numbers, names, expressions, matrices of these."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from signorini_fenicsx.base.text import did_you_mean
from signorini_fenicsx.cases.complaints import shown, told
from signorini_fenicsx.expressions import parse_number
from signorini_fenicsx.meshes.shapes import full_name

MAX_BITS = 1000
"""Largest size of an integer."""


def number(value: object) -> object:
    """A number, also one written as `1/16` or `2^-4`."""
    if isinstance(value, bool):
        raise ValueError("must be a number, not true or false")
    if isinstance(value, str):
        with told():
            value = parse_number(value)
    return _not_huge(value)


def text_of(value: object) -> object:
    """A number as text; all else as it is."""
    return str(_not_huge(value)) if isinstance(value, int | float) and not isinstance(value, bool) else value


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
    with told():
        return full_name(value if isinstance(value, str) and len(value) < 100 and value.isprintable() else shown(value))


def within(low: float, high: float) -> AfterValidator:
    """Accept numbers in this closed interval."""

    def check(value: float) -> float:
        if not low <= value <= high:
            raise ValueError(f"must be between {low:g} and {high:g}, not {value:g}")
        return value

    return AfterValidator(check)


def _texts(value: object) -> object:
    """Numbers as texts, in lists too."""
    return [_texts(entry) for entry in value] if isinstance(value, list) else text_of(value)


def _has(shape: tuple[int | None, ...], texts: object) -> bool:
    """Whether these are texts in lists with these numbers of entries, None for any; () for one text."""
    if not shape:
        return isinstance(texts, str)
    is_list = isinstance(texts, list) and shape[0] in (None, len(texts))
    return is_list and all(_has(shape[1:], entry) for entry in texts)  # type: ignore[attr-defined]


def given(what: str, *shapes: tuple[int | None, ...], table: bool = False, only: str = "") -> BeforeValidator:
    """Read numbers and texts as texts.

    Args:
        what: What they have to be, in words.
        shapes: For each list that they may be its length, or None for any, and that of its entries; () for no list.
        table: Whether there may be a table with one for each region or part.
        only: What this table has, in words, if there has to be one.
    """

    def one(value: object) -> object:
        texts = _texts(value)
        if not any(_has(shape, texts) for shape in shapes):
            raise ValueError(f"must be {what}, not {shown(value)}")
        return texts

    def check(value: object) -> object:
        if isinstance(value, dict) and (value or only) and (table or only):
            return {place: one(entry) for place, entry in value.items()}
        if only:
            raise ValueError(f"must be a table with {only}")
        return one(value)

    return BeforeValidator(check)


type Text = str | list[str] | list[list[str]]
type ConductivityText = Text | dict[str, Text]


def texts_of(name: str, given: Text | Mapping[str, Text]) -> list[tuple[str, str]]:
    """Each expression with its name, to which that of its region or part is added; entries of a list share a name."""
    values = {f"{name}.{key}": text for key, text in given.items()} if isinstance(given, Mapping) else {name: given}
    return [(key, text) for key, value in values.items() for text in _leaves(value)]


def _leaves(value: Text | str) -> list[str]:
    return [value] if isinstance(value, str) else [text for entry in value for text in _leaves(entry)]


def _names(value: object) -> object:
    """One name as a list of it."""
    return [value] if isinstance(value, str) else value


def _direction(value: object) -> object:
    """Refuse what is neither "normal" nor a vector."""
    if value != "normal" and not isinstance(value, list):
        raise ValueError(f'must be "normal", or a vector such as [0, -1], not {shown(value)}')
    return value if value == "normal" else [number(each) for each in value]


PartNames = Annotated[list[str], BeforeValidator(_names), Field(min_length=1)]
Direction = Annotated[Literal["normal"] | list[float], BeforeValidator(_direction)]
Positive = Annotated[float, BeforeValidator(number), Field(gt=0, allow_inf_nan=False)]
Whole = Annotated[int, BeforeValidator(number)]
MATRICES = (), (2, 2), (3, 3)
VECTOR = 'a list with an expression for each component, such as ["0", "-1"]'
MODULUS = "an expression, a list of three, or a table with one per region"
MATRIX = "an expression, a matrix of 2 rows of 2 expressions, in 3D 3 of 3, or a table with one per region"
AXES = "a list with one direction in the plane, as [[1, 1]], or two in space"
STIFFNESS = "a stiffness: an expression, [along n, across n], or a matrix"
Expression = Annotated[str, given("an expression", ())]
Vector = Annotated[list[str], given(VECTOR, (None,))]
VectorByPart = Annotated[list[str] | dict[str, list[str]], given(VECTOR, (None,), table=True)]
Entries = Annotated[list[Any], given("pairs, such as [[0, 1], [2, 3]]", (None, None))]
ShapeName = Annotated[str, BeforeValidator(_shape)]
ByPart = given("an expression", (), only='one expression per part, such as {top = "0.1"}')
ExpressionByPart = Annotated[dict[str, str], ByPart]
ByRegion = given("an expression, or a table with one per region", (), table=True)
ExpressionByRegion = Annotated[str | dict[str, str], ByRegion]
OrByPart = given("an expression, or a table with one per part", (), table=True)
ExpressionOrByPart = Annotated[str | dict[str, str], OrByPart]
Conductivity = Annotated[ConductivityText, given(MATRIX, *MATRICES, table=True)]
Moduli = Annotated[str | list[str] | dict[str, str | list[str]], given(MODULUS, (), (3,), table=True)]
OfPart = given(STIFFNESS, *MATRICES, (2,), only="a stiffness per part, such as {bottom = [10, 5]}")
Stiffnesses = Annotated[dict[str, Text], OfPart]
Directions = Annotated[list[list[str]] | dict[str, list[list[str]]], given(AXES, (1, 2), (2, 3), table=True)]
