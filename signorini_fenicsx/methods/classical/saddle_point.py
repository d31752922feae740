"""The saddle point of RT0/P0 with any data on Γ_S, factored once for all steps with the same essential conditions."""

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.fem.petsc import create_vector

from signorini_fenicsx.backends.contract import Iterate, direct_solver, solve_linear, solver_name
from signorini_fenicsx.backends.mixed import flux_and_scalar, saddle_point_load, saddle_point_matrix
from signorini_fenicsx.discrete.conditions import Condition, FacetConditions
from signorini_fenicsx.discrete.data import Data
from signorini_fenicsx.discrete.spaces import Spaces, cell_measures

type Array = npt.NDArray[np.float64]


class SaddlePoint:
    """The mixed problem with σ·n or p given on each facet of Γ_S, and perhaps stabilised.

        (κ⁻¹σ, τ) + (u, ∇·τ) = (p, τ·n)_ΓS + (u_D, τ·n)_ΓD,      (∇·σ, v) − ε(u, v) = −(f_h, v) − ε(u_before, v).

    What is solved for is σ − σ_lift and u; on Γ_S p and σ·n stand for p − ψ and σ·n − q_S, as in an `Iterate`.
    ε = 0 is the mixed method. ε > 0 is Slimane's stabilisation of it for u_before = 0, and a step of the proximal
    iteration u = u_before + (1/ε)(∇·σ + f_h) otherwise. It is a backend for the active-set loop, too.

    Attributes:
        before: u_before.
    """

    name = "mixed"

    def __init__(self, spaces: Spaces, data: Data, *, stabilisation: float = 0.0):
        """Assemble (collective).

        Args:
            spaces: The discrete spaces.
            data: Its means over cells and facets.
            stabilisation: ε ≥ 0.

        Raises:
            InputError: If PETSc refuses an option.
        """
        self.spaces, self.data, self._stabilisation = spaces, data, stabilisation
        V, Q = spaces.V, spaces.Q
        self._system = saddle_point_matrix(spaces, data, stabilisation=stabilisation)
        self.dofs = self._system.matrix.getSize()[0]
        self._flux_size = V.dofmap.index_map.size_local
        self._measures = cell_measures(Q)[: Q.dofmap.index_map.size_local]
        self._load = saddle_point_load(spaces, data, self._system)
        self.before = fem.Function(Q)

        self._given_flux = np.zeros(len(spaces.facets), dtype=bool)
        self._impose()
        self._b, self._x, self._residual = (create_vector([V, Q]) for _ in range(3))
        self._ksp = direct_solver(self._system.matrix, "lu")

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return solver_name(self._ksp)

    def solve(self, conditions: FacetConditions) -> Iterate:
        """Solve with σ·n = 0 on NO_FLUX and p = 0 on the other facets (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        nothing = np.zeros(len(self.spaces.facets))
        self.give_flux(conditions.kind == Condition.NO_FLUX)
        return self.respond(flux=nothing, trace=nothing)

    def give_flux(self, where: npt.NDArray[np.bool_]) -> None:
        """Make σ·n essential on these facets of this rank, natural on the others (collective)."""
        comm = self.spaces.mesh.comm
        if not comm.allreduce(bool(np.any(where != self._given_flux))):
            return
        self._given_flux = where
        self._impose()

    def _impose(self) -> None:
        none = np.empty(0, dtype=np.int32)
        essential = np.concatenate([self.spaces.neumann_dofs, self.spaces.flux_dofs[self._given_flux]])
        self._system.impose(essential, none, none)

    def respond(self, *, flux: Array, trace: Array, loaded: bool = True) -> Iterate:
        """Solve with these values on Γ_S (collective).

        Args:
            flux: σ·n per facet, used where it is essential.
            trace: p per facet, used elsewhere.
            loaded: Whether with the data and u_before, or with 0 instead of all of them.

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        spaces, given = self.spaces, self._given_flux
        b, x, residual = self._b, self._x, self._residual
        essential = spaces.flux_dofs[given]
        values = (flux * spaces.facet_measure / spaces.basis_flux)[given]
        x.set(0.0)
        x.array_w[essential] = values
        self._system.natural.mult(x, b)
        b.scale(-1.0)
        b.array_w[spaces.flux_dofs] += trace * spaces.basis_flux
        if loaded:
            b.array_w[:] += self._load
            b.array_w[self._flux_size :] -= (
                self._stabilisation * self._measures * self.before.x.array[: len(self._measures)]
            )
        b.array_w[spaces.neumann_dofs] = 0.0
        b.array_w[essential] = values
        solve_linear(self._ksp, b, x)

        self._system.natural.mult(x, residual)
        if loaded:
            residual.array_w[:] -= self._load
        sigma, u = flux_and_scalar(spaces, x)
        p = np.where(given, residual.array_r[spaces.flux_dofs] / spaces.basis_flux, trace)  # (12)
        flux = np.where(given, flux, spaces.normal_flux(sigma))
        if loaded:
            sigma.x.array[:] += self.data.sigma_lift.x.array
        return Iterate(sigma, u, p, flux, self._ksp.getIterationNumber())
