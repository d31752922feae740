"""A small exact solve inside a large system: near a few unknowns, while all others stay unchanged."""

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from signorini_fenicsx.linear.petsc import LinearSolver, set_direct


class Patch:
    """The unknowns within some layers around given ones. A solve is one step of restricted additive Schwarz.

    Each rank has a patch around its own unknowns. The patch may contain unknowns of other ranks, but the rank changes
    only those that it owns.

    Attributes:
        size: Unknowns of all patches, over all ranks.
    """

    def __init__(self, matrix: PETSc.Mat, around: npt.NDArray[np.int32], layers: int):
        """Find the unknowns (collective).

        Args:
            matrix: A matrix with the system's sparsity pattern.
            around: Owned unknowns in the middle of the patch.
            layers: How many layers of cells around them belong to the patch.
        """
        first, end = matrix.getOwnershipRange()
        self._unknowns = PETSc.IS().createGeneral(first + around, comm=PETSc.COMM_SELF)
        matrix.increaseOverlap(self._unknowns, layers)
        self._unknowns.sort()
        indices = self._unknowns.getIndices()
        self.size = matrix.getComm().tompi4py().allreduce(len(indices))
        self._own = (indices >= first) & (indices < end)
        self._rows = indices[self._own] - first
        self._residual = matrix.createVecLeft()
        self._local = PETSc.Vec().createSeq(len(indices))
        self._correction = self._local.duplicate()
        self._scatter = PETSc.Scatter().create(self._residual, self._unknowns, self._local, None)
        self._solver = LinearSolver(None, "facet_", PETSc.COMM_SELF)
        set_direct(self._solver.ksp, "cholesky")

    def solve(self, matrix: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Change x on the patch so that the equations there hold (collective).

        Raises:
            LinearSolveFailure: If the factorisation fails.
        """
        matrix.mult(x, self._residual)
        self._residual.aypx(-1.0, b)
        self._scatter.scatter(self._residual, self._local)
        (block,) = matrix.createSubMatrices([self._unknowns], [self._unknowns])
        if len(self._own) > 0:
            self._solver.ksp.setOperators(block)
            self._solver.solve(self._local, self._correction)
            x.array_w[self._rows] += self._correction.array_r[self._own]
