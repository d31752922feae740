"""A datum with a value for each coordinate, such as a force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.datum import Datum, datum_of, largest_degree
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.points import Points
from signorini_fenicsx.expressions.given import parsed


@dataclass(frozen=True)
class VectorDatum:
    """A vector field on the mesh.

    Attributes:
        name: Its key.
        components: Each component.
    """

    name: str
    components: tuple[Datum, ...]

    @property
    def degree(self) -> int:
        """The polynomial degree that UFL estimates."""
        return max(component.degree for component in self.components)

    @property
    def polynomial(self) -> int | None:
        """The degree of the polynomial that it is known to be, or None."""
        return largest_degree(self.components)

    def values(self, points: Points) -> Array:
        """Values, shape (n, points, dim) (collective)."""
        return np.stack([component.values(points) for component in self.components], axis=2)

    def gradients(self, points: Points) -> Array:
        """Gradients, the derivatives last, shape (n, points, dim, dim) (collective)."""
        return np.stack([component.jet(points, gradient=True)[:, :, 1:] for component in self.components], axis=2)


def vector_datum_of(spaces: MeshSpaces, name: str, given: Any, *, continuous: bool = True) -> VectorDatum:
    """A vector from what was given, see `elastic_problem.GivenVector`; None is 0 (collective).

    Raises:
        InputError: If it cannot be read, has not a component per coordinate, or is UFL on another mesh.
    """
    dim = spaces.mesh.geometry.dim
    if given is None:
        entries: list[Any] = [0.0] * dim
    elif isinstance(given, Expr):
        if given.ufl_shape != (dim,):
            raise InputError(f"[problem] {name}: has shape {given.ufl_shape}, not ({dim},)")
        entries = [given[i] for i in range(dim)]
    elif isinstance(given, Sequence | np.ndarray) and not isinstance(given, str):
        entries = list(given)
    elif callable(given):
        entries = [lambda x, i=i: _rows(given(x), dim)[i] for i in range(dim)]
    else:
        raise InputError(f"[problem] {name}: must be a list of {dim} components")
    if len(entries) != dim:
        raise InputError(f"[problem] {name}: has {len(entries)} components, not {dim}")
    components = (
        datum_of(spaces, name, parsed(entry, "xyz"[:dim], f"[problem] {name}"), continuous=continuous)
        for entry in entries
    )
    return VectorDatum(name, tuple(components))


def _rows(values: npt.ArrayLike, dim: int) -> Array:
    """What a function of points gives, a row for each component.

    Raises:
        ValueError: If there is another number of rows.
    """
    found = np.asarray(values)
    if found.shape[:1] != (dim,):
        raise ValueError(f"it must give {dim} rows, not an array of shape {found.shape}")
    return found
