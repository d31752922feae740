"""The hybrid backend: the facet system, solved by Cholesky or by CG with auxiliary-space multigrid."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.backend import Inexact, Iterate
from signorini_fenicsx.contact.chains import SiteConditions
from signorini_fenicsx.linear.earlier import EarlierSolutions
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.linear.kept_factors import Imposed, KeptFactors
from signorini_fenicsx.linear.patch import Patch
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.sources import mean_moments
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solve.auxiliary_space import DEFAULTS, AuxiliarySpace
from signorini_fenicsx.physics.diffusion.solve.facet_system import PREDICT_FROM, FacetSystem, Loads
from signorini_fenicsx.physics.diffusion.solve.facets import FacetBackend
from signorini_fenicsx.physics.diffusion.solve.mixed import MixedBackend
from signorini_fenicsx.physics.diffusion.solve.solvability import floating_cells
from signorini_fenicsx.physics.diffusion.solve.tangent import Tangent, off_chains

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
    place if CG takes too many iterations, and for the problems that follow, as it serves many of their sets.

    Attributes:
        tangent: Where κ depends on u, whose steps take the place of solves; None for solves with the present κ.
        solves: How many linear systems it has been asked to solve.
    """

    name = "hybrid"
    tangent: Tangent | None = None
    solves: int = 0

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
        self.dofs = system.dofs
        iterative = multigrid or system.large or self._tuning.predicts(self.dofs, PREDICT_FROM)
        make = partial(AuxiliarySpace, spaces, system) if iterative else None
        most = None if system.large else MOST_ITERATIONS
        self._solver = FacetSolver(system.matrix, prefix, DEFAULTS, make, most)
        self._earlier = EarlierSolutions()
        self._applied: SiteConditions | None = None
        self._iterations = 0
        self._factors = self._none_kept()
        self._keeps: bool | None = None  # known when first asked for
        self._offer_precise()

    def renew(self, data: Data) -> bool:
        """Go on with other data, see `Renewable`; multigrid has to be set up again for another κ or c (collective)."""
        if self._solver.gives_way:
            self._solver.factorise()
        elif self._solver.iterates and not data.same_operator(self.data, self.spaces):
            return False
        same = self._system.renew(data)
        self.data, self._applied, self._keeps = data, None, None
        if self._solver.iterates:
            self._earlier.add(self._system.x)
        if same:
            self._factors.serve_more()
        else:
            self._factors = self._none_kept()
        self._offer_precise()
        return True

    def take_kappa(self, data: Data) -> None:
        """Go on with the same data but for κ (collective)."""
        self._system.renew(data)
        self.data, self._applied, self._keeps = data, None, None
        self._factors = self._none_kept()
        self._offer_precise()

    @property
    def x(self) -> PETSc.Vec:
        """û less the lift, and jumps inside the domain, of the owned unknowns."""
        return self._system.x

    @property
    def natural(self) -> PETSc.Mat:
        """The matrix without conditions."""
        return self._system.natural

    @property
    def system(self) -> FacetSystem:
        """The facet system."""
        return self._system

    def new_tangent(self) -> Tangent:
        """Newton's method from the last solution."""
        return Tangent(self, self._solver)

    def imposed(self, conditions: SiteConditions) -> tuple[PETSc.Mat, npt.NDArray[np.int32], Array, Array]:
        """The matrix under conditions, the unknowns that they fix, their values, and the right side (collective)."""
        load, held = self._system.posed(conditions)
        x = self.x.array_r.copy()
        fixed, self._applied = self._impose(conditions), None
        self.x.array_w[:] = x
        return self._system.matrix, fixed, held, load

    def off_laws(self, conditions: SiteConditions) -> Array:
        """How far the sites are off their laws, as a p, where x need not be a solution (collective)."""
        p, flux = self._system.traces(self.x, conditions)
        diagonal = self._system.natural.getDiagonal().array_r[self._system.trace_dofs]
        unit = np.append(diagonal / self.spaces.facet_measure, 1 / mean_moments(self.spaces, self.data))[: len(p)]
        return off_chains(self.chains, p, flux, unit)

    def _none_kept(self) -> KeptFactors:
        """What will keep a factorisation for the present κ and c."""
        system, dim = self._system, self.spaces.mesh.topology.dim
        return KeptFactors(self._solver, system.operator, system.dirichlet_dofs, system.trace_dofs, dim)

    def _offer_precise(self) -> None:
        if self._solver.factorises or self._solver.gives_way:
            self.precise = partial(MixedBackend, self.spaces, self.data)

    @property
    def cheap(self) -> bool:
        """Whether traces cost little beside a solve: by a factorisation that is kept."""
        return self._factors.present

    @property
    def inexact(self) -> Inexact | None:
        """The backend itself if its linear solver iterates, or once it keeps a factorisation."""
        return self if self._solver.iterates or self._factors.present else None

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return self._solver.name()

    def solve(self, conditions: SiteConditions) -> Iterate:
        """Solve as `Backend.solve` says, starting from earlier solutions (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        if self.tangent is None:
            self.solves += 1
            self._solve(conditions)
        else:
            self.tangent.step(conditions)
        return self._system.recover(conditions, self._iterations)

    def respond(self, conditions: SiteConditions, loads: Loads) -> tuple[fem.Function, fem.Function, Array]:
        """Solve with any right side, see `FacetSystem.respond`; the last solution stays (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        plain = replace(conditions, value=0.0)
        if not self._factors.present:  # with laws in Ω the sources are those of the conditions
            self._impose_plain(plain)
        return self._system.respond(plain, loads, partial(self._solve_for, plain))

    def _solve_for(self, plain: SiteConditions, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve with another right side, under conditions without values (collective)."""
        imposed = self._imposed(plain)
        if self._factors.solve(b.array_r.copy(), x, imposed):
            return
        self._impose_plain(plain)
        self._solve_imposed(b, x, imposed)

    def _imposed(self, conditions: SiteConditions) -> Imposed:
        return Imposed.alone(*self._system.held_and_springs(conditions))

    def _impose_plain(self, plain: SiteConditions) -> None:
        """Apply conditions without values, unless they are those of the last solve (collective)."""
        if self._applied is None or not plain.same(replace(self._applied, value=0.0), self.comm):
            self._applied = None
            self._impose(plain)

    def _solve_imposed(self, b: PETSc.Vec, x: PETSc.Vec, imposed: Imposed) -> None:
        """Solve with the matrix under the conditions that were imposed, and keep a factorisation (collective)."""
        self._solver.solve(b, x)
        if self._solver.factorises and self._can_keep:
            self._factors.keep(imposed)

    @property
    def _can_keep(self) -> bool:
        """Whether a factorisation may serve other sets: the matrix is regular for all, and no law in Ω changes it."""
        if self._keeps is None:
            self._keeps = self.data.inside is None and floating_cells(self.spaces, self.data)[1] == 0
        return self._keeps

    def solve_until(self, conditions: SiteConditions, enough: Callable[[Array, Array], bool]) -> tuple[Array, Array]:
        """Solve as `Inexact.solve_until` says (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        system = self._system
        if self._factors.present and not conditions.same(self._applied, self.comm):
            (load, given), imposed = system.posed(conditions), self._imposed(conditions)
            if (traces := self._factors.at_sites(load, imposed)) is not None:
                sites, left = system.trace_dofs, np.where(imposed.held, 0.0, conditions.value)
                flux = (traces[1] - load[sites]) / self.spaces.facet_measure + left
                return conditions.clean(traces[0] + given[sites], flux, self.data.conductance)
        with self._solver.stopping(lambda x: enough(*system.traces(x, conditions))):
            self._solve(conditions)
        return system.traces(system.x, conditions)

    def reached(self, conditions: SiteConditions) -> Iterate | None:
        """The iterate of the last solve, see `Inexact.reached`; None by a factorisation, which gives traces alone.

        Collective.
        """
        return self._system.recover(conditions, self._iterations) if self._solver.iterates else None

    def solve_near(
        self, sites: Mask, layers: int, share: float
    ) -> Callable[[SiteConditions], tuple[Array, Array]] | None:
        """Solves as `Inexact.solve_near` says; None by a factorisation (collective)."""
        if not self._solver.iterates:
            return None
        patch = Patch(self._system.matrix, self._system.unknowns(sites), layers)

        def solve_on_patch(conditions: SiteConditions) -> tuple[Array, Array]:
            self._applied = None
            self._factors.forget()
            self._system.apply(conditions)
            patch.solve(self._system.matrix, self._system.b, self._system.x)
            return self._system.traces(self._system.x, conditions)

        return None if patch.size > share * self.dofs else solve_on_patch

    def _solve(self, conditions: SiteConditions) -> None:
        """Apply the conditions and solve.

        Nothing is done if the last solve under the same conditions converged; one that stopped early goes on.
        """
        system, new = self._system, not conditions.same(self._applied, self.comm)
        if not new and (self._solver.converged or not self._solver.iterates):
            return
        imposed = self._imposed(conditions)
        self._applied = None  # a solve that fails leaves no solution
        if new:
            if self._factors.present and self._factors.repeated <= FACTORISATION:
                load, given = system.posed(conditions)
                if self._factors.solve(load, system.x, imposed):
                    system.x.array_w[:] += given
                    self._applied, self._iterations = conditions, 1
                    return
            essential, self._iterations = self._impose(conditions), 0
            self._earlier.combine(system.matrix, system.b, system.x, essential)
        self._solve_imposed(system.b, system.x, imposed)
        self._applied = conditions
        self._iterations += self._solver.ksp.getIterationNumber()

    def _impose(self, conditions: SiteConditions) -> npt.NDArray[np.int32]:
        """Apply the conditions, to multigrid as well, and return the owned unknowns that they fix (collective)."""
        self._factors.forget()
        essential = self._system.apply(conditions)
        if self._solver.levels is not None:
            with self._solver.options():
                self._solver.levels.update(self.facets.of(conditions), essential)
        return essential
