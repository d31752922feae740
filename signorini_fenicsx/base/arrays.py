"""Types of NumPy arrays.

*Determinants, inverses and products with many small matrices, several times faster than by `numpy.linalg`*.

They are fast if the entries of one kind are one after the other in memory: arrays in Fortran's order, the number of the
matrix first. Then each step of `einsum` runs along the matrices; along their rows of two or three it takes several
times as long.
"""

import numpy as np
import numpy.typing as npt

type Array = npt.NDArray[np.float64]
type Indices = npt.NDArray[np.int64]
type AnyIndices = npt.NDArray[np.integer]
type Mask = npt.NDArray[np.bool_]


def determinants(matrices: Array) -> Array:
    """Determinants of matrices of shape (n, d, d) with d ≤ 3."""
    m = np.moveaxis(matrices, 0, -1)
    if len(m) == 1:
        return np.asarray(m[0, 0])
    if len(m) == 2:
        return np.asarray(m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0])
    return np.asarray(sum(m[0, j] * _minor(m, 0, j) for j in range(3)))


def inverses(matrices: Array) -> Array:
    """Inverses of matrices of shape (n, d, d) with d = 2 or 3; not finite where there is none."""
    m, inverse = np.moveaxis(matrices, 0, -1), np.empty(matrices.shape, order="F")
    for i, j in np.ndindex(len(m), len(m)):
        inverse[:, j, i] = _minor(m, i, j) if len(m) == 3 else (-1) ** (i + j) * m[1 - i, 1 - j]
    inverse /= determinants(matrices)[:, None, None]
    return inverse


def positions(listed: AnyIndices, wanted: AnyIndices) -> npt.NDArray[np.intp]:
    """Where some numbers are among listed ones, in any order, of which each is there once."""
    order = np.argsort(listed)
    return order[np.searchsorted(listed, wanted, sorter=order)]


def rows_of(wanted: Indices, known: Indices) -> Indices:
    """The number of each wanted row in another array, −1 if it is not there."""
    _, number = np.unique(np.concatenate([known, wanted]), axis=0, return_inverse=True)
    row = np.full(int(number.max(initial=-1)) + 1, -1)
    row[number[: len(known)]] = np.arange(len(known))
    return row[number[len(known) :]]


def gathered(values: Array, numbers: npt.NDArray[np.int32]) -> Array:
    """values[numbers] for numbers of shape (n, …), in Fortran's order."""
    return values.take(numbers.T).T


def times(vectors: Array, matrices: Array) -> Array:
    """Bᵀx for vectors of shape (cells, n, dim) and a matrix B per cell, or one for all; shape (cells, n, columns)."""
    of_cells = np.broadcast_to(matrices, (len(vectors), *matrices.shape[-2:]))
    return np.asarray(np.einsum("cvi,cij->cvj", vectors, of_cells))


def squares_of(vectors: Array, matrix: Array) -> Array:
    """All x·Bx for vectors of shape (cells, n, dim) and a matrix B per cell, or one for all; shape (cells, n)."""
    return np.asarray(np.einsum("cvi,cvi->cv", times(vectors, matrix), vectors))


def scaled(kappa: Array, slope: Array) -> Array:
    """κ times vectors in points; κ is a number in each, or a matrix."""
    return kappa[:, :, None] * slope if kappa.ndim == 2 else np.asarray((kappa @ slope[..., None])[..., 0])


def inverted(kappa: Array) -> Array:
    """κ⁻¹ in points; infinite where there is none."""
    with np.errstate(all="ignore"):
        if kappa.ndim == 2:
            return 1 / kappa
        regular = np.linalg.det(kappa) != 0
        inverse = np.linalg.inv(np.where(regular[..., None, None], kappa, np.eye(kappa.shape[-1])))
        return np.where(regular[..., None, None], inverse, np.inf)


def _minor(m: Array, i: int, j: int) -> Array:
    """The determinant of a 3 × 3 matrix without row i and column j, with its sign."""
    (a, b), (c, d) = (((k + 1) % 3, (k + 2) % 3) for k in (i, j))
    return np.asarray(m[a, c] * m[b, d] - m[a, d] * m[b, c])
