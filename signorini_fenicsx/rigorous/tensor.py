"""Symmetric matrices, such as κ, on simplices, enclosed."""

import functools
import itertools

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.expressions.intervals import Interval, enclosing, larger
from signorini_fenicsx.rigorous.simplices import Simplices, root, squared, total, with_midpoints


class Tensor:
    """A symmetric matrix κ on simplices by its linear interpolant κ̃, a 1 × 1 matrix if it is a scalar.

    In elasticity it is the compliance, see `elasticity.theorem`.

    Attributes:
        theta: θ > 0 with LᵀκL ≥ θ.
        root_largest: Upper bound of √ of the largest eigenvalue.
    """

    def __init__(self, cells: Simplices, corners: Interval, deviation: Array, name: str = "kappa"):
        """Choose L, the inverse of the transposed Cholesky factor of κ̃ in the centroid.

        Args:
            cells: The cells.
            corners: κ̃ in their vertices, shape (cells, d + 1, size, size).
            deviation: Upper bound of |κ − κ̃| in the Frobenius norm, per cell.
            name: Name of κ in the case.

        Raises:
            InputError: If κ is not certainly positive definite, or varies too much within a cell.
        """
        self._corners, self._deviation = corners, deviation
        size = corners.lo.shape[-1]
        middle = corners.lo.mean(axis=1)
        smallest = np.linalg.eigvalsh(middle).min(axis=1)
        if not (smallest > 0).all():
            raise InputError(f"{name} is not positive {near(cells.vertices, smallest)}")
        lower = np.linalg.inv(np.linalg.cholesky(middle))
        self._half = enclosing(np.swapaxes(lower, -1, -2))
        self._half_size = total(total(squared(self._half)))
        scaled = _product(_product(enclosing(lower[:, None]), corners), self._half[:, None])
        if size == 1:
            least = scaled.lo[..., 0, 0].min(axis=1)
        else:
            least = (1.0 - root(total(total(squared(scaled - np.eye(size))))).hi).min(axis=1)
        self.theta = enclosing(least) - self._half_size * deviation
        if not (self.theta.lo > 0).all():
            where = near(cells.vertices, self.theta.lo)
            raise InputError(f"{name} varies too much within a cell {where}; choose a smaller h")
        of_rows = total(enclosing(corners.largest)).hi.max(axis=-1)
        largest = np.minimum(root(total(total(squared(corners)))).hi, of_rows).max(axis=1)
        self.root_largest = root(enclosing(largest) + deviation)
        self._cells = cells

    def times(self, slopes: Interval) -> Interval:
        """κ̃∇v in the nodes of P2, from ∇v there, shape (cells, nodes, d)."""
        return _applied(with_midpoints(self._corners), slopes)

    def half(self, field: Interval) -> Interval:
        """Lᵀq, shape (cells, nodes, d)."""
        return _applied(enclosing(np.swapaxes(self._half.lo, -1, -2)[:, None]), field)

    def deviation_norm(self, slopes: Interval) -> Interval:
        """Bound of ‖Lᵀ(κ − κ̃)∇v‖ per cell, from ‖∇v‖²."""
        return self.half_norm(slopes) * self._deviation

    def half_norm(self, squares: Interval) -> Interval:
        """Bound of ‖Lᵀq‖ per cell, from ‖q‖²."""
        return root(self._half_size * squares)

    @functools.cached_property
    def diameter(self) -> Interval:
        """ĥ: the longest edge in the coordinates Lᵀx."""
        x = self.half(enclosing(self._cells.vertices))
        pairs = itertools.combinations(range(self._cells.dim + 1), 2)
        squares = [total(squared(x[:, i] - x[:, j])) for i, j in pairs]
        return root(functools.reduce(larger, squares))


def near(vertices: Array, values: Array) -> str:
    """The place, in words, of the simplex with the smallest or a NaN value."""
    return f"near ({', '.join(f'{x:.4g}' for x in vertices[np.argmin(values)].mean(axis=0))})"


def _product(a: Interval, b: Interval) -> Interval:
    """The product of matrices in the last two axes, one column of the first after another, for the sake of memory."""
    terms = (a[..., :, k, None] * b[..., None, k, :] for k in range(a.lo.shape[-1]))
    return functools.reduce(Interval.__add__, terms)


def _applied(matrix: Interval, vector: Interval) -> Interval:
    """A matrix times a vector; a 1 × 1 matrix is a scalar."""
    if matrix.lo.shape[-1] == 1:
        return matrix[..., 0] * vector
    return _product(matrix, vector[..., None])[..., 0]
