"""The saddle-point backend: (11b)-(11c) on RT0/P0, assembled once, solved with MUMPS unless PETSc options say else."""

import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.fem.petsc import assemble_matrix, create_vector
from petsc4py import PETSc

from forms.mixed import flux_equation, load, mass_balance
from signorini_fenicsx.backend import Iterate, solve_linear, solver_name, take_options
from signorini_fenicsx.conditions import Condition, FacetConditions
from signorini_fenicsx.spaces import Spaces


class MixedBackend:
    """The mixed method as it is written: unknowns σ_h and u_h, then p_h from the identity (12).

    The matrix [(σ, τ), (u, ∇·τ); (∇·σ, v), 0] is assembled once. A NO_FLUX facet is an essential condition on its
    flux degree of freedom, a ZERO_TRACE facet a natural one, a ROBIN facet adds to the diagonal: a step changes rows
    and columns of facets only and the sparsity pattern, with its symbolic factorisation, stays.
    """

    name = "mixed"

    def __init__(self, spaces: Spaces, f_h: fem.Function):
        """Assemble (collective).

        Args:
            spaces: The discrete spaces.
            f_h: P0 projection of the load.
        """
        self.spaces = spaces
        V, Q = spaces.V, spaces.Q
        W = ufl.MixedFunctionSpace(V, Q)
        (sigma, u), (tau, v) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
        zero = fem.Constant(V.mesh, 0.0) * u * v * ufl.dx  # MatZeroRowsColumns wants every diagonal entry stored
        blocks = ufl.extract_blocks(flux_equation(sigma, u, tau) + mass_balance(sigma, v) + zero)
        self._assembled = assemble_matrix(fem.form(blocks))
        self._assembled.assemble()
        self._flux_size = V.dofmap.index_map.size_local
        self.dofs = self._assembled.getSize()[0]

        self._load = create_vector([V, Q])
        self._load.set(0.0)
        self._load.array_w[self._flux_size :] = -_owned(
            fem.assemble_vector(fem.form(load(f_h, ufl.TestFunction(Q)))), Q
        )

        self._matrix = self._assembled.duplicate(copy=True)
        self._matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._ksp = PETSc.KSP().create(V.mesh.comm)
        self._ksp.setOperators(self._matrix)
        self._ksp.setType("preonly")
        self._ksp.getPC().setType("lu")
        self._ksp.getPC().setFactorSolverType("mumps")
        take_options(self._ksp)

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return solver_name(self._ksp)

    def solve(self, conditions: FacetConditions) -> Iterate:
        """Solve with these conditions on Γ_S and u = 0 on Γ_D (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        spaces = self.spaces
        self._assembled.copy(self._matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        first_row = self._matrix.getOwnershipRange()[0]
        self._add_robin(conditions)
        no_flux = spaces.flux_dofs[conditions.kind == Condition.NO_FLUX]
        self._matrix.zeroRowsColumns(first_row + no_flux)

        x = self._matrix.createVecRight()  # PETSc never frees a duplicate of a vector with ghosts, such as the load
        solve_linear(self._ksp, self._load, x)

        residual = self._matrix.createVecLeft()
        self._assembled.mult(x, residual)
        sigma, u = fem.Function(spaces.V, name="sigma"), fem.Function(spaces.Q, name="u")
        _set_owned(sigma, x.array_r[: self._flux_size])
        _set_owned(u, x.array_r[self._flux_size :])
        p = residual.array_r[spaces.flux_dofs] / spaces.basis_flux  # (12) with τ_h = the facet's basis function
        p, flux = conditions.clean(p, spaces.normal_flux(sigma))
        return Iterate(sigma, u, p, flux, self._ksp.getIterationNumber())

    def _add_robin(self, conditions: FacetConditions) -> None:
        """Add (1/β)(σ·n, τ·n)_e, one diagonal entry per ROBIN facet: its basis function alone has a flux there."""
        spaces = self.spaces
        robin = conditions.kind == Condition.ROBIN
        diagonal = self._matrix.createVecLeft()
        diagonal.set(0.0)
        diagonal.array_w[spaces.flux_dofs[robin]] = (spaces.basis_flux**2 / spaces.facet_measure)[
            robin
        ] / conditions.beta
        self._matrix.setDiagonal(diagonal, PETSc.InsertMode.ADD_VALUES)


def _owned(vector: la.Vector, space: fem.FunctionSpace) -> np.ndarray:
    return vector.array[: space.dofmap.index_map.size_local]


def _set_owned(function: fem.Function, values: np.ndarray) -> None:
    function.x.array[: len(values)] = values
    function.x.scatter_forward()
