"""A two-level multigrid: a smoother on the facets, a solver on conforming P1. The facet systems share it."""

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc

from signorini_fenicsx.base.owned import cell_dofs


class TwoLevel:
    """A PCMG with two levels. What conditions fix is left out of the interpolation.

    Attributes:
        interpolation: The interpolation in use.
        coarse: The solver on P1.
    """

    def __init__(self, pc: PETSc.PC, interpolation: PETSc.Mat):
        """Make `pc` a two-level multigrid, still without a coarse operator (collective).

        Args:
            pc: The preconditioner.
            interpolation: From P1 to the facets, without conditions.
        """
        self._pc, self._full = pc, interpolation
        self.interpolation = interpolation.duplicate(copy=True)
        pc.setMGLevels(2)
        pc.setMGInterpolation(1, self.interpolation)
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


def choose_smoother(pc: PETSc.PC, level: int, dim: int, *, jumps: bool = False) -> None:
    """Gauss-Seidel in the plane, Chebyshev's iteration with Jacobi in space, for scalar problems (collective).

    In the plane one sweep before the coarser levels and one after them take half the time of the other, and CG takes as
    many iterations; in space it takes more.

    Args:
        pc: A multigrid.
        level: The level.
        dim: Dimension of the domain.
        jumps: Whether some unknowns are jumps, so that those of both sides are unknowns of a cell.
    """
    if dim == 2:
        _smooth_by_sweeps(pc, level, 2 * (dim + 1) if jumps else dim + 1)
    else:
        pc.getMGSmoother(level).setType("chebyshev")
        pc.getMGSmoother(level).getPC().setType("jacobi")


def _smooth_by_sweeps(pc: PETSc.PC, level: int, unknowns_of_cell: int) -> None:
    """One sweep, forward before the coarser levels and backward after them (collective).

    On several ranks each sweeps over its own unknowns. Then M = D/ω + L, with L within the ranks, and the sweeps reduce
    every error if M + Mᵀ − A = (2/ω − 1)D − B is positive, with B the entries of A between ranks. A is a sum over cells
    of semidefinite matrices with n unknowns, whose entries are at most √(d_i d_j). So D + B ≤ nD, and ω = 2/n will do.
    With ω = 1 the preconditioner is indefinite at times.
    """
    options = PETSc.Options()
    omega = 1.0 if pc.getComm().size == 1 else 2 / unknowns_of_cell
    for smoother, direction in ((pc.getMGSmootherDown(level), "forward"), (pc.getMGSmootherUp(level), "backward")):
        smoother.setType("richardson")
        smoother.setTolerances(max_it=1)
        sweep = smoother.getPC()
        sweep.setType("sor")
        prefix = sweep.getOptionsPrefix()
        sweep.setOptionsPrefix("sweep_")  # petsc4py has no other way to these two
        settings = {f"sweep_pc_sor_local_{direction}": None, "sweep_pc_sor_omega": omega}
        for name, value in settings.items():
            options.setValue(name, value)
        sweep.setFromOptions()
        for name in settings:
            options.delValue(name)
        sweep.setOptionsPrefix(prefix)


def facet_vertices(vertices: fem.FunctionSpace, facets: fem.FunctionSpace) -> npt.NDArray[np.int32]:
    """Blocks of P1 at the vertices of each owned facet, shape (facets, d).

    Args:
        vertices: P1.
        facets: Crouzeix-Raviart functions on the same mesh.
    """
    of_cell, rows = cell_dofs(facets), facets.dofmap.index_map
    of_facet = np.empty((rows.size_local + rows.num_ghosts, of_cell.shape[1] - 1), dtype=np.int32)
    for facet in range(of_cell.shape[1]):  # facet i of a cell lies opposite to its vertex i
        of_facet[of_cell[:, facet]] = np.delete(cell_dofs(vertices), facet, axis=1)
    return of_facet[: rows.size_local]
