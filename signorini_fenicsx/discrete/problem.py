"""The data of a problem as the user gives them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy.typing as npt
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.expressions import Tree, exactly, read

type Rows = Sequence[Sequence[Tree]]
type Entries = Sequence[Sequence[float | str | Tree]]
type Given = float | str | Tree | Entries | Expr | Callable[[Array], npt.ArrayLike]
"""A number; an expression in the language of case files, as text or as a tree; a matrix of these; a UFL expression on
the mesh, such as a `fem.Function`; or a Python function of points of shape (3, n)."""


@dataclass(frozen=True)
class Problem:
    """−∇·(κ∇u) = f, u = u_D on Γ_D, κ∇u·n = g_N on Γ_N; on Γ_S u ≥ ψ and κ∇u·n ≥ q_S, with equality in one of them.

    Attributes:
        f: Load.
        kappa: κ: a scalar, a symmetric positive definite matrix, or one of these for each region of the mesh.
        u_D: Trace on Γ_D, continuous.
        g_N: Flux κ∇u·n on Γ_N, with the outer normal n.
        psi: Lower bound of the trace on Γ_S, continuous.
        q_S: Lower bound of the flux on Γ_S.
        exact: The exact u, where it is known.
    """

    f: Given
    kappa: Given | Mapping[str, Given] = 1.0
    u_D: Given = 0.0
    g_N: Given = 0.0
    psi: Given = 0.0
    q_S: Given = 0.0
    exact: Given | None = None

    def parsed(self, dim: int) -> "Problem":
        """The same problem, with numbers and texts read as trees.

        Raises:
            InputError: If a text cannot be read.
        """
        return Problem(**{field.name: parsed(getattr(self, field.name), "xyz"[:dim]) for field in fields(self)})


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
