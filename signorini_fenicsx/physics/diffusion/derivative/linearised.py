"""A diffusion problem linearised at its solution: how σ, u and p change with the numbers that it sees of its data.

Under the segments that the sites are on, the discrete problem is linear. It is

    B((σ, u, p), (τ, v, q)) = (κ_h⁻¹σ, τ) + (u, ∇·τ) − ⟨p, τ·n⟩ + (∇·σ, v) − (c_h u, v) − ⟨σ·n + βp, q⟩
                            = ⟨u_D, τ·n⟩ − (f_h, v) − ⟨value, q⟩   with q on sloped segments,

p = value on vertical segments, σ·n = g_h on Γ_N, and a term −(s, v) or u_T = value in the cells of laws in Ω. B is
symmetric. So the change with the data and the adjoint state (λ_σ, λ_u, λ_p), B(·, λ) = dJ for all that is homogeneous,
are solutions of one system, see `facet_system.Loads`, and

    dJ = −(d(κ_h⁻¹)(σ − b), λ_σ) + (κ_h⁻¹db, λ_σ) + ⟨du_D, λ_σ·n⟩ + (dc_h u − df_h, λ_u) + ⟨dβ p − dvalue, λ_p⟩
         + ⟨dvalue, J_p + λ_σ·n⟩ on vertical segments − ⟨dg_h, λ̂⟩ on Γ_N,

with λ̂ the trace of λ_u on a facet. In a cell that a law holds the factor of dvalue is J_u − ∇·λ_σ.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property

import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem
from ufl import Form
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array, Indices, Mask, inverses
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import cell_dofs, function_of, owned_values, set_owned, sums_at
from signorini_fenicsx.contact.chains import Chains, Condition, SiteConditions
from signorini_fenicsx.contact.law import LawWithMemory
from signorini_fenicsx.derivatives.linearised import Effect, Linearised, Solved
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.mesh_spaces import assembled, cells_and_dofs
from signorini_fenicsx.discrete.part_laws import PartLaw, means_of
from signorini_fenicsx.discrete.seen import Seen, derivative_by, seen_in_cells
from signorini_fenicsx.forms.mixed import flux_product
from signorini_fenicsx.physics.diffusion.derivative.law_lines import moved_lines
from signorini_fenicsx.physics.diffusion.discrete.quasilinear import OnCells
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.solve.facet_system import Loads
from signorini_fenicsx.physics.diffusion.solve.hybrid import HybridBackend


class LinearisedDiffusion(Linearised):
    """A diffusion problem linearised at its solution; biactive sites are facets of Γ_S, and with laws in Ω cells."""

    refusal = "cell", "may leave a corner where several laws add up"

    def places(self) -> Array:
        """The midpoints of the biactive sites of this rank, shape (sites, dim)."""
        mesh, facets = self._spaces.mesh, len(self._spaces.facets)
        dim, on_facets, in_cells = mesh.topology.dim, self.biactive[:facets], np.flatnonzero(self.biactive[facets:])
        midpoints = [
            dolfinx.mesh.compute_midpoints(mesh, of, sites.astype(np.int32))
            for of, sites in ((dim - 1, self._spaces.facets[on_facets]), (dim, in_cells))
        ]
        return np.concatenate(midpoints)[:, :dim]

    def scales(self) -> tuple[Array, Array]:
        """Sizes of p and σ·n, see `FacetBackend.scales` (collective)."""
        of_p, of_flux = self._backend.scales(self._solution.outcome.iterate)
        return np.where(of_p > 0, of_p, 1.0), np.where(of_flux > 0, of_flux, 1.0)

    def refused(self, _chains: Chains) -> Mask:
        """The biactive cells, if there are several laws in Ω."""
        inside, refused = self._data.inside, self.biactive.copy()
        refused[: len(self._spaces.facets) if len(inside.of_regions) > 1 else None] = False
        return refused

    def plain(self) -> Iterator[tuple[str, Seen]]:
        """The means of f, κ, c, u_D and g_N, and (κ_h⁻¹b, τ_h) of a given flux (collective)."""
        spaces, data = self._spaces, self._data
        for name, datum in (("f", data.f), ("kappa", data.kappa), ("c", data.c)):
            if datum.pieces is None and not isinstance(datum, OnCells):
                space, cells = spaces.Q_matrix if datum.shape else spaces.Q, np.arange(len(spaces.cell_measures))
                yield name, seen_in_cells(space, datum, cells.astype(np.int32), spaces.cell_measures)
        dofs = cells_and_dofs(spaces.V, spaces.dirichlet_facets)[1]
        if data.u_D.pieces is None:
            basis = assembled(ufl.dot(ufl.TestFunction(spaces.V), spaces.n) * spaces.ds_dirichlet)[dofs]
            yield "u_D", Seen(_on_facets(spaces, data.u_D, spaces.ds_dirichlet), spaces.V, dofs, basis)
        if data.g_N.pieces is None:
            form = _on_facets(spaces, data.g_N, spaces.ds_neumann)
            yield "g_N", Seen(form, spaces.V, spaces.neumann_dofs, spaces.neumann_basis_flux)
        if data.b is not None and (b := data.b.in_ufl) is not None:
            every, dx = np.arange(spaces.V.dofmap.index_map.size_local, dtype=np.int32), ufl.dx(degree=data.b.degree)
            yield "b", Seen(lambda v: flux_product(b, v, dx, data.kappa_h), spaces.V, every, np.ones(len(every)))

    def lines(self, segment: Indices) -> Iterator[tuple[str, Effect]]:
        """See `Linearised.lines`; of several laws in a cell a steep one says all (collective)."""
        solution, facets = self._solution, len(self._spaces.facets)
        at, penalty = np.append(solution.p.x.array[:facets], owned_values(solution.u)), solution.method.penalty
        ends = None if penalty is None else penalty.slopes(solution.options.eps)
        held = np.isinf(np.take_along_axis(self._law.slope, segment[:, None], axis=1)[:, 0])
        for part in (*self._data.laws.of_parts, *self._data.inside.of_regions):
            sites = part.rows + (facets if part.law.region else 0)
            on = segment[sites]
            if part.law.region:
                on += solution.segments_of_law(part) - self._segment[sites]
            for key, steep, moved in moved_lines(self._spaces, part, on, at[sites], None if part.law.region else ends):
                places, matrices = sites[:, None], np.where(steep == held[sites], moved, 0.0)[:, None, None]
                yield part.key(key), Effect("line", _seen_by_law(self._spaces, part, key), places, matrices)

    def change(self, changes: Mapping[str, Array]) -> dict[str, fem.Function]:
        """The changes of σ, u and p with these numbers (collective).

        A biactive site moves along one of the two rays of the moved corner.

        Raises:
            InputError: If a cell is on a corner of several laws.
            NumericalFailure: If the sets of those sites do not settle.
        """
        loads = self._loads(changes)
        found: dict[str, fem.Function] = self.settled(changes, lambda conditions, _: self._solved(conditions, loads))
        return found

    def _solved(self, conditions: SiteConditions, loads: Loads) -> Solved:
        """The change under these conditions on the sites, whose p and σ·n are measured from 0 (collective)."""
        spaces, data, (facets, cells) = self._spaces, self._data, self._spaces.site_kinds
        space, sites = spaces.crouzeix_raviart, self._backend.sites
        values, held = np.broadcast_to(conditions.value, sites), conditions.kind == Condition.ZERO_TRACE
        trace, pulled = np.where(held, values, 0.0), np.where(held, 0.0, values)
        dofs = cells_and_dofs(space, spaces.facets)[1]
        on_facets = np.zeros(len(loads.forces) + space.dofmap.index_map.num_ghosts)
        on_facets[dofs] = facets.of(trace)  # only the cell behind a facet of Γ_S has it
        forces = loads.forces.copy()
        forces[dofs] += facets.of(pulled) * spaces.facet_measure
        loads = replace(loads, jumps=loads.jumps + on_facets[cell_dofs(space)], forces=forces)
        if data.inside:
            loads = replace(loads, source=loads.source + cells.of(pulled), held=cells.of(trace))
        sigma, u, traces = self._backend.respond(conditions, loads)
        p, flux, of_u = traces[dofs] + facets.of(trace), spaces.normal_flux(sigma), owned_values(u)
        if data.inside:  # there σ·n is −s = −∇·σ − f + cu
            c = 0.0 if data.c_h is None else owned_values(data.c_h)
            minus_s = c * of_u - loads.source + cells.of(pulled) - self._out_of(sigma) / spaces.cell_measures
            p, flux = np.append(p, of_u), np.append(flux, minus_s)
        p, flux = conditions.clean(p, flux, data.conductance)
        return p, flux, {"sigma": sigma, "u": u, "p": spaces.multiplier(facets.of(p))}

    def _out_of(self, sigma: fem.Function) -> Array:
        """∫∇·σ over each owned cell."""
        return np.einsum("cf,cf->c", self._spaces.outflow, sigma.x.array[cell_dofs(self._spaces.V)])

    def _loads(self, changes: Mapping[str, Array]) -> Loads:
        """The right side of the change, without what the laws add (collective)."""
        spaces, data, u = self._spaces, self._data, owned_values(self._solution.u)
        flux, traces = fem.Function(spaces.V), fem.Function(spaces.crouzeix_raviart)
        space = traces.function_space
        forces = np.zeros(space.dofmap.index_map.size_local)
        if "kappa" in changes:
            kappa = data.kappa_h.copy()
            set_owned(kappa, changes["kappa"])
            flux.x.array[:] = -assembled(spaces.kept(_with_kappa, data.kappa_h, self._driving, kappa))
        if "b" in changes:
            flux.x.array[: len(changes["b"])] += changes["b"]
        flux.x.scatter_forward()
        traces.x.array[cells_and_dofs(space, spaces.dirichlet_facets)[1]] = changes.get("u_D", 0.0)
        forces[cells_and_dofs(space, spaces.neumann_facets)[1]] = changes.get("g_N", 0.0) * spaces.neumann_measure
        source = changes.get("f", 0.0) - changes.get("c", 0.0) * u
        jumps = self._jumps(flux) + traces.x.array[cell_dofs(space)]
        return Loads(jumps, source + np.zeros_like(u), np.zeros_like(u), forces)

    def by(self, J: Form, besides: tuple[Array, Array] | None, of_traces: Array | None = None) -> dict[str, Array]:
        """See `Linearised.by`; besides J there are derivatives by u and by the s of laws in Ω of each cell.

        `of_traces` has those of a functional of û on the facets, one for each owned unknown.
        """
        spaces, data, u, (facets, _) = self._spaces, self._data, owned_values(self._solution.u), self._spaces.site_kinds
        flux, by_u, by_p = (
            derivative_by(function, J, spaces.entity_maps)
            for function in (self._solution.sigma, self._solution.u, self._solution.p)
        )
        on_gamma, on_neumann = (
            cells_and_dofs(spaces.crouzeix_raviart, listed)[1] for listed in (spaces.facets, spaces.neumann_facets)
        )
        on_p, on_u = by_p.x.array[: len(facets)].copy(), owned_values(by_u).copy()
        held = self._held[len(facets) :] if data.inside else np.zeros(len(u), dtype=bool)
        of_s = np.zeros_like(u)  # in held cells, where s = ∇·σ + f − cu
        if besides is not None:
            on_u += besides[0]
            if data.inside:
                slope = np.take_along_axis(self._law.slope, self._segment[:, None], axis=1)[len(facets) :, 0]
                on_u += np.where(held, 0.0, slope) * besides[1]
                of_s = np.where(held, besides[1], 0.0)
        forces = np.zeros(spaces.crouzeix_raviart.dofmap.index_map.size_local)
        if of_traces is not None:
            on_p += of_traces[on_gamma]
            forces -= of_traces
        forces[on_gamma] = -on_p
        volumes, none = spaces.cell_measures, np.zeros_like(u)
        jumps = self._jumps(flux) + (of_s / volumes)[:, None]
        loads = Loads(jumps, -on_u / volumes, none, forces)
        of_sigma, of_balance, traces = self._backend.respond(self._conditions, loads)
        of_f = of_s - volumes * owned_values(of_balance)
        of_trace = on_p + spaces.basis_flux * of_sigma.x.array[spaces.flux_dofs]
        on_facets = np.where(facets.of(self._held), of_trace, -spaces.facet_measure * traces[on_gamma])
        in_cells = np.where(held, on_u - self._out_of(of_sigma), of_f)
        by = {"f": of_f, "c": -u * of_f, "g_N": -traces[on_neumann] * spaces.neumann_measure}
        by["line"] = np.append(on_facets, in_cells)
        if "kappa" in self.seen or data.quasilinear is not None:
            of_cells = -assembled(spaces.kept(_by_kappa, data.kappa_h, self._driving, of_sigma))
            by["kappa"] = of_cells[: len(u)] if data.quasilinear is not None else of_cells[self.seen["kappa"].dofs]
        if "b" in self.seen:
            by["b"] = of_sigma.x.array[self.seen["b"].dofs]
        if "u_D" in self.seen:
            by["u_D"] = self.seen["u_D"].scale * of_sigma.x.array[self.seen["u_D"].dofs]
            if of_traces is not None:
                by["u_D"] += of_traces[cells_and_dofs(spaces.crouzeix_raviart, spaces.dirichlet_facets)[1]]
        return by

    @cached_property
    def _driving(self) -> fem.Function:
        """σ, less a given flux b (collective)."""
        solution, b = self._solution, self._data.b
        return solution.sigma if b is None or b.by_kappa else b.less_projected(solution.cell_flux)

    def _jumps(self, functional: fem.Function) -> Array:
        """The z whose ⟨z, τ·n⟩ is the value at τ of a functional, given by its values at the basis functions."""
        spaces, dofs = self._spaces, cell_dofs(self._spaces.V)
        cells = sums_at(spaces.V.dofmap.index_map, dofs)
        return np.asarray((functional.x.array / cells)[dofs] / spaces.outflow)


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


class LinearisedByU(LinearisedDiffusion):
    """The same where κ depends on u, by the derivative of the whole problem, Newton's matrix.

    Let g be the derivatives of J by κ on the cells, as if κ did not depend on u; B those of ∫σ·n by κ, S those of κ by
    û, K the matrix and x the unknowns. Where the data change κ by dκ₀ the change of κ is dκ = dκ₀ + S dx with
    dx = −K⁻¹B dκ + …, so the derivatives by dκ₀ are μ = (I + BᵀK⁻¹Sᵀ)⁻¹g = g − Bᵀ(K + BS)⁻ᵀSᵀg. All others are those of
    J + (Sᵀμ)·û under a fixed κ.
    """

    def __init__(self, solution: Solution, backend: HybridBackend, law: Chains, tolerance: float):
        """See `Linearised` (collective).

        Raises:
            InputError: For terms cu, laws in Ω and steps in time.
        """
        data = solution.data
        if data.c_h is not None or data.inside or solution.step is not None:
            raise InputError("derivatives: there are none where κ depends on u with terms cu, laws in Ω, or in time")
        inverse = np.asarray(inverses(data.matrices(solution.spaces)))
        traces = owned_values(solution.u)[:, None] + solution.cell_flux.tested(inverse)
        of_b, of_u = data.jumps(solution.spaces), data.quasilinear
        assert of_u is not None
        self._of_u, self._traces = of_u, traces - of_u.constant - (0.0 if of_b is None else of_b)
        super().__init__(solution, backend, law, tolerance)

    def plain(self) -> Iterator[tuple[str, Seen]]:
        """The means of f, u_D and g_N, and of κ by the numbers of soils (collective)."""
        yield from super().plain()
        spaces = self._spaces
        by_numbers = self._of_u.by_controls(self._traces)
        terms = [number * function_of(spaces.Q, derivative) for number, derivative in by_numbers]
        if terms:
            dofs = np.arange(len(spaces.cell_measures), dtype=np.int32)
            yield "kappa", Seen(lambda v: sum(terms) * v * ufl.dx, spaces.Q, dofs, spaces.cell_measures)

    def change(self, changes: Mapping[str, Array]) -> dict[str, fem.Function]:
        """Not there.

        Raises:
            InputError: Always.
        """
        raise InputError("derivative: where κ depends on u there are gradients alone; take gradient")

    def by(self, J: Form, besides: tuple[Array, Array] | None, of_traces: Array | None = None) -> dict[str, Array]:
        """See `LinearisedDiffusion.by` (collective)."""
        backend, slopes = self._backend, self._of_u.of_traces(self._traces)[1][:, 0]
        through = backend.system.by_kappa_for(self._traces)[:, :, 0]
        g = super().by(J, besides)["kappa"]
        matrices = through[:, :, None] * slopes[:, None]
        w = backend.new_tangent().transposed(self._conditions, matrices, self._sums(slopes, g))
        mu = g - np.einsum("cn,cn->c", through, self._in_cells(w))
        # λ_σ·n jumps where û has a functional, so that it is not in RT0, and μ is known
        return super().by(J, besides, self._sums(slopes, mu)) | {"kappa": mu}

    def _sums(self, slopes: Array, of_cells: Array) -> Array:
        """Sᵀ times numbers of the owned cells, for the owned unknowns (collective)."""
        space = self._spaces.crouzeix_raviart
        sums = sums_at(space.dofmap.index_map, cell_dofs(space), slopes * of_cells[:, None])
        owned: Array = self._backend.system.sides.forces(sums[: space.dofmap.index_map.size_local])
        return owned

    def _in_cells(self, x: Array) -> Array:
        """The values of unknowns on the facets of the owned cells (collective)."""
        values = fem.Function(self._spaces.crouzeix_raviart)
        values.x.array[: len(x)] = self._backend.system.sides.values(x)
        values.x.scatter_forward()
        return np.asarray(values.x.array[cell_dofs(values.function_space)])


def check_differentiable(solution: Solution) -> None:
    """Refuse laws with memory.

    Raises:
        InputError: If there is one.
    """
    if any(isinstance(law, LawWithMemory) for law in solution.problem.laws):
        raise InputError("derivatives: there are none with laws with memory")


def linearised(solution: Solution, tolerance: float) -> LinearisedDiffusion:
    """A problem linearised at its solution, with the factors of the solver that has just solved it (collective).

    Raises:
        InputError: If its method solves another discrete problem.
    """
    if solution.outcome.own_residual is not None:
        raise InputError(
            f"{solution.options.algorithm_name} solves another discrete problem; alg1 to alg4 have derivatives"
        )
    check_differentiable(solution)
    kind = LinearisedDiffusion if solution.data.quasilinear is None else LinearisedByU
    return kind(solution, solution.backend_of(HybridBackend), solution.law, tolerance)
