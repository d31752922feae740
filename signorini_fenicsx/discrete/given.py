"""What data may be given as."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy.typing as npt
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.expressions import Tree, exactly, read

type Rows = Sequence[Sequence[Tree]]
type Entries = Sequence[Sequence[float | str | Tree]]
type Given = float | str | Tree | Entries | Expr | Callable[[Array], npt.ArrayLike]
"""A number; an expression as a case file has it, as text or read, or a matrix of them; a UFL expression on the mesh, or
a `fem.Function`; or a function of points of shape (3, n)."""


def parsed(given: Any, names: str) -> Any:
    """What was given, with numbers and texts read as trees in these coordinates.

    Raises:
        InputError: If a text cannot be read.
    """
    if isinstance(given, Mapping):
        return {name: parsed(value, names) for name, value in given.items()}
    if isinstance(given, tuple | list):
        return [parsed(entry, names) for entry in given]
    if isinstance(given, str):
        return read(given, names)
    return exactly(given) if isinstance(given, int | float) else given
