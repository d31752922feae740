"""Simplices, linear and quadratic functions on them, and their integrals, in interval arithmetic.

Vertices are the stored floats. The first axis of arrays is that of the cells. A quadratic is given by its values in the
nodes of P2: vertices first, then the midpoints of the edges in Basix's order. The last axis of a field has components.
"""

import math
from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.reference_cells import EDGES
from signorini_fenicsx.certificate.proof import Proven
from signorini_fenicsx.expressions.intervals import Interval, enclosing, stacked


def total(a: Interval, axis: int = -1) -> Interval:
    """Sum over an axis."""
    parts = [Interval(lo, hi) for lo, hi in zip(np.moveaxis(a.lo, axis, 0), np.moveaxis(a.hi, axis, 0), strict=True)]
    return sum(parts[1:], parts[0])


def root(a: Interval) -> Interval:
    """√a of numbers ≥ 0, whose enclosure may reach below 0 by rounding."""
    lo, hi = np.sqrt(np.maximum(a.lo, 0.0)), np.sqrt(np.maximum(a.hi, 0.0))
    return Interval(np.maximum(np.nextafter(lo, -np.inf), 0.0), np.where(hi == 0, 0.0, np.nextafter(hi, np.inf)))


def squared(a: Interval) -> Interval:
    """a², entry by entry."""
    return a * a  # an interval times itself is a square


def total_above(values: Array) -> float:
    """A float not below the sum of floats ≥ 0."""
    if not values.any():
        return 0.0
    total = math.fsum(values.tolist())  # correctly rounded
    return math.nextafter(total, math.inf) if math.isfinite(total) else math.inf


def proven(twice_the_gap: Array, oscillation: Array, left: float) -> Proven:
    """The bounds from upper bounds of what adds to twice the gap, of osc² on cells, and of ‖y − σ_h‖.

    Raises:
        InputError: If one of them is not finite.
    """
    gap, square = total_above(twice_the_gap), total_above(oscillation)
    if not np.isfinite(gap + square + left):
        raise InputError("the data have no certain finite bounds, or not finite gradients, near Γ_D or Γ_S")
    return Proven(
        bound=total_above(np.array([root_above(gap), root_above(square), left])),
        sigma_bound=total_above(np.array([root_above(total_above(np.array([gap, square]))), left])),
        gap=gap / 2,
        oscillation=root_above(square),
        remainder=left,
    )


def root_above(value: float) -> float:
    """A float not below √value."""
    if value == 0:
        return 0.0
    return math.nextafter(math.sqrt(value), math.inf) if math.isfinite(value) else math.inf


@dataclass(frozen=True)
class BareCells:
    """Simplices of which the vertices are known.

    Attributes:
        vertices: Their vertices, shape (cells, d + 1, d).
    """

    vertices: Array

    @property
    def dim(self) -> int:
        """The dimension d."""
        return self.vertices.shape[2]


@dataclass(frozen=True)
class Simplices(BareCells):
    """Cells and their geometry.

    Attributes:
        measure: |T|.
        gradients: Gradients of the barycentric coordinates, shape (cells, d + 1, d).
    """

    measure: Interval
    gradients: Interval

    def some(self, which: Indices) -> "Simplices":
        """The geometry of some of the cells."""
        return Simplices(self.vertices[which], self.measure[which], self.gradients[which])


def simplices(vertices: Array) -> Simplices:
    """Cells with these vertices and their geometry.

    Raises:
        InputError: If a cell is so flat that the sign of its volume is lost in rounding.
    """
    dim = vertices.shape[2]
    x = enclosing(vertices)
    edges = [x[:, k] - x[:, 0] for k in range(1, dim + 1)]
    if dim == 2:
        (a, b), (c, d) = ((edge[..., 0], edge[..., 1]) for edge in edges)
        determinant = a * d - b * c
        normals = [stacked([d, -c]), stacked([-b, a])]
    else:
        normals = [cross(edges[1], edges[2]), cross(edges[2], edges[0]), cross(edges[0], edges[1])]
        determinant = total(edges[0] * normals[0])
    if ((determinant.lo <= 0) & (determinant.hi >= 0)).any():
        raise InputError("a cell of the mesh is flat up to rounding")
    across = determinant[:, None]
    gradients = [normal / across for normal in normals]
    size = Interval(np.minimum(abs(determinant.lo), abs(determinant.hi)), determinant.largest)
    return Simplices(
        vertices,
        size / math.factorial(dim),
        stacked([-sum(gradients[1:], gradients[0]), *gradients], axis=1),
    )


def cross(a: Interval, b: Interval) -> Interval:
    """The products a×b in space."""
    (a0, a1, a2), (b0, b1, b2) = ([each[..., i] for i in range(3)] for each in (a, b))
    return stacked([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def facet_measures(corners: Array) -> Interval:
    """|e| of facets with these vertices, shape (…, d, d)."""
    x = enclosing(corners)
    spans = [x[..., k, :] - x[..., 0, :] for k in range(1, corners.shape[-2])]
    if len(spans) == 1:
        return root(total(squared(spans[0])))
    return root(total(squared(cross(*spans)))) / 2.0


def with_midpoints(vertices: Interval) -> Interval:
    """Values of linear functions in the nodes of P2, from those in the vertices (axis 1)."""
    dim = vertices.lo.shape[1] - 1
    middle = [(vertices[:, i] + vertices[:, j]) / 2.0 for i, j in EDGES[dim]]
    return stacked([*(vertices[:, k] for k in range(dim + 1)), *middle], axis=1)


def gradient_in_vertices(cells: Simplices, values: Interval) -> Interval:
    """∇v in the vertices, shape (cells, d + 1, d), of a quadratic with these values in the nodes of P2."""
    dim = cells.dim
    slopes = [cells.gradients[:, i] for i in range(dim + 1)]
    columns = []
    for k in range(dim + 1):
        terms = [values[:, i, None] * slopes[i] * (3.0 if i == k else -1.0) for i in range(dim + 1)]
        for number, (i, j) in enumerate(EDGES[dim]):
            if k in (i, j):
                terms.append(values[:, dim + 1 + number, None] * slopes[j if i == k else i] * 4.0)
        columns.append(sum(terms[1:], terms[0]))
    return stacked(columns, axis=1)


def flux_in_vertices(cells: Simplices, fluxes: Interval) -> Interval:
    """RT0 fields y in the vertices, shape (cells, d + 1, d), from outward fluxes; facet i is opposite to vertex i.

    y(x) = Σ_i Φ_i (x − x_i)/(d|T|): its normal component is constant on facets, and its divergence ΣΦ_i/|T|.
    """
    x = enclosing(cells.vertices)
    columns = []
    for k in range(cells.dim + 1):
        arms = x[:, k, None, :] - x
        columns.append(total(fluxes[:, :, None] * arms, axis=1) / (cells.measure * float(cells.dim))[:, None])
    return stacked(columns, axis=1)


def node_ends(dim: int) -> list[tuple[int, int]]:
    """The two vertices to which each node of P2 belongs, and its coefficient; that of a vertex twice."""
    return [(k, k) for k in range(dim + 1)] + list(EDGES[dim])


def _exponents(dim: int) -> Indices:
    """α of λ^α for each coefficient of a quadratic."""
    return np.array([np.bincount(pair, minlength=dim + 1) for pair in node_ends(dim)])


def mean_square(values: Interval, dim: int, to_coefficients: Array | None = None) -> Interval:
    """Mean squares over simplices of quadratics, scalar or with components as last axis.

    Args:
        values: Their coefficients in Bernstein's basis, shape (n, nodes, …).
        dim: Of the simplices.
        to_coefficients: A matrix, exact in floats, that makes these of `values`, if they are other numbers.
    """
    # times 24 (dim + 4 choose dim) the means of the products of the basis are whole numbers
    alpha, factorials = _exponents(dim), np.array([1.0, 1.0, 2.0, 6.0, 24.0])
    weights = 2 / factorials[alpha].prod(axis=1)
    products = factorials[alpha[:, None] + alpha].prod(axis=2) * weights[:, None] * weights
    if to_coefficients is not None:
        products = to_coefficients.T @ products @ to_coefficients
    values = values if values.lo.ndim > 2 else values[..., None]
    square = enclosing(np.zeros(len(values.lo)))
    for i, row in enumerate(products):
        square = square + total(values[:, i] * total(values * row[:, None], axis=1))
    positive = Interval(np.maximum(square.lo, 0.0), np.maximum(square.hi, 0.0))
    return positive / float(24 * math.comb(dim + 4, dim))


def square_norm(cells: Simplices, nodes: Interval) -> Interval:
    """∫|q|² per cell, for a quadratic q, scalar or with components as last axis, from its values in the nodes of P2."""
    dim = cells.dim
    to_coefficients = np.diag(np.where(np.arange(len(node_ends(dim))) > dim, 2.0, 1.0))
    to_coefficients[dim + 1 :, : dim + 1] = -_exponents(dim)[dim + 1 :] / 2
    return mean_square(nodes, dim, to_coefficients) * cells.measure


def mean(nodes: Interval, dim: int) -> Interval:
    """Mean of a quadratic over simplices of this dimension, 1, 2 or 3, from its values in the nodes of P2."""
    vertices, middle = total(nodes[:, : dim + 1]), total(nodes[:, dim + 1 :])
    return (vertices * (2.0 - dim) + middle * 4.0) / float((dim + 1) * (dim + 2))


def means_with_hats(coefficients: Interval, dim: int) -> Interval:
    """Means of quadratics times the hats of the vertices, from their coefficients, shape (n, dim + 1)."""
    weights = 1 + _exponents(dim).T.astype(np.float64)
    return total(coefficients[:, None] * weights) / float((dim + 3) * math.comb(dim + 2, dim))


def bernstein(nodes: Interval, dim: int) -> Interval:
    """Bernstein coefficients of a quadratic: its values in the vertices, and 2q_m − (q_i + q_j)/2 for each edge."""
    columns = [nodes[:, k] for k in range(dim + 1)]
    columns += [
        nodes[:, dim + 1 + number] * 2.0 - (columns[i] + columns[j]) / 2.0 for number, (i, j) in enumerate(EDGES[dim])
    ]
    return stacked(columns)
