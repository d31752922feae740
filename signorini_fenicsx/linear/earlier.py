"""Solutions of earlier problems, from which an iterative solve of the next one starts."""

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array

MOST = 3
"""So many solutions are remembered; with steps in time a start from three is at least as near as a parabola."""
DEPENDENT = 1e-12
"""Combinations whose energy is below this share of the largest are rounding."""


class EarlierSolutions:
    """The last solutions, as x_n and its backward differences x_n − x_(n−1), x_n − 2x_(n−1) + x_(n−2).

    These span what the solutions span, and stay far from linearly dependent where the steps are small.
    """

    def __init__(self) -> None:
        self._differences: list[Array] = []
        self._fresh = False

    def add(self, x: PETSc.Vec) -> None:
        """Remember a solution; the next `combine` starts from it and those before."""
        self._fresh = True
        differences = [x.array_r.copy()]
        for before in self._differences[: MOST - 1]:
            differences.append(differences[-1] - before)
        self._differences = differences

    def combine(self, matrix: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec, fixed: npt.NDArray[np.int32]) -> None:
        """Make of x, in place, the combination nearest in energy to the solution of a system (collective).

        0 is one of the combinations, so no start is worse than that from 0. It is for the first system after a solution
        was remembered; in others x stays.

        Args:
            matrix: Symmetric and positive definite, with rows of the identity for what is fixed.
            b: The right side.
            x: Has the values of what is fixed already; these stay.
            fixed: Owned unknowns that are fixed.
        """
        if not self._fresh:
            return
        self._fresh = False
        fixed_values, free = x.array_r[fixed].copy(), b.array_r.copy()
        free[fixed] = 0.0
        products = [self._products(free)]
        free_part, image = matrix.createVecs()
        for difference in self._differences:
            free_part.array_w[:] = difference
            free_part.array_w[fixed] = 0.0
            matrix.mult(free_part, image)
            image.array_w[fixed] = 0.0
            products.append(self._products(image.array_r))
        loads, *energies = b.getComm().tompi4py().allreduce(np.array(products))
        sizes = np.sqrt(np.diagonal(energies))
        sizes[sizes == 0] = 1.0
        shares = np.linalg.lstsq(energies / np.outer(sizes, sizes), loads / sizes, rcond=DEPENDENT)[0] / sizes
        x.set(0.0)
        for share, difference in zip(shares, self._differences, strict=True):
            x.array_w[:] += share * difference
        x.array_w[fixed] = fixed_values
        for vector in (free_part, image):
            vector.destroy()

    def _products(self, values: Array) -> list[float]:
        return [float(difference @ values) for difference in self._differences]
