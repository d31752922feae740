"""The hybrid backend: the facet system, solved by Cholesky or by CG with auxiliary-space multigrid."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from signorini_fenicsx.backends.auxiliary_space import AuxiliarySpace
from signorini_fenicsx.backends.contract import Array, Iterate, set_direct, solve_linear, solver_name, take_options
from signorini_fenicsx.backends.facet_system import FacetSystem
from signorini_fenicsx.backends.patch import Patch
from signorini_fenicsx.discrete.conditions import FacetConditions
from signorini_fenicsx.discrete.data import Data
from signorini_fenicsx.discrete.spaces import Spaces

TOLERANCE = 1e-12
"""Relative tolerance of CG; making the recovered flux conforming amplifies what is left by 1/h."""


class HybridBackend:
    """The facet system with its linear solver, set up once.

    Small systems go to MUMPS (Cholesky), larger ones to CG with auxiliary-space multigrid; PETSc options override
    either.

    Attributes:
        iterative: Whether the linear solver iterates, so that it may stop early.
    """

    name = "hybrid"

    def __init__(self, spaces: Spaces, data: Data, *, multigrid: bool = False):
        """Assemble and choose the solver (collective).

        Args:
            spaces: The discrete spaces.
            data: Its means over cells and facets.
            multigrid: Whether multigrid is the default at any size.
        """
        self.spaces, self.data = spaces, data
        self._system = FacetSystem(spaces, data)
        self.dofs = self._system.dofs
        self._ksp = PETSc.KSP().create(spaces.mesh.comm)
        self._ksp.setOperators(self._system.matrix)
        self._auxiliary = self._set_up_solver(multigrid=multigrid or self._system.large)
        self.iterative = self._ksp.getType() != "preonly"
        self._early_stop = _EarlyStop()
        if self.iterative:
            self._ksp.addConvergenceTest(self._early_stop, prepend=True)
        self._applied: FacetConditions | None = None
        self._iterations = 0

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return solver_name(self._ksp)

    def solve(self, conditions: FacetConditions) -> Iterate:
        """Solve as `Backend.solve` says, starting from the last solution (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        self._solve(conditions)
        return self._system.recover(conditions, self._iterations)

    def solve_until(self, conditions: FacetConditions, enough: Callable[[Array, Array], bool]) -> tuple[Array, Array]:
        """Solve from the last solution, to the tolerance or until enough is said (collective).

        Args:
            conditions: Facet conditions.
            enough: Called on all ranks after each iteration with what would be `Iterate.p` and `Iterate.flux`.

        Returns:
            `Iterate.p` and `Iterate.flux` in the end.

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        self._early_stop.asks = lambda x: enough(*self._system.traces(x, conditions))
        try:
            self._solve(conditions)
        finally:
            self._early_stop.asks = None
        return self._system.traces(self._system.x, conditions)

    def patch(self, facets: npt.NDArray[np.bool_], layers: int) -> Patch:
        """The unknowns near some of the Γ_S facets of this rank (collective)."""
        return Patch(self._system.matrix, self._system.trace_dofs[facets], layers)

    def solve_on(self, patch: Patch, conditions: FacetConditions) -> tuple[Array, Array]:
        """Change the last solution on the patch alone; `Iterate.p` and `Iterate.flux` of what it then is (collective).

        Raises:
            LinearSolveFailure: If a factorisation fails.
        """
        self._applied = None
        self._system.apply(conditions)
        patch.solve(self._system.matrix, self._system.b, self._system.x)
        return self._system.traces(self._system.x, conditions)

    def _solve(self, conditions: FacetConditions) -> None:
        """Apply the conditions and solve, unless that is done; go on if the last solve under them stopped early."""
        if conditions is self._applied:
            reason = self._ksp.getConvergedReason()
            if reason > 0 and reason != PETSc.KSP.ConvergedReason.CONVERGED_ITS:
                return
        else:
            essential = self._system.apply(conditions)
            if self._auxiliary is not None:
                self._auxiliary.update(self._ksp.getPC(), conditions, essential)
            self._applied, self._iterations = conditions, 0
        solve_linear(self._ksp, self._system.b, self._system.x)
        self._iterations += self._ksp.getIterationNumber()

    def _set_up_solver(self, *, multigrid: bool) -> AuxiliarySpace | None:
        """Defaults by size, then the user's options; the coarse space, if multigrid is what came out."""
        ksp, pc = self._ksp, self._ksp.getPC()
        if multigrid:
            ksp.setType("cg")
            ksp.setTolerances(rtol=TOLERANCE)
            ksp.setInitialGuessNonzero(True)
            pc.setType("mg")
        else:
            set_direct(ksp, "cholesky")
        auxiliary = AuxiliarySpace(self.spaces, self.data, pc) if multigrid else None
        take_options(ksp)
        if ksp.getType() == "preonly":
            ksp.setInitialGuessNonzero(False)
        return auxiliary if pc.getType() == "mg" else None


class _EarlyStop:
    """What PETSc asks before its own test of convergence; no part of the backend, which PETSc would keep alive.

    Attributes:
        asks: Whether an iterate is good enough, if anybody wants to know.
    """

    asks: Callable[[PETSc.Vec], bool] | None = None

    def __call__(self, ksp: PETSc.KSP, iteration: int, _norm: float) -> PETSc.KSP.ConvergedReason:
        """Stop, or leave it to PETSc (collective)."""
        stop = False
        if self.asks is not None and iteration > 0:
            x = ksp.buildSolution()
            stop = self.asks(x)
            x.destroy()  # this reference; by PETSc's queue for several ranks it would keep the solver alive
        return PETSc.KSP.ConvergedReason.CONVERGED_ITS if stop else PETSc.KSP.ConvergedReason.CONVERGED_ITERATING
