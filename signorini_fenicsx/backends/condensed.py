"""The facet system under any conditions on Γ_S with one factorisation, for repeated solves.

Let A be the matrix with σ·n given on all of Γ_S, E the inclusion of the Γ_S unknowns and C = EᵀA⁻¹E. Under any
conditions on Γ_S

    u = A⁻¹(b + Eλ)   with   λ = |e|v on NO_FLUX, u = v on ZERO_TRACE, λ + β|e|u = |e|v on ROBIN facets,

so that on the last two, I, (C_II + D)λ = w − (A⁻¹b)_I − C_INλ_N with D = 0, w = v or D = 1/(β|e|), w = v/β.
"""

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.backends.petsc import LinearSolver
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.discrete.conditions import Condition, SiteConditions


class Condensed:
    """C, as a matrix on all ranks, and solves by it."""

    def __init__(self, solver: LinearSolver, matrix: PETSc.Mat, trace_dofs: npt.NDArray[np.int32], measure: Array):
        """Solve with A for each Γ_S facet (collective).

        Args:
            solver: Solves with A.
            matrix: A.
            trace_dofs: Owned unknown of each Γ_S facet of this rank.
            measure: |e| of each of these facets.

        Raises:
            LinearSolveFailure: If a solve fails.
        """
        self._solver, self._dofs = solver, trace_dofs
        self._comm: MPI.Comm = matrix.getComm().tompi4py()
        self._x, self._b = matrix.createVecs()
        sizes = self._comm.allgather(len(trace_dofs))
        first = sum(sizes[: self._comm.rank])
        self._mine = slice(first, first + len(trace_dofs))
        self._measure = self._gathered(measure)
        self._b.set(0.0)
        self._compliance = np.stack([self._traces(unit) for unit in np.eye(len(self._measure))], axis=1)

    def load(self, b: PETSc.Vec) -> None:
        """Take the right side for σ·n given on all of Γ_S (collective).

        Raises:
            LinearSolveFailure: If the solve fails.
        """
        self._b.array_w[:] = b.array_r
        self._free = self._traces(np.zeros(len(self._measure)))

    def solve(self, conditions: SiteConditions, x: PETSc.Vec) -> None:
        """Solve with this right side under these conditions on the Γ_S facets; `x` gets the solution (collective).

        Raises:
            LinearSolveFailure: If the solve fails.
        """
        everywhere = np.ones(len(conditions.kind), dtype=bool)
        kind = self._gathered(conditions.kind)
        beta, value = (self._gathered(one(everywhere)) for one in (conditions.beta_where, conditions.values_where))
        inside = np.flatnonzero(kind != Condition.NO_FLUX)
        robin = kind[inside] == Condition.ROBIN
        flux = np.where(kind == Condition.NO_FLUX, value * self._measure, 0.0)
        added = np.where(robin, 1 / (beta * self._measure)[inside], 0.0)
        wanted = np.where(robin, (value / beta)[inside], value[inside]) - self._free[inside]
        if conditions.has_values:
            wanted -= self._compliance[inside] @ flux
        flux[inside] = np.linalg.solve(self._compliance[np.ix_(inside, inside)] + np.diag(added), wanted)
        self._traces(flux)
        x.array_w[:] = self._x.array_r
        held = conditions.kind == Condition.ZERO_TRACE
        x.array_w[self._dofs[held]] = conditions.values_where(held)

    def _traces(self, flux: Array) -> Array:
        """U on all Γ_S facets for this λ, and the present b; `_x` is the solution (collective)."""
        b, before = self._b, self._b.array_r[self._dofs]
        b.array_w[self._dofs] = before + flux[self._mine]
        self._solver.solve(b, self._x)
        b.array_w[self._dofs] = before
        return self._gathered(self._x.array_r[self._dofs])

    def _gathered[T: np.generic](self, values: npt.NDArray[T]) -> npt.NDArray[T]:
        """Values of the Γ_S facets of all ranks (collective)."""
        return np.concatenate(self._comm.allgather(values))
