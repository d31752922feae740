"""A diffusion problem linearised at its solution: how σ, u and p change with the numbers that it sees of its data.

Under the segments that the sites are on, the discrete problem is linear. It is

    B((σ, u, p), (τ, v, q)) = (κ_h⁻¹σ, τ) + (u, ∇·τ) − ⟨p, τ·n⟩ + (∇·σ, v) − (c_h u, v) − ⟨σ·n + βp, q⟩
                            = ⟨u_D, τ·n⟩ − (f_h, v) − ⟨value, q⟩   with q on sloped segments,

p = value on vertical segments, σ·n = g_h on Γ_N, and a term −(s, v) or u_T = value in the cells of laws in Ω. B is
symmetric. So the change with the data and the adjoint state (λ_σ, λ_u, λ_p), B(·, λ) = dJ for all that is homogeneous,
are solutions of one system, see `facet_system.Loads`, and

    dJ = −(d(κ_h⁻¹)σ, λ_σ) + ⟨du_D, λ_σ·n⟩ + (dc_h u − df_h, λ_u) + ⟨dβ p − dvalue, λ_p⟩
         + ⟨dvalue, J_p + λ_σ·n⟩ on vertical segments − ⟨dg_h, λ̂⟩ on Γ_N,

with λ̂ the trace of λ_u on a facet. In a cell that a law holds the factor of dvalue is J_u − ∇·λ_σ.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import ufl
from dolfinx import fem, la
from ufl import Form
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.conditions import Condition, SiteConditions
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import assembled, cells_and_dofs
from signorini_fenicsx.discrete.part_laws import PartLaw, means_of
from signorini_fenicsx.discrete.seen import Seen
from signorini_fenicsx.forms.mixed import flux_product
from signorini_fenicsx.physics.diffusion.facet_system import Loads
from signorini_fenicsx.physics.diffusion.hybrid import HybridBackend
from signorini_fenicsx.physics.diffusion.law_lines import Lines
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.spaces import Spaces


@dataclass(frozen=True)
class State:
    """Values of the mixed spaces.

    Attributes:
        sigma: σ, or λ_σ.
        u: u, or λ_u.
        p: p of each facet of Γ_S, or λ_p.
        neumann: The trace of u on each facet of Γ_N.
    """

    sigma: fem.Function
    u: fem.Function
    p: Array
    neumann: Array


class Linearised:
    """A problem linearised at its solution.

    Attributes:
        seen: The numbers that the discrete problem sees of each datum that is given in UFL, by its name in messages.
    """

    def __init__(self, solution: Solution, backend: HybridBackend):
        """Take a solution, and a backend whose κ_h and c_h are its own."""
        self._solution, self._backend = solution, backend
        self._spaces, self._data = solution.spaces, solution.data
        cells = solution.outcome.iterate.cells
        self._conditions: SiteConditions = solution.outcome.conditions.and_cells(cells)
        self._held = self._conditions.kind[: len(self._spaces.facets)] == Condition.ZERO_TRACE
        none = np.zeros(len(self._spaces.cell_measures), dtype=bool)
        self._held_cells = none if cells is None else cells.kind == Condition.ZERO_TRACE
        self.seen = dict(_seen(self._spaces, solution))

    @cached_property
    def _lines(self) -> list[Lines]:
        """The lines of all laws (collective when first used)."""
        solution, penalty = self._solution, (self._solution.method.penalty, self._solution.options.eps)
        segment, inside = solution.segments().segment, self._data.inside
        on_gamma = [Lines.of(self._spaces, part, segment[part.rows], penalty) for part in self._data.laws.of_parts]
        regions = () if inside is None else inside.of_regions
        in_cells = [Lines.of(self._spaces, part, solution.segments_of_law(part), (None, 1.0)) for part in regions]
        return on_gamma + in_cells

    def change(self, changes: Mapping[str, Array]) -> State:
        """The change of the solution with these numbers (collective)."""
        spaces, data, u = self._spaces, self._data, self._solution.u.x.array
        p = self._solution.p.x.array[: len(spaces.facets)]
        flux, traces = fem.Function(spaces.V), fem.Function(spaces.crouzeix_raviart)
        space, source = traces.function_space, np.zeros_like(u)
        held, forces = np.zeros_like(u), np.zeros(space.dofmap.index_map.size_local)
        on_gamma, value_on_gamma = cells_and_dofs(space, spaces.facets)[1], np.zeros_like(p)
        if "kappa" in changes:
            kappa = data.kappa_h.copy()
            kappa.x.array[:] = changes["kappa"]
            flux.x.array[:] = -assembled(spaces.kept(_with_kappa, data.kappa_h, self._solution.sigma, kappa))
            flux.x.scatter_forward()
        if "u_D" in changes:
            traces.x.array[cells_and_dofs(space, spaces.dirichlet_facets)[1]] = changes["u_D"]
        if "g_N" in changes:
            forces[cells_and_dofs(space, spaces.neumann_facets)[1]] = changes["g_N"] * spaces.neumann_measure
        source += changes.get("f", 0.0) - changes.get("c", 0.0) * u
        for line in self._lines:
            rows, (slope, value) = line.part.rows, line.changes(changes)
            if line.part.law.region:
                held[rows] += np.where(line.steep, value, 0.0)
                source[rows] += np.where(line.steep, 0.0, value - slope * u[rows])
            else:
                value_on_gamma[rows] = np.where(line.steep, value, 0.0)
                pulled = np.where(line.steep, 0.0, value - slope * p[rows])
                forces[on_gamma[rows]] = spaces.facet_measure[rows] * pulled
        traces.x.array[on_gamma] = value_on_gamma
        jumps = self._jumps(flux) + traces.x.array[space.dofmap.list]
        return self._solved(Loads(jumps, source, np.where(self._held_cells, held, 0.0), forces), value_on_gamma)

    def adjoint(self, J: Form) -> dict[str, Array]:
        """The derivatives of J by all numbers that are seen, but for where the data stand in J itself (collective)."""
        spaces, data, u = self._spaces, self._data, self._solution.u.x.array
        p = self._solution.p.x.array[: len(spaces.facets)]
        flux, by_u, by_p = (
            self._by(J, function, space)
            for function, space in (
                (self._solution.sigma, spaces.V),
                (self._solution.u, spaces.Q),
                (self._solution.p, spaces.Lambda),
            )
        )
        on_p, on_u = by_p.x.array[: len(p)], by_u.x.array
        forces = np.zeros(spaces.crouzeix_raviart.dofmap.index_map.size_local)
        forces[cells_and_dofs(spaces.crouzeix_raviart, spaces.facets)[1]] = -on_p
        volumes, none = spaces.cell_measures, np.zeros_like(u)
        state = self._solved(Loads(self._jumps(flux), -on_u / volumes, none, forces))
        through = spaces.outflow * state.sigma.x.array[spaces.V.dofmap.list]
        found = {"f": -volumes * state.u.x.array, "c": volumes * u * state.u.x.array}
        if "kappa" in self.seen:
            form = spaces.kept(_by_kappa, data.kappa_h, self._solution.sigma, state.sigma)
            found["kappa"] = -assembled(form)
        if "u_D" in self.seen:
            found["u_D"] = self.seen["u_D"].scale * state.sigma.x.array[self.seen["u_D"].dofs]
        found["g_N"] = -state.neumann * spaces.neumann_measure
        of_trace = on_p + spaces.basis_flux * state.sigma.x.array[spaces.flux_dofs]
        of_force = -spaces.facet_measure * state.p
        of_u = on_u - np.einsum("cf->c", through)
        for line in self._lines:
            rows = line.part.rows
            if line.part.law.region:
                held = self._held_cells[rows]
                of_value = np.where(line.steep, of_u[rows], np.where(held, 0.0, found["f"][rows]))
                of_slope = np.where(held, 0.0, found["c"][rows])
            else:
                of_value = np.where(line.steep, of_trace[rows], of_force[rows])
                of_slope = np.where(line.steep, 0.0, -of_force[rows] * p[rows])
            found |= line.sensitivities(of_slope, of_value)
        return found

    def _by(self, J: Form, function: fem.Function, space: fem.FunctionSpace) -> fem.Function:
        """The derivative of J by a part of the solution, ghosts updated (collective)."""
        found = fem.Function(space)
        if function in J.coefficients():
            form = ufl.derivative(J, function, ufl.TestFunction(space))
            found.x.array[:] = assembled(form, [self._spaces.entity_map])
            found.x.scatter_forward()
        return found

    def _solved(self, loads: Loads, p: Array | float = 0.0) -> State:
        """The solution with these loads, and with these values of p where it is held (collective)."""
        spaces = self._spaces
        sigma, u, traces = self._backend.respond(self._conditions, loads)
        on_gamma, on_neumann = (
            cells_and_dofs(spaces.crouzeix_raviart, facets)[1] for facets in (spaces.facets, spaces.neumann_facets)
        )
        return State(sigma, u, traces[on_gamma] + p, traces[on_neumann])

    def _jumps(self, functional: fem.Function) -> Array:
        """Z with ⟨z, τ·n⟩ the value at τ of a functional that is given by its values at the basis functions."""
        spaces, dofs, cells = self._spaces, self._spaces.V.dofmap.list, fem.Function(self._spaces.V).x
        cells.array[:] = np.bincount(dofs.ravel(), minlength=len(cells.array))
        cells.scatter_reverse(la.InsertMode.add)
        cells.scatter_forward()
        return np.asarray((functional.x.array / cells.array)[dofs] / spaces.outflow)


def _seen(spaces: Spaces, solution: Solution) -> Iterator[tuple[str, Seen]]:
    """What is seen of the data that are given in UFL, by their names (collective)."""
    data = solution.data
    for name, datum in (("f", data.f), ("kappa", data.kappa), ("c", data.c)):
        if datum.pieces is None:
            size = int(np.prod(datum.shape, dtype=int))
            volumes = np.repeat(spaces.cell_measures, size)
            space = spaces.Q_matrix if datum.shape else spaces.Q
            yield name, Seen(_on_cells(datum), space, np.arange(len(volumes), dtype=np.int32), volumes)
    neumann = spaces.neumann_dofs, spaces.neumann_basis_flux
    dofs = cells_and_dofs(spaces.V, spaces.dirichlet_facets)[1]
    if data.u_D.pieces is None:
        basis = assembled(ufl.dot(ufl.TestFunction(spaces.V), spaces.n) * spaces.ds_dirichlet)[dofs]
        yield "u_D", Seen(_on_facets(spaces, data.u_D, spaces.ds_dirichlet), spaces.V, dofs, basis)
    if data.g_N.pieces is None:
        yield "g_N", Seen(_on_facets(spaces, data.g_N, spaces.ds_neumann), spaces.V, *neumann)
    for part in (*data.laws.of_parts, *(() if data.inside is None else data.inside.of_regions)):
        for key, datum in part.data.items():
            if datum.pieces is None or (key in part.law.weights and part.data[part.law.weights[key]].pieces is None):
                yield part.key(key), _seen_by_law(spaces, part, key)


def _seen_by_law(spaces: Spaces, part: PartLaw, key: str) -> Seen:
    """What a law sees of one of its data (collective)."""
    datum, rows = part.data[key], part.rows
    if part.law.region:
        return Seen(_on_cells(datum), spaces.Q, rows.astype(np.int32), spaces.cell_measures[rows])
    dofs, basis, means = spaces.flux_dofs[rows], spaces.basis_flux[rows], means_of(spaces, part)
    weight = part.data.get(part.law.weights.get(key, ""))
    if weight is None:
        return Seen(_on_facets(spaces, datum, spaces.ds), spaces.V, dofs, basis)
    # the mean is ∫dw/∫w, and its change that of ∫(d − mean)w/∫w
    mean, sizes = fem.Function(spaces.V), means[part.law.weights[key]]
    mean.x.array[dofs] = means[key] * spaces.facet_measure[rows] / basis
    mean.x.scatter_forward()
    ds = spaces.ds(degree=quadrature_degree(datum, weight, power=2))

    def form(v: Expr) -> Form:
        return (datum.ufl - ufl.dot(mean, spaces.n)) * weight.ufl * ufl.dot(v, spaces.n) * ds

    return Seen(form, spaces.V, dofs, np.where(sizes > 0, basis * sizes, 1.0))


def _on_cells(datum: Datum) -> Callable[[Expr], Form]:
    """∫ datum · v."""
    return lambda v: ufl.inner(datum.ufl, v) * ufl.dx(degree=quadrature_degree(datum))


def _on_facets(spaces: Spaces, datum: Datum, ds: ufl.Measure) -> Callable[[Expr], Form]:
    """∫ datum v·n; v·n is constant on a facet if v is in RT0."""
    return lambda v: datum.ufl * ufl.dot(v, spaces.n) * ds(degree=quadrature_degree(datum))


def _by_kappa(spaces: Spaces, kappa: Expr, sigma: Expr, tau: Expr) -> Form:
    """The derivative of (κ⁻¹σ, τ) by κ in P0."""
    return ufl.derivative(flux_product(sigma, tau, ufl.dx, kappa), kappa, ufl.TestFunction(kappa.ufl_function_space()))


def _with_kappa(spaces: Spaces, kappa: Expr, sigma: Expr, change: Expr) -> Form:
    """The change of (κ⁻¹σ, τ) with κ."""
    return ufl.derivative(flux_product(sigma, ufl.TestFunction(spaces.V), ufl.dx, kappa), kappa, change)


def linearised(solution: Solution) -> Linearised:
    """A problem linearised at its solution, with the factors of the solver that has just solved it (collective).

    Raises:
        InputError: If its method solves another discrete problem.
    """
    if solution.outcome.own_residual is not None:
        raise InputError(f"{solution.options.algorithm_name} solves another discrete problem; it has no derivatives")
    system = None if solution.system is None else solution.system()
    backend = None if system is None else system.backend_of(solution.outcome)
    return Linearised(
        solution, backend or HybridBackend(solution.spaces, solution.data, tuning=solution.options.tuning)
    )
