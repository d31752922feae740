"""The factorisation of one set serves the sets that differ from it at few sites.

Let K be the matrix without conditions, and w the solution under the factorised set with the present load. The solution
under another set is w + Σ c_j d_j with one d_j for each site j that changes:

- j is free now: d_j is 1 there, 0 where else the factorised set fixes, and without force elsewhere; c_j is such that
  the force at j is the load's.
- j is fixed now: d_j is what a force at j alone does; c_j is such that the whole is 0 at j.

So a set costs a solve by the factors, and one more for each site that did not change before. Both together cost less
than a factorisation.

`condensed` is this for the set with all sites free and every site changed: there only the traces of the d_j are kept,
so p and σ·n under any set need no solve, and the solution needs one.
"""

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.linear.petsc import LinearSolver

MOST = {2: 6, 3: 24}
"""For each dimension, with more changed sites a factorisation costs less. In space it costs far more."""


class KeptFactors:
    """Solves by the last factorisation, if there is one."""

    def __init__(self, solver: LinearSolver, natural: PETSc.Mat, sites: npt.NDArray[np.int32], dim: int):
        """Keep nothing yet (collective).

        Args:
            solver: What may factorise.
            natural: K.
            sites: Owned unknown of each site.
            dim: Dimension of the mesh.
        """
        self._solver, self._natural, self._unknowns = solver, natural, sites
        self._comm: MPI.Comm = natural.getComm().tompi4py()
        self._x, self._force = natural.createVecs()
        self._most = MOST[dim]
        self._held: Mask | None = None

    def forget(self) -> None:
        """The matrix of the solver is another one."""
        self._held = None

    def keep(self, fixed: npt.NDArray[np.int32], held: Mask) -> None:
        """The solver has just factorised for this set.

        Args:
            fixed: Owned unknowns that are fixed.
            held: The sites among them.
        """
        if self._solver.factorises:
            self._fixed, self._held = fixed, held
            self._changed: Indices = np.empty(0, dtype=np.int64)  # own sites with a d_j, and the j of each
            self._number: Indices = np.empty(0, dtype=np.int64)
            size = self._natural.getLocalSize()[0]
            self._moves, self._forces = np.empty((0, size)), np.empty((0, len(held)))

    def solve(self, load: Array, x: PETSc.Vec, held: Mask) -> bool:
        """Solve with 0 at the sites that are held, if that costs less than a factorisation (collective).

        Args:
            load: Right side without conditions, of the owned unknowns.
            x: Gets the solution.
            held: Mask of these sites.

        Returns:
            Whether it was solved.

        Raises:
            LinearSolveFailure: If PETSc gives up.
        """
        if self._held is None:
            return False
        new = np.setdiff1d(np.flatnonzero(held != self._held), self._changed)
        counts = self._comm.allgather(len(new))
        if len(self._moves) + sum(counts) > self._most:
            return False
        for rank, count in enumerate(counts):
            for site in new.tolist() if rank == self._comm.rank else [None] * count:
                self._add(site)
        self._by_factors(load)
        x.array_w[:] = self._x.array_r + self._shares(load, held) @ self._moves
        x.array_w[self._unknowns[held]] = 0.0
        return True

    def _by_factors(self, load: Array) -> None:
        """Let `_x` be the solution under the factorised set, and `_force` its forces (collective)."""
        self._force.array_w[:] = load
        self._force.array_w[self._fixed] = 0.0
        self._solver.solve(self._force, self._x)
        self._natural.mult(self._x, self._force)

    def _add(self, site: int | None) -> None:
        """Find d_j for a site of this rank, or None for one of another rank (collective)."""
        moved, load = self._x.duplicate(), self._x.duplicate()
        moved.set(0.0)
        load.set(0.0)
        diagonal = self._natural.getDiagonal().array_r
        if site is not None:
            assert self._held is not None
            unknown = self._unknowns[site]
            if self._held[site]:
                moved.array_w[unknown] = 1.0
            else:
                load.array_w[unknown] = diagonal[unknown]
            self._changed, self._number = np.append(self._changed, site), np.append(self._number, len(self._moves))
        self._natural.mult(moved, self._force)
        self._by_factors(load.array_r - self._force.array_r)
        self._x.axpy(1.0, moved)
        self._natural.mult(self._x, self._force)
        self._moves = np.vstack([self._moves, self._x.array_r])
        self._forces = np.vstack([self._forces, self._force.array_r[self._unknowns]])

    def _shares(self, load: Array, held: Mask) -> Array:
        """The coefficients c_j of all sites; 0 where a site is as in the factorised set (collective)."""
        assert self._held is not None
        unknowns = self._unknowns[self._changed]
        released = self._held[self._changed]
        rows = np.where(released, self._forces[:, self._changed], self._moves[:, unknowns]).T
        wanted = np.where(released, load[unknowns] - self._force.array_r[unknowns], -self._x.array_r[unknowns])
        as_before = held[self._changed] == released
        rows[as_before], wanted[as_before] = np.eye(len(self._moves))[self._number[as_before]], 0.0
        size = np.abs(rows).max(axis=1, initial=0.0)
        gathered = self._comm.allgather(np.column_stack([self._number, rows / size[:, None], wanted / size]))
        system = np.concatenate(gathered)
        found: Array = np.linalg.solve(system[:, 1:-1], system[:, -1])  # the order of equations does not matter
        return found
