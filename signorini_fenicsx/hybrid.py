"""The hybrid backend: the facet system, solved by Cholesky or by CG with auxiliary-space multigrid."""

from petsc4py import PETSc

from signorini_fenicsx.auxiliary_space import AuxiliarySpace
from signorini_fenicsx.backend import Array, Iterate, set_direct, solve_linear, solver_name, take_options
from signorini_fenicsx.conditions import FacetConditions
from signorini_fenicsx.data import Data
from signorini_fenicsx.facet_system import FacetSystem
from signorini_fenicsx.spaces import Spaces

TOLERANCE = 1e-12
"""Relative tolerance of CG; making the recovered flux conforming amplifies what is left by 1/h."""


class HybridBackend:
    """The facet system with its linear solver, set up once.

    Small systems go to MUMPS (Cholesky), larger ones to CG with auxiliary-space multigrid; PETSc options override
    either.

    Attributes:
        iterative: Whether the linear solver iterates, so that rough solves are cheaper than exact ones.
    """

    name = "hybrid"

    def __init__(self, spaces: Spaces, data: Data):
        """Assemble and choose the solver (collective).

        Args:
            spaces: The discrete spaces.
            data: Its means over cells and facets.
        """
        self.spaces, self.data = spaces, data
        self._system = FacetSystem(spaces, data)
        self.dofs = self._system.dofs
        self._ksp = PETSc.KSP().create(spaces.mesh.comm)
        self._ksp.setOperators(self._system.matrix)
        self._auxiliary = self._set_up_solver()
        self.iterative = self._ksp.getType() != "preonly"

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return solver_name(self._ksp)

    def solve(self, conditions: FacetConditions) -> Iterate:
        """Solve as `Backend.solve` says, starting from the last solution (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        self._apply(conditions)
        solve_linear(self._ksp, self._system.b, self._system.x)
        return self._system.recover(conditions, self._ksp.getIterationNumber())

    def solve_roughly(self, conditions: FacetConditions, iterations: int) -> tuple[Array, Array]:
        """`Iterate.p` and `Iterate.flux` after some more iterations from the last solution (collective).

        Raises:
            LinearSolveFailure: If the linear solver breaks down.
        """
        self._apply(conditions)
        limit = self._ksp.getTolerances()[3]
        self._ksp.setTolerances(max_it=min(iterations, limit))
        try:
            solve_linear(self._ksp, self._system.b, self._system.x, to_tolerance=False)
        finally:
            self._ksp.setTolerances(max_it=limit)
        return self._system.recover_traces(conditions)

    def _apply(self, conditions: FacetConditions) -> None:
        essential = self._system.apply(conditions)
        if self._auxiliary is not None:
            self._auxiliary.update(self._ksp.getPC(), conditions, essential)

    def _set_up_solver(self) -> AuxiliarySpace | None:
        """Defaults by size, then the user's options; the coarse space, if multigrid is what came out."""
        ksp, pc = self._ksp, self._ksp.getPC()
        large = self._system.large
        if large:
            ksp.setType("cg")
            ksp.setTolerances(rtol=TOLERANCE)
            ksp.setInitialGuessNonzero(True)
            pc.setType("mg")
        else:
            set_direct(ksp, "cholesky")
        auxiliary = AuxiliarySpace(self.spaces, self.data, pc) if large else None
        take_options(ksp)
        if ksp.getType() == "preonly":
            ksp.setInitialGuessNonzero(False)
        return auxiliary if pc.getType() == "mg" else None
