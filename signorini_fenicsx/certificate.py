"""A guaranteed bound of the energy error of a solution, computed from that solution alone.

y = σ_h and a continuous v made of u_h and σ_h are admissible in the gap identity (see `forms.certificate`), but for
what the data and the linear solver leave. All norms are those of the energy: ‖σ‖² = (κ⁻¹σ, σ), |∇w|² = (κ∇w, ∇w). With
ũ the solution for the load −∇·y and the means of g_N and q_S, the identity gives |∇(v − ũ)| and ‖y − κ∇ũ‖ ≤ √(2 gap).
g_N and q_S are loads like f: the variational inequality is (κ∇u, ∇(w − u)) ≥ (f, w − u) + (g_N, w − u) on Γ_N + (q_S, w
− u) on Γ_S for all w ≥ ψ. So those of u and ũ, each tested with the other's solution, give |∇(u − ũ)| ≤ sup (r, w)/|∇w|
over w = 0 on Γ_D with r the difference of the loads. As f + ∇·y = (f − f_h) + c with c constant on cells, that is at
most osc + C_F‖c‖. Hence

    |∇(v − u)| and ‖σ − σ_h‖ are both at most   √(2 gap) + osc + C_F‖c‖ + ‖y − σ_h‖ = bound.

With r ≠ 0 the identity itself has (r, u − v) ≤ (osc + C_F‖c‖)|∇(v − u)| on its right side too, and Young's
inequality puts √(2 gap + osc²) in the place of √(2 gap) + osc for ‖σ − σ_h‖ alone.

u is the solution of the Signorini problem itself, also if a penalty method was used, on the domain that the mesh
covers: where the boundary is curved, on the polygon or polyhedron.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from dolfinx.fem.petsc import assemble_matrix, create_vector
from mpi4py import MPI
from petsc4py import PETSc
from ufl.core.expr import Expr

from forms.certificate import (
    contact_gap,
    covered,
    flux_gap,
    flux_oscillation,
    load_oscillation,
    reconstruction,
    second_moment,
    with_exact_dirichlet_values,
)
from forms.crouzeix_raviart import stiffness
from forms.mixed import flux_product
from forms.norms import l2
from signorini_fenicsx.algorithms import Penalty
from signorini_fenicsx.backend import LinearSolveFailure
from signorini_fenicsx.conditions import Condition, FacetConditions
from signorini_fenicsx.data import Data, Problem, is_constant, project_data, quadrature, scalar_conductivity
from signorini_fenicsx.hybrid import HybridBackend
from signorini_fenicsx.parallel import Stopwatch
from signorini_fenicsx.solution import Solution
from signorini_fenicsx.spaces import Spaces, assembled, cell_measures, centroids

RELAXATIONS = 5
"""Steps of CG that improve v: more gain nothing, as v is then far better than σ_h, but for corners."""
ROUNDING = 1e-9
"""A mass balance violated by less than this, relative to ‖σ‖/L, is taken for rounding and counted with L for C_F."""
FAR_BELOW = 20.0
"""A quadratic function on a cell that is ≥ 0 on Γ_S falls from there by less than this times its largest nodal value:
its Lebesgue constant is at most 2, and Markov's inequality allows a slope of 8 times its maximum."""
FAR, NEAR = 1, 2
"""Cells away from Γ_D and cells that touch it."""


@dataclass(frozen=True)
class Certificate:
    """A bound for |∇(v − u)| and for ‖σ − σ_h‖, see the module; infinite if u_D < ψ where Γ_D meets Γ_S.

    Attributes:
        bound: √(2 gap) + oscillation + remainder, for either error.
        sigma_bound: √(2 gap + oscillation²) + remainder, for ‖σ − σ_h‖ alone.
        gap: ½‖κ∇v − y‖² + ⟨y·n − q_S, v − ψ⟩ on Γ_S.
        oscillation: osc, see `forms.certificate`; of f in cells, of g_N and q_S on facets.
        remainder: C_F‖c‖ + ‖y − σ_h‖, which the linear solver or a penalty leaves.
        relative: bound/‖σ_h‖.
        indicator: η_T in P0 with Σ η_T² = 2 gap + oscillation².
        v: The continuous v in P2, before Dirichlet data that are not quadratic have been made exact.
        seconds: What it took, the longest over all ranks.
    """

    bound: float
    sigma_bound: float
    gap: float
    oscillation: float
    remainder: float
    relative: float
    indicator: fem.Function
    v: fem.Function
    seconds: float

    def summary(self) -> dict[str, float]:
        """The numbers, ready for JSON."""
        names = ("bound", "sigma_bound", "gap", "oscillation", "remainder", "relative")
        return {name: getattr(self, name) for name in names}


def certify(solution: Solution) -> Certificate:
    """Bound the energy error of a converged solution (collective).

    Costs some assembly and, if the linear solver or a penalty leaves something, one or two linear solves. The integrals
    of the data are by quadrature, the smallest κ on a cell is that in its nodes of P2, and u_D and ψ have to be
    continuous.

    Args:
        solution: Of any algorithm.
    """
    watch = Stopwatch()
    spaces, data = solution.spaces, solution.data
    y = _admissible_flux(solution)
    trace = _admissible_trace(solution)

    q = ufl.TestFunction(spaces.Q)
    kappa = data.kappa
    degree = quadrature(data.u_D + data.psi + scalar_conductivity(kappa))
    near = np.zeros(spaces.Q.dofmap.index_map.size_local, dtype=bool)
    near[trace.cells] = True
    parts = [(FAR, np.flatnonzero(~near).astype(np.int32)), (NEAR, trace.cells)]
    dx = ufl.Measure("dx", domain=spaces.mesh, subdomain_data=parts)
    twice_the_gap = [
        flux_gap(trace.v, y, kappa, q, dx(FAR) if is_constant(kappa) else dx(FAR, metadata=quadrature(kappa))),
        flux_gap(trace.exact, y, kappa, q, dx(NEAR, metadata=degree)),
        contact_gap(trace.above, y - data.sigma_lift, spaces.n, q, spaces.ds(metadata=degree)),
    ]
    gap = np.sum([assembled(form) for form in twice_the_gap], axis=0) / 2
    oscillation = _oscillation(spaces, data)
    indicator = fem.Function(spaces.Q, name="indicator")
    indicator.x.array[:] = np.sqrt(np.maximum(2 * gap + oscillation, 0.0))  # no ghost cells; < 0 only without a bound

    comm = spaces.mesh.comm
    total_gap, total_oscillation = comm.allreduce(np.array([gap.sum(), oscillation.sum()])).tolist()
    remainder = _remainder(solution, y)
    bound = sigma_bound = np.inf
    if trace.feasible and np.isfinite(total_gap):
        bound = np.sqrt(2 * total_gap) + np.sqrt(total_oscillation) + remainder
        sigma_bound = np.sqrt(2 * total_gap + total_oscillation) + remainder
    size = np.sqrt(spaces.integrate(flux_product(solution.sigma, solution.sigma, data.kappa_h)))
    PETSc.garbage_cleanup(comm)
    watch.lap("certificate")
    return Certificate(
        bound=float(bound),
        sigma_bound=float(sigma_bound),
        gap=total_gap,
        oscillation=float(np.sqrt(total_oscillation)),
        remainder=remainder,
        relative=float(bound / size) if size > 0 else (0.0 if bound == 0 else np.inf),
        indicator=indicator,
        v=trace.v,
        seconds=watch.longest(comm)["certificate"],
    )


def _oscillation(spaces: Spaces, data: Data) -> npt.NDArray[np.float64]:
    """osc_T² per owned cell (collective)."""
    q = ufl.TestFunction(spaces.Q)
    kappa_min = _smallest_conductivity(spaces, data.kappa)
    dx = ufl.Measure("dx", domain=spaces.mesh, metadata=quadrature(data.f**2))
    in_cells = assembled(load_oscillation(data.f, data.f_h, kappa_min, q, dx))
    g_h = ufl.dot(data.sigma_lift, spaces.n)
    given = [(g, ds) for g, ds in ((data.g_N, spaces.ds_neumann), (data.q_S, spaces.ds)) if not is_constant(g)]
    if not given:
        return in_cells
    on_facets = np.zeros_like(in_cells)
    for g, ds in given:
        # at most d facets of a cell are boundary, and (Σ a_e)² ≤ d Σ a_e²
        flux = flux_oscillation(g, g_h, kappa_min, q, ds(metadata=quadrature(g**2)))
        on_facets += spaces.mesh.topology.dim * assembled(flux)
    return (np.sqrt(in_cells) + np.sqrt(on_facets)) ** 2


def _smallest_conductivity(spaces: Spaces, kappa: Expr) -> Expr:
    """The smallest eigenvalue of κ in the nodes of P2 on each cell (collective)."""
    if is_constant(kappa):
        return kappa
    mesh = spaces.mesh
    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    nodes = basix.ufl.element("Lagrange", mesh.basix_cell(), 2).basix_element.points
    one = fem.Constant(mesh, 1.0)  # a constant matrix knows no mesh
    values = fem.Expression(one * kappa, nodes).eval(mesh, cells)
    shape = kappa.ufl_shape or (1, 1)
    smallest = fem.Function(spaces.Q)
    smallest.x.array[:] = np.linalg.eigvalsh(values.reshape(len(cells), len(nodes), *shape)).min(axis=(1, 2))
    return smallest


def _admissible_flux(solution: Solution) -> fem.Function:
    """σ_h if σ_h·n ≥ q_S; for (MPε-II), where it is < q_S off the contact set, the flux after a step of Algorithm 1."""
    spaces, data = solution.spaces, solution.data
    y = solution.sigma
    if solution.algorithm.penalty is Penalty.FLUX:
        open_facets = solution.conditions.kind == Condition.ROBIN
        kind = np.where(open_facets, Condition.NO_FLUX, Condition.ZERO_TRACE).astype(np.int8)
        with contextlib.suppress(LinearSolveFailure):
            y = HybridBackend(spaces, data).solve(FacetConditions(kind)).sigma
    negative = spaces.normal_flux(y) < data.q_Sh
    if not spaces.mesh.comm.allreduce(bool(negative.any()), MPI.LOR):
        return y
    y = y.copy()
    low = spaces.flux_dofs[negative]
    y.x.array[low] = data.sigma_lift.x.array[low]
    y.x.scatter_forward()
    return y


@dataclass(frozen=True)
class _Trace:
    """A continuous function near u.

    Attributes:
        v: In P2, with the values of u_D in its nodes on Γ_D.
        exact: The same with u_D itself on Γ_D and not below ψ itself on Γ_S.
        above: On Γ_S, exact − ψ.
        cells: Owned cells on which v and exact may differ.
        feasible: Whether u_D allows the function to be ≥ ψ on all of Γ_S.
    """

    v: fem.Function
    exact: Expr
    above: Expr
    cells: npt.NDArray[np.int32]
    feasible: bool


def _admissible_trace(solution: Solution) -> _Trace:
    """The reconstruction, made continuous and admissible (collective)."""
    spaces, data = solution.spaces, solution.data
    mesh = spaces.mesh
    facet_dim = mesh.topology.dim - 1
    v = _averaged(solution)
    space = v.function_space
    on_signorini = fem.locate_dofs_topological(space, facet_dim, spaces.facets)
    on_dirichlet = fem.locate_dofs_topological(space, facet_dim, spaces.dirichlet_facets)
    in_contact = fem.locate_dofs_topological(space, facet_dim, spaces.facets[solution.contact_set().inside])

    w_D, psi = (_interpolated(space, value) for value in (data.u_D - data.psi, data.psi))
    w = v.copy()
    w.x.array[:] -= psi.x.array
    w.x.array[on_signorini] = np.maximum(w.x.array[on_signorini], 0.0)
    w.x.array[in_contact] = 0.0
    w.x.array[on_dirichlet] = w_D.x.array[on_dirichlet]
    _raise_midpoints(w, np.setdiff1d(on_signorini, on_dirichlet))
    v.x.array[:] = before = w.x.array + psi.x.array
    _relax(v, solution, np.union1d(on_signorini, on_dirichlet))
    w.x.array[:] += v.x.array - before
    largest = mesh.comm.allreduce(np.abs(w.x.array).max(initial=0.0), MPI.MAX)
    on_both = w.x.array[np.intersect1d(on_signorini, on_dirichlet)]
    feasible = mesh.comm.allreduce(bool((on_both >= -1e-12 * largest).all()), MPI.LAND)
    if is_constant(data.u_D) and is_constant(data.psi):
        return _Trace(v, v, w, np.empty(0, dtype=np.int32), feasible)

    linear = fem.functionspace(mesh, ("Lagrange", 1))
    near_dirichlet, near_signorini, floor = (fem.Function(linear) for _ in range(3))
    near_dirichlet.x.array[fem.locate_dofs_topological(linear, facet_dim, spaces.dirichlet_facets)] = 1.0
    near_signorini.x.array[fem.locate_dofs_topological(linear, facet_dim, spaces.facets)] = 1.0
    floor.x.array[:] = -FAR_BELOW * largest * (1 - near_signorini.x.array)
    bound = psi if is_constant(data.psi) else covered(data.psi, psi, near_signorini)
    above = with_exact_dirichlet_values(w, data.u_D - bound, w_D, near_dirichlet, floor)
    different = near_dirichlet.x.array if is_constant(data.psi) else near_dirichlet.x.array + near_signorini.x.array
    cells = np.flatnonzero(different[linear.dofmap.list].any(axis=1)).astype(np.int32)
    return _Trace(v, bound + above, above, cells, feasible)


def _interpolated(space: fem.FunctionSpace, value: Expr) -> fem.Function:
    """I_h of a continuous function (collective)."""
    function = fem.Function(space)
    zero = fem.Constant(space.mesh, 0.0)
    function.interpolate(fem.Expression(value + zero, space.element.interpolation_points))
    return function


def _averaged(solution: Solution) -> fem.Function:
    """The reconstruction, averaged over the cells around each node of P2 with weights κ_h (collective)."""
    spaces, kappa = solution.spaces, solution.data.kappa_h
    mesh = spaces.mesh
    x = ufl.SpatialCoordinate(mesh)
    centroid = centroids(mesh)
    moment = fem.Function(spaces.Q)
    moment.x.array[:] = assembled(
        second_moment(centroid, x, kappa) * ufl.TestFunction(spaces.Q) * ufl.dx
    ) / cell_measures(spaces.Q)
    quadratic = reconstruction(solution.u, solution.sigma, centroid, moment, x, kappa)

    v = fem.Function(fem.functionspace(mesh, ("Lagrange", 2)), name="v")
    space = v.function_space
    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    values = fem.Expression(quadratic, space.element.interpolation_points).eval(mesh, cells)
    weights = np.broadcast_to(_weights(solution.data)[:, None], values.shape)
    total = fem.Function(space)
    for function, summands in ((v, (weights * values).ravel()), (total, weights.ravel())):
        function.x.array[:] = np.bincount(space.dofmap.list.ravel(), summands, len(function.x.array))
        function.x.scatter_reverse(la.InsertMode.add)
        function.x.scatter_forward()
    v.x.array[:] /= total.x.array
    return v


def _weights(data: Data) -> npt.NDArray[np.float64]:
    """Mean eigenvalue of κ_h per cell of this rank."""
    if is_constant(data.kappa_h):
        return np.ones(len(data.f_h.x.array))
    entries = data.kappa_h.x.array.reshape(len(data.f_h.x.array), *(data.kappa_h.ufl_shape or (1, 1)))
    means: npt.NDArray[np.float64] = np.trace(entries, axis1=1, axis2=2) / entries.shape[1]
    return means


def _raise_midpoints(v: fem.Function, dofs: npt.NDArray[np.int32]) -> None:
    """Make v ≥ 0 on facets whose vertices have v ≥ 0, by Bernstein's coefficients 2v_m − (v_0 + v_1)/2 ≥ 0 of edges."""
    space = v.function_space
    nodes = space.dofmap.list
    of_edge = np.zeros(len(v.x.array), dtype=bool)
    of_edge[dofs] = True
    vertices = space.mesh.topology.dim + 1
    for edge, (a, b) in enumerate(basix.topology(space.mesh.basix_cell())[1]):
        middle = nodes[:, vertices + edge]
        chosen = of_edge[middle]
        lowest = (v.x.array[nodes[chosen, a]] + v.x.array[nodes[chosen, b]]) / 4
        v.x.array[middle[chosen]] = np.maximum(v.x.array[middle[chosen]], lowest)


def _relax(v: fem.Function, solution: Solution, fixed: npt.NDArray[np.int32]) -> None:
    """Lower ½‖κ_h∇v − σ_h‖² by a few steps of CG that keep v at the fixed nodes (collective).

    What the average adds to the error varies from node to node, and that is what the first steps remove.
    """
    space, kappa = v.function_space, solution.data.kappa_h
    w, t = ufl.TrialFunction(space), ufl.TestFunction(space)
    matrix = assemble_matrix(fem.form(stiffness(w, t, kappa)))
    matrix.assemble()
    first, last = matrix.getOwnershipRange()
    fixed = fixed[fixed < last - first]
    matrix.zeroRowsColumns(first + fixed)
    residual, change = create_vector(space), create_vector(space)
    residual.array_w[:] = assembled(ufl.inner(solution.sigma - kappa * ufl.grad(v), ufl.grad(t)) * ufl.dx)[
        : last - first
    ]
    residual.array_w[fixed] = 0.0
    ksp = PETSc.KSP().create(space.mesh.comm)
    ksp.setOperators(matrix)
    ksp.setType("cg")
    ksp.getPC().setType("jacobi")
    ksp.setNormType(PETSc.KSP.NormType.NONE)
    ksp.setTolerances(max_it=RELAXATIONS)
    ksp.solve(residual, change)
    v.x.array[: last - first] += change.array_r
    v.x.scatter_forward()
    for thing in (ksp, matrix, residual, change):
        thing.destroy()


def _remainder(solution: Solution, y: fem.Function) -> float:
    """C_F‖c‖ + ‖y − σ_h‖ with c = ∇·y + f_h (collective)."""
    spaces, data = solution.spaces, solution.data
    length = spaces.length()
    size = np.sqrt(spaces.integrate(l2(y, ufl.dx)))
    imbalance = np.sqrt(spaces.integrate(l2(ufl.div(y) + data.f_h, ufl.dx)))
    constant = friedrichs_constant(spaces) if length * imbalance > ROUNDING * size else length
    lowest = _smallest_conductivity(spaces, data.kappa)
    kappa_min = float(lowest) if is_constant(lowest) else lowest.x.array.min(initial=np.inf)
    left = constant * imbalance / np.sqrt(spaces.mesh.comm.allreduce(kappa_min, MPI.MIN))
    if y is solution.sigma:
        return float(left)
    difference = y - solution.sigma
    return float(left + np.sqrt(spaces.integrate(flux_product(difference, difference, data.kappa_h))))


def friedrichs_constant(spaces: Spaces) -> float:
    """A guaranteed C_F with ‖w‖ ≤ C_F‖∇w‖ for all w ∈ H¹ that vanish on Γ_D (collective).

    It is infinite without Γ_D, or if its linear solve fails.

    For any τ with τ·n ≥ 0 on Γ_S, ‖∇w‖² ≥ (2wτ, ∇w) − ‖wτ‖² ≥ (−∇·τ − |τ|², w²). With τ = tz, z ∈ RT0 the flux for the
    load 1 and z·n = 0 on Γ_S and Γ_N, m = min(−∇·z), s = max|z| and the best t = m/2s² this says C_F = 2s/m.
    """
    mesh = spaces.mesh
    if not spaces.has_dirichlet:
        return np.inf
    no_flux = FacetConditions(np.full(len(spaces.facets), Condition.NO_FLUX, dtype=np.int8))
    try:
        z = HybridBackend(spaces, project_data(spaces, Problem(f=1.0))).solve(no_flux).sigma
    except LinearSolveFailure:
        return np.inf
    dim = mesh.geometry.dim
    corners = fem.Function(fem.functionspace(mesh, ("DG", 1, (dim,))))
    corners.interpolate(z)
    load = fem.Function(spaces.Q)
    load.interpolate(fem.Expression(-ufl.div(z), spaces.Q.element.interpolation_points))
    s = mesh.comm.allreduce(np.linalg.norm(corners.x.array.reshape(-1, dim), axis=1).max(initial=0.0), MPI.MAX)
    m = mesh.comm.allreduce(load.x.array.min(initial=np.inf), MPI.MIN)
    return float(2 * s / m) if m > 0 else np.inf
