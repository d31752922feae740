"""The saddle-point backend of RT1: the forms of the mixed method on RT1, P1 and the traces of the boundary."""

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
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import cell_dofs, function_of, owned_cells
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.discrete.datum import DEGREES, Datum, quadrature_degree
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, blocks_of_cells
from signorini_fenicsx.discrete.matrices import identity_with
from signorini_fenicsx.discrete.mesh_spaces import assembled
from signorini_fenicsx.discrete.points import Points, cell_quadrature
from signorini_fenicsx.discrete.seen_on_facets import dofs_on_boundary
from signorini_fenicsx.forms.mixed import flux_product, mass_balance, trace_term
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix
from signorini_fenicsx.linear.petsc import direct_solver
from signorini_fenicsx.physics.diffusion.discrete.added_flux import AddedFlux
from signorini_fenicsx.physics.diffusion.discrete.linear_data import LinearData
from signorini_fenicsx.physics.diffusion.discrete.raviart_thomas import Cells
from signorini_fenicsx.physics.diffusion.discrete.spaces import LinearSpaces
from signorini_fenicsx.physics.diffusion.solve.linear_backend import VertexBackend
from signorini_fenicsx.physics.diffusion.solve.linear_residuals import LinearIterate


class LinearMixedBackend(VertexBackend):
    """The mixed method as the slides state it, on other spaces: unknowns σ_h, u_h, and û on the facets of the boundary.

        (κ⁻¹σ, τ) + (u, ∇·τ) − ⟨û, τ·n⟩ = 0,   (∇·σ, v) − (cu, v) = −(f, v),   −⟨σ·n, q⟩ = −⟨g, q⟩,

    with û given on Γ_D and at vertices with ZERO_TRACE, and g on Γ_N and at vertices with NO_FLUX. Springs are entries
    of û. On Γ_S the unknowns are those of `LinearTraces.frames`, and on parts inside the domain the jumps.
    """

    name = "mixed RT1"

    def __init__(self, spaces: LinearSpaces, data: LinearData):
        """Assemble (collective).

        Raises:
            InputError: If PETSc refuses an option; for laws in Ω and steps in time.
        """
        if data.inside is not None or data.memory is not None:
            raise InputError("element: the mixed backend with RT1 takes no laws in Ω and no steps in time; take hybrid")
        self.spaces, self.data, self.comm, self.sites = spaces, data, spaces.mesh.comm, len(spaces.site_kinds.unknown)
        traces, _ = spaces.on_boundary
        sizes = [space.dofmap.index_map.size_local for space in (spaces.flux_space, spaces.scalar_space, traces)]
        self._ends = np.cumsum(sizes)
        forms = spaces.kept(_saddle_point, _in_points(spaces, data.kappa), _in_points(spaces, data.c))
        self._system = ConstrainedMatrix(forms, PETSc.Mat.Option.SYMMETRIC, self._basis())
        self.dofs = self._system.matrix.getSize()[0]
        self._unknowns = self._of(spaces.contact).ravel()
        self._fixed = self._of(spaces.dirichlet).ravel()
        self._lift, self._load, self._x, self._b = (self._system.matrix.createVecRight() for _ in range(4))
        for vector in (self._lift, self._load):
            vector.set(0.0)
        for facets in (spaces.contact, spaces.dirichlet, spaces.neumann):
            rows, of_data = self._of(facets), spaces.unknowns(facets)
            self._lift.array_w[rows] = data.lift[of_data]
            self._load.array_w[rows] = -data.load[of_data]
        moments = fem.Function(spaces.scalar_space)
        dofs = np.take_along_axis(cell_dofs(spaces.scalar_space), spaces.order, axis=1)
        for numbers in blocks_of_cells(spaces.mesh):
            moments.x.array[dofs[numbers]] = data.moments_of_f(spaces, numbers, Cells(spaces.vertices[numbers]))
        self._load.array_w[self._ends[0] : self._ends[1]] = -moments.x.array[: sizes[1]]
        if data.b is not None:
            of_b = assembled(spaces.kept(_of_b, _b_in_points(spaces, data, data.b)))
            self._load.array_w[: sizes[0]] += of_b[: sizes[0]]
        self._system.natural.mult(self._lift, self._b)
        self._load.axpy(-1.0, self._b)
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

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return self._solver.name()

    def solve(self, conditions: SiteConditions) -> LinearIterate:
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
        system.natural.mult(x, b)
        b.aypx(-1.0, self._load)
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


def _in_points(spaces: LinearSpaces, datum: Datum) -> fem.Function:
    """A datum by its values in points of the cells, those in which the hybrid system has it (collective)."""
    return _of_points(spaces, min(quadrature_degree(datum) + 2, DEGREES[1]), datum.shape, datum.values)


def _of_points(
    spaces: LinearSpaces, degree: int, shape: tuple[int, ...], values: Callable[[Points], Array]
) -> fem.Function:
    """A function by its values in points of a quadrature (collective)."""
    element = basix.ufl.quadrature_element(spaces.mesh.basix_cell(), shape, degree=degree)
    function = fem.Function(fenicsx.function_space(spaces.mesh, element))
    by_point = function.x.array.reshape(-1, *shape)
    for points in cell_quadrature(spaces.mesh, owned_cells(spaces.mesh), degree):
        by_point[function.function_space.dofmap.list[points.cells]] = values(points)
    return function


def _b_in_points(spaces: LinearSpaces, data: LinearData, b: AddedFlux) -> fem.Function:
    """κ⁻¹b by its values in points of the cells, see `_in_points` (collective)."""
    degree = min(data.degree_of(b) + 2, DEGREES[1])
    return _of_points(spaces, degree, (spaces.dim,), partial(b.over_kappa, kappa=data.kappa))


def _of_b(spaces: LinearSpaces, over_kappa: Expr) -> Form:
    """(κ⁻¹b, τ)."""
    return ufl.inner(over_kappa, ufl.TestFunction(spaces.flux_space)) * ufl.dx


def _saddle_point(spaces: LinearSpaces, kappa: Expr, c: Expr) -> list[list[Form | None]]:
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
