"""The saddle-point backend: (11b)-(11c) on RT0/P0, assembled once, solved with MUMPS unless PETSc options say else."""

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import create_vector
from petsc4py import PETSc

from forms.mixed import flux_equation, load, mass_balance, trace_term
from signorini_fenicsx.backend import Iterate, direct_solver, solve_linear, solver_name
from signorini_fenicsx.conditioned import ConditionedMatrix
from signorini_fenicsx.conditions import Condition, FacetConditions
from signorini_fenicsx.data import Data
from signorini_fenicsx.spaces import Spaces, assembled


class MixedBackend:
    """The mixed method as it is written: unknowns σ_h and u_h, then p_h from the identity (12).

    The matrix [(σ, τ), (u, ∇·τ); (∇·σ, v), 0] is assembled once. A NO_FLUX facet is an essential condition on its
    flux degree of freedom, a ZERO_TRACE facet a natural one, a ROBIN facet adds to the diagonal: a step changes rows
    and columns of facets only and the sparsity pattern, with its symbolic factorisation, stays.
    """

    name = "mixed"

    def __init__(self, spaces: Spaces, data: Data):
        """Assemble (collective).

        Args:
            spaces: The discrete spaces.
            data: Its means over cells and facets.
        """
        self.spaces = spaces
        V, Q = spaces.V, spaces.Q
        self._system = saddle_point_matrix(spaces)
        self._flux_size = V.dofmap.index_map.size_local
        self.dofs = self._system.matrix.getSize()[0]

        self._load = create_vector([V, Q])
        tau, v = ufl.TestFunction(V), ufl.TestFunction(Q)
        trace = assembled(trace_term(data.u_Dh, tau, spaces.n, spaces.ds_dirichlet))
        self._load.array_w[: self._flux_size] = trace[: self._flux_size]
        self._load.array_w[self._flux_size :] = -assembled(load(data.f_h, v))  # no ghost cells

        self._ksp = direct_solver(self._system.matrix, "lu")

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return solver_name(self._ksp)

    def solve(self, conditions: FacetConditions) -> Iterate:
        """Solve with these conditions on Γ_S and u = u_D on Γ_D (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        spaces = self.spaces
        no_flux, robin = conditions.kind == Condition.NO_FLUX, conditions.kind == Condition.ROBIN
        # (1/β)(σ·n, τ·n)_e is one diagonal entry per ROBIN facet: its basis function alone has a flux there.
        added = (spaces.basis_flux**2 / spaces.facet_measure)[robin] / conditions.beta
        self._system.impose(spaces.flux_dofs[no_flux], spaces.flux_dofs[robin], added)

        # Not duplicates of the load: PETSc never frees a duplicate of a vector with ghosts.
        x, residual = self._system.matrix.createVecs()
        solve_linear(self._ksp, self._load, x)

        self._system.natural.mult(x, residual)
        sigma, u = flux_and_scalar(spaces, x)
        p = residual.array_r[spaces.flux_dofs] / spaces.basis_flux  # (12) with τ_h = the facet's basis function
        p, flux = conditions.clean(p, spaces.normal_flux(sigma))
        return Iterate(sigma, u, p, flux, self._ksp.getIterationNumber())


def saddle_point_matrix(spaces: Spaces, *, stabilisation: float = 0.0) -> ConditionedMatrix:
    """[(σ, τ), (u, ∇·τ); (∇·σ, v), −ε(u, v)] (collective).

    Args:
        spaces: The discrete spaces.
        stabilisation: ε ≥ 0; 0 is the mixed method.
    """
    W = ufl.MixedFunctionSpace(spaces.V, spaces.Q)
    (sigma, u), (tau, v) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
    block = fem.Constant(spaces.mesh, -stabilisation) * u * v * ufl.dx  # stored even where 0, for MatZeroRowsColumns
    blocks = ufl.extract_blocks(flux_equation(sigma, u, tau) + mass_balance(sigma, v) + block)
    return ConditionedMatrix(fem.form(blocks), PETSc.Mat.Option.SYMMETRIC)


def flux_and_scalar(spaces: Spaces, x: PETSc.Vec) -> tuple[fem.Function, fem.Function]:
    """σ_h and u_h from a vector of the saddle point (collective)."""
    sigma, u = fem.Function(spaces.V, name="sigma"), fem.Function(spaces.Q, name="u")
    for function, values in zip((sigma, u), np.split(x.array_r, [spaces.V.dofmap.index_map.size_local]), strict=True):
        function.x.array[: len(values)] = values
        function.x.scatter_forward()
    return sigma, u
