"""The facet system under any conditions on Γ_S with one factorisation, for repeated solves.

Let A be the matrix and b the right side with σ·n = q_S on all of Γ_S, E the inclusion of the Γ_S unknowns and C =
EᵀA⁻¹E. Under any conditions on Γ_S

    u = A⁻¹(b + Eλ)   with   λ = v|e| on NO_FLUX, u = v on ZERO_TRACE, λ = |e|(v − βu) on ROBIN facets,

so that on the last two, I, (C_II + D)λ = w − u_I for λ = 0 there, with D = 0 and w = v, or D = 1/(β|e|) and w = v/β.

The traces need C alone, so the sets can be followed without a solve in Ω. C has a column for each facet of Γ_S, all on
every rank; `kept_factors` is for more sites, of which few change.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.contact.conditions import Condition, SiteConditions
from signorini_fenicsx.linear.petsc import LinearSolver


class Condensed:
    """C, as a matrix on all ranks, and solves by it; the `Inexact` of a backend.

    Attributes:
        cheap: A solve for the traces costs next to nothing.
    """

    cheap = True

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

    def load(self, b: PETSc.Vec, conductance: float) -> None:
        """Take the right side for σ·n given on all of Γ_S, and the size of σ·n that belongs to p = 1 (collective).

        Raises:
            LinearSolveFailure: If the solve fails.
        """
        self._b.array_w[:] = b.array_r
        self._free = self._traces(np.zeros(len(self._measure)))
        self._conductance = conductance

    def solve(self, conditions: SiteConditions, x: PETSc.Vec) -> None:
        """Solve with this right side under these conditions on the Γ_S facets; `x` gets the solution (collective).

        Raises:
            LinearSolveFailure: If the solve fails.
        """
        self._traces(self._multiplier(conditions))
        x.array_w[:] = self._x.array_r
        held = conditions.kind == Condition.ZERO_TRACE
        x.array_w[self._dofs[held]] = conditions.values_where(held)

    def respond(self, conditions: SiteConditions, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve with another right side, under conditions without values (collective).

        Raises:
            LinearSolveFailure: If the solve fails.
        """
        kept = self._b.array_r.copy(), self._free
        self._b.array_w[:] = b.array_r
        try:
            self._free = self._traces(np.zeros(len(self._measure)))
            self.solve(conditions, x)
        finally:
            self._b.array_w[:], self._free = kept

    def solve_until(self, conditions: SiteConditions, _enough: Callable[[Array, Array], bool]) -> tuple[Array, Array]:
        """The traces, as `Inexact.solve_until` says; they are exact up to rounding (collective)."""
        flux = self._multiplier(conditions)
        p = self._free + self._compliance @ flux
        return conditions.clean(p[self._mine], (flux / self._measure)[self._mine], self._conductance)

    def reached(self, _conditions: SiteConditions) -> None:
        """None: it would take a solve on the whole domain."""

    def solve_near(self, _sites: Mask, _layers: int, _share: float) -> None:
        """None: no solve on a part is cheaper."""

    def _multiplier(self, conditions: SiteConditions) -> Array:
        """λ on all Γ_S facets (collective)."""
        everywhere = np.ones(len(conditions.kind), dtype=bool)
        local = conditions.kind, conditions.beta_where(everywhere), conditions.values_where(everywhere)
        kind, beta, value = self._gathered(np.stack(local, axis=1).astype(np.float64)).T
        beta = np.where(kind == Condition.ROBIN, beta, 1.0)
        flux = np.where(kind == Condition.NO_FLUX, value * self._measure, 0.0)
        inside = np.flatnonzero(kind != Condition.NO_FLUX)
        robin = kind[inside] == Condition.ROBIN
        added = np.where(robin, 1 / (beta * self._measure)[inside], 0.0)
        wanted = np.where(robin, (value / beta)[inside], value[inside])
        matrix = self._compliance[np.ix_(inside, inside)] + np.diag(added)
        flux[inside] = np.linalg.solve(matrix, wanted - (self._free + self._compliance @ flux)[inside])
        return flux

    def _traces(self, flux: Array) -> Array:
        """The traces on all Γ_S facets for this λ, and the present b; `_x` is the solution (collective)."""
        b, before = self._b, self._b.array_r[self._dofs]
        b.array_w[self._dofs] = before + flux[self._mine]
        self._solver.solve(b, self._x)
        b.array_w[self._dofs] = before
        return self._gathered(self._x.array_r[self._dofs])

    def _gathered(self, values: Array) -> Array:
        """Values of the Γ_S facets of all ranks (collective)."""
        return np.concatenate(self._comm.allgather(values))
