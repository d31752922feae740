"""The saddle-point backend: (11b)-(11c) on RT0/P0, assembled once, solved with MUMPS unless PETSc options say else."""

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import create_vector
from petsc4py import PETSc

from signorini_fenicsx.backends.contract import Iterate, direct_solver, solve_linear, solver_name
from signorini_fenicsx.discrete.conditions import Condition, FacetConditions
from signorini_fenicsx.discrete.constrained_matrix import ConditionedMatrix
from signorini_fenicsx.discrete.data import Data
from signorini_fenicsx.discrete.spaces import Array, Spaces, assembled
from signorini_fenicsx.forms.mixed import flux_equation, load, mass_balance, trace_term


class MixedBackend:
    """The mixed method as it is written: unknowns σ_h and u_h, then p_h from the identity (12).

    The matrix [(κ_h⁻¹σ, τ), (u, ∇·τ); (∇·σ, v), 0] is assembled once; what is solved for is σ − σ_lift and u. A NO_FLUX
    facet is an essential condition on its flux degree of freedom, a ZERO_TRACE facet a natural one, a ROBIN facet adds
    to the diagonal: a step changes rows and columns of facets only and the sparsity pattern, with its symbolic
    factorisation, stays.
    """

    name = "mixed"

    def __init__(self, spaces: Spaces, data: Data):
        """Assemble (collective).

        Args:
            spaces: The discrete spaces.
            data: Its means over cells and facets.
        """
        self.spaces, self.data = spaces, data
        V, Q = spaces.V, spaces.Q
        self._system = saddle_point_matrix(spaces, data)
        self._flux_size = V.dofmap.index_map.size_local
        self.dofs = self._system.matrix.getSize()[0]

        self._load = saddle_point_load(spaces, data, self._system)
        self._b = create_vector([V, Q])
        self._ksp = direct_solver(self._system.matrix, "lu")

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return solver_name(self._ksp)

    def solve(self, conditions: FacetConditions) -> Iterate:
        """Solve as `Backend.solve` says (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        spaces = self.spaces
        no_flux, robin = conditions.kind == Condition.NO_FLUX, conditions.kind == Condition.ROBIN
        # (1/β)(σ·n, τ·n)_e is one diagonal entry per ROBIN facet: its basis function alone has a flux there.
        added = (spaces.basis_flux**2 / spaces.facet_measure)[robin] / conditions.beta
        essential = np.concatenate([spaces.neumann_dofs, spaces.flux_dofs[no_flux]])
        self._system.impose(essential, spaces.flux_dofs[robin], added)
        self._b.array_w[:] = self._load
        self._b.array_w[essential] = 0.0

        # Not duplicates of the load: PETSc never frees a duplicate of a vector with ghosts.
        x, residual = self._system.matrix.createVecs()
        solve_linear(self._ksp, self._b, x)

        self._system.natural.mult(x, residual)
        residual.array_w[:] -= self._load
        p = residual.array_r[spaces.flux_dofs] / spaces.basis_flux  # (12) with τ_h = the facet's basis function
        sigma, u = flux_and_scalar(spaces, x)
        p, flux = conditions.clean(p, spaces.normal_flux(sigma), self.data.stiffness)
        sigma.x.array[:] += self.data.sigma_lift.x.array
        return Iterate(sigma, u, p, flux, self._ksp.getIterationNumber())


def saddle_point_matrix(spaces: Spaces, data: Data, *, stabilisation: float = 0.0) -> ConditionedMatrix:
    """[(κ_h⁻¹σ, τ), (u, ∇·τ); (∇·σ, v), −ε(u, v)] (collective).

    Args:
        spaces: The discrete spaces.
        data: For κ_h.
        stabilisation: ε ≥ 0; 0 is the mixed method.
    """
    W = ufl.MixedFunctionSpace(spaces.V, spaces.Q)
    (sigma, u), (tau, v) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
    block = fem.Constant(spaces.mesh, -stabilisation) * u * v * ufl.dx  # stored even where 0, for MatZeroRowsColumns
    saddle_point = flux_equation(sigma, u, tau, ufl.dx, data.kappa_h) + mass_balance(sigma, v, ufl.dx)  # (11b), (11c)
    blocks = ufl.extract_blocks(saddle_point + block)
    return ConditionedMatrix(fem.form(blocks), PETSc.Mat.Option.SYMMETRIC)


def saddle_point_load(spaces: Spaces, data: Data, system: ConditionedMatrix) -> Array:
    """Right side of the saddle point for σ − σ_lift and u, with u_D on Γ_D and ψ on Γ_S: owned entries (collective)."""
    tau, v = ufl.TestFunction(spaces.V), ufl.TestFunction(spaces.Q)
    lift, right = create_vector([spaces.V, spaces.Q]), create_vector([spaces.V, spaces.Q])
    size = spaces.V.dofmap.index_map.size_local
    lift.set(0.0)
    lift.array_w[:size] = data.sigma_lift.x.array[:size]
    system.natural.mult(lift, right)
    right.scale(-1.0)
    right.array_w[:size] += assembled(trace_term(data.u_lift, tau, spaces.n, spaces.ds_dirichlet + spaces.ds))[:size]
    right.array_w[size:] -= assembled(load(data.f_h, v, ufl.dx))  # no ghost cells
    return right.array_r.copy()


def flux_and_scalar(spaces: Spaces, x: PETSc.Vec) -> tuple[fem.Function, fem.Function]:
    """σ_h and u_h from a vector of the saddle point (collective)."""
    sigma, u = fem.Function(spaces.V, name="sigma"), fem.Function(spaces.Q, name="u")
    for function, values in zip((sigma, u), np.split(x.array_r, [spaces.V.dofmap.index_map.size_local]), strict=True):
        function.x.array[: len(values)] = values
        function.x.scatter_forward()
    return sigma, u
