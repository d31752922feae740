"""A two-level multigrid: a smoother on the facets, a solver on conforming P1. The facet systems share it."""

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc


class TwoLevel:
    """A PCMG with two levels. What conditions fix is left out of the interpolation.

    Attributes:
        interpolation: The interpolation in use.
        coarse: The solver on P1.
    """

    def __init__(self, pc: PETSc.PC, interpolation: PETSc.Mat, smoother: str):
        """Make `pc` a two-level multigrid, still without a coarse operator (collective).

        Args:
            pc: The preconditioner.
            interpolation: From P1 to the facets, without conditions.
            smoother: Type of the preconditioner of Chebyshev's iteration on the facets.
        """
        self._pc, self._full = pc, interpolation
        self.interpolation = interpolation.duplicate(copy=True)
        pc.setMGLevels(2)
        pc.setMGInterpolation(1, self.interpolation)
        pc.getMGSmoother(1).setType("chebyshev")
        pc.getMGSmoother(1).getPC().setType(smoother)
        self.coarse = pc.getMGCoarseSolve()
        self.coarse.setType("preonly")
        self.coarse.getPC().setType("gamg")

    def leave_out(self, facets: npt.NDArray[np.int32], vertices: npt.NDArray[np.int32]) -> None:
        """Let the interpolation be 0 for these owned unknowns and from those (collective)."""
        keep_vertices, keep_facets = self._full.createVecs()
        for keep, out in ((keep_vertices, vertices), (keep_facets, facets)):
            keep.set(1.0)
            keep.array_w[out] = 0.0
        self._full.copy(self.interpolation, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.interpolation.diagonalScale(keep_facets, keep_vertices)
        self._pc.setMGInterpolation(1, self.interpolation)


def facet_vertices(vertices: fem.FunctionSpace, facets: fem.FunctionSpace) -> npt.NDArray[np.int32]:
    """Blocks of P1 at the vertices of each owned facet, shape (facets, d).

    Args:
        vertices: P1.
        facets: Crouzeix-Raviart functions on the same mesh.
    """
    of_cell, rows = facets.dofmap.list, facets.dofmap.index_map
    of_facet = np.empty((rows.size_local + rows.num_ghosts, of_cell.shape[1] - 1), dtype=np.int32)
    for facet in range(of_cell.shape[1]):  # facet i of a cell lies opposite to its vertex i
        of_facet[of_cell[:, facet]] = np.delete(vertices.dofmap.list, facet, axis=1)
    return of_facet[: rows.size_local]
