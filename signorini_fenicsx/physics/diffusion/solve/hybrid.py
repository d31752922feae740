"""The hybrid backend of RT0: the facet system, solved by Cholesky or by CG with auxiliary-space multigrid."""

from functools import partial

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.owned import cell_dofs, function_of
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.backend import Inexact, Iterate
from signorini_fenicsx.contact.chains import Chains, Condition, SiteConditions
from signorini_fenicsx.discrete.mesh_spaces import cells_and_dofs
from signorini_fenicsx.discrete.posed import State
from signorini_fenicsx.discrete.vertex_laws import VertexLaws
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solve.auxiliary_space import DEFAULTS, AuxiliarySpace
from signorini_fenicsx.physics.diffusion.solve.facet_system import FacetSystem, Loads
from signorini_fenicsx.physics.diffusion.solve.facets import FacetBackend
from signorini_fenicsx.physics.diffusion.solve.flux_backend import FluxBackend
from signorini_fenicsx.physics.diffusion.solve.mixed import MixedBackend
from signorini_fenicsx.physics.diffusion.solve.solvability import floating_cells

PREDICT_FROM = 5_000
"""Number of facets of the mesh from which a prediction saves more than it costs."""
DIRECT_UP_TO = 60_000
"""Most facets of a system that is factorised: tenths of a second in the plane, seconds in space, for any κ."""
MOST_ITERATIONS = 100
"""If CG needs more and the system is not large, it gives way to a factorisation."""


class HybridBackend(FacetBackend, FluxBackend):
    """The facet system of RT0 with its linear solver, set up once.

    Small systems are solved by MUMPS (Cholesky), larger ones by CG with auxiliary-space multigrid; PETSc options
    override both. With a factorisation the results are as precise as those of the saddle point, except κ∇u where κ is
    large and cells are badly shaped.

    Systems in between begin with CG, because a factorisation takes as long as several solves. A factorisation takes its
    place if CG takes too many iterations, and for the problems that follow, as it serves many of their sets.
    """

    name = "hybrid"
    corrects = False
    spaces: Spaces
    system: FacetSystem
    data: Data

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
        system, tuning, rows = FacetSystem(spaces, data), tuning or Tuning(), np.arange(len(spaces.facets))
        fixed = cells_and_dofs(spaces.crouzeix_raviart, spaces.dirichlet_facets)[1]

        def choose(operator: ConstrainedMatrix) -> FacetSolver[AuxiliarySpace]:
            dofs = operator.matrix.getSize()[0]
            large = tuning.is_large(dofs, DIRECT_UP_TO)
            iterative = multigrid or large or tuning.predicts(dofs, PREDICT_FROM)
            make = partial(AuxiliarySpace, spaces, system, operator) if iterative else None
            return FacetSolver(operator.matrix, prefix, DEFAULTS, make, None if large else MOST_ITERATIONS)

        FluxBackend.__init__(self, system, spaces, data, fixed, (rows[:, None], rows[:, None]), choose)
        self._factors.by_gmres, none = False, np.zeros(len(rows))
        self._laws = VertexLaws((), Chains.at_corner(len(rows)), none, none, np.zeros((len(rows), 2)), 1)
        self._take(data)
        self._check_floating()

    def _take(self, data: Data) -> None:
        """Take data (collective)."""
        self.data, self._state, self.conductance = data, State.START, data.conductance
        if self._solver.factorises or self._solver.gives_way:
            self.precise = partial(MixedBackend, self.spaces, data)

    def _check_floating(self) -> None:
        """Keep no factorisation where the matrix is singular under some conditions (collective)."""
        if self.precise is not None:
            self._factors.keeps = self.by_traces and floating_cells(self.spaces, self.data)[1] == 0

    def renew(self, data: Data) -> bool:
        """Go on with other data, see `Renewable`; multigrid has to be set up again for another κ or c (collective)."""
        if self._solver.gives_way:
            self._solver.factorise()
        elif self.iterates and not data.same_operator(self.data, self.spaces):
            return False
        if self.system.renew(data):
            self._factors.serve_more()
        else:
            self._take_natural()
        self._take(data)
        self._check_floating()
        if self.iterates:
            self._factors.earlier.add(self._x)
        return True

    @property
    def laws(self) -> VertexLaws:
        """The facets by their conditions alone: a facet has one p and one flux."""
        return self._laws

    @property
    def cheap(self) -> bool:
        """Whether traces cost little beside a solve: by a factorisation that is kept."""
        return self._factors.present

    @property
    def inexact(self) -> Inexact | None:
        """The backend itself if its linear solver iterates, or once it keeps a factorisation."""
        return self if self.iterates or self._factors.present else None

    def around(self, sites: Mask) -> npt.NDArray[np.int32]:
        """The owned unknowns of facets of Γ_S, and of the facets of cells with laws."""
        of_cells = cell_dofs(self.spaces.crouzeix_raviart)[np.flatnonzero(self.cells.of(sites))].ravel()
        owned = of_cells[of_cells < self._x.getLocalSize()]
        return np.union1d(self._unknowns[self.facets.of(sites)], owned).astype(np.int32)

    def iterate(self, conditions: SiteConditions, sigma: Array, u: Array) -> Iterate:
        """The iterate from ∫σ·n out of cells through their facets, and u_T (collective).

        Values that are prescribed are exact.
        """
        spaces, data, flux = self.spaces, self.data, self.spaces.out_of_cells(sigma)
        through = spaces.normal_flux(flux) - data.q_Sh
        p, through = self._with_cells(self._x, conditions, through)
        on_facets = (self.facets.of(through) + data.q_Sh) * spaces.facet_measure
        flux.x.array[spaces.flux_dofs] = on_facets / spaces.basis_flux
        flux.x.array[spaces.neumann_dofs] = data.sigma_lift.x.array[spaces.neumann_dofs]
        flux.x.scatter_forward()
        spaces.carry_across(flux)
        if data.inside:
            cells = self.cells.of(conditions)
            u = np.where(cells.kind == Condition.ZERO_TRACE, data.inside.as_linear(cells)[1], u)
        return Iterate(p, through, self._iterations, flux, function_of(spaces.Q, u, "u"))

    def respond(self, conditions: SiteConditions, loads: Loads) -> tuple[fem.Function, fem.Function, Array]:
        """Solve with any right side under conditions, whose values do not matter; the last solution stays (collective).

        Returns:
            σ and u, and û of each facet that is owned, on inner ones of Γ_S its jump.

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        self.posed(conditions)

        def solve(load: Array) -> Array:
            return self.system.everywhere(self.solve_homogeneous(conditions, load).array_r)

        through, u, x = self.system.respond(loads, solve=solve)
        sigma = self.spaces.out_of_cells(through)
        self.spaces.carry_across(sigma)
        return sigma, function_of(self.spaces.Q, u, "u"), x[: len(self.system.load)]
