"""The hybrid backend: the facet system, solved by Cholesky or by CG with auxiliary-space multigrid."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.backend import Inexact, Iterate
from signorini_fenicsx.contact.conditions import Condition, SiteConditions
from signorini_fenicsx.linear.condensed import Condensed
from signorini_fenicsx.linear.earlier import EarlierSolutions
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.methods.prediction import PREDICT_FROM
from signorini_fenicsx.physics.diffusion.auxiliary_space import DEFAULTS, AuxiliarySpace
from signorini_fenicsx.physics.diffusion.data import Data
from signorini_fenicsx.physics.diffusion.facet_system import FacetSystem, Loads
from signorini_fenicsx.physics.diffusion.facets import FacetBackend
from signorini_fenicsx.physics.diffusion.mixed import MixedBackend
from signorini_fenicsx.physics.diffusion.patch import Patch
from signorini_fenicsx.physics.diffusion.solvability import floating_cells
from signorini_fenicsx.physics.diffusion.spaces import Spaces

FACTORISATION = 10
"""About as many solves take as long as a factorisation."""
MOST_ITERATIONS = 100
"""If CG needs more and the system is not large, it gives way to a factorisation."""


class HybridBackend(FacetBackend):
    """The facet system with its linear solver, set up once.

    Small systems are solved by MUMPS (Cholesky), larger ones by CG with auxiliary-space multigrid; PETSc options
    override both. With a factorisation the results are as precise as those of the saddle point, except κ∇u where κ is
    large and cells are badly shaped.

    Systems in between begin with CG, because a factorisation takes as long as several solves. A factorisation takes its
    place if CG takes too many iterations, and for the problems that follow if it will serve many of their sets.
    """

    name = "hybrid"
    cheap = False

    def __init__(
        self,
        spaces: Spaces,
        data: Data,
        *,
        tuning: Tuning | None = None,
        multigrid: bool = False,
        prefix: str = "facet_",
    ):
        """Assemble and choose the solver (collective).

        Args:
            spaces: The discrete spaces.
            data: The data and their means over cells and facets.
            tuning: Has the sizes from which multigrid is the default.
            multigrid: Whether multigrid is the default at any size.
            prefix: Prefix of its PETSc options.

        Raises:
            InputError: If PETSc refuses an option.
        """
        super().__init__(spaces, data)
        self._tuning = tuning or Tuning()
        self._system = system = FacetSystem(spaces, data, self._tuning)
        self._condensed: Condensed | None = None
        self._regret = math.inf
        self.dofs = system.dofs
        iterative = multigrid or system.large or self._tuning.predicts(self.dofs, PREDICT_FROM)
        make = partial(AuxiliarySpace, spaces, system) if iterative else None
        most = None if system.large else MOST_ITERATIONS
        self._solver = FacetSolver(system.matrix, prefix, DEFAULTS, make, most)
        self._earlier, self._renewed = EarlierSolutions(), False
        self._applied: SiteConditions | None = None
        self._held: SiteConditions | None = None
        self._moved = False  # since the data were last renewed
        self._iterations = 0
        self._offer_precise()

    def renew(self, data: Data) -> bool:
        """Go on with other data, see `Renewable`; multigrid has to be set up again for another κ or c (collective)."""
        if self._solver.gives_way and (self._can_be_condensed() or not self._moved):
            self._solver.factorise()
        elif self._solver.iterates and not data.same_operator(self.data, self.spaces):
            return False
        system, given_flux = self._system, SiteConditions.everywhere(Condition.NO_FLUX, self.sites)
        same = system.renew(data)
        self.data, self._applied, self._moved = data, None, False
        if self._solver.iterates:
            self._earlier.add(system.x)
            self._renewed = True
        self._offer_precise()
        if not same:
            self._condensed, self._regret = None, math.inf
        elif self._condensed is None and self._is_worth_condensing():
            system.impose(given_flux)
            self._condensed = Condensed(self._solver, system.matrix, system.trace_dofs, self.spaces.facet_measure)
            self._regret = 0.0
        elif self._condensed is not None and self._regret > FACTORISATION:
            self._condensed, self._regret = None, 0.0
        if self._condensed is not None:
            system.load(given_flux)
            self._condensed.load(system.b, data.conductance)
        return True

    def _is_worth_condensing(self) -> bool:
        """Whether condensing the system is possible, by a factorisation with few facets in Γ_S, and pays itself back.

        The condensed system costs one more solve for each right side, and saves a factorisation for each change of the
        sets. When as much was lost without it, or with it, as making it costs, it is made, or given up.
        """
        factorised = self.precise is not None and not self._solver.iterates
        return factorised and self._can_be_condensed() and self._regret >= self._facets_of_gamma_s()

    def _can_be_condensed(self) -> bool:
        possible = self.data.inside is None and self._facets_of_gamma_s() <= self._tuning.condense_up_to
        return possible and floating_cells(self.spaces, self.data)[1] == 0

    def _facets_of_gamma_s(self) -> int:
        number: int = self.spaces.Lambda.dofmap.index_map.size_global
        return number

    def _offer_precise(self) -> None:
        if self._solver.factorises or self._solver.gives_way:
            self.precise = partial(MixedBackend, self.spaces, self.data)

    @property
    def inexact(self) -> Inexact | None:
        """The backend itself if its linear solver iterates; otherwise the condensed system, once there is one."""
        return self if self._solver.iterates else self._condensed

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return self._solver.name()

    def solve(self, conditions: SiteConditions) -> Iterate:
        """Solve as `Backend.solve` says, starting from earlier solutions (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        self._solve(conditions)
        return self.reached(conditions)

    def respond(self, conditions: SiteConditions, loads: Loads) -> tuple[fem.Function, fem.Function, Array]:
        """Solve with any right side, see `FacetSystem.respond`; the last solution stays (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        plain = replace(conditions, value=0.0)
        if self._condensed is not None:
            return self._system.respond(plain, loads, partial(self._condensed.respond, plain))
        if self._applied is None or not plain.same(replace(self._applied, value=0.0), self.comm):
            self._applied = None
            self._impose(plain)
        return self._system.respond(plain, loads, self._solver.solve)

    def solve_until(self, conditions: SiteConditions, enough: Callable[[Array, Array], bool]) -> tuple[Array, Array]:
        """Solve as `Inexact.solve_until` says (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        with self._solver.stopping(lambda x: enough(*self._system.traces(x, conditions))):
            self._solve(conditions)
        return self._system.traces(self._system.x, conditions)

    def reached(self, conditions: SiteConditions) -> Iterate:
        """The iterate of the last solve, see `Inexact.reached` (collective)."""
        return self._system.recover(conditions, self._iterations)

    def solve_near(
        self, sites: Mask, layers: int, share: float
    ) -> Callable[[SiteConditions], tuple[Array, Array]] | None:
        """Solves as `Inexact.solve_near` says (collective)."""
        patch = Patch(self._system.matrix, self._system.unknowns(sites), layers)

        def solve_on_patch(conditions: SiteConditions) -> tuple[Array, Array]:
            self._applied = None
            self._system.apply(conditions)
            patch.solve(self._system.matrix, self._system.b, self._system.x)
            return self._system.traces(self._system.x, conditions)

        return None if patch.size > share * self.dofs else solve_on_patch

    def _solve(self, conditions: SiteConditions) -> None:
        """Apply the conditions and solve.

        Nothing is done if the last solve under the same conditions converged; one that stopped early goes on.
        """
        if conditions.same(self._applied, self.comm):
            if self._solver.converged:
                return
        elif self._condensed is not None:
            self._condensed.solve(conditions, self._system.x)
            self._regret = self._regret + 1 if conditions.same(self._held, self.comm) else 0.0
            self._applied, self._held, self._iterations = conditions, conditions, 1
            return
        else:
            if not conditions.same(self._held, self.comm):
                self._regret, self._moved = self._regret + FACTORISATION, True
            self._held = conditions
            essential = self._impose(conditions)
            if self._renewed:
                self._earlier.combine(self._system.matrix, self._system.b, self._system.x, essential)
                self._renewed = False
            self._applied, self._iterations = conditions, 0
        self._solver.solve(self._system.b, self._system.x)
        self._iterations += self._solver.ksp.getIterationNumber()

    def _impose(self, conditions: SiteConditions) -> npt.NDArray[np.int32]:
        """Apply the conditions, to multigrid as well, and return the owned unknowns that they fix (collective)."""
        essential = self._system.apply(conditions)
        if self._solver.levels is not None:
            with self._solver.options():
                self._solver.levels.update(conditions.take(self.facets), essential)
        return essential
