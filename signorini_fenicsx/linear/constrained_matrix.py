"""An assembled matrix with unknowns that are fixed in one step and free in another; its sparsity pattern stays."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Mask


@dataclass(frozen=True)
class Imposed:
    """What is imposed at the sites: 0, or the load, with springs.

    Attributes:
        held: Mask of the sites with 0.
        springs: Stiffness between each other site and those near it, shape (sites, near).
        shares: What shares of the forces at other sites each one has added to its own, shape (sites, others).
    """

    held: Mask
    springs: Array
    shares: Array

    @property
    def symmetric(self) -> Self:
        """What is imposed without the shares."""
        return replace(self, shares=np.zeros_like(self.shares))

    def differ(self, other: "Imposed") -> Mask:
        """The sites at which another thing is imposed; springs at sites that are held do nothing."""
        free = (self.springs != other.springs).any(axis=1) | (self.shares != other.shares).any(axis=1)
        return np.asarray((self.held != other.held) | (~self.held & free))


class ConstrainedMatrix:
    """A matrix that is assembled once, and a copy that the conditions of each step change.

    Attributes:
        natural: The matrix as it was assembled.
        matrix: The matrix under the conditions last imposed.
    """

    def __init__(self, form: fem.Form | PETSc.Mat, kind: PETSc.Mat.Option, basis: PETSc.Mat | None = None):
        """Assemble (collective).

        Args:
            form: Bilinear form, or blocks of them; or a matrix that is assembled.
            kind: A property on which PETSc may rely: SYMMETRIC or SPD.
            basis: T, if x with the unknowns Tx of the form are the unknowns; then the matrix is Tᵀ(…)T.
        """
        self._assembled = form if isinstance(form, PETSc.Mat) else assemble_matrix(form)
        self._assembled.assemble()
        self._basis = basis
        self.natural = self._assembled if basis is None else self._assembled.ptap(basis)
        self.matrix = self.natural.duplicate(copy=True)
        self.matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self.matrix.setOption(kind, True)
        self._copies = [(self.natural, self.matrix)]

    def in_blocks(self) -> PETSc.Mat:
        """A copy of a symmetric `matrix`, one triangle in blocks, that takes all conditions from now on (collective).

        Products take half of the time, also those with `natural`, which is not to be renewed then.
        """
        self.natural.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        natural = self.natural.convert("sbaij", PETSc.Mat())
        matrix = natural.duplicate(copy=True)
        matrix.setOption(PETSc.Mat.Option.IGNORE_LOWER_TRIANGULAR, True)
        self._copies.append((natural, matrix))
        return matrix

    def renew(self, form: fem.Form) -> None:
        """Assemble again, a form with the same sparsity pattern (collective)."""
        assemble_again(self._assembled, form, self._basis, self.natural)

    def take_natural(self) -> None:
        """Take over other entries of `natural`, also into copies in blocks (collective)."""
        for natural, _ in self._copies[1:]:
            self.natural.convert("sbaij", natural)

    def mult(self, x: PETSc.Vec, product: PETSc.Vec) -> None:
        """Let a vector be `natural` times x (collective)."""
        natural, _ = self._copies[-1]
        natural.mult(x, product)

    def image(self, x: PETSc.Vec) -> npt.NDArray[np.float64]:
        """`natural` times x, for the owned unknowns (collective)."""
        product = self.natural.createVecLeft()
        self.mult(x, product)
        found = np.array(product.array_r)
        product.destroy()
        return found

    def rows(self, unknowns: npt.NDArray[np.int32]) -> PETSc.Mat:
        """The rows of `natural` for some owned unknowns, each once (collective)."""
        rows = (unknowns + self.natural.getOwnershipRange()[0]).astype(PETSc.IntType)
        return self.natural.createSubMatrix(PETSc.IS().createGeneral(rows, comm=self.natural.getComm()))

    def impose(
        self,
        essential: npt.NDArray[np.int32],
        rows: npt.NDArray[np.int32],
        added: npt.ArrayLike,
        columns: npt.NDArray[np.int32] | None = None,
    ) -> None:
        """Start again from `natural`, add to entries that there are, and fix unknowns (collective).

        Args:
            essential: Owned unknowns that get an identity row and column.
            rows: Owned unknowns in whose rows something is added.
            added: What is added; one value, or one for each.
            columns: Owned unknowns in whose columns it is added; None for the diagonal.
        """
        first = self.matrix.getOwnershipRange()[0]
        pairs = rows, rows if columns is None else columns
        places = [(each + first).astype(PETSc.IntType)[:, None] for each in pairs]
        values = np.broadcast_to(added, rows.shape)[:, None].copy()
        for natural, matrix in self._copies:
            natural.copy(matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            matrix.setValuesRCV(*places, values, addv=True)
            matrix.assemble()
            matrix.zeroRowsColumns(essential + first)


def image_of(matrix: PETSc.Mat, values: Array, *, transposed: bool = False) -> Array:
    """The product of a matrix, or of its transpose, with values of the owned unknowns (collective)."""
    right, left = matrix.createVecs()
    start, image = (left, right) if transposed else (right, left)
    start.array_w[:] = values
    (matrix.multTranspose if transposed else matrix.mult)(start, image)
    found = np.array(image.array_r)
    for vector in (right, left):
        vector.destroy()
    return found


def assemble_again(assembled: PETSc.Mat, form: fem.Form, basis: PETSc.Mat | None, natural: PETSc.Mat) -> None:
    """Assemble a matrix again by a form with the same sparsity pattern, and Tᵀ(…)T of it if there is a T (collective).

    Args:
        assembled: The matrix of the form.
        form: The form.
        basis: T, see `ConstrainedMatrix`.
        natural: With a basis the product, else `assembled` itself.
    """
    assembled.zeroEntries()
    assemble_matrix(assembled, form)  # type: ignore[arg-type]  # of the overloads mypy sees the first
    assembled.assemble()
    if basis is not None:
        assembled.ptap(basis, natural)
