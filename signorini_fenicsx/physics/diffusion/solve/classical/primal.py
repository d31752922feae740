"""The conforming P1 system of the primal methods, and how σ, u and p are recovered from it (see `forms/primal.py`)."""

import math
from functools import cached_property

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix
from petsc4py import PETSc

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import function_of
from signorini_fenicsx.base.tolerances import KKT, ROUNDING
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.contact.history import History, Outcome
from signorini_fenicsx.discrete.mesh_spaces import assembled, owned_on_facets
from signorini_fenicsx.forms.crouzeix_raviart import stiffness
from signorini_fenicsx.forms.mixed import flux_product, load, trace_term
from signorini_fenicsx.forms.primal import gradient, mass, vertex_weight
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix, image_of
from signorini_fenicsx.linear.petsc import LinearSolver, direct_solver
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solve.task import DiffusionTask

type Indices = npt.NDArray[np.int32]


class P1System:
    """(κ_h∇u, ∇v) + (c_h u, v) = (f_h, v) + (g_N, v) + (q_S, v) in P1, u = u_D at the vertices of Γ_D.

    On Γ_S u stands for u − ψ.
    Arrays hold values at the owned vertices, those of u − ψ on Γ_S.

    Attributes:
        spaces: The mixed spaces, for mesh and Γ_S.
        space: P1.
        dirichlet: Owned vertices of Γ_D.
        signorini: Owned vertices of Γ_S that are not on Γ_D.
        load: Right side: u_D on Γ_D, elsewhere the loads minus the contributions of u_D and ψ.
        weights: w_i = ∫_ΓS φ_i of the vertices `signorini`.
        matrix: Stiffness matrix with identity rows and columns for Γ_D.
        diagonal: Its diagonal.
        dofs: Vertices over all ranks.
    """

    name = "P1"

    def __init__(self, spaces: Spaces, data: Data):
        """Assemble (collective).

        Raises:
            InputError: If PETSc refuses an option.
        """
        self.spaces = spaces
        self.space = fenicsx.function_space(spaces.mesh, ("Lagrange", 1))
        self._size = self.space.dofmap.index_map.size_local
        self.dofs = self.space.dofmap.index_map.size_global
        v = ufl.TestFunction(self.space)
        self.dirichlet = owned_on_facets(self.space, spaces.dirichlet_facets)
        self.signorini = np.setdiff1d(owned_on_facets(self.space, spaces.facets), self.dirichlet)
        self.weights = self._owned(vertex_weight(v, spaces.ds))[self.signorini]
        u = ufl.TrialFunction(self.space)
        form = stiffness(u, v, ufl.dx, data.kappa_h)
        if data.c_h is not None:
            form += mass(data.c_h * u, v, ufl.dx)
        self._system = ConstrainedMatrix(fenicsx.form(form), PETSc.Mat.Option.SPD)
        self._stiffness = self._system.natural
        self.change_matrix()
        self.matrix = self._system.matrix.duplicate(copy=True)
        self.diagonal = self.matrix.getDiagonal().array_r.copy()

        self._x, self._b = self.matrix.createVecs()
        nodes = self.space.element.interpolation_points
        u_D, psi = (datum.at_nodes(self.space, nodes).x.array[: self._size] for datum in (data.u_D, data.psi))
        self._data, self._psi = data, self.at_signorini(psi[self.signorini])
        lift = self._psi.copy()
        lift[self.dirichlet] = u_D[self.dirichlet]
        given_flux = trace_term(v, data.sigma_lift, spaces.n, spaces.ds_neumann + spaces.ds)
        self.load = self._owned(load(data.f_h, v, ufl.dx) + given_flux) - image_of(self._stiffness, lift)
        self.load[self.dirichlet] = u_D[self.dirichlet]
        self._above_bound = u_D[self.dirichlet] > psi[self.dirichlet]
        self._solver = direct_solver(self._system.matrix, "cholesky", "primal_")

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return self._solver.name()

    def change_matrix(self, *, fixed: Indices | None = None, added: Array | None = None) -> None:
        """Let the next solves fix u = 0 at the vertices `fixed` and add `added` to the diagonal (collective).

        Args:
            fixed: Some of the vertices `signorini`.
            added: A value for each of the vertices `signorini`.
        """
        essential = self.dirichlet if fixed is None else np.concatenate([self.dirichlet, fixed])
        self._system.impose(essential, self.signorini, 0.0 if added is None else added)

    def solve(self, b: Array) -> Array:
        """Solve with this right side, which is 0 at all fixed vertices (collective).

        Raises:
            LinearSolveFailure: If the linear solver does not converge.
        """
        self._b.array_w[:] = b
        self._solver.solve(self._b, self._x)
        return self._x.array_r.copy()

    def at_signorini(self, values: Array) -> Array:
        """Values at the vertices `signorini` extended by 0."""
        everywhere = np.zeros(self._size)
        everywhere[self.signorini] = values
        return everywhere

    def times(self, u: Array) -> Array:
        """`matrix` times u (collective)."""
        return image_of(self.matrix, u)

    def dot(self, u: Array, v: Array) -> float:
        """Σ u_i v_i over all ranks (collective)."""
        return float(self.spaces.mesh.comm.allreduce(float(u @ v)))

    def energy_norm(self, u: Array) -> float:
        """((κ_h∇u, ∇u) + (c_h u, u))^½ (collective)."""
        return math.sqrt(max(self.dot(u, image_of(self._stiffness, u)), 0.0))

    def residual(self, u: Array, eps: float = 0.0) -> float:
        """Natural residual of (VI) in P1, or of (P_ε) if ε > 0; scale-free (collective).

        With r_i the reaction and D_i the diagonal it is √(Σ D_i m_i²)/‖∇u‖, where m_i = min(u_i + ε r_i/w_i, r_i/D_i)
        on Γ_S and m_i = r_i/D_i in Ω. It is 0 only at the solution. It is infinite if ∇u = 0 and u is not the solution.
        """
        size = self.energy_norm(u + self._psi)
        reaction = self.times(u) - self.load
        natural = reaction / self.diagonal
        on = self.signorini
        natural[on] = np.minimum(natural[on], u[on] + eps * reaction[on] / self.weights)
        norm = math.sqrt(self.dot(self.diagonal, natural**2))
        if size == 0:
            return math.inf if norm > 0 else 0.0
        return norm / size

    def conditions(self, zero: npt.NDArray[np.bool_], kind: Condition, beta: float = 1.0) -> SiteConditions:
        """Facet conditions: `kind` on facets all of whose vertices are on Γ_D with u = 0, or in `zero` (collective).

        Args:
            zero: Mask of the vertices `signorini`: True for those in contact.
            kind: The condition for contact.
            beta: β of a ROBIN condition.
        """
        marked = fem.Function(self.space)
        marked.x.array[self.dirichlet] = ~self._above_bound
        marked.x.array[self.signorini] = zero
        marked.x.scatter_forward()
        touching = marked.x.array[self._facet_vertices].min(axis=1, initial=1.0) > 0
        return SiteConditions(np.where(touching, kind, Condition.NO_FLUX).astype(np.int8), beta)

    def recover(self, u: Array) -> Iterate:
        """σ, the L² projection of ∇u to RT0, u by its cell means and p by the facet means of its trace (collective).

        Raises:
            LinearSolveFailure: If the projection does not converge.
        """
        spaces = self.spaces
        u_h = function_of(self.space, u + self._psi)
        integrals = assembled(mass(u_h, ufl.TestFunction(spaces.Q), ufl.dx))
        means = function_of(spaces.Q, integrals[: len(spaces.cell_measures)] / spaces.cell_measures, "u")
        sigma = _projected_flux(u_h, self._data, spaces)
        p = u_h.x.array[self._facet_vertices].mean(axis=1, dtype=np.float64) - self._data.psi_h
        flux = spaces.normal_flux(sigma) - self._data.q_Sh
        return Iterate(p=p, flux=flux, linear_iterations=1, sigma=sigma, u=means)

    @cached_property
    def _facet_vertices(self) -> Indices:
        """Vertices of each Γ_S facet, owned or ghost, shape (facets, d): those of its cell without the opposite one."""
        spaces = self.spaces
        dofs = self.space.dofmap.list[spaces.cells]
        opposite = np.argmax(spaces.V.dofmap.list[spaces.cells] == spaces.flux_dofs[:, None], axis=1)
        keep = np.arange(dofs.shape[1]) != opposite[:, None]
        return dofs[keep].reshape(len(dofs), spaces.mesh.topology.dim)

    def _owned(self, form: ufl.Form) -> Array:
        return assembled(form)[: self._size].copy()


class P1Change:
    """‖κ^½∇(u − u')‖ and ‖u − u'‖. The first is the change of σ, because ∇u_h has no divergence on cells."""

    def __init__(self, system: P1System):
        """Assemble the mass matrix (collective)."""
        self._system = system
        trial, test = ufl.TrialFunction(system.space), ufl.TestFunction(system.space)
        self._mass = assemble_matrix(fenicsx.form(mass(trial, test, ufl.dx)))
        self._mass.assemble()

    def __call__(self, change: Array) -> tuple[float, float]:
        """The norms of a change (collective)."""
        square = self._system.dot(change, image_of(self._mass, change))
        return self._system.energy_norm(change), math.sqrt(max(square, 0.0))


class P1History(History):
    """The history of a P1 method, in terms of the Γ_S facets in contact."""

    def __init__(self, task: DiffusionTask, system: P1System, u: Array, conditions: SiteConditions):
        """Begin with the start, which is not a step itself (collective)."""
        self._system, self._last, self._norms = system, u, P1Change(system)
        super().__init__(task.spaces.mesh.comm, task.on_step)
        self.start_from(conditions)

    def add(self, u: Array, conditions: SiteConditions) -> None:
        """Record an iteration (collective)."""
        change, self._last = self._norms(u - self._last), u
        self.append(conditions, change, lambda: (self._system.recover(u), conditions))


def not_solved(residual: float) -> str | None:
    """Why a natural residual is too large for a solution, or None if it is small."""
    return None if residual <= KKT else f"the natural residual of the P1 problem is {residual:.1e}, above {KKT:g}"


def primal_outcome(
    system: P1System,
    history: P1History,
    u: Array,
    conditions: SiteConditions,
    failure: str | None,
    *,
    reason: str,
    solver: str,
    details: dict[str, float],
) -> Outcome:
    """How a P1 method ended, judged by its natural residual (collective)."""
    residual = system.residual(u)
    failure = failure or not_solved(residual)
    state, solved = (system.recover(u), conditions), (P1System.name, system.dofs, solver)
    about = {"own_residual": residual, "details": details}
    return history.outcome(state, failure or reason, solved, converged=failure is None, **about)


def _projected_flux(u: fem.Function, data: Data, spaces: Spaces) -> fem.Function:
    """The projection of κ_h∇u to RT0 in (κ_h⁻¹·, ·), by CG on its well-conditioned mass matrix (collective)."""
    tau = ufl.TestFunction(spaces.V)
    matrix = assemble_matrix(fenicsx.form(flux_product(ufl.TrialFunction(spaces.V), tau, ufl.dx, data.kappa_h)))
    matrix.assemble()
    x, b = matrix.createVecs()
    b.array_w[:] = assembled(gradient(u, tau, ufl.dx))[: b.getLocalSize()]
    solver = LinearSolver(matrix, "")  # not the solver of the method: it takes no options
    solver.ksp.setType("cg")
    solver.ksp.getPC().setType("jacobi")
    solver.ksp.setTolerances(rtol=ROUNDING, max_it=1000)
    solver.solve(b, x)
    sigma = function_of(spaces.V, x.array_r, "sigma")
    for thing in (solver.ksp, matrix, x, b):
        thing.destroy()
    return sigma
