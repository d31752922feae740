"""A system under one set after another; the factorisation of one serves the sets that differ from it at few sites.

Let K be the matrix without conditions, and w the solution under the factorised set with the present load. The solution
under another set is w + Σ c_j d_j with one d_j for each site j that changes:

- j is free now: d_j is 1 there, 0 where else the factorised set fixes, and without force elsewhere; c_j is such that
  the force at j is the load's.
- j is fixed now: d_j is what a force at j alone does; c_j is such that the whole is 0 at j. Another load at j, or
  another spring, is another c_j, too.

Of w and of the d_j only p and the forces at the sites are kept. So these need no solve under a set whose sites have all
changed before, and the solution needs one, by the factors. The d_j of sites that change for the first time are solved
for together, which costs a third of a solve for each, or less.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix
from signorini_fenicsx.linear.facet_solver import TO_THE_END, FacetSolver
from signorini_fenicsx.linear.gmres import Added, coupled

type Springs = Array | float
"""The stiffness of a spring at each site, or of all; 0 for none."""

MOST = {2: 40, 3: 64}
"""For each dimension, where more sites change for the first time a factorisation costs less; in space it costs more."""
MOST_KEPT = 300
"""So many sites at most have changed; their equations are on every rank."""


class KeptFactors:
    """Solves with 0 at some sites, by the last factorisation if there is one that serves.

    Attributes:
        repeated: How often one set that is not that of the factorisation was solved for in a row, which takes two
            solves each time.
    """

    def __init__(
        self,
        solver: FacetSolver[Any],
        operator: ConstrainedMatrix,
        fixed: npt.NDArray[np.int32],
        sites: npt.NDArray[np.int32],
        dim: int,
    ):
        """Keep nothing yet (collective).

        Args:
            solver: What may factorise.
            operator: K, as `natural`, and its matrix.
            fixed: Owned unknowns that are fixed under all sets.
            sites: Owned unknown of each site.
            dim: Dimension of the mesh.
        """
        self._solver, self._operator, self._natural = solver, operator, operator.natural
        self._fixed, self._unknowns = fixed, sites
        self._comm: MPI.Comm = self._natural.getComm().tompi4py()
        self._x, self._b = self._natural.createVecs()
        self._w = self._x.duplicate()
        self._most = self._more = MOST[dim]
        self._held: Mask | None = None
        self._plainly: tuple[Mask, Springs] | None = None  # sites held, and springs, of a matrix without blocks

    def essential(self, held: Mask) -> npt.NDArray[np.int32]:
        """The unknowns that are fixed if these sites are held."""
        return np.concatenate([self._fixed, self._unknowns[held]])

    def solve_anew(
        self,
        load: Array,
        x: PETSc.Vec,
        held: Mask,
        springs: Springs,
        blocks: Sequence[tuple[npt.NDArray[np.int32], Array]],
    ) -> None:
        """Set the solver up and solve with 0 at the sites that are held (collective).

        Args:
            load: Right side without conditions, of the owned unknowns.
            x: Gets the solution; an iteration starts from it.
            held: Mask of these sites.
            springs: The stiffness of a spring at each site, 0 for none.
            blocks: What else is added to the matrix, see `ConstrainedMatrix.impose`.

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        essential, plain = self.impose(held, springs, blocks)
        self._b.array_w[:] = load
        for vector in (self._b, x):
            vector.array_w[essential] = 0.0
        self._solver.solve(self._b, x)
        if plain and self._solver.factorises:
            self.keep(held, springs)

    def impose(
        self, held: Mask, springs: Springs, blocks: Sequence[tuple[npt.NDArray[np.int32], Array]]
    ) -> tuple[npt.NDArray[np.int32], bool]:
        """Give the solver its matrix; return the unknowns that are fixed, and whether nothing is added (collective)."""
        essential, plain = self.essential(held), not self._comm.allreduce(bool(blocks), MPI.LOR)
        same = plain and self._plainly is not None and not self._differ(held, springs, *self._plainly).any()
        if not self._comm.allreduce(same, MPI.LAND):
            self._plainly = (held, springs) if plain else None
            self._operator.impose(essential, self._unknowns, springs, blocks)
            if self._solver.levels is not None:
                with self._solver.options():
                    self._solver.levels.update(self._fixed, essential)
        return essential, plain

    def coupled(self, load: Array, x: PETSc.Vec, held: Mask, added: Added, share: float) -> tuple[int, bool]:
        """Solve by GMRES with the present preconditioner, where rows have shares of others added, see `coupled`.

        Collective.

        Args:
            load: Right side without conditions, of the owned unknowns.
            x: Where GMRES starts; gets the solution.
            held: Mask of the sites that are held.
            added: What is added.
            share: GMRES leaves this share of what there is at its start, or what solves to the end leave.

        Returns:
            The number of steps, and whether they went to the end.

        Raises:
            LinearSolveFailure: If PETSc gives up.
        """
        essential, matrices = self.essential(held), (self._operator.matrix, self._natural)
        x.array_w[essential] = 0.0
        return coupled(*matrices, self._solver.preconditioner(), load, essential, added, x, share, TO_THE_END)

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
        return self._held is not None

    def serve_more(self) -> None:
        """Another problem has the same K: as much again is worth it for factors that serve all sets."""
        self._most += self._more

    def forget(self) -> None:
        """The matrix of the solver is another one."""
        self._held = None

    def keep(self, held: Mask, springs: Springs) -> None:
        """Keep the factorisation that the solver has just made, with these sites held and these springs."""
        self._essential, self._held, self._springs = self.essential(held), held, springs
        self._changed: Indices = np.empty(0, dtype=np.int64)  # own sites with a d_j, and the j of each
        self._number: Indices = np.empty(0, dtype=np.int64)
        self._of_moves: Array = np.empty((0, 2, len(held)))  # p and the forces at the sites for each j
        self._load: Array | None = None
        self._last, self.repeated = (held, springs), 0

    @staticmethod
    def _differ(held: Mask, springs: Springs, held_before: Mask, springs_before: Springs) -> Mask:
        """The sites that change from one set to another one; springs at sites that are held do nothing."""
        return np.asarray((held != held_before) | (~held & (springs != springs_before)))

    def at_sites(self, load: Array, held: Mask, springs: Springs = 0.0) -> tuple[Array, Array] | None:
        """The solution with 0 at the sites that are held, and K times it, at the sites alone (collective).

        Args:
            load: Right side without conditions, of the owned unknowns.
            held: Mask of these sites.
            springs: The stiffness of a spring at each site, 0 for none.

        Returns:
            None if a factorisation costs less.

        Raises:
            LinearSolveFailure: If PETSc gives up.
        """
        if not self._serves(held, springs):
            return None
        self._take(load, held)
        p, forces = self._of_load + np.tensordot(self._shares(load, held, springs), self._of_moves, 1)
        return np.where(held, 0.0, p), forces

    def solve(self, load: Array, x: PETSc.Vec, held: Mask, springs: Springs = 0.0) -> bool:
        """Solve with 0 at the sites that are held, if that costs less than a factorisation (collective).

        Args:
            load: Right side without conditions, of the owned unknowns.
            x: Gets the solution.
            held: Mask of these sites.
            springs: The stiffness of a spring at each site, 0 for none.

        Returns:
            Whether it was solved.

        Raises:
            LinearSolveFailure: If PETSc gives up.
        """
        if not self._serves(held, springs):
            return False
        assert self._held is not None
        shares = np.zeros(len(held))
        others = [self._differ(held, springs, *each).any() for each in ((self._held, self._springs), self._last)]
        kept = self._load is not None and np.delete(load == self._load, self._essential).all()
        flags = np.array([*others, not kept], dtype=bool)
        self._comm.Allreduce(MPI.IN_PLACE, flags, MPI.LOR)
        changed, is_new, is_other = flags.tolist()
        self._last, self.repeated = (held, springs), 0 if is_new or not changed else self.repeated + 1
        if not changed and not is_other:
            self._w.copy(x)
            return True
        if changed:
            self._take(load, held)
            assert self._load is not None
            shares[self._changed] = self._shares(load, held, springs)[self._number]
            load = self._load
        moved, pulled = np.where(self._held, shares, 0.0), np.where(self._held, 0.0, shares)
        right = load - self._of_moved(moved)
        right[self._essential] = 0.0
        right[self._unknowns] += pulled * self._diagonal
        self._b.array_w[:] = right
        self._solver.solve(self._b, x)
        x.array_w[self._unknowns] += moved
        x.array_w[self._unknowns[held]] = 0.0
        return True

    @cached_property
    def _diagonal(self) -> Array:
        """The entries of K that are the size of forces at the sites."""
        return np.array(self._natural.getDiagonal().array_r[self._unknowns])

    def _serves(self, held: Mask, springs: Springs) -> bool:
        """Whether the last factorisation serves; then there is a d_j for each changed site (collective)."""
        if self._held is None:
            return False
        changed = self._differ(held, springs, self._held, self._springs)
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
        """K times what is this at the sites and 0 elsewhere, for the owned unknowns (collective)."""
        self._forces.array_w[:] = moved
        self._rows.multTranspose(self._forces, self._b)
        return np.array(self._b.array_r)

    def _add(self, sites: Indices, before: int, count: int) -> None:
        """Find d_j for new sites (collective).

        Args:
            sites: Those of this rank.
            before: How many there are on the ranks before.
            count: How many there are on all ranks.
        """
        assert self._held is not None
        own = np.zeros((count, len(self._held)))
        own[before + np.arange(len(sites)), sites] = 1.0
        columns = np.zeros((self._natural.getLocalSize()[0], count), order="F")
        for column, moved in enumerate(np.where(self._held, own, 0.0)):
            columns[:, column] = -self._of_moved(moved)
        columns[self._essential] = 0.0
        columns[self._unknowns] += (np.where(self._held, 0.0, own) * self._diagonal).T
        solutions = self._solver.solve_all(columns)
        traces = []
        for column, moved in enumerate(np.where(self._held, own, 0.0)):
            self._x.array_w[:] = solutions[:, column]
            self._x.array_w[self._unknowns] += moved
            traces.append(self._traces(self._x))
        first = len(self._of_moves)
        self._changed = np.append(self._changed, sites)
        self._number = np.append(self._number, first + before + np.arange(len(sites)))
        self._of_moves = np.concatenate([self._of_moves, traces])

    def _shares(self, load: Array, held: Mask, springs: Springs) -> Array:
        """The coefficients c_j of all sites (collective)."""
        assert self._held is not None
        assert self._load is not None
        mine, released = self._changed, self._held[self._changed]
        free, spring = ~held[mine], np.broadcast_to(springs, held.shape)[mine]
        (p, forces), (own_p, own_forces) = np.swapaxes(self._of_moves[:, :, mine], 0, 1), self._of_load[:, mine]
        rows = np.where(free, forces + spring * p, p).T
        wanted = np.where(free, load[self._unknowns[mine]] - own_forces - spring * own_p, -own_p)
        as_before = ~self._differ(held, springs, self._held, self._springs)[mine]
        more = (load - self._load)[self._unknowns[mine]] / self._diagonal[mine]
        rows[as_before] = np.eye(len(self._of_moves))[self._number[as_before]]
        wanted[as_before] = np.where(released, 0.0, more)[as_before]
        size = np.abs(rows).max(axis=1, initial=0.0)
        gathered = self._comm.allgather(np.column_stack([self._number, rows / size[:, None], wanted / size]))
        system = np.concatenate(gathered)
        shares: Array = np.linalg.solve(system[:, 1:-1], system[:, -1])  # the order of equations does not matter
        return shares
