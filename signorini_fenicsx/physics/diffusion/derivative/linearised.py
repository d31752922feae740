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

import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem
from ufl import Form
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import cell_dofs, owned_values, set_owned, sums_at
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.contact.conditions import Condition, SiteConditions
from signorini_fenicsx.contact.loop import settled_change
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import assembled, cells_and_dofs
from signorini_fenicsx.discrete.part_laws import PartLaw, means_of
from signorini_fenicsx.discrete.seen import Seen, derivative_by, seen_in_cells
from signorini_fenicsx.forms.mixed import flux_product
from signorini_fenicsx.physics.diffusion.derivative.law_lines import Lines, rays
from signorini_fenicsx.physics.diffusion.derivative.tangent import Tangent
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.solve.facet_system import Loads
from signorini_fenicsx.physics.diffusion.solve.hybrid import HybridBackend


class Linearised:
    """A problem linearised at its solution.

    Attributes:
        seen: The numbers that the discrete problem sees of each datum that is given in UFL, by its name in messages.
        biactive: Mask of the sites on a corner of their law: the facets of Γ_S, and with laws in Ω the cells.
    """

    def __init__(self, solution: Solution, backend: HybridBackend, tolerance: float):
        """Take a solution and what solves under its conditions (collective).

        Args:
            solution: The solution.
            backend: A backend whose κ_h and c_h are its own.
            tolerance: Sites whose p and σ·n are on a corner of their law, but for this share of their sizes, are
                biactive.
        """
        self._solution, self._backend = solution, backend
        self._spaces, self._data = solution.spaces, solution.data
        self._conditions: SiteConditions = solution.outcome.conditions
        self._held_cells = self._spaces.site_kinds["cell"].of(self._conditions.kind) == Condition.ZERO_TRACE
        self._law = solution.law
        self._segment = solution.segments().segment
        self.seen = dict(_seen(self._spaces, solution))
        self._beside = self._segments_beside(tolerance)
        self.biactive = self._beside != 0

    def places(self) -> Array:
        """The midpoints of the biactive sites of this rank, shape (sites, dim)."""
        mesh, facets = self._spaces.mesh, len(self._spaces.facets)
        dim, on_facets, in_cells = mesh.topology.dim, self.biactive[:facets], np.flatnonzero(self.biactive[facets:])
        midpoints = [
            dolfinx.mesh.compute_midpoints(mesh, of, sites.astype(np.int32))
            for of, sites in ((dim - 1, self._spaces.facets[on_facets]), (dim, in_cells))
        ]
        return np.concatenate(midpoints)[:, :dim]

    def _segments_beside(self, tolerance: float) -> Indices:
        """Which way the other segment is of each site that is on a corner; 0 at other sites (collective)."""
        iterate = self._solution.outcome.iterate
        of_p, of_flux = (np.where(scale > 0, scale, 1.0) for scale in self._backend.scales(iterate))
        return self._law.beside(self._segment, iterate.p, iterate.flux, (of_p, of_flux), tolerance)

    def _lines(self, step: Indices) -> list[Lines]:
        """The lines of all laws on the segments that are so many beyond those that the sites are on (collective)."""
        solution, penalty = self._solution, (self._solution.method.penalty, self._solution.options.eps)
        segment, inside = (self._segment + step)[: len(self._spaces.facets)], self._data.inside
        on_gamma = [Lines.of(self._spaces, part, segment[part.rows], penalty) for part in self._data.laws.of_parts]
        in_cells, step = [], step[len(self._spaces.facets) :]
        for part in () if inside is None else inside.of_regions:
            on = solution.segments_of_law(part) + step[part.rows]
            in_cells.append(Lines.of(self._spaces, part, on, (None, 1.0)))
        return on_gamma + in_cells

    def _moved_lines(self, changes: Mapping[str, Array], step: Indices) -> tuple[Array, Array]:
        """The slopes of lines, and how their values change at the present p (collective)."""
        facets = len(self._spaces.facets)
        p, u = self._solution.p.x.array[:facets], owned_values(self._solution.u)
        slopes = np.take_along_axis(self._law.slope, (self._segment + step)[:, None], axis=1)[:, 0]
        values = np.zeros(len(self._segment))
        for line in self._lines(step):
            slope, value = line.changes(changes)
            rows, at = line.part.rows, u if line.part.law.region else p
            sites = rows + facets if line.part.law.region else rows
            kept = line.steep == np.isinf(slopes[sites])  # of several laws in a cell a steep one says all
            values[sites] += np.where(kept, value - np.where(line.steep, 0.0, slope * at[rows]), 0.0)
        return slopes, values

    def change(self, changes: Mapping[str, Array]) -> dict[str, fem.Function]:
        """The changes of σ, u and p with these numbers (collective).

        A biactive site moves along one of the two rays of the moved corner.

        Raises:
            InputError: If a cell is on a corner of several laws.
            NumericalFailure: If the sets of those sites do not settle.
        """
        comm, inside = self._spaces.mesh.comm, self._data.inside
        several = inside is not None and len(inside.of_regions) > 1
        number, of_cells = comm.allreduce(
            np.array([np.count_nonzero(self.biactive), np.count_nonzero(self.biactive[len(self._spaces.facets) :])])
        ).tolist()
        if several and of_cells > 0:
            raise InputError(f"derivative: {counted(of_cells, 'cell')} may leave a corner where several laws add up")
        (before, one), (beyond, other) = (
            self._moved_lines(changes, pick(self._beside, 0)) for pick in (np.minimum, np.maximum)
        )
        chains = rays((before, beyond), (one, other))
        backend = Tangent(self._spaces, self._data, self._backend, self._loads(changes), chains)
        start = chains.conditions((self._beside < 0).astype(np.int64))
        iterate = settled_change(backend, start, number, self._solution.options.max_iterations)
        p = self._spaces.multiplier(iterate.p[: len(self._spaces.facets)])
        return {"sigma": iterate.sigma, "u": iterate.u, "p": p}

    def _loads(self, changes: Mapping[str, Array]) -> Loads:
        """The right side of the change, without what the laws add (collective)."""
        spaces, data, u = self._spaces, self._data, owned_values(self._solution.u)
        flux, traces = fem.Function(spaces.V), fem.Function(spaces.crouzeix_raviart)
        space = traces.function_space
        forces = np.zeros(space.dofmap.index_map.size_local)
        if "kappa" in changes:
            kappa = data.kappa_h.copy()
            set_owned(kappa, changes["kappa"])
            flux.x.array[:] = -assembled(spaces.kept(_with_kappa, data.kappa_h, self._solution.sigma, kappa))
            flux.x.scatter_forward()
        if "u_D" in changes:
            traces.x.array[cells_and_dofs(space, spaces.dirichlet_facets)[1]] = changes["u_D"]
        if "g_N" in changes:
            forces[cells_and_dofs(space, spaces.neumann_facets)[1]] = changes["g_N"] * spaces.neumann_measure
        source = changes.get("f", 0.0) - changes.get("c", 0.0) * u
        jumps = self._jumps(flux) + traces.x.array[cell_dofs(space)]
        return Loads(jumps, source + np.zeros_like(u), np.zeros_like(u), forces)

    def adjoint(self, J: Form, more: tuple[Array, Array] | None = None) -> dict[str, Array]:
        """The derivatives by all numbers that are seen, but for where the data stand in J itself (collective).

        Args:
            J: What is differentiated.
            more: The derivatives by u and by the s of laws in Ω of each cell, of what is differentiated besides; None
                if nothing is.
        """
        spaces, data, u = self._spaces, self._data, owned_values(self._solution.u)
        p = self._solution.p.x.array[: len(spaces.facets)]
        flux, by_u, by_p = (
            derivative_by(function, J, spaces.entity_maps)
            for function in (self._solution.sigma, self._solution.u, self._solution.p)
        )
        on_gamma, on_neumann = (
            cells_and_dofs(spaces.crouzeix_raviart, facets)[1] for facets in (spaces.facets, spaces.neumann_facets)
        )
        on_p, on_u = by_p.x.array[: len(p)], owned_values(by_u).copy()
        of_s = np.zeros_like(u)  # in held cells, where s = ∇·σ + f − cu
        if more is not None:
            on_u += more[0]
            if self._data.inside is not None:
                slope = np.take_along_axis(self._law.slope, self._segment[:, None], axis=1)[len(p) :, 0]
                on_u += np.where(self._held_cells, 0.0, slope) * more[1]
                of_s = np.where(self._held_cells, more[1], 0.0)
        forces = np.zeros(spaces.crouzeix_raviart.dofmap.index_map.size_local)
        forces[on_gamma] = -on_p
        volumes, none = spaces.cell_measures, np.zeros_like(u)
        jumps = self._jumps(flux) + (of_s / volumes)[:, None]
        loads = Loads(jumps, -on_u / volumes, none, forces)
        of_sigma, of_balance, traces = self._backend.respond(self._conditions, loads)
        through = spaces.outflow * of_sigma.x.array[cell_dofs(spaces.V)]
        of_f = of_s - volumes * owned_values(of_balance)
        derivatives = {"f": of_f, "c": -u * of_f}
        if "kappa" in self.seen:
            form = spaces.kept(_by_kappa, data.kappa_h, self._solution.sigma, of_sigma)
            derivatives["kappa"] = -assembled(form)[self.seen["kappa"].dofs]
        if "u_D" in self.seen:
            derivatives["u_D"] = self.seen["u_D"].scale * of_sigma.x.array[self.seen["u_D"].dofs]
        derivatives["g_N"] = -traces[on_neumann] * spaces.neumann_measure
        of_trace = on_p + spaces.basis_flux * of_sigma.x.array[spaces.flux_dofs]
        of_force = -spaces.facet_measure * traces[on_gamma]
        of_u = on_u - np.einsum("cf->c", through)
        for line in self._lines(np.zeros_like(self._segment)):
            rows = line.part.rows
            if line.part.law.region:
                held = self._held_cells[rows]
                of_value = np.where(line.steep, of_u[rows], np.where(held, 0.0, derivatives["f"][rows]))
                of_slope = np.where(held, 0.0, derivatives["c"][rows])
            else:
                of_value = np.where(line.steep, of_trace[rows], of_force[rows])
                of_slope = np.where(line.steep, 0.0, -of_force[rows] * p[rows])
            derivatives |= line.sensitivities(of_slope, of_value)
        return derivatives

    def _jumps(self, functional: fem.Function) -> Array:
        """The z whose ⟨z, τ·n⟩ is the value at τ of a functional, given by its values at the basis functions."""
        spaces, dofs = self._spaces, cell_dofs(self._spaces.V)
        cells = sums_at(spaces.V.dofmap.index_map, dofs)
        return np.asarray((functional.x.array / cells)[dofs] / spaces.outflow)


def _seen(spaces: Spaces, solution: Solution) -> Iterator[tuple[str, Seen]]:
    """The numbers that are seen of data given in UFL, by the names of these (collective)."""
    data = solution.data
    for name, datum in (("f", data.f), ("kappa", data.kappa), ("c", data.c)):
        if datum.pieces is None:
            space, cells = spaces.Q_matrix if datum.shape else spaces.Q, np.arange(len(spaces.cell_measures))
            yield name, seen_in_cells(space, datum, cells.astype(np.int32), spaces.cell_measures)
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
        return seen_in_cells(spaces.Q, datum, rows.astype(np.int32), spaces.cell_measures[rows])
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


def _on_facets(spaces: Spaces, datum: Datum, ds: ufl.Measure) -> Callable[[Expr], Form]:
    """∫ datum v·n; v·n is constant on a facet if v is in RT0."""
    return lambda v: datum.ufl * ufl.dot(v, spaces.n) * ds(degree=quadrature_degree(datum))


def _by_kappa(spaces: Spaces, kappa: Expr, sigma: Expr, tau: Expr) -> Form:
    """The derivative of (κ⁻¹σ, τ) by κ in P0."""
    return ufl.derivative(flux_product(sigma, tau, ufl.dx, kappa), kappa, ufl.TestFunction(kappa.ufl_function_space()))


def _with_kappa(spaces: Spaces, kappa: Expr, sigma: Expr, change: Expr) -> Form:
    """The change of (κ⁻¹σ, τ) with κ."""
    return ufl.derivative(flux_product(sigma, ufl.TestFunction(spaces.V), ufl.dx, kappa), kappa, change)


def linearised(solution: Solution, tolerance: float) -> Linearised:
    """A problem linearised at its solution, with the factors of the solver that has just solved it (collective).

    Raises:
        InputError: If its method solves another discrete problem.
    """
    if solution.outcome.own_residual is not None:
        raise InputError(
            f"{solution.options.algorithm_name} solves another discrete problem; alg1 to alg4 have derivatives"
        )
    system = None if solution.system is None else solution.system()
    backend = None if system is None else system.kept.of(solution.outcome, HybridBackend)
    backend = backend or HybridBackend(solution.spaces, solution.data, tuning=solution.options.tuning)
    return Linearised(solution, backend, tolerance)
