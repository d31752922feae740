"""Data f, κ, u_D, …, from whatever they were given as: their values in points, as NumPy arrays.

Numbers and texts are evaluated by NumPy alone, so that no new text compiles anything. UFL is evaluated by DOLFINx,
which compiles it once.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TypeGuard

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.algorithms.analysis import extract_arguments, extract_coefficients, extract_constants, extract_type
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.classes import Condition
from ufl.constantvalue import ComplexValue
from ufl.core.expr import Expr
from ufl.domain import extract_domains

from signorini_fenicsx.base.arrays import AnyIndices, Array, Indices, Mask, positions
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import function_at, owned_cells, owned_values
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.of_points import interpolated
from signorini_fenicsx.discrete.points import FacetPoints, Points, in_cells
from signorini_fenicsx.expressions import TREES, Tree, exactly, to_ufl, values, values_and_gradient
from signorini_fenicsx.expressions.given import Given, Rows, parsed
from signorini_fenicsx.expressions.tree import polynomial_degree
from signorini_fenicsx.meshes.domain import Domain

DEGREES = 8, 30
"""Least and largest degree of a quadrature of data."""


@dataclass(frozen=True)
class Datum:
    """A function on the mesh: a scalar, or κ as a matrix; this one is given as UFL.

    Attributes:
        ufl: The function in UFL.
    """

    ufl: Expr

    @cached_property
    def number(self) -> float | None:
        """The number that it is; None for all else."""
        is_number = isinstance(self.ufl, ufl.constantvalue.ConstantValue) and self.ufl.ufl_shape == ()
        return float(self.ufl) if is_number else None

    @property
    def shape(self) -> tuple[int, ...]:
        """() or (dim, dim)."""
        return self.ufl.ufl_shape

    @cached_property
    def degree(self) -> int:
        """The polynomial degree that UFL estimates."""
        return int(ufl.algorithms.estimate_total_polynomial_degree(apply_algebra_lowering(self.ufl)))

    @property
    def polynomial(self) -> int | None:
        """The degree of the polynomial that it is known to be, or None."""
        return None if self.number is None else 0

    @property
    def pieces(self) -> list[tuple[Tree | Rows, Mask | None]] | None:
        """The trees that it was given as, each with a mask of the cells where it holds; None if in another way."""
        return None if self.number is None else [(exactly(self.number), None)]

    def pieces_in(self, cells: AnyIndices) -> Iterator[tuple[Tree | Rows, Indices]]:
        """The pieces, each with the rows of some owned cells where it holds; nothing if it was given in another way."""
        for given, inside in self.pieces or ():
            yield given, np.arange(len(cells)) if inside is None else np.flatnonzero(inside[cells])

    def trees_in(self, cells: AnyIndices) -> Iterator[tuple[Tree, Indices]]:
        """The trees of a scalar, each with the rows of some owned cells where it holds, see `pieces_in`."""
        for tree, rows in self.pieces_in(cells):
            assert isinstance(tree, TREES)
            yield tree, rows

    def values(self, points: Points) -> Array:
        """Values, shape (n, points, *shape); NaN or ±∞ where there are none (collective)."""
        if self.number is not None:
            return np.full(points.shape, self.number, order="F")
        return self._look(points, slope=False)

    def gradients(self, points: Points) -> Array:
        """Gradients of a scalar, shape (n, points, dim) (collective)."""
        if self.number is not None:
            return np.zeros((*points.shape, points.mesh.geometry.dim))
        return self._look(points, slope=True)

    def jet(self, points: Points, *, gradient: bool = False) -> Array:
        """The jet of a scalar, see `points` (collective)."""
        value = self.values(points)[:, :, None]
        return np.concatenate([value, self.gradients(points)], axis=2) if gradient else value

    def _look(self, points: Points, *, slope: bool) -> Array:
        """The values, or the gradients, of what is not one number (collective)."""
        return points.of_ufl(ufl.grad(self.ufl) if slope else self.ufl)

    def by_facets(self, facets: npt.NDArray[np.int32]) -> list[tuple[Mask, Datum]]:
        """Rows of the given facets with the datum that holds on them."""
        return [(np.ones(len(facets), dtype=bool), self)]

    def less(self, constant: float) -> Datum:
        """A scalar less a number."""
        return _Less(self.ufl - constant, self, constant)

    def at_nodes(self, space: fem.FunctionSpace, nodes: Array) -> fem.Function:
        """A continuous function with these values in the nodes of a space, given on the reference cell (collective)."""
        function = fem.Function(space)
        if self.number is not None:
            function.x.array[:] = self.number
            return function
        for points in in_cells(space.mesh, owned_cells(space.mesh), nodes):
            function.x.array[space.dofmap.list[points.cells]] = self.values(points)
        function.x.scatter_forward()
        return function


@dataclass(frozen=True)
class _Text(Datum):
    """A tree, or a matrix of them; also a number."""

    trees: Tree | list[list[Tree]]

    @cached_property
    def number(self) -> float | None:
        """The number that it is; None if UFL made one of a text that may have no value somewhere, as 0 sqrt(x − 2)."""
        return None if self.polynomial is None else super().number

    @property
    def polynomial(self) -> int | None:
        """The degree of the polynomial that it is, of a matrix the largest of its entries, or None."""
        trees = [entry for row in self.trees for entry in row] if isinstance(self.trees, list) else [self.trees]
        degrees = [polynomial_degree(tree) for tree in trees]
        return None if None in degrees else max(degree for degree in degrees if degree is not None)

    @property
    def pieces(self) -> list[tuple[Tree | Rows, Mask | None]]:
        """The datum itself, everywhere."""
        return [(self.trees, None)]

    def _look(self, points: Points, *, slope: bool) -> Array:
        x = points.x
        if isinstance(self.trees, list):
            return np.stack([np.stack([values(entry, x) for entry in row], axis=-1) for row in self.trees], axis=-2)
        return values_and_gradient(self.trees, x)[1] if slope else values(self.trees, x)


@dataclass(frozen=True)
class _Less(Datum):
    """A datum less a number."""

    datum: Datum
    constant: float

    def _look(self, points: Points, *, slope: bool) -> Array:
        return self.datum.gradients(points) if slope else self.datum.values(points) - self.constant


@dataclass(frozen=True)
class _ByRegion(Datum):
    """A value in each region of the mesh; each cell is in one of them.

    Attributes:
        parts: Which cells of this rank, and the value there.
    """

    parts: list[tuple[Mask, Datum]]
    number = None

    @property
    def polynomial(self) -> int | None:
        """The largest degree in a region, or None."""
        return largest_degree(datum for _, datum in self.parts)

    @property
    def pieces(self) -> list[tuple[Tree | Rows, Mask | None]] | None:
        """The pieces of all regions; None if one has none."""
        pieces_of_parts = [(inside, datum.pieces) for inside, datum in self.parts]
        if any(pieces is None for _, pieces in pieces_of_parts):
            return None
        return [(tree, inside) for inside, pieces in pieces_of_parts for tree, _ in pieces or ()]

    def _look(self, points: Points, *, slope: bool) -> Array:
        looked = np.empty((*points.shape, *((points.mesh.geometry.dim,) if slope else self.shape)))
        for inside, datum in self.parts:
            some = points.among(inside)
            value = datum.gradients(some) if slope else datum.values(some)
            if value.ndim < looked.ndim:  # a number for a matrix
                value = value[..., None, None] * np.eye(self.shape[0])
            looked[inside[points.cells]] = value
        return looked


@dataclass(frozen=True)
class _OnParts(Datum):
    """A value on each of some parts of the boundary, and 0 elsewhere; it has values in points of facets alone.

    Attributes:
        parts: Which facets of this rank, ascending, and the value there; of several values of a facet the last counts.
    """

    parts: list[tuple[npt.NDArray[np.int32], Datum]]
    number = None

    @property
    def degree(self) -> int:
        """The largest degree on a part."""
        return max(datum.degree for _, datum in self.parts)

    @property
    def polynomial(self) -> int | None:
        """The largest degree on a part, or None."""
        return largest_degree(datum for _, datum in self.parts)

    def _look(self, points: Points, *, slope: bool) -> Array:
        assert isinstance(points, FacetPoints)
        looked = np.zeros((*points.shape, points.mesh.geometry.dim) if slope else points.shape)
        for facets, datum in self.parts:
            inside = np.isin(points.facets, facets)
            some = points.take(inside)
            looked[inside] = datum.gradients(some) if slope else datum.values(some)
        return looked

    def by_facets(self, facets: npt.NDArray[np.int32]) -> list[tuple[Mask, Datum]]:
        """Rows of the given facets of each part with its datum."""
        last = np.full(len(facets), -1)
        for number, (part, _) in enumerate(self.parts):
            last[np.isin(facets, part)] = number
        return [(last == number, datum) for number, (_, datum) in enumerate(self.parts)]


@dataclass(frozen=True, eq=False)
class OnFacets(Datum):
    """A number on each of some facets of this rank, as a state has; it has values in points of facets alone.

    Attributes:
        facets: The facets.
        numbers: Its value on each.
    """

    facets: npt.NDArray[np.int32]
    numbers: Array
    number = pieces = None
    polynomial = 0

    def _look(self, points: Points, *, slope: bool) -> Array:
        assert isinstance(points, FacetPoints)
        numbers = self.numbers[positions(self.facets, points.facets)]
        shape = (*points.shape, points.mesh.geometry.dim) if slope else points.shape
        return np.zeros(shape) if slope else np.repeat(numbers[:, None], shape[1], axis=1)


def datum_by_cells(parts: list[tuple[Mask, Datum]]) -> Datum:
    """A datum with a value in each of some sets of owned cells; each cell is in one of them."""
    return _ByRegion(max((datum for _, datum in parts), key=lambda datum: datum.degree).ufl, parts)


def datum_on_parts(spaces: MeshSpaces, name: str, given: Given | Mapping[str, Given]) -> Datum:
    """A datum on the boundary that may have a value on each part, and by "" one elsewhere (collective).

    Raises:
        InputError: If a text cannot be read, or a value has the wrong shape; if a part is unknown.
    """
    names = "xyz"[: spaces.mesh.geometry.dim]
    if not isinstance(given, Mapping):
        return datum_of(spaces, name, parsed(given, names, f"[problem] {name}"))
    parts = []
    for part, value in sorted(given.items()):  # "" is the first
        key, facets = f"{name}.{part}".rstrip("."), spaces.domain.facets
        if part and part not in facets:
            raise InputError(f"[problem] {key}: unknown part; there are {', '.join(facets)}")
        everywhere = dolfinx.mesh.exterior_facet_indices(spaces.mesh.topology)
        datum = datum_of(spaces, key, parsed(value, names, f"[problem] {key}"))
        parts.append((facets[part] if part else everywhere, datum))
    return _OnParts(parts[0][1].ufl, parts)


def largest_degree(data: Iterable[Datum]) -> int | None:
    """The largest degree of data that are polynomials, None if one is not known to be a polynomial."""
    degrees = [datum.polynomial for datum in data]
    return None if None in degrees else max(degree for degree in degrees if degree is not None)


def quadrature_degree(*data: Datum, power: int = 1) -> int:
    """Degree of a quadrature for a power of the sum of some data."""
    least, most = DEGREES
    return min(max(least, power * max((datum.degree for datum in data), default=0)), most)


def datum_of(
    spaces: MeshSpaces | Domain, name: str, given: Given, *, continuous: bool = True, matrix: bool = False
) -> Datum:
    """A datum from what was given, with numbers and texts as trees; a datum as it is (collective).

    Functions of points become piecewise quadratic, those that may jump by inner points.

    Raises:
        InputError: If it has the wrong shape, is not real, or is UFL on another mesh.
    """
    if isinstance(given, Datum):
        return given
    dim = spaces.mesh.geometry.dim
    shapes = [(), (dim, dim)] if matrix else [()]
    x = ufl.SpatialCoordinate(spaces.mesh)
    if isinstance(given, Expr):
        _check_ufl(spaces, name, given)
        datum = Datum(given)
    elif isinstance(given, int | float):
        datum = Datum(ufl.as_ufl(given))
    elif isinstance(given, TREES):
        datum = _Text(_in_ufl(name, given, x), given)
    elif _is_matrix(given):
        datum = _Text(ufl.as_matrix([[_in_ufl(name, entry, x) for entry in row] for row in given]), given)
    elif callable(given):
        datum = Datum(interpolated(spaces.mesh, name, given, continuous=continuous))
    else:
        texts = "numbers, texts, square matrices of them, UFL (by ufl.as_matrix)" if matrix else "numbers, texts, UFL"
        kind = type(given).__name__
        raise InputError(f"[problem] {name}: is a {kind}; data are {texts}, Functions or functions of points")
    if datum.shape not in shapes:
        raise InputError(f"[problem] {name}: has shape {datum.shape}, not {' or '.join(map(str, shapes))}")
    return datum


def _check_ufl(spaces: MeshSpaces | Domain, name: str, given: Expr) -> None:
    """Refuse UFL that is no real function on the mesh.

    Raises:
        InputError: If it is not.
    """
    wrong = ""
    constants = (*extract_coefficients(given), *extract_constants(given))
    types = {str(getattr(each, "dtype", "none")) for each in constants} - {"float64"}
    if any(domain != spaces.mesh.ufl_domain() for domain in extract_domains(given)):
        wrong = "UFL on another mesh; write it on `domain.mesh`"
    elif extract_arguments(given):
        wrong = "UFL with a test or trial function; data have none"
    elif isinstance(given, Condition):
        wrong = "a condition in UFL; data are numbers, such as ufl.conditional(condition, 1, 0)"
    elif types:
        wrong = f"UFL with a Function or Constant of type {types.pop()}; data are real, float64"
    elif extract_type(given, ComplexValue):
        wrong = "UFL with a complex number; data are real"
    if wrong:
        raise InputError(f"[problem] {name}: is {wrong}")


def _in_ufl(name: str, tree: Tree, x: Expr) -> Expr:
    """A tree as UFL in these coordinates.

    Raises:
        InputError: If a part without coordinates cannot be evaluated, such as 1/(t − 1) at t = 1.
    """
    try:
        return to_ufl(tree, x)
    except (ArithmeticError, ValueError) as error:
        raise InputError(f"[problem] {name}: cannot be evaluated: {error}") from None


def _is_matrix(given: object) -> TypeGuard[list[list[Tree]]]:
    """Whether a given datum is a list of equally long rows of trees."""
    if not isinstance(given, list) or not all(isinstance(row, list) and row for row in given):
        return False
    return len({len(row) for row in given}) == 1 and all(isinstance(entry, TREES) for row in given for entry in row)


def conductivity_of(spaces: MeshSpaces, given: Given | Mapping[str, Given]) -> Datum:
    """κ, see `regional_datum` (collective)."""
    return regional_datum(spaces, "kappa", given, matrix=True)


def regional_datum(spaces: MeshSpaces, key: str, given: Given | Mapping[str, Given], *, matrix: bool = False) -> Datum:
    """A datum that may have a value for each region (collective).

    Raises:
        InputError: If it has the wrong shape, or not one value in each cell.
    """
    if not isinstance(given, Mapping):
        return datum_of(spaces, key, given, continuous=False, matrix=matrix)
    regions = spaces.domain.regions
    for name in given:
        if name not in regions:
            regions_in_words = f"its regions are {', '.join(regions)}" if regions else "it has none"
            raise InputError(f"[problem] {key}: unknown region '{name}' of the mesh; {regions_in_words}")
    number = len(spaces.cell_measures)
    parts, terms, values_given = [], [], np.zeros(number, dtype=np.int64)
    for name, value in given.items():
        inside = function_at(spaces.Q, regions[name], 1.0, name)
        datum = datum_of(spaces, f"{key}.{name}", value, continuous=False, matrix=matrix)
        parts.append((owned_values(inside) > 0, datum))
        terms.append((inside, datum.ufl))
        values_given[regions[name]] += 1
    without, several = spaces.mesh.comm.allreduce(
        np.array([np.count_nonzero(values_given == 0), np.count_nonzero(values_given > 1)])
    ).tolist()
    if without > 0 or not parts:
        missing = [name for name in regions if name not in given]
        which = f"; regions without one: {', '.join(missing)}" if missing else ", as they are in no region"
        raise InputError(f"[problem] {key}: {without} cells have no value{which}")
    if several > 0:
        raise InputError(f"[problem] {key}: {several} cells are in more than one of {', '.join(given)}")
    identity = ufl.Identity(spaces.mesh.geometry.dim)
    if any(datum.shape for _, datum in parts):
        terms = [(inside, value if value.ufl_shape else value * identity) for inside, value in terms]
    return _ByRegion(sum(inside * value for inside, value in terms), parts)
