"""Values of what was given at points of cells and facets: trees and functions by NumPy, UFL by DOLFINx."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr
from ufl.domain import extract_domains

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.johnson_mercier import opposite
from signorini_fenicsx.expressions import TREES, Tree, exactly, polynomial_degree, read, values, values_and_gradient

type Entities = npt.NDArray[np.int32]
type Sample = Callable[[Entities], Array]
"""From cells, or rows of a cell and the number of a facet in it, to values of shape (entities, points, …)."""

DEGREE = 8
"""Of a quadrature of what is no polynomial."""


class Sampler:
    """A scalar or a vector that can be evaluated.

    Attributes:
        degree: Of the quadrature that its integral takes: its own if it is a polynomial.
    """

    def __init__(self, mesh: dolfinx.mesh.Mesh, name: str, given: Any, *, vector: bool = False):
        """Read it.

        Args:
            mesh: The mesh.
            name: Of the key, for complaints.
            given: See `problem.Given` and `elastic_problem.GivenVector`; None is 0.
            vector: Whether it has a value per dimension.

        Raises:
            InputError: If it cannot be read, or has not the shape.
        """
        self._mesh, self._dim, self.name = mesh, mesh.geometry.dim, name
        shape = (self._dim,) if vector else ()
        self._what: Any = given
        if given is None:
            given = [0.0] * self._dim
        if isinstance(given, Expr):
            self._check_ufl(given, shape)
        elif vector and isinstance(given, Sequence) and not isinstance(given, str):
            if len(given) != self._dim:
                raise InputError(f"[problem] {name}: has {len(given)} components, not {self._dim}")
            if any(isinstance(entry, Expr) for entry in given):
                self._what = ufl.as_vector(list(given))
                self._check_ufl(self._what, shape)
            else:
                self._what = [self._tree(entry) for entry in given]
        elif vector and not callable(given):
            raise InputError(f"[problem] {name}: must be a list of {self._dim} components")
        elif not callable(given):
            self._what = self._tree(given)
        self._vector = vector

    def _check_ufl(self, value: Expr, shape: tuple[int, ...]) -> None:
        if any(domain != self._mesh.ufl_domain() for domain in extract_domains(value)):
            raise InputError(f"[problem] {self.name}: is UFL on another mesh; write it on `domain.mesh`")
        if value.ufl_shape != shape:
            raise InputError(f"[problem] {self.name}: has shape {value.ufl_shape}, not {shape}")

    def _tree(self, given: Any) -> Tree:
        if isinstance(given, str):
            return read(given, "xyz"[: self._dim])
        return exactly(given) if isinstance(given, int | float) else given

    @property
    def trees(self) -> list[Tree] | None:
        """Its components as trees, if it was given as such."""
        entries = self._what if isinstance(self._what, list) else [self._what]
        return entries if all(isinstance(entry, TREES) for entry in entries) else None

    @property
    def polynomial(self) -> int | None:
        """Its degree, if it is known to be a polynomial."""
        if self.trees is None:
            return None
        degrees = [polynomial_degree(tree) for tree in self.trees]
        return None if None in degrees else max(degree for degree in degrees if degree is not None)

    @property
    def degree(self) -> int:
        """Of the quadrature that sees it."""
        return DEGREE if self.polynomial is None else self.polynomial

    def in_cells(self, points: Array) -> Sample:
        """Its values at these points of the reference cell (collective)."""
        return self._sample(self._what, points, partial(cell_points, self._mesh, points))

    def on_facets(self, points: Array) -> Sample:
        """Its values at these points of the reference facet (collective)."""
        return self._sample(self._what, points, partial(facet_points, self._mesh, points))

    def gradient_in_cells(self, points: Array) -> Sample:
        """Its gradient at these points of the reference cell, with the derivatives last (collective).

        Raises:
            InputError: If it is a function of points.
        """
        place = partial(cell_points, self._mesh, points)
        if isinstance(self._what, Expr):
            return self._sample(ufl.grad(self._what), points, place)
        if self.trees is None:
            raise InputError(f"[problem] {self.name}: a function of points has no gradient; give text or UFL")
        trees = self.trees

        def sample(entities: Entities) -> Array:
            named = _named(place(entities), self._dim)
            found = [values_and_gradient(tree, named)[1] for tree in trees]
            return np.stack(found, axis=2) if self._vector else found[0]

        return sample

    def _sample(self, what: Any, points: Array, place: Callable[[Entities], Array]) -> Sample:
        if isinstance(what, Expr):
            entries = [*ufl.SpatialCoordinate(self._mesh), *_flat(what)]
            compiled = fem.Expression(ufl.as_vector(entries), points)

            def by_dolfinx(entities: Entities) -> Array:
                shape = len(entities), len(points)
                found = np.float64(compiled.eval(self._mesh, entities)).reshape(*shape, len(entries))
                if points.shape[1] < self._dim:
                    found = _in_order(found, place(entities))
                return found[:, :, self._dim :].reshape(*shape, *what.ufl_shape)

            return by_dolfinx
        trees = self.trees

        def by_numpy(entities: Entities) -> Array:
            x = place(entities)
            if trees is None:
                found = list(np.reshape(what(_as_columns(x)), (self._dim if self._vector else 1, *x.shape[:2])))
            else:
                found = [values(tree, _named(x, self._dim)) for tree in trees]
            return np.stack(found, axis=2) if self._vector else found[0]

        return by_numpy


def _in_order(found: Array, places: Array) -> Array:
    """Rows that begin with their place, in the order of places: DOLFINx turns the points of some facets."""
    distances = np.square(places[:, :, None] - found[:, None, :, : places.shape[2]]).sum(axis=3)
    return np.take_along_axis(found, distances.argmin(axis=2)[:, :, None], axis=1)


def _flat(value: Expr) -> list[Expr]:
    return [value[index] for index in np.ndindex(value.ufl_shape)] if value.ufl_shape else [value]


def _named(x: Array, dim: int) -> dict[str, Array]:
    return dict(zip("xyz"[:dim], np.moveaxis(x, -1, 0), strict=True))


def _as_columns(x: Array) -> Array:
    """Points as DOLFINx gives them to functions, shape (3, n)."""
    flat = x.reshape(-1, x.shape[-1])
    return np.pad(flat, ((0, 0), (0, 3 - x.shape[-1]))).T


def cell_points(mesh: dolfinx.mesh.Mesh, points: Array, cells: Entities) -> Array:
    """Where points of the reference cell are, shape (cells, points, d)."""
    dim = mesh.geometry.dim
    vertices = mesh.geometry.x[mesh.geometry.dofmaps[0][cells], :dim]
    hats = np.column_stack([1 - points.sum(axis=1), points])
    return np.einsum("qv,nvx->nqx", hats, vertices)


def facet_points(mesh: dolfinx.mesh.Mesh, points: Array, facets: Entities) -> Array:
    """Where points of the reference facet are, shape (facets, points, d)."""
    dim = mesh.geometry.dim
    nodes = np.take_along_axis(mesh.geometry.dofmaps[0][facets[:, 0]], opposite(dim)[facets[:, 1]], axis=1)
    hats = np.column_stack([1 - points.sum(axis=1), points])
    return np.einsum("qv,nvx->nqx", hats, mesh.geometry.x[nodes, :dim])


def by_region(
    mesh: dolfinx.mesh.Mesh, name: str, given: Any, regions: Mapping[str, Entities]
) -> tuple[list[Sampler], npt.NDArray[np.int64]]:
    """A scalar that may have a value of its own in each region (collective).

    Returns:
        The values, and for each owned cell which of them it has.

    Raises:
        InputError: If a region is unknown, or cells have none or several values.
    """
    size = mesh.topology.index_map(mesh.topology.dim).size_local
    if not isinstance(given, Mapping):
        return [Sampler(mesh, name, given)], np.zeros(size, dtype=np.int64)
    which, number = np.zeros(size, dtype=np.int64), np.zeros(size, dtype=np.int64)
    for index, region in enumerate(given):
        if region not in regions:
            known = f"its regions are {', '.join(regions)}" if regions else "it has none"
            raise InputError(f"[problem] {name}: unknown region '{region}' of the mesh; {known}")
        which[regions[region]] = index
        number[regions[region]] += 1
    without, several = mesh.comm.allreduce(np.array([np.sum(number == 0), np.sum(number > 1)]), MPI.SUM).tolist()
    if without > 0:
        missing = [region for region in regions if region not in given]
        raise InputError(f"[problem] {name}: {without} cells have no value; regions without one: {', '.join(missing)}")
    if several > 0:
        raise InputError(f"[problem] {name}: {several} cells are in more than one of {', '.join(given)}")
    return [Sampler(mesh, f"{name}.{region}", value) for region, value in given.items()], which
