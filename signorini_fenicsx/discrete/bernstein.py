"""Polynomials on simplices by Bernstein coefficients, of any degree, in the order in which Basix has the nodes."""

from functools import cache

import basix
import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Indices, times
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.discrete.lattices import numbers_in
from signorini_fenicsx.expressions import Tree, values


@cache
def nodes(cell: basix.CellType, degree: int) -> Array:
    """The nodes of a reference simplex: vertices, then points that divide its edges equally, and so on."""
    return basix.create_element(basix.ElementFamily.P, cell, degree, basix.LagrangeVariant.equispaced).points


def degree_of(space: fem.FunctionSpace) -> int:
    """The degree of a space of polynomials on cells."""
    return int(space.element.basix_element.degree)


@cache
def degree_with(cell: basix.CellType, number: int) -> int:
    """The degree of polynomials with so many nodes on a simplex."""
    return next(degree for degree in range(1, number) if len(nodes(cell, degree)) == number)


def nodes_of(space: fem.FunctionSpace) -> Array:
    """The nodes of a space of polynomials on the reference cell."""
    return nodes(space.mesh.basix_cell(), degree_of(space))


@cache
def exponents(cell: basix.CellType, degree: int) -> Indices:
    """α of the Bernstein polynomial degree!/α! λ^α that belongs to each node, shape (nodes, vertices)."""
    x = nodes(cell, degree)
    return np.rint(degree * np.column_stack([1 - x.sum(axis=1), x])).astype(np.int64)


def renumbered(cell: basix.CellType, degree: int, order: Indices, points: Indices) -> Indices:
    """Which node each point of the lattice is in simplices whose vertices have other numbers, shape (n, points)."""
    number_of = np.argsort(numbers_in(exponents(cell, degree), degree))
    return np.asarray(number_of[numbers_in(points[:, np.argsort(order, axis=1)], degree)].T)


def basis(cell: basix.CellType, degree: int, points: Array, *, slopes: bool = False) -> Array:
    """The Bernstein polynomials in points of the reference simplex, or their derivatives there.

    The shape is (points, nodes), or (dim, points, nodes).
    """
    element = basix.create_element(basix.ElementFamily.P, cell, degree, basix.LagrangeVariant.bernstein)
    value, *derivatives = element.tabulate(int(slopes), points)[:, :, :, 0]
    return np.asarray(derivatives if slopes else value)


def interpolation(cell: basix.CellType, degree: int, points: Array) -> Array:
    """Values in points of the polynomials that are 1 in one node, 0 in the others, shape (points, nodes)."""
    return basis(cell, degree, points) @ _from_values(cell, len(nodes(cell, degree)))


def coefficients_of(values: Array, cell: basix.CellType) -> Array:
    """Bernstein coefficients of the polynomials with these values in the nodes of simplices, shape (n, nodes).

    Where a value that it needs is not finite, the value in the node itself stands for a coefficient.
    """
    matrix = _from_values(cell, values.shape[1])
    coefficients = np.zeros(values.shape)
    with np.errstate(invalid="ignore"):  # entry by entry, so that facets and cells have the same to the last bit
        for row, column in zip(*np.nonzero(matrix), strict=True):
            coefficients[:, row] += matrix[row, column] * values[:, column]
    return np.where(np.isfinite(coefficients), coefficients, values)


@cache
def to_values(cell: basix.CellType, degree: int) -> Array:
    """The matrix from coefficients to values in the nodes; a 0 is exact, as values in vertices are coefficients."""
    matrix = basis(cell, degree, nodes(cell, degree))
    matrix[np.abs(matrix) < 1e-9] = 0.0
    return matrix


@cache
def _from_values(cell: basix.CellType, number: int) -> Array:
    """The matrix from values in so many nodes to coefficients."""
    matrix = np.linalg.inv(to_values(cell, degree_with(cell, number)))
    matrix[np.abs(matrix) < 1e-9] = 0.0
    return matrix


@cache
def _raised(cell: basix.CellType, degree: int) -> Indices:
    """The node of degree + 1 with α + e_v for each node of a degree, with α, and each vertex v."""
    number = {tuple(alpha): row for row, alpha in enumerate(exponents(cell, degree + 1).tolist())}
    dim = len(basix.topology(cell)) - 1
    units = np.eye(dim + 1, dtype=np.int64)
    return np.array([[number[tuple(alpha + unit)] for unit in units] for alpha in exponents(cell, degree)])


def raised(coefficients: Array, cell: basix.CellType, degree: int) -> Array:
    """The coefficients of quadratics on simplices as those of polynomials of a higher degree, or the same."""
    lower = 2
    while lower < degree:
        places, shares = _raised(cell, lower), (exponents(cell, lower) + 1) / (lower + 1)
        higher = np.zeros((len(coefficients), len(nodes(cell, lower + 1))))
        for vertex in range(places.shape[1]):
            higher[:, places[:, vertex]] += coefficients * shares[:, vertex]
        coefficients, lower = higher, lower + 1
    return coefficients


def jet(coefficients: Array, barycentric: Array, slopes: Array | None = None) -> Array:
    """Values, and gradients if the slopes of the barycentric coordinates are given, by de Casteljau's algorithm.

    Args:
        coefficients: Of n polynomials, of degree ≥ 1, shape (n, nodes).
        barycentric: Of the points, shape (n or 1, points, vertices).
        slopes: Shape (n, vertices, dim).
    """
    cell, form = SIMPLEX[barycentric.shape[2] - 1], coefficients[:, None]
    degree = degree_with(cell, coefficients.shape[1])
    for lower in range(degree - 1, 0, -1):
        form = np.einsum("npv,npav->npa", barycentric, form[:, :, _raised(cell, lower)])
    form = np.broadcast_to(form, (len(form), barycentric.shape[1], form.shape[2]))
    value = np.einsum("npv,npv->np", form, np.broadcast_to(barycentric, form.shape))[:, :, None]
    return value if slopes is None else np.concatenate([value, degree * times(form, slopes)], axis=2)


def in_nodes(tree: Tree, vertices: Array, degree: int = 2) -> Array:
    """Values in the nodes of polynomials of a degree on simplices, shape (n, nodes)."""
    shares = exponents(SIMPLEX[vertices.shape[1] - 1], degree) / degree
    return values(tree, shares @ vertices)


def to_bernstein(function: fem.Function) -> None:
    """Turn values in the nodes of a function into Bernstein coefficients, in place, with ghosts."""
    cells, cell = function.function_space.dofmap.list, function.function_space.mesh.basix_cell()
    function.x.array[cells] = coefficients_of(function.x.array[cells], cell)


def make_linear(function: fem.Function) -> None:
    """Let a function be linear on each cell, with its values in the vertices, in place, with ghosts."""
    cells, cell = function.function_space.dofmap.list, function.function_space.mesh.basix_cell()
    shares = exponents(cell, degree_of(function.function_space))
    vertices = shares.shape[1]
    function.x.array[cells] = function.x.array[cells[:, :vertices]] @ (shares / shares[0].sum()).T
