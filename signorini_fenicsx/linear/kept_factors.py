"""A system under one set after another; the factorisation of one serves the sets that differ from it at few sites.

Let K be the matrix without conditions, and w the solution under the factorised set with the present load. The solution
under another set is w + Σ c_j d_j with one d_j for each site j that changes:

- j is free now: d_j is 1 there, 0 where else the factorised set fixes, and without force elsewhere; c_j is such that
  the force at j is the load's.
- j is fixed now: d_j is what a force at j alone does; c_j is such that the whole is 0 at j. Another load at j, or
  other springs, is another c_j, too, and so is a share of the force at another site.

Of w and of the d_j only p and the forces at the sites are kept. So these need no solve under a set whose sites have all
changed before, and the solution needs one, by the factors. The d_j of sites that change for the first time are solved
for together, which costs a third of a solve for each, or less.
"""

from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix, Imposed
from signorini_fenicsx.linear.earlier import EarlierSolutions
from signorini_fenicsx.linear.facet_solver import TO_THE_END, FacetSolver
from signorini_fenicsx.linear.gmres import DIRECTIONS, gmres
from signorini_fenicsx.linear.patch import Patch

MOST = {2: 40, 3: 200}
"""For each dimension, where more sites change for the first time a factorisation costs less; in space it costs more."""
FACTORISATION = 10
"""About as many solves take as long as a factorisation."""
WORTH = 20
"""So many steps of GMRES by the factors of another set cost less than a factorisation."""
RESTART = 50
"""Steps after which GMRES begins anew, for the sake of memory."""
TOGETHER = 64
"""So many right sides are solved for at once; more would take memory and save no time."""
MOST_KEPT = 1000
"""So many sites at most have changed; their equations are on every rank."""


class KeptFactors:
    """The solver with 0 at some sites, by the last factorisation if there is one that serves.

    Attributes:
        earlier: Solutions of earlier problems, from which iterations may start.
        by_gmres: Whether GMRES by factors of another set may take the place of a factorisation.
        keeps: Whether a factorisation may serve other sets; if not, none is kept.
        repeated: How often one set that is not that of the factorisation was solved for in a row, which takes two
            solves each time.
    """

    keeps = True
    by_gmres = True
    repeated = 0

    def __init__(
        self,
        solver: FacetSolver[Any],
        operator: ConstrainedMatrix,
        fixed: npt.NDArray[np.int32],
        sites: npt.NDArray[np.int32],
        dim: int,
        near: Indices,
        pressing: Indices,
    ):
        """Keep nothing yet (collective).

        Args:
            solver: What may factorise.
            operator: K, as `natural`, and its matrix.
            fixed: Owned unknowns that are fixed under all sets.
            sites: Owned unknown of each site.
            dim: Dimension of the mesh.
            near: The sites to which springs of each site may go, shape (sites, near).
            pressing: The sites of which each one may have shares of the forces, shape (sites, others).
        """
        self._solver, self._operator, self._natural = solver, operator, operator.natural
        self._fixed, self._unknowns = fixed, sites
        self._near, self._pressing = near, pressing
        self._comm: MPI.Comm = self._natural.getComm().tompi4py()
        self._x, self._b = self._natural.createVecs()
        self._w = self._x.duplicate()
        self._most = self._more = MOST[dim]
        self.earlier = EarlierSolutions()
        self._kept: Imposed | None = None
        self._present: Imposed | None = None  # with the matrix of the solver

    def essential(self, held: Mask) -> npt.NDArray[np.int32]:
        """The unknowns that are fixed if these sites are held."""
        return np.concatenate([self._fixed, self._unknowns[held]])

    def solve_by_any(self, load: Array, x: PETSc.Vec, imposed: Imposed) -> tuple[int, bool]:
        """Solve by factors that are kept, or else anew: iterations, and whether they went to the end (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        if self.repeated > FACTORISATION:
            self.forget()
        return (1, True) if self.solve(load, x, imposed) else self.solve_anew(load, x, imposed)

    def solve_anew(self, load: Array, x: PETSc.Vec, imposed: Imposed) -> tuple[int, bool]:
        """Set the solver up and solve (collective).

        Args:
            load: Right side without conditions, of the owned unknowns.
            x: Gets the solution; an iteration starts from it.
            imposed: What is imposed at the sites.

        Returns:
            The number of iterations, and whether they went to the end.

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        if self._is_near(imposed):
            ended = self.coupled(load, x, imposed, self._solver.share, WORTH)
            if ended[0] < WORTH:
                return ended
        essential = self.impose(imposed)
        if self._comm.allreduce(bool(imposed.shares.any()), MPI.LOR):
            ended = self.coupled(load, x, imposed, self._solver.share)
        else:
            self._b.array_w[:] = load
            for vector in (self._b, x):
                vector.array_w[essential] = 0.0
            self.earlier.combine(self._operator.matrix, self._b, x, essential)
            self._solver.solve(self._b, x)
            ended = self._solver.ksp.getIterationNumber(), self._solver.converged or self._solver.factorises
        if self._solver.factorises and self.keeps:
            self.keep(imposed.symmetric)
        return ended

    def solve_on(self, patch: Patch, load: Array, x: PETSc.Vec, imposed: Imposed) -> None:
        """Change x on a patch so that the equations hold there, without shares (collective).

        Raises:
            LinearSolveFailure: If the factorisation fails.
        """
        self._present, self._kept = None, None  # multigrid does not see these conditions
        essential = self._to_matrix(imposed)
        self._b.array_w[:] = load
        self._b.array_w[essential] = 0.0
        patch.solve(self._operator.matrix, self._b, x)

    def _is_near(self, imposed: Imposed) -> bool:
        """Whether GMRES may come to the end sooner by factors that are kept than by new ones (collective)."""
        if self._kept is None or not self.by_gmres:
            return False
        moved = self._comm.allreduce(int(np.count_nonzero(imposed.held != self._kept.held)))  # one step for each
        return bool(moved < WORTH / 2)

    def impose(self, imposed: Imposed) -> npt.NDArray[np.int32]:
        """Give the solver its matrix, but for the shares; return the unknowns that are fixed (collective)."""
        essential, imposed = self.essential(imposed.held), imposed.symmetric
        same = self._present is not None and not imposed.differ(self._present).any()
        if not self._comm.allreduce(same, MPI.LAND):
            self._present = imposed
            self._to_matrix(imposed)
            if self._solver.levels is not None:
                with self._solver.options():
                    self._solver.levels.update(self._fixed, essential)
        return essential

    def _to_matrix(self, imposed: Imposed) -> npt.NDArray[np.int32]:
        """Give the matrix what is imposed, but for the shares; return the unknowns that are fixed (collective)."""
        essential, (rows, column) = self.essential(imposed.held), np.nonzero(imposed.springs)
        others = self._unknowns[self._near[rows, column]]
        self._operator.impose(essential, self._unknowns[rows], imposed.springs[rows, column], others)
        return essential

    def coupled(
        self, load: Array, x: PETSc.Vec, imposed: Imposed, share: float, most: int = DIRECTIONS
    ) -> tuple[int, bool]:
        """Solve by GMRES with the present preconditioner, which may be that of another matrix (collective).

        Args:
            load: Right side without conditions, of the owned unknowns.
            x: Where GMRES starts; gets the solution.
            imposed: What is imposed at the sites.
            share: GMRES leaves this share of what there is at its start, or what solves to the end leave.
            most: Steps at most.

        Returns:
            The number of steps, and whether they went to the end.

        Raises:
            LinearSolveFailure: If PETSc gives up.
        """
        essential, preconditioner = self.essential(imposed.held), self._solver.preconditioner()
        assert self._present is not None
        freed = self._present.held & ~imposed.held

        def product(values: Array) -> Array:
            self._x.array_w[:] = values
            return -self.left(0.0, self._x, imposed)

        def precondition(values: Array) -> Array:
            self._b.array_w[:] = values
            preconditioner.apply(self._b, self._x)
            step = np.array(self._x.array_r)
            step[self._unknowns[freed]] /= self._diagonal[freed]
            step[essential] = 0.0
            return step

        (load := load.copy())[essential] = x.array_w[essential] = 0.0
        left = self.left(load, x, imposed)
        size, at_start = np.sqrt(self._comm.allreduce(np.array([load @ load, left @ left]))).tolist()
        if at_start <= TO_THE_END * size:
            return 0, True
        enough = TO_THE_END * size / at_start
        step, steps, reached = gmres(self._comm, product, left, precondition, RESTART, max(share, enough), most)
        x.array_w[:] = x.array_r + step
        return steps, share <= enough and reached

    def left(self, load: Array | float, x: PETSc.Vec, imposed: Imposed) -> Array:
        """What x leaves of this right side, 0 where the solution is fixed (collective)."""
        self._operator.mult(x, self._b)
        left: Array = load - self._b.array_r
        left[self._unknowns] -= self._pulls(imposed, x.array_r[self._unknowns], self._b.array_r[self._unknowns])
        left[self.essential(imposed.held)] = 0.0
        return left

    def _pulls(self, imposed: Imposed, p: Array, forces: Array, at: Indices | slice = slice(None)) -> Array:
        """What springs, and shares of other forces, add to the forces at sites; shapes (…, sites)."""
        pulls = np.einsum("sn,...sn->...s", imposed.springs[at], p[..., self._near[at]])
        shares = np.einsum("sn,...sn->...s", imposed.shares[at], forces[..., self._pressing[at]])
        return np.asarray(pulls + shares)

    @cached_property
    def _rows(self) -> PETSc.Mat:
        """The rows of K at the sites (collective when first used)."""
        return self._operator.rows(self._unknowns)

    @cached_property
    def _forces(self) -> PETSc.Vec:
        """Space for a number per site."""
        return self._rows.createVecLeft()

    @property
    def present(self) -> bool:
        """Whether a factorisation is kept."""
        return self._kept is not None

    def serve_more(self) -> None:
        """Another problem has the same K: as much again is worth it for factors that serve all sets."""
        self._most += self._more

    def forget(self) -> None:
        """The matrix of the solver is another one."""
        self._kept = None

    def take_natural(self) -> None:
        """K has other entries; earlier solutions stay."""
        self._kept = self._present = None
        self._most = self._more
        for name in ("_rows", "_diagonal"):
            vars(self).pop(name, None)

    def keep(self, imposed: Imposed) -> None:
        """Keep the factorisation that the solver has just made, with this imposed, which has no shares."""
        self._essential, self._kept = self.essential(imposed.held), imposed
        self._changed: Indices = np.empty(0, dtype=np.int64)  # own sites with a d_j, and the j of each
        self._number: Indices = np.empty(0, dtype=np.int64)
        self._of_moves: Array = np.empty((0, 2, len(imposed.held)))  # p and the forces at the sites for each j
        self._load: Array | None = None
        self._last, self.repeated = imposed, 0

    def at_sites(self, load: Array, imposed: Imposed) -> tuple[Array, Array] | None:
        """The solution and K times it, at the sites alone (collective).

        Args:
            load: Right side without conditions, of the owned unknowns.
            imposed: What is imposed at the sites.

        Returns:
            None if a factorisation costs less.

        Raises:
            LinearSolveFailure: If PETSc gives up.
        """
        if not self._serves(imposed):
            return None
        self._take(load, imposed.held)
        p, forces = self._of_load + np.tensordot(self._coefficients(load, imposed), self._of_moves, 1)
        return np.where(imposed.held, 0.0, p), forces

    def solve(self, load: Array, x: PETSc.Vec, imposed: Imposed) -> bool:
        """Solve by a factorisation that is kept, if that costs less than another one (collective).

        Args:
            load: Right side without conditions, of the owned unknowns.
            x: Gets the solution.
            imposed: What is imposed at the sites.

        Returns:
            Whether it was solved.

        Raises:
            LinearSolveFailure: If PETSc gives up.
        """
        if not self._serves(imposed):
            return False
        assert self._kept is not None
        changes = np.zeros(len(imposed.held))
        others = [imposed.differ(each).any() for each in (self._kept, self._last)]
        kept = self._load is not None and np.delete(load == self._load, self._essential).all()
        flags = np.array([*others, not kept], dtype=bool)
        self._comm.Allreduce(MPI.IN_PLACE, flags, MPI.LOR)
        changed, is_new, is_other = flags.tolist()
        self._last, self.repeated = imposed, 0 if is_new or not changed else self.repeated + 1
        if not changed and not is_other:
            self._w.copy(x)
            return True
        if changed:
            self._take(load, imposed.held)
            assert self._load is not None
            changes[self._changed] = self._coefficients(load, imposed)[self._number]
            load = self._load
        moved, pulled = np.where(self._kept.held, changes, 0.0), np.where(self._kept.held, 0.0, changes)
        right = load - self._of_moved(moved)
        right[self._essential] = 0.0
        right[self._unknowns] += pulled * self._diagonal
        self._b.array_w[:] = right
        self._solver.solve(self._b, x)
        x.array_w[self._unknowns] += moved
        x.array_w[self._unknowns[imposed.held]] = 0.0
        return True

    @cached_property
    def _diagonal(self) -> Array:
        """The entries of K that are the size of forces at the sites."""
        return np.array(self._natural.getDiagonal().array_r[self._unknowns])

    def _serves(self, imposed: Imposed) -> bool:
        """Whether the last factorisation serves; then there is a d_j for each changed site (collective)."""
        if self._kept is None:
            return False
        changed = imposed.differ(self._kept)
        new = np.setdiff1d(np.flatnonzero(changed), self._changed)
        counts = np.array(self._comm.allgather(len(new)))
        if counts.sum() > self._most or len(self._of_moves) + counts.sum() > MOST_KEPT:
            return False
        if counts.sum() > 0:
            self._add(new, int(counts[: self._comm.rank].sum()), int(counts.sum()))
        return True

    def _take(self, load: Array, held: Mask) -> None:
        """Let `_of_load` be w at the sites, and the forces there (collective).

        The load at sites that are held makes no difference, and that at sites with a d_j is in its c_j.
        """
        if self._load is not None:
            differs = load != self._load
            differs[self._essential] = differs[self._unknowns[held]] = differs[self._unknowns[self._changed]] = False
        if self._comm.allreduce(self._load is None or bool(differs.any()), MPI.LOR):
            self._load, right = load.copy(), load.copy()
            right[self._essential] = 0.0
            self._w.array_w[:] = self._solver.solve_all(right[:, None])[:, 0]
            self._of_load = self._traces(self._w)

    def _traces(self, x: PETSc.Vec) -> Array:
        """A solution and K times it, at the sites (collective)."""
        return np.array([x.array_r[self._unknowns], self.forces(x)])

    def forces(self, x: PETSc.Vec) -> Array:
        """K times x at the sites (collective)."""
        self._rows.mult(x, self._forces)
        return np.array(self._forces.array_r)

    def _of_moved(self, moved: Array) -> Array:
        """The forces of what is this at the sites and 0 elsewhere, for the owned unknowns (collective)."""
        assert self._kept is not None
        self._forces.array_w[:] = moved
        self._rows.multTranspose(self._forces, self._b)
        forces = np.array(self._b.array_r)
        forces[self._unknowns] += np.einsum("sn,sn->s", self._kept.springs, moved[self._near])
        return forces

    def _add(self, sites: Indices, before: int, count: int) -> None:
        """Find d_j for new sites (collective).

        Args:
            sites: Those of this rank.
            before: How many there are on the ranks before.
            count: How many there are on all ranks.
        """
        assert self._kept is not None
        held = self._kept.held
        added = np.zeros((count, len(held)))
        added[before + np.arange(len(sites)), sites] = 1.0
        traces = []
        for begin in range(0, count, TOGETHER):
            several = added[begin : begin + TOGETHER]
            columns = np.zeros((self._natural.getLocalSize()[0], len(several)), order="F")
            for column, moved in enumerate(np.where(held, several, 0.0)):
                columns[:, column] = -self._of_moved(moved)
            columns[self._essential] = 0.0
            columns[self._unknowns] += (np.where(held, 0.0, several) * self._diagonal).T
            solutions = self._solver.solve_all(columns)
            for column, moved in enumerate(np.where(held, several, 0.0)):
                self._x.array_w[:] = solutions[:, column]
                self._x.array_w[self._unknowns] += moved
                traces.append(self._traces(self._x))
        first = len(self._of_moves)
        self._changed = np.append(self._changed, sites)
        self._number = np.append(self._number, first + before + np.arange(len(sites)))
        self._of_moves = np.concatenate([self._of_moves, traces])

    def _coefficients(self, load: Array, imposed: Imposed) -> Array:
        """The coefficients c_j of all sites (collective)."""
        assert self._kept is not None
        assert self._load is not None
        changed = self._changed
        released, free = self._kept.held[changed], ~imposed.held[changed]

        def given(traces: Array) -> Array:
            p, forces = traces[..., 0, :], traces[..., 1, :]
            return np.where(free, forces[..., changed] + self._pulls(imposed, p, forces, changed), p[..., changed])

        rows = given(self._of_moves).T
        wanted = np.where(free, load[self._unknowns[changed]], 0.0) - given(self._of_load)
        as_before = ~imposed.differ(self._kept)[changed]
        change = (load - self._load)[self._unknowns[changed]] / self._diagonal[changed]
        rows[as_before] = np.eye(len(self._of_moves))[self._number[as_before]]
        wanted[as_before] = np.where(released, 0.0, change)[as_before]
        size = np.abs(rows).max(axis=1, initial=0.0)
        gathered = self._comm.allgather(np.column_stack([self._number, rows / size[:, None], wanted / size]))
        system = np.concatenate(gathered)
        return np.linalg.solve(system[:, 1:-1], system[:, -1])  # the order of equations does not matter
