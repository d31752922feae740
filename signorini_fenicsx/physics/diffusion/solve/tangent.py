"""Newton's steps for −∇·(κ(x, u)∇u) = f, with a line search.

The residual is that of the hybrid system with the κ of û, and its derivative K + N: on a cell N has the derivative of
∫σ·n by κ times that of κ by û. Beside what the equations leave, the sites may be off their laws.
"""

from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, LinearSolveFailure
from signorini_fenicsx.contact.chains import Chains, SiteConditions
from signorini_fenicsx.linear.constrained_matrix import image_of
from signorini_fenicsx.linear.gmres import gmres
from signorini_fenicsx.linear.petsc import LinearSolver, direct_solver

HALVINGS = 8
"""A step is halved so often at most."""
FALLS = 1e-4
"""Share of a step by which the residual has to fall."""
LOWER, PATIENCE, LOST = 0.9, 8, 1e2
"""The steps have failed where the residual has not fallen to this share of the least one in so many of them, or is so
many times as large."""
TRUSTED = 3
"""In time steps are as long as soils allow, without a search, until the residual has not fallen in so many of them."""


class Tangent:
    """Newton's method from the x of a backend.

    Attributes:
        left: The largest residual, as a u, after the last step.
        norm: The norm of all of them.
        since: So many steps ago it has fallen.
    """

    left = np.inf
    norm = np.inf
    since = 0

    def __init__(self, backend: Any, solver: LinearSolver):
        """Begin at the last solution of the backend (collective).

        Args:
            backend: A `FluxBackend`; its data get the κ of each step.
            solver: Its linear solver, whose preconditioner is that of the matrix under the present conditions.
        """
        self._backend = backend
        self._least, self._unit, self._last = np.inf, np.empty(0), np.empty(0)
        self._iterates, self._preconditioner = solver.iterates, solver.preconditioner

    def step(self, conditions: SiteConditions) -> None:
        """One step under these conditions (collective).

        Raises:
            LinearSolveFailure: If its linear problem cannot be solved, or the residual does not fall any more.
        """
        backend, of_u = self._backend, self._backend.data.quasilinear
        self._take_kappa()
        base, start = self._residual(conditions), backend.x.array_r.copy()
        traces = backend.system.on_cells(backend.x)
        step = self._direction(conditions, of_u.of_traces(traces)[1])
        searches = backend.data.stored is None or self.since >= TRUSTED
        best = self._searched(conditions, start, step, base if searches else np.inf)
        if best[0] >= base and searches:  # as where κ has a kink, or an infinite slope: by its slope along the step
            backend.x.array_w[:] = start + step
            moved = backend.system.on_cells(backend.x) - traces
            backend.x.array_w[:] = start
            self._take_kappa()
            self._residual(conditions)
            step = self._direction(conditions, of_u.along(traces, moved))
            best = min(best, self._searched(conditions, start, step, base), key=lambda found: found[0])
        backend.x.array_w[:] = best[1]
        self._take_kappa()
        self.norm = self._residual(conditions)
        self.since = 0 if self.norm < LOWER * self._least else self.since + 1
        if self.norm > LOST * self._least or self.since > PATIENCE:
            raise LinearSolveFailure(f"Newton's method for κ leaves a residual of {self.norm:.1e}")
        self._least = min(self._least, self.norm)

    def _searched(self, conditions: SiteConditions, start: Array, step: Array, base: float) -> tuple[float, Array]:
        """The least residual along a step that is halved until it falls, and its x (collective)."""
        backend, best, share = self._backend, (np.inf, start), 1.0
        stores = backend.data.stored is not None
        unit = self._unit if stores else 0.0
        for _ in range(HALVINGS):
            x = start + share * step
            backend.x.array_w[:] = backend.system.limited(start, x) if stores else x
            norm = self._residual(conditions, unit) if self._take_kappa() else np.inf
            if norm < best[0]:
                best = norm, backend.x.array_r.copy()
            if norm < (1 - FALLS * share) * base:
                break
            share /= 2
        return best

    def _take_kappa(self) -> bool:
        """Let κ be that of the present x; whether it is positive (collective)."""
        backend, x = self._backend, self._backend.x.array_r.copy()
        if backend.comm.allreduce(np.array_equal(x, self._last), MPI.LAND):
            return True
        try:
            backend.take_kappa(backend.data.at_traces(backend.spaces, backend.system.on_cells(backend.x)))
        except InputError:
            return False
        self._last = x
        return True

    def _parts(self, conditions: SiteConditions) -> tuple[PETSc.Mat, npt.NDArray[np.int32], Array, Array, Array]:
        """The matrix and what is fixed, x less given values in two parts, free and fixed, and the right side."""
        matrix, fixed, held, load = self._backend.imposed(conditions)
        free = self._backend.x.array_r - held
        of_fixed = np.zeros_like(free)
        of_fixed[fixed], free[fixed] = free[fixed], 0.0
        return matrix, fixed, free, of_fixed, load

    def _residual(self, conditions: SiteConditions, unit: Array | float = 0.0) -> float:
        """The norm of what is left of the equations over their diagonal, and of how far sites are off (collective).

        Args:
            conditions: Those of the sites.
            unit: Where the diagonal is smaller this takes its place: as soil dries the same lack of a flux is no more.
        """
        backend = self._backend
        matrix, fixed, free, of_fixed, load = self._parts(conditions)
        self._unit = np.maximum(unit, matrix.getDiagonal().array_r)
        left = (image_of(matrix, free) + image_of(backend.natural, of_fixed) - load) / self._unit
        left[fixed] = of_fixed[fixed]
        values = np.concatenate([left, backend.off_laws(conditions)])
        self.left = backend.comm.allreduce(float(np.abs(values).max(initial=0.0)), MPI.MAX)
        return float(np.sqrt(backend.comm.allreduce(float(values @ values))))

    def _direction(self, conditions: SiteConditions, slopes: Array) -> Array:
        """Newton's step, undamped, with these slopes of κ (collective)."""
        backend, system = self._backend, self._backend.system
        tangent = system.of_cells(system.by_kappa(backend.x) @ slopes)
        matrix, fixed, free, of_fixed, load = self._parts(conditions)
        right = load - image_of(matrix, free) + image_of(tangent, of_fixed)
        tangent.axpy(1.0, matrix, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        right[fixed] = -of_fixed[fixed]
        backend.solves += 1
        tangent.zeroRowsColumns((fixed + tangent.getOwnershipRange()[0]).astype(PETSc.IntType))
        return self._solved(tangent, right)

    def transposed(self, conditions: SiteConditions, matrices: Array, right: Array) -> Array:
        """Solve with the transpose of K + N, with N from matrices of cells (collective).

        Raises:
            LinearSolveFailure: If it cannot be solved.
        """
        tangent = self._backend.system.of_cells(matrices.transpose(0, 2, 1).copy())
        matrix, fixed, *_ = self._backend.imposed(conditions)
        tangent.axpy(1.0, matrix, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        right = right.copy()
        right[fixed] = 0.0
        tangent.zeroRowsColumns((fixed + tangent.getOwnershipRange()[0]).astype(PETSc.IntType))
        return self._solved(tangent, right)

    def _solved(self, tangent: PETSc.Mat, right: Array) -> Array:
        """Solve with K + N, by GMRES with the preconditioner of K where that iterates (collective)."""
        if self._iterates:
            preconditioner, (b, x) = self._preconditioner(), tangent.createVecs()

            def precondition(values: Array) -> Array:
                b.array_w[:] = values
                preconditioner.apply(b, x)
                return np.array(x.array_r)

            return gmres(self._backend.comm, partial(image_of, tangent), right, precondition)[0]
        solver = direct_solver(tangent, "lu", "tangent_")
        b, x = tangent.createVecs()
        b.array_w[:] = right
        solver.solve(b, x)
        found = np.array(x.array_r)
        for each in (solver.ksp, tangent, b, x):
            each.destroy()
        return found


def off_chains(chains: Chains, p: Array, flux: Array, unit: Array) -> Array:
    """How far pairs are off their laws, as a p; one unit of p is so many of the flux."""
    return np.asarray(np.max(np.abs(chains.distances(p, flux, unit)) / [np.ones_like(unit), unit, unit], axis=0))
