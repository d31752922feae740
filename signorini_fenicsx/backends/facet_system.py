"""The facet system: one SPD problem with one unknown per facet, from which the mixed solution is recovered."""

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from dolfinx.fem.petsc import create_vector
from petsc4py import PETSc

from signorini_fenicsx.backends.contract import Iterate
from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.discrete.conditions import Condition, SiteConditions
from signorini_fenicsx.discrete.constrained_matrix import ConstrainedMatrix
from signorini_fenicsx.discrete.data import Data
from signorini_fenicsx.discrete.spaces import Spaces, cells_and_dofs
from signorini_fenicsx.forms.crouzeix_raviart import recovered_flux, recovered_scalar, stiffness
from signorini_fenicsx.forms.mixed import load, trace_term


class FacetSystem:
    """The mixed method by its Crouzeix-Raviart form (see `forms/crouzeix_raviart.py`).

    A ZERO_TRACE facet, like one of Γ_D, is an essential condition on its degree of freedom, a NO_FLUX facet a natural
    one, and a ROBIN facet adds β|e| p̄ q̄, on facet means, to the diagonal. v|e| is a load on either of the last two.

    Attributes:
        spaces: The discrete spaces.
        space: Crouzeix-Raviart functions.
        matrix: The Crouzeix-Raviart matrix under the conditions last applied.
        b: Its right side.
        x: Its solution, u_CR minus the lift of u_D and ψ; the start of the next iterative solve.
        trace_dofs: The unknown of each Γ_S facet.
        dofs: Unknowns over all ranks.
        large: Whether an iterative solver is the default at this size.
    """

    def __init__(self, spaces: Spaces, data: Data, tuning: Tuning):
        """Assemble (collective).

        Args:
            spaces: The discrete spaces.
            data: The data and their means over cells and facets.
            tuning: Has the size from which it is large.
        """
        self.spaces, self._data = spaces, data
        self.space = data.u_lift.function_space
        self.trace_dofs = cells_and_dofs(self.space, spaces.facets)[1]
        self._dirichlet_dofs = cells_and_dofs(self.space, spaces.dirichlet_facets)[1]
        self.dofs = self.space.dofmap.index_map.size_global
        self.large = self.dofs > tuning.direct_up_to
        u, v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        self._operator = ConstrainedMatrix(fem.form(stiffness(u, v, ufl.dx, data.kappa_h)), PETSc.Mat.Option.SPD)
        self.matrix = self._operator.matrix
        given_flux = trace_term(v, data.sigma_lift, spaces.n, spaces.ds_neumann + spaces.ds)
        self._load = fem.assemble_vector(
            fem.form(load(data.f_h, v, ufl.dx) + given_flux - stiffness(data.u_lift, v, ufl.dx, data.kappa_h))
        )
        self._load.scatter_reverse(la.InsertMode.add)
        self.x, self.b = create_vector(self.space), create_vector(self.space)
        self.x.set(0.0)
        self._recovery = _Recovery(spaces, data)

    def apply(self, conditions: SiteConditions) -> npt.NDArray[np.int32]:
        """Impose conditions on `matrix`, `b` and `x` and return the owned unknowns that they fix (collective)."""
        zero_trace, robin = conditions.kind == Condition.ZERO_TRACE, conditions.kind == Condition.ROBIN
        essential = np.concatenate([self._dirichlet_dofs, self.trace_dofs[zero_trace]])
        added = conditions.beta_where(robin) * self.spaces.facet_measure[robin]
        self._operator.impose(essential, self.trace_dofs[robin], added)
        self.b.array_w[:] = self._load.array[: self.b.getLocalSize()]
        if conditions.has_values:
            self._add_values(conditions, zero_trace)
        given = np.zeros(len(essential))
        given[len(self._dirichlet_dofs) :] = conditions.values_where(zero_trace)
        self.b.array_w[essential] = given
        self.x.array_w[essential] = given
        return essential

    def _add_values(self, conditions: SiteConditions, zero_trace: Mask) -> None:
        """The loads of fluxes that are not 0, and those of traces that are not, in `b` (collective)."""
        known, image = self.matrix.createVecs()
        known.set(0.0)
        known.array_w[self.trace_dofs[zero_trace]] = conditions.values_where(zero_trace)
        self._operator.natural.mult(known, image)
        self.b.array_w[:] -= image.array_r
        self.b.array_w[self.trace_dofs[~zero_trace]] += (
            conditions.values_where(~zero_trace) * self.spaces.facet_measure[~zero_trace]
        )
        for vector in (known, image):
            vector.destroy()

    def recover(self, conditions: SiteConditions, linear_iterations: int) -> Iterate:
        """σ_h, u_h and p_h from `x`, which solves the system under these conditions (collective)."""
        spaces = self.spaces
        sigma, u = self._recovery.fields(self.x)
        flux = spaces.normal_flux(sigma) - self._data.q_Sh
        p, flux = conditions.clean(self.x.array_r[self.trace_dofs], flux, self._data.conductance)
        sigma.x.array[spaces.flux_dofs] = (flux + self._data.q_Sh) * spaces.facet_measure / spaces.basis_flux
        sigma.x.array[spaces.neumann_dofs] = self._data.sigma_lift.x.array[spaces.neumann_dofs]
        sigma.x.scatter_forward()
        return Iterate(p=p, flux=flux, linear_iterations=linear_iterations, sigma=sigma, u=u)

    def traces(self, x: PETSc.Vec, conditions: SiteConditions) -> tuple[Array, Array]:
        """Trace and flux per Γ_S facet as `recover` gives them, for an x that need not be a solution (collective)."""
        flux = self._recovery.normal_flux(x) - self._data.q_Sh
        return conditions.clean(x.array_r[self.trace_dofs], flux, self._data.conductance)


class _Recovery:
    """σ_h and u_h from u_CR, with the forms compiled once."""

    def __init__(self, spaces: Spaces, data: Data):
        self._spaces = spaces
        mesh, f_h, kappa = spaces.mesh, data.f_h, data.kappa_h
        self._lift = data.u_lift
        self._u_cr, self._at_contact = fem.Function(data.u_lift.function_space), fem.Function(spaces.V)
        x = ufl.SpatialCoordinate(mesh)
        centroid = spaces.centroids
        flux = recovered_flux(self._u_cr, f_h, centroid, x, kappa)
        self._flux = fem.Expression(flux, spaces.V.element.interpolation_points)
        scalar = recovered_scalar(self._u_cr, f_h, centroid, x, kappa)
        self._scalar = fem.form(scalar * ufl.TestFunction(spaces.Q) * ufl.dx)
        self._measures = spaces.cell_measures

    def fields(self, x: PETSc.Vec) -> tuple[fem.Function, fem.Function]:
        """σ_h and u_h. A facet between two cells gets the flux of one of them; both agree up to the linear residual."""
        self._set(x)
        sigma, u = fem.Function(self._spaces.V, name="sigma"), fem.Function(self._spaces.Q, name="u")
        sigma.interpolate(self._flux)
        sigma.x.scatter_forward()
        u.x.array[:] = fem.assemble_vector(self._scalar).array / self._measures
        return sigma, u

    def normal_flux(self, x: PETSc.Vec) -> Array:
        """σ_h·n per Γ_S facet, from the cells behind these facets alone."""
        self._set(x)
        self._at_contact.interpolate(self._flux, cells0=self._spaces.cells)
        return self._spaces.normal_flux(self._at_contact)

    def _set(self, x: PETSc.Vec) -> None:
        owned: Array = x.array_r
        self._u_cr.x.array[: len(owned)] = owned
        self._u_cr.x.scatter_forward()
        self._u_cr.x.array[:] += self._lift.x.array
