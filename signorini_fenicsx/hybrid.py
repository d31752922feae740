"""The hybrid backend: one SPD system with one unknown per facet, and the mixed solution recovered from it."""

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from dolfinx.fem.petsc import assemble_matrix, create_vector
from petsc4py import PETSc

from forms.crouzeix_raviart import recovered_flux, recovered_scalar, stiffness
from forms.mixed import load
from signorini_fenicsx.auxiliary_space import AuxiliarySpace
from signorini_fenicsx.backend import Iterate, solve_linear, solver_name, take_options
from signorini_fenicsx.conditions import Condition, FacetConditions
from signorini_fenicsx.data import Data
from signorini_fenicsx.spaces import Spaces, cell_measures, cells_and_dofs

DIRECT_UP_TO = 60_000
"""Unknowns up to which a direct factorisation is at least as fast as multigrid."""
TOLERANCE = 1e-12
"""Relative tolerance of CG; making the recovered flux conforming amplifies what is left by 1/h."""


class HybridBackend:
    """The mixed method by its Crouzeix-Raviart form (see `forms.crouzeix_raviart`).

    A ZERO_TRACE facet, like one of Γ_D, is an essential condition on its degree of freedom, a NO_FLUX facet a natural
    one, and a ROBIN facet adds β|e| p̄ q̄, on facet means, to the diagonal. Small systems go to MUMPS (Cholesky), larger
    ones to CG with auxiliary-space multigrid; PETSc options override either.

    Attributes:
        matrix: The Crouzeix-Raviart matrix under the conditions last applied.
        b: Its right side.
        x: Its solution, u_CR less the lifting u_Dh of the Dirichlet data; the start of the next iterative solve.
        trace_dofs: The unknown of each Γ_S facet.
        large: Whether iterative solvers are the default at this size.
    """

    name = "hybrid"

    def __init__(self, spaces: Spaces, data: Data):
        """Assemble (collective).

        Args:
            spaces: The discrete spaces.
            data: Its means over cells and facets.
        """
        self.spaces = spaces
        mesh = spaces.mesh
        self._space = data.u_Dh.function_space
        self.trace_dofs = cells_and_dofs(self._space, spaces.facets)[1]
        self._dirichlet_dofs = cells_and_dofs(self._space, spaces.dirichlet_facets)[1]
        self.dofs = self._space.dofmap.index_map.size_global
        self.large = self.dofs > DIRECT_UP_TO
        u, v = ufl.TrialFunction(self._space), ufl.TestFunction(self._space)
        self._assembled = assemble_matrix(fem.form(stiffness(u, v)))
        self._assembled.assemble()
        self.matrix = self._assembled.duplicate(copy=True)
        self.matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self.matrix.setOption(PETSc.Mat.Option.SPD, True)
        self._load = fem.assemble_vector(fem.form(load(data.f_h, v) - stiffness(data.u_Dh, v)))
        self._load.scatter_reverse(la.InsertMode.add)
        self.x, self.b = create_vector(self._space), create_vector(self._space)
        self.x.set(0.0)
        self._recovery = _Recovery(spaces, data)
        self._ksp = PETSc.KSP().create(mesh.comm)
        self._ksp.setOperators(self.matrix)
        self._auxiliary = self._set_up_solver()

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return solver_name(self._ksp)

    def solve(self, conditions: FacetConditions) -> Iterate:
        """Solve with these conditions on Γ_S and u = u_D on Γ_D (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        essential = self.apply(conditions)
        self.x.array_w[essential] = 0.0
        if self._auxiliary is not None:
            self._auxiliary.update(self._ksp.getPC(), conditions, essential)
        solve_linear(self._ksp, self.b, self.x)
        return self.recover(conditions, self._ksp.getIterationNumber())

    def apply(self, conditions: FacetConditions) -> npt.NDArray[np.int32]:
        """Make `matrix` and `b` those of these conditions and return the owned unknowns they fix (collective)."""
        zero_trace = conditions.kind == Condition.ZERO_TRACE
        essential = np.concatenate([self._dirichlet_dofs, self.trace_dofs[zero_trace]])
        self._assembled.copy(self.matrix, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self._add_robin(conditions)
        self.matrix.zeroRowsColumns(essential + self.matrix.getOwnershipRange()[0])
        self.b.array_w[:] = self._load.array[: self.b.getLocalSize()]
        self.b.array_w[essential] = 0.0
        return essential

    def recover(self, conditions: FacetConditions, linear_iterations: int) -> Iterate:
        """σ_h, u_h and p_h from the present `x`, a solution under these conditions (collective)."""
        spaces = self.spaces
        sigma, u = self._recovery(self.x)
        p, flux = conditions.clean(self.x.array_r[self.trace_dofs], spaces.normal_flux(sigma))
        sigma.x.array[spaces.flux_dofs] = flux * spaces.facet_measure / spaces.basis_flux
        sigma.x.scatter_forward()
        return Iterate(sigma, u, p, flux, linear_iterations)

    def _set_up_solver(self) -> AuxiliarySpace | None:
        """Defaults by size, then the user's options; the coarse space, if multigrid is what came out."""
        ksp, pc = self._ksp, self._ksp.getPC()
        if self.large:
            ksp.setType("cg")
            ksp.setTolerances(rtol=TOLERANCE)
            ksp.setInitialGuessNonzero(True)
            pc.setType("mg")
        else:
            ksp.setType("preonly")
            pc.setType("cholesky")
            pc.setFactorSolverType("mumps")
        auxiliary = AuxiliarySpace(self.spaces, self._space, pc) if self.large else None
        take_options(ksp)
        if ksp.getType() == "preonly":
            ksp.setInitialGuessNonzero(False)
        return auxiliary if pc.getType() == "mg" else None

    def _add_robin(self, conditions: FacetConditions) -> None:
        robin = conditions.kind == Condition.ROBIN
        diagonal = self.matrix.createVecLeft()
        diagonal.set(0.0)
        diagonal.array_w[self.trace_dofs[robin]] = conditions.beta * self.spaces.facet_measure[robin]
        self.matrix.setDiagonal(diagonal, PETSc.InsertMode.ADD_VALUES)


class _Recovery:
    """σ_h and u_h from u_CR, with the forms compiled once."""

    def __init__(self, spaces: Spaces, data: Data):
        self._spaces = spaces
        mesh, f_h = spaces.mesh, data.f_h
        self._u_Dh = data.u_Dh
        self._u_cr = fem.Function(data.u_Dh.function_space)
        x = ufl.SpatialCoordinate(mesh)
        centroid = fem.Function(fem.functionspace(mesh, ("DG", 0, (mesh.geometry.dim,))))
        centroid.interpolate(lambda x: x[: mesh.geometry.dim])
        flux = recovered_flux(self._u_cr, f_h, centroid, x)
        self._flux = fem.Expression(flux, spaces.V.element.interpolation_points)
        self._scalar = fem.form(recovered_scalar(self._u_cr, f_h, centroid, x, ufl.TestFunction(spaces.Q)))
        self._measures = cell_measures(spaces.Q)

    def __call__(self, x: PETSc.Vec) -> tuple[fem.Function, fem.Function]:
        """σ_h and u_h; on a facet between two cells the flux of the last one, equal up to the linear residual."""
        owned: npt.NDArray[np.float64] = x.array_r
        self._u_cr.x.array[: len(owned)] = owned
        self._u_cr.x.scatter_forward()
        self._u_cr.x.array[:] += self._u_Dh.x.array
        sigma, u = fem.Function(self._spaces.V, name="sigma"), fem.Function(self._spaces.Q, name="u")
        sigma.interpolate(self._flux)
        sigma.x.scatter_forward()
        u.x.array[:] = fem.assemble_vector(self._scalar).array / self._measures
        return sigma, u
