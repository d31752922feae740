"""Data with a value for each coordinate, such as a force or a given flux, and pressures as tractions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.datum import Datum, datum_of, datum_on_parts, largest_degree, regional_datum
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.points import Points
from signorini_fenicsx.expressions.given import parsed


@dataclass(frozen=True)
class PressureDatum:
    """The traction −pn of a pressure p, in points of facets with these normals.

    Attributes:
        name: Its key.
        pressure: p.
        normals: The outer unit normals, shape (facets, d).
    """

    name: str
    pressure: Datum
    normals: Array

    @property
    def polynomial(self) -> int | None:
        """The degree of the polynomial that it is known to be on each facet, or None."""
        return self.pressure.polynomial

    @property
    def scalars(self) -> tuple[Datum, ...]:
        """p, whose square is that of the traction."""
        return (self.pressure,)

    @property
    def directions(self) -> Array:
        """The direction of p on each facet, shape (facets, 1, d)."""
        return self.normals[:, None]

    def values(self, points: Points) -> Array:
        """Values, shape (facets, points, dim) (collective)."""
        return -self.pressure.values(points)[:, :, None] * self.normals[:, None]


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

    @property
    def scalars(self) -> tuple[Datum, ...]:
        """The components, the sum of whose squares is that of the vector."""
        return self.components

    @property
    def directions(self) -> Array:
        """The direction of each of them, everywhere the same, shape (1, d, d)."""
        return np.eye(len(self.components))[None]

    def values(self, points: Points) -> Array:
        """Values, shape (n, points, dim) (collective)."""
        return np.stack([component.values(points) for component in self.components], axis=2)

    def gradients(self, points: Points) -> Array:
        """Gradients, the derivatives last, shape (n, points, dim, dim) (collective)."""
        return np.stack([component.jet(points, gradient=True)[:, :, 1:] for component in self.components], axis=2)


def vector_datum_of(spaces: MeshSpaces, name: str, given: Any, *, continuous: bool = True) -> VectorDatum:
    """A vector from what was given, see `problem.GivenVector`; None is 0 (collective).

    If it need not be continuous, it or a component may have a value for each region.

    Raises:
        InputError: If it cannot be read, has not a component per coordinate, or is UFL on another mesh.
    """
    dim = spaces.mesh.geometry.dim
    if continuous and isinstance(given, Mapping):
        raise InputError(f"[problem] {name}: must be one list of {dim} components, not one for each region")
    entries = (parsed(entry, "xyz"[:dim], f"[problem] {name}") for entry in components_of(dim, name, given))
    read = datum_of if continuous else regional_datum
    return VectorDatum(name, tuple(read(spaces, name, entry) for entry in entries))


def vector_on_parts(spaces: MeshSpaces, name: str, given: Any) -> VectorDatum:
    """A vector on the boundary that may have a value on each part, and by "" one elsewhere (collective).

    Raises:
        InputError: As `vector_datum_of`; if a part is unknown.
    """
    dim = spaces.mesh.geometry.dim
    if not isinstance(given, Mapping):
        return vector_datum_of(spaces, name, given)
    components = components_of(dim, name, given)
    return VectorDatum(name, tuple(datum_on_parts(spaces, name, component) for component in components))


def components_of(dim: int, name: str, given: Any) -> list[Any]:
    """The components of a vector, or of one for each region or part, as they were given.

    Raises:
        InputError: If there are not as many as coordinates.
    """
    if given is None:
        return [0.0] * dim
    if isinstance(given, Mapping):
        of_places = {place: components_of(dim, f"{name}.{place}".rstrip("."), value) for place, value in given.items()}
        return [{place: entries[i] for place, entries in of_places.items()} for i in range(dim)]
    if isinstance(given, Expr):
        if given.ufl_shape != (dim,):
            raise InputError(f"[problem] {name}: has shape {given.ufl_shape}, not ({dim},)")
        return [given[i] for i in range(dim)]
    if isinstance(given, Sequence | np.ndarray) and not isinstance(given, str):
        if len(given) != dim:
            raise InputError(f"[problem] {name}: has {len(given)} components, not {dim}")
        return list(given)
    if callable(given):
        return [lambda x, i=i: _rows(given(x), dim)[i] for i in range(dim)]
    raise InputError(f"[problem] {name}: must be a list of {dim} components")


def _rows(values: npt.ArrayLike, dim: int) -> Array:
    """What a function of points gives, a row for each component.

    Raises:
        ValueError: If there is another number of rows.
    """
    rows = np.asarray(values)
    if rows.shape[:1] != (dim,):
        raise ValueError(f"it must give {dim} rows, not an array of shape {rows.shape}")
    return rows
