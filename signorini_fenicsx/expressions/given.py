"""What data may be given as."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.core.expr import Expr
from ufl.domain import extract_domains

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, telling
from signorini_fenicsx.expressions import TREES, Binary, Tree, exactly, read, substituted, to_ufl, values
from signorini_fenicsx.expressions.tree import Negative

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

type Rows = Sequence[Sequence[Tree]]
type Entries = Sequence[Sequence[float | str | Tree]]
type Given = float | str | Tree | Entries | Array | Expr | Callable[[Array], npt.ArrayLike]
"""A number; an expression as a case file has it, as text or read, or a matrix of them, also an array; a UFL expression
on the mesh, or a `fem.Function`; or a function of points of shape (3, n)."""
type GivenByRegion = Given | Mapping[str, Given]
"""A scalar, or one for each region of the mesh."""
type GivenMatrix = Given | Mapping[str, Given]
"""A number times the unit matrix, or a symmetric matrix; or one of these for each region of the mesh."""
type GivenVectorByRegion = Sequence[Given] | Expr | Callable[[Array], npt.ArrayLike] | Mapping[str, Any]
"""A vector by its components, or one for each region of the mesh."""


def parsed(given: Any, names: str, key: str) -> Any:
    """A given datum, or a table of them, with numbers and texts read as trees in these coordinates.

    Raises:
        InputError: If a text cannot be read or a number is too large; the message begins with the key.
    """
    if isinstance(given, Mapping):
        return {name: parsed(value, names, f"{key}.{name}".rstrip(".")) for name, value in given.items()}
    if isinstance(given, np.ndarray | np.generic):
        return parsed(given.tolist(), names, key)
    if isinstance(given, tuple | list):
        return [parsed(entry, names, key) for entry in given]
    with telling(key):
        if isinstance(given, str):
            return read(given, names)
        try:
            return exactly(given) if isinstance(given, int | float) else given
        except OverflowError:
            raise InputError("is an integer too large for a float") from None


def number_of(name: str, given: Any) -> float:
    """The number that a tree is.

    Raises:
        InputError: If it is not one.
    """
    number = float(values(given, np.full(3, np.nan))) if isinstance(given, TREES) else np.nan
    if not np.isfinite(number):
        raise InputError(f"{name}: must be a number")
    return number


def with_data[P: "DataclassInstance"](problem: P, change: Callable[[str, Any], Any], but: Collection[str]) -> P:
    """A problem with changed data, but for those with these names.

    Args:
        problem: The problem.
        change: Gets the place of a datum in a case file and what was given.
        but: Names of fields that stay.
    """
    keys = [field.name for field in fields(problem) if field.name not in but]
    places = {key: "[exact] u" if key == "exact" else f"[problem] {key}" for key in keys}
    return replace(problem, **{key: change(place, getattr(problem, key)) for key, place in places.items()})


def at_time(given: Any, t: float) -> Any:
    """A given datum, or a table of them, with t in the trees replaced by its value."""
    if isinstance(given, Mapping):
        return {name: at_time(value, t) for name, value in given.items()}
    if isinstance(given, tuple | list):
        return type(given)(at_time(entry, t) for entry in given)
    return substituted(given, "t", exactly(t)) if isinstance(given, TREES) else given


def combined(one: Given, other: Given, factor: float, where: str) -> Tree | Expr:
    """The sum one + factor·other: a tree of trees, UFL if one of them is UFL.

    Raises:
        InputError: If one of them is a function of points; `where` says which data they are.
    """
    number = ufl.constantvalue.ScalarValue
    one, other = (exactly(float(each)) if isinstance(each, number) else each for each in (one, other))
    if isinstance(one, TREES) and isinstance(other, TREES):
        return Binary("+", one, Binary("*", exactly(factor), other))
    if not isinstance(one, TREES | Expr) or not isinstance(other, TREES | Expr):
        raise InputError(f"{where} must be numbers, texts or UFL, not functions of points")
    meshes = [mesh for each in (one, other) if isinstance(each, Expr) for mesh in extract_domains(each)]
    x = ufl.SpatialCoordinate(meshes[0])
    one, other = (each if isinstance(each, Expr) else to_ufl(each, x) for each in (one, other))
    return one + factor * other


def negative(given: Given, name: str) -> Given:
    """−`given`.

    Raises:
        InputError: If it is a function of points.
    """
    if isinstance(given, str):
        return f"-({given})"
    if isinstance(given, TREES):
        return Negative(given)
    if not isinstance(given, int | float | Expr):
        raise InputError(f"{name} must be a number, a text or UFL")
    return -given


def is_fixed(given: Any) -> bool:
    """Whether data are trees, texts and numbers alone, so that equal ones are the same."""
    if isinstance(given, Mapping):
        return all(map(is_fixed, given.values()))
    if isinstance(given, tuple | list):
        return all(map(is_fixed, given))
    return given is None or isinstance(given, TREES | str | int | float)
