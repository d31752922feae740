"""The saddle-point backend: (11b)-(11c) on RT0/P0, assembled once, solved with MUMPS unless PETSc options differ.

*The saddle-point backend of RT1*: the forms of the mixed method on RT1, P1 and the traces of the boundary.
"""

from collections.abc import Callable
from functools import partial

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc
from ufl import Form
from ufl.core.expr import Expr

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import function_of, owned_cells, owned_values
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.discrete.datum import DEGREES, Datum, quadrature_degree
from signorini_fenicsx.discrete.kept_forms import Coefficient
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets
from signorini_fenicsx.discrete.matrices import identity_with
from signorini_fenicsx.discrete.mesh_spaces import assembled
from signorini_fenicsx.discrete.points import Points, cell_quadrature
from signorini_fenicsx.discrete.seen import dofs_on_boundary
from signorini_fenicsx.forms.mixed import flux_equation, flux_product, load, mass_balance, trace_term
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix, image_of
from signorini_fenicsx.linear.petsc import direct_solver
from signorini_fenicsx.physics.diffusion.discrete.added_flux import AddedFlux
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import joined
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.jumps import with_one_flux
from signorini_fenicsx.physics.diffusion.discrete.rt1_data import RT1Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces, Spaces
from signorini_fenicsx.physics.diffusion.solve.facets import FacetBackend
from signorini_fenicsx.physics.diffusion.solve.rt1_backend import VertexBackend
from signorini_fenicsx.physics.diffusion.solve.rt1_residuals import RT1Iterate


class RT1MixedBackend(VertexBackend):
    """The mixed method as the slides state it, on other spaces: unknowns σ_h, u_h, and û on the facets of the boundary.

        (κ⁻¹σ, τ) + (u, ∇·τ) − ⟨û, τ·n⟩ = 0,   (∇·σ, v) − (cu, v) = −(f, v),   −⟨σ·n, q⟩ = −⟨g, q⟩,

    with û given on Γ_D and at vertices with ZERO_TRACE, and g on Γ_N and at vertices with NO_FLUX. Springs are entries
    of û. On Γ_S the unknowns are those of `LinearTraces.frames`, and on parts inside the domain the jumps.
    """

    name = "mixed RT1"

    def __init__(self, spaces: RT1Spaces, data: RT1Data):
        """Assemble (collective).

        Raises:
            InputError: If PETSc refuses an option; for laws in Ω and steps in time.
        """
        if data.inside or data.memory is not None:
            raise InputError("element: the mixed backend with RT1 takes no laws in Ω and no steps in time; take hybrid")
        self.spaces, self.data, self.comm, self.sites = spaces, data, spaces.mesh.comm, len(spaces.site_kinds.unknown)
        traces, _ = spaces.on_boundary
        sizes = [space.dofmap.index_map.size_local for space in (spaces.flux_space, spaces.scalar_space, traces)]
        self._ends = np.cumsum(sizes)
        forms = spaces.kept(_linear_saddle_point, _in_points(spaces, data.kappa), _in_points(spaces, data.c))
        self._system = ConstrainedMatrix(forms, PETSc.Mat.Option.SYMMETRIC, self._basis())
        self.dofs = self._system.matrix.getSize()[0]
        self._unknowns = self._of(spaces.contact).ravel()
        self._fixed = self._of(spaces.dirichlet).ravel()
        self._x, self._b = self._system.matrix.createVecs()
        lift, load = np.zeros((2, int(self._ends[2])))
        for facets in (spaces.contact, spaces.dirichlet, spaces.neumann):
            rows, of_data = self._of(facets), spaces.unknowns(facets)
            lift[rows], load[rows] = data.lift[of_data], -data.load[of_data]
        moments, dofs = fem.Function(spaces.scalar_space), spaces.at_vertices(spaces.scalar_space)
        for cells in spaces.blocks():
            moments.x.array[dofs[cells.numbers]] = data.moments_of_f(spaces, cells)
        load[self._ends[0] : self._ends[1]] = -moments.x.array[: sizes[1]]
        if data.b is not None:
            of_b = assembled(spaces.kept(_of_b, _b_in_points(spaces, data, data.b)))
            load[: sizes[0]] += of_b[: sizes[0]]
        self._load = load - image_of(self._system.natural, lift)
        self._solver = direct_solver(self._system.matrix, "lu", "mixed_")

    def _of(self, facets: BoundaryFacets) -> npt.NDArray[np.int32]:
        """The unknowns û of facets, shape (facets, d)."""
        return (self._ends[1] + dofs_on_boundary(self.spaces, facets)).astype(np.int32)

    def _basis(self) -> PETSc.Mat:
        """From the unknowns to values of û at the vertices on both sides of facets of Γ_S (collective)."""
        spaces, contact, across = self.spaces, self._of(self.spaces.contact), self._of(self.spaces.across)
        rows = np.concatenate([contact, across, contact[spaces.inner.rows]])
        columns = np.concatenate([contact, across, across])
        dual, size = (spaces.dim + 1) * np.eye(spaces.dim) - 1, int(self._ends[2])
        values = np.broadcast_to(dual, (len(rows), *dual.shape)).copy()
        values[: len(contact) + len(across)] -= np.eye(spaces.dim)  # the identity is there
        shape, comm = values.shape, spaces.mesh.comm
        places = np.broadcast_to(rows[:, :, None], shape), np.broadcast_to(columns[:, None], shape)
        row, column = (int(comm.exscan(size) or 0) + each.ravel() for each in places)
        return identity_with(comm, size, row, column, values.ravel())

    def solve(self, conditions: SiteConditions) -> RT1Iterate:
        """Solve as `Backend.solve` says (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        spaces, system, x, b, sites = self.spaces, self._system, self._x, self._b, self._unknowns
        held, springs = conditions.kind == Condition.ZERO_TRACE, self.laws.springs(conditions)
        (kind, _), values = spaces.site_kinds, np.broadcast_to(conditions.value, self.sites)
        essential = np.append(self._fixed, sites[held])
        by_row = np.broadcast_to(sites.reshape(-1, spaces.dim)[:, None], springs.stiffness.shape)
        added = -springs.stiffness.ravel() * kind.measure.repeat(spaces.dim)
        system.impose(essential, sites.repeat(spaces.dim), added, by_row.ravel())
        x.set(0.0)
        x.array_w[sites] = np.where(held, values, 0.0)
        b.array_w[:] = self._load - image_of(system.natural, x.array_r)
        flux = np.where(conditions.kind == Condition.NO_FLUX, values, 0.0) + springs.pressure(np.zeros(self.sites))
        b.array_w[sites] -= kind.measure * flux
        b.array_w[essential] = x.array_r[essential]
        self._solver.solve(b, x)
        sigma, u, _ = np.split(x.array_r, self._ends[:2])
        return self.iterate_of(
            conditions,
            x.array_r[sites],
            function_of(spaces.flux_space, sigma, "sigma"),
            function_of(spaces.scalar_space, u, "u"),
            self._solver.ksp.getIterationNumber(),
        )

    def scales(self, iterate: Iterate) -> tuple[Array, Array]:
        """The largest |u| and the largest |σ|, see `Backend.scales` (collective)."""
        values = iterate.u.x.array, self.spaces.flux_values(iterate.sigma)
        u, sigma = (self.comm.allreduce(np.abs(each).max(initial=0.0), MPI.MAX) for each in values)
        return np.full(self.sites, u), np.full(self.sites, sigma)


def _in_points(spaces: RT1Spaces, datum: Datum) -> fem.Function:
    """A datum by its values in points of the cells, those in which the hybrid system has it (collective)."""
    return _of_points(spaces, min(quadrature_degree(datum) + 2, DEGREES[1]), datum.shape, datum.values)


def _of_points(
    spaces: RT1Spaces, degree: int, shape: tuple[int, ...], values: Callable[[Points], Array]
) -> fem.Function:
    """A function by its values in points of a quadrature (collective)."""
    element = basix.ufl.quadrature_element(spaces.mesh.basix_cell(), shape, degree=degree)
    function = fem.Function(fenicsx.function_space(spaces.mesh, element))
    by_point = function.x.array.reshape(-1, *shape)
    for points in cell_quadrature(spaces.mesh, owned_cells(spaces.mesh), degree):
        by_point[function.function_space.dofmap.list[points.cells]] = values(points)
    return function


def _b_in_points(spaces: RT1Spaces, data: RT1Data, b: AddedFlux) -> fem.Function:
    """κ⁻¹b by its values in points of the cells, see `_in_points` (collective)."""
    degree = min(data.degree_of(b) + 2, DEGREES[1])
    return _of_points(spaces, degree, (spaces.dim,), partial(b.over_kappa, kappa=data.kappa))


def _of_b(spaces: RT1Spaces, over_kappa: Expr) -> Form:
    """(κ⁻¹b, τ)."""
    return ufl.inner(over_kappa, ufl.TestFunction(spaces.flux_space)) * ufl.dx


def _linear_saddle_point(spaces: RT1Spaces, kappa: Expr, c: Expr) -> list[list[Form | None]]:
    """The blocks of (σ, u, û)."""
    V, Q, traces = spaces.flux_space, spaces.scalar_space, spaces.on_boundary[0]
    (sigma, u, trace), (tau, v, q) = (
        [of(space) for space in (V, Q, traces)] for of in (ufl.TrialFunction, ufl.TestFunction)
    )
    n, ds = spaces.n, ufl.Measure("ds", domain=spaces.mesh)
    nothing = fem.Constant(spaces.mesh, 0.0)  # stored, for springs and for MatZeroRowsColumns
    return [
        [flux_product(sigma, tau, ufl.dx, kappa), u * ufl.div(tau) * ufl.dx, -trace_term(trace, tau, n, ds)],
        [mass_balance(sigma, v, ufl.dx), -c * u * v * ufl.dx, None],
        [-trace_term(q, sigma, n, ds), None, nothing * trace * q * ds],
    ]


class MixedBackend(FacetBackend):
    """The mixed method as the slides state it: unknowns σ_h and u_h, then p_h from the identity (12).

        (κ_h⁻¹σ, τ) + (u, ∇·τ) = (p, τ·n)_ΓS + (u_D, τ·n)_ΓD,
        (∇·σ, v) − ((c_h + ε)u, v) = −(f_h, v) − ε(u_before, v).

    ε = 0 is the mixed method. ε > 0 with u_before = 0 is Slimane's stabilisation of it. ε > 0 with another u_before is
    a step of the proximal iteration u = u_before + (1/ε)(∇·σ + f_h).

    The matrix is assembled once; the unknowns are σ − σ_lift and u. A NO_FLUX facet is an essential condition on its
    flux degree of freedom, a ZERO_TRACE facet is a natural one, and a ROBIN facet adds to the diagonal. So a step
    changes only rows and columns of facets, and the sparsity pattern with its symbolic factorisation stays. Laws in Ω
    fix u in a cell as well, or add to the diagonal, and the residual of its mass balance is the s of its law.

    Attributes:
        before: u_before.
    """

    name = "mixed"

    def __init__(self, spaces: Spaces, data: Data, *, stabilisation: float = 0.0):
        """Assemble (collective).

        Args:
            spaces: The discrete spaces.
            data: The data and their means over cells and facets.
            stabilisation: ε ≥ 0.

        Raises:
            InputError: If PETSc refuses an option.
        """
        super().__init__(spaces, data)
        V, Q = spaces.V, spaces.Q
        self._stabilisation = stabilisation
        W = [V, Q]
        basis = with_one_flux(spaces, sum(space.dofmap.index_map.size_local for space in W))
        saddle_point = spaces.kept(_saddle_point, *self._coefficients())
        self._system = ConstrainedMatrix(saddle_point, PETSc.Mat.Option.SYMMETRIC, basis)
        self._flux_size = V.dofmap.index_map.size_local
        self.dofs = self._system.matrix.getSize()[0]
        self._cells = spaces.cell_measures
        across = spaces.fluxes_across[0] if spaces.inner.present else spaces.neumann_dofs[:0]
        self._given = np.concatenate([spaces.neumann_dofs, across])  # these fluxes are never unknown
        self._load = self._right_side()
        self.before = fem.Function(Q)
        self._b, self._x, self._residual = (self._system.matrix.createVecRight() for _ in range(3))
        self._solver = direct_solver(self._system.matrix, "lu", "mixed_")
        self._imposed: SiteConditions | None = None

    def renew(self, data: Data) -> bool:
        """Go on with other data, see `Renewable` (collective)."""
        same = data.same_operator(self.data, self.spaces)
        self.data = data
        if not same:
            self._system.renew(self.spaces.kept(_saddle_point, *self._coefficients()))
            self._imposed = None
        self._load = self._right_side()
        self.before.x.array[:] = 0.0
        return True

    def _coefficients(self) -> tuple[Coefficient, Coefficient]:
        if self.data.c_h is None:
            return self.data.kappa_h, fem.Constant(self.spaces.mesh, self._stabilisation)
        c = self.data.c_h.copy()
        c.x.array[:] += self._stabilisation
        return self.data.kappa_h, c

    def solve(self, conditions: SiteConditions) -> Iterate:
        """Solve as `Backend.solve` says (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        values = np.array(np.broadcast_to(conditions.value, self.sites))
        return self.respond(conditions, flux=values, trace=values)

    def respond(self, conditions: SiteConditions, *, flux: Array, trace: Array, loaded: bool = True) -> Iterate:
        """Solve with given values of σ·n on NO_FLUX facets and of p on ZERO_TRACE facets (collective).

        Args:
            conditions: Conditions on the sites, whose own values are those of ROBIN facets only.
            flux: σ·n − q_S per site.
            trace: p − ψ per site.
            loaded: If False, all data and u_before are replaced by 0.

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        spaces, b, x, residual = self.spaces, self._b, self._x, self._residual
        self._impose(conditions)
        given_flux, given_trace = (conditions.kind == kind for kind in (Condition.NO_FLUX, Condition.ZERO_TRACE))
        inside, held, in_cells = self.data.inside, self.cells.of(given_trace), self.cells.of(conditions)
        on_facets, given = self.facets.of(conditions), self.facets.of(given_flux)
        load = inside.as_linear(in_cells)[1]
        essential = np.append(spaces.flux_dofs[given], self._of_cells(held))
        values = (self.facets.of(flux) * spaces.facet_measure / spaces.basis_flux)[given]
        values = np.append(values, load[held])
        x.set(0.0)
        x.array_w[essential] = values
        self._system.natural.mult(x, b)
        b.scale(-1.0)
        b.array_w[spaces.flux_dofs] += self.facets.of(np.where(given_trace, trace, 0.0)) * spaces.basis_flux
        robin = on_facets.kind == Condition.ROBIN
        of_robin = on_facets.values_where(robin) / on_facets.beta_where(robin)
        b.array_w[spaces.flux_dofs[robin]] += of_robin * spaces.basis_flux[robin]
        if loaded:
            b.array_w[:] += self._load
            b.array_w[self._flux_size :] -= self._stabilisation * self._cells * owned_values(self.before)
            if inside:
                b.array_w[self._flux_size :] -= self._cells * load
        b.array_w[self._given] = 0.0
        b.array_w[essential] = values
        self._solver.solve(b, x)

        self._system.natural.mult(x, residual)
        if loaded:
            residual.array_w[:] -= self._load
        p = residual.array_r[spaces.flux_dofs] / spaces.basis_flux  # (12) with τ_h = the facet's basis function
        sigma, u = self._fields(x)
        normal_flux = spaces.normal_flux(sigma)
        if inside:
            p = np.append(p, owned_values(u) - inside.means)
            normal_flux = np.append(normal_flux, -residual.array_r[self._flux_size :] / self._cells)
        p, normal_flux = conditions.clean(p, normal_flux, self.data.conductance)
        if loaded:
            sigma.x.array[:] += self.data.sigma_lift.x.array
        spaces.carry_across(sigma)
        return Iterate(
            p=np.where(given_trace, trace, p),
            flux=np.where(given_flux, flux, normal_flux),
            linear_iterations=self._solver.ksp.getIterationNumber(),
            sigma=sigma,
            u=u,
        )

    def _of_cells(self, cells: Mask) -> npt.NDArray[np.int32]:
        """The unknowns u of some cells."""
        return (self._flux_size + np.flatnonzero(cells)).astype(np.int32)

    def _impose(self, conditions: SiteConditions) -> None:
        """Make the matrix that of these conditions (collective)."""
        if conditions.same(self._imposed, self.comm):
            return
        spaces, in_cells = self.spaces, self.cells.of(conditions)
        of_cells, sloped = (self._of_cells(in_cells.kind == kind) for kind in (Condition.ZERO_TRACE, Condition.ROBIN))
        self._imposed, conditions = conditions, self.facets.of(conditions)
        no_flux, robin = conditions.kind == Condition.NO_FLUX, conditions.kind == Condition.ROBIN
        # (1/β)(σ·n, τ·n)_e is one diagonal entry per ROBIN facet: its basis function alone has a flux there.
        added = (spaces.basis_flux**2 / spaces.facet_measure)[robin] / conditions.beta_where(robin)
        essential = np.concatenate([self._given, spaces.flux_dofs[no_flux], of_cells])
        grows = in_cells.kind == Condition.ROBIN
        added = np.append(added, -self._cells[grows] * in_cells.beta_where(grows) if len(sloped) else np.empty(0))
        self._system.impose(essential, np.append(spaces.flux_dofs[robin], sloped), added)

    def _right_side(self) -> Array:
        """Right side for σ − σ_lift and u, with u_D on Γ_D and ψ on Γ_S: owned entries (collective)."""
        spaces, data, size = self.spaces, self.data, self._flux_size
        lift = np.append(data.sigma_lift.x.array[:size], np.zeros(len(self._cells)))
        right = -image_of(self._system.natural, lift)
        right[:size] += assembled(spaces.kept(_traces, data.u_lift))[:size]
        if (jumps := data.jumps(spaces)) is not None:  # (κ_h⁻¹b, τ)
            right[:size] += joined(spaces, spaces.outflow * jumps)[:size]
        right[size:] -= assembled(spaces.kept(_load, data.f_h))[: len(self._cells)]
        return right

    def _fields(self, x: PETSc.Vec) -> tuple[fem.Function, fem.Function]:
        """σ_h − σ_lift and u_h (collective)."""
        sigma, u = np.split(x.array_r, [self._flux_size])
        return function_of(self.spaces.V, sigma, "sigma"), function_of(self.spaces.Q, u, "u")


def _saddle_point(spaces: Spaces, kappa: Expr, c: Expr) -> list[list[Form]]:
    """[(κ_h⁻¹σ, τ), (u, ∇·τ); (∇·σ, v), −(cu, v)]."""
    W = ufl.MixedFunctionSpace(spaces.V, spaces.Q)
    (sigma, u), (tau, v) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
    block = -c * u * v * ufl.dx  # stored even where 0, for MatZeroRowsColumns
    blocks = flux_equation(sigma, u, tau, ufl.dx, kappa) + mass_balance(sigma, v, ufl.dx) + block  # (11b), (11c)
    extracted: list[list[Form]] = ufl.extract_blocks(blocks)
    return extracted


def _traces(spaces: Spaces, u_lift: Expr) -> Form:
    return trace_term(u_lift, ufl.TestFunction(spaces.V), spaces.n, spaces.ds_dirichlet + spaces.ds)


def _load(spaces: Spaces, f_h: Expr) -> Form:
    return load(f_h, ufl.TestFunction(spaces.Q), ufl.dx)
