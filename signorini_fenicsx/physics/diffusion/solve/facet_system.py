"""The facet system: one SPD problem with one unknown per facet, from which the mixed solution is recovered."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from petsc4py import PETSc
from ufl import Form
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.owned import cell_dofs, function_of, owned_values, sums_at
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.discrete.hybrid_system import Sides, copies
from signorini_fenicsx.discrete.matrices import of_cells
from signorini_fenicsx.discrete.mesh_spaces import assembled, cells_and_dofs
from signorini_fenicsx.forms.crouzeix_raviart import outflow, reaction, stiffness
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.sources import sources
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces


@dataclass(frozen=True)
class Loads:
    """Any right side of the mixed problem.

    It is (κ_h⁻¹σ, τ) + (u, ∇·τ) − ⟨û, τ·n⟩ = ⟨z, τ·n⟩, with the sum of ⟨·, ·⟩_∂T over all cells on both sides, and
    −∇·σ + cu = f. So u_CR + z, which jumps between cells, stands where u_CR does without z.

    Attributes:
        jumps: z on each facet of each owned cell, shape (cells, dim + 1).
        source: f of each owned cell.
        held: u_T of each owned cell where a law in Ω holds it, 0 elsewhere.
        forces: What is given of ∫σ·n on each facet, for the owned unknowns.
    """

    jumps: Array
    source: Array
    held: Array
    forces: Array


PREDICT_FROM = 5_000
"""Number of facets of the mesh from which a prediction saves more than it costs."""
DIRECT_UP_TO = 60_000
"""Most facets of a system that is factorised: tenths of a second in the plane, seconds in space, for any κ."""


class FacetSystem:
    """The mixed method by its Crouzeix-Raviart form (see `forms/crouzeix_raviart.py`).

    A ZERO_TRACE facet, like one of Γ_D, is an essential condition on its degree of freedom, a NO_FLUX facet a natural
    one, and a ROBIN facet adds β|e| p̄ q̄, on facet means, to the diagonal. v|e| is a load on either of the last two.
    Inside the domain the unknown of a facet of Γ_S is the jump of u, see `Sides`.

    With laws in Ω the conditions of the cells follow those of the facets. They change the sources, and so the matrix
    and the load.

    Attributes:
        spaces: The discrete spaces.
        space: Crouzeix-Raviart functions.
        operator: The Crouzeix-Raviart matrix without conditions on facets, and the next.
        matrix: The Crouzeix-Raviart matrix under the conditions last applied.
        b: Its right side.
        x: Its solution, u_CR minus the lift of u_D and ψ; the start of the next iterative solve.
        trace_dofs: The unknown of each Γ_S facet.
        dirichlet_dofs: Those of Γ_D.
        sides: The unknowns of facets inside the domain.
        dofs: Unknowns over all ranks.
        large: Whether an iterative solver is the default at this size.
        sources: Those of the cells under the conditions last applied.
    """

    name = "hybrid"

    def __init__(self, spaces: Spaces, data: Data, tuning: Tuning):
        """Assemble (collective).

        Args:
            spaces: The discrete spaces.
            data: The data and their means over cells and facets.
            tuning: Has the size from which it is large.
        """
        self.spaces = spaces
        self.space = spaces.crouzeix_raviart
        self.trace_dofs = cells_and_dofs(self.space, spaces.facets)[1]
        self._neumann_dofs = cells_and_dofs(self.space, spaces.neumann_facets)[1]
        self.dirichlet_dofs = cells_and_dofs(self.space, spaces.dirichlet_facets)[1]
        self.dofs = self.space.dofmap.index_map.size_global
        self.large = tuning.is_large(self.dofs, DIRECT_UP_TO)
        across = cells_and_dofs(self.space, spaces.inner.facets)[1]
        named = self.trace_dofs[spaces.inner.rows]
        self.sides = Sides(self.space, copies(self.space, named, across), present=spaces.inner.present)
        self._facets, self._cells = spaces.site_kinds
        self.sources = sources(spaces, data)
        self.operator = ConstrainedMatrix(self._form(data), PETSc.Mat.Option.SPD, self.sides.basis)
        self.matrix = self.operator.matrix
        self._imposed: SiteConditions | None = None
        self.x, self.b = self.matrix.createVecs()
        self.x.set(0.0)
        self._rows: PETSc.Mat | None = None
        self._take(data)

    @property
    def natural(self) -> PETSc.Mat:
        """The matrix without conditions on facets."""
        return self.operator.natural

    @property
    def follows_cells(self) -> bool:
        """Whether conditions of cells, or u, change `natural`."""
        return self._data.inside is not None or self._data.quasilinear is not None

    def _form(self, data: Data) -> fem.Form:
        """The bilinear form (collective)."""
        spaces, s = self.spaces, self.sources.s
        form: fem.Form = (
            spaces.kept(_stiffness, data.kappa_h) if s is None else spaces.kept(_with_reaction, data.kappa_h, s)
        )
        return form

    def _take(self, data: Data) -> None:
        """Assemble the right side (collective)."""
        self._data, self._jumps = data, data.jumps(self.spaces)
        self._assemble_load()

    def _assemble_load(self) -> None:
        """Add up the right side without conditions on Γ_S: sources and given fluxes, less what the lift has of them.

        Collective.
        """
        data, spaces = self._data, self.spaces
        y, dofs = owned_values(self.sources.b), cell_dofs(self.space)
        if self.sources.s is not None:
            y = y - owned_values(self.sources.s) * self.sources.jumps
        per_facet = (y * spaces.cell_measures / dofs.shape[1])[:, None]
        if self._jumps is not None:
            per_facet = per_facet - self._flow(self._jumps)
        owned = self.sides.forces(sums_at(self.space.dofmap.index_map, dofs, per_facet)[: self.b.getLocalSize()])
        owned[self.trace_dofs] += data.q_Sh * spaces.facet_measure
        owned[self._neumann_dofs] += data.sigma_lift.x.array[spaces.neumann_dofs] * spaces.neumann_basis_flux
        lift, image = self.matrix.createVecs()
        lift.array_w[:] = data.u_lift.x.array[: len(owned)]
        self.operator.natural.mult(lift, image)
        self._load = owned - image.array_r
        for vector in (lift, image):
            vector.destroy()

    def _assemble_again(self, data: Data) -> None:
        """Assemble the matrix with another κ, or other sources (collective)."""
        self.operator.renew(self._form(data))
        self._rows = None

    def renew(self, data: Data) -> bool:
        """Go on with other data, the next iterative solve from solutions of earlier ones (collective).

        Returns:
            Whether κ and c, and so the matrix, stay.
        """
        same = data.same_operator(self._data, self.spaces)
        kept = same and data.inside is None and data.b is self._data.b
        self.sources = self.sources.renewed(data) if kept else sources(self.spaces, data)
        if not kept:
            self._assemble_again(data)
            self._imposed = None
        self._take(data)
        return same

    def on_cells(self, x: PETSc.Vec) -> Array:
        """û on the facets of the owned cells, shape (cells, d + 1) (collective)."""
        return np.asarray(self._with_lift(x.array_r).x.array[cell_dofs(self.space)])

    def begin(self, traces: Array) -> None:
        """Let x be that of û on the facets of the owned cells, with u_D where that is given (collective)."""
        nodes, numbers = cell_dofs(self.space), self.space.dofmap.index_map
        sums, count = (sums_at(numbers, nodes, each)[: len(self._load)] for each in (traces, np.ones_like(traces)))
        owned = sums / count - self._data.u_lift.x.array[: len(sums)]
        owned[self.dirichlet_dofs] = 0.0
        self.x.array_w[:] = self.sides.unknowns(owned)

    def limited(self, start: Array, x: Array) -> Array:
        """These unknowns, or nearer ones to a start as far as soils allow, see `Soil.nearer` (collective)."""
        of_u, space = self._data.quasilinear, self.space
        assert of_u is not None
        nodes, numbers = cell_dofs(space), space.dofmap.index_map
        traces, wanted = (self._with_lift(each).x.array[nodes] for each in (start, x))
        off = of_u.nearer(traces, wanted) - wanted
        moved = sums_at(numbers, nodes, off)[: len(x)] / sums_at(numbers, nodes)[: len(x)]
        return self.sides.unknowns(self.sides.values(x)[: len(x)] + moved)

    def by_kappa(self, x: PETSc.Vec) -> Array:
        """The derivatives of ∫σ·n on the facets of each cell by its κ, shape (cells, d + 1, 1) (collective).

        With a source y also u_T depends on κ, by m_T.
        """
        of_cells = self.by_kappa_for(self.on_cells(x))
        if self.sources.s is not None:
            y = self.sources.values(self._with_lift(x.array_r))[1] * owned_values(self.sources.s) * self.sources.moments
            share = y * self.spaces.cell_measures / of_cells.shape[1]
            of_cells -= (share[:, None] / self._data.kappa_values)[:, :, None]
        return of_cells

    def by_kappa_for(self, traces: Array) -> Array:
        """`by_kappa`, from û on the facets of the owned cells, without what sources have of u (collective)."""
        b = self._data.b
        if b is not None and b.by_kappa and self._jumps is not None:
            traces = traces + self._jumps
        of_cells = self._flow(traces)
        return np.asarray((of_cells / self._data.kappa_values)[:, :, None])

    def of_cells(self, matrices: Array) -> PETSc.Mat:
        """The sum of matrices of the owned cells, between û on their facets (collective)."""
        nodes, comm = cell_dofs(self.space), self.spaces.mesh.comm
        return self.sides.of_unknowns(of_cells(comm, self.space.dofmap.index_map, 1, [nodes], [(nodes, matrices)]))

    def unknowns(self, sites: Mask) -> npt.NDArray[np.int32]:
        """The owned unknowns of some sites."""
        of_cells = cell_dofs(self.space)[np.flatnonzero(self._cells.of(sites))].ravel()
        owned = of_cells[of_cells < self.space.dofmap.index_map.size_local]
        return np.union1d(self.trace_dofs[self._facets.of(sites)], owned).astype(np.int32)

    def apply(self, conditions: SiteConditions) -> npt.NDArray[np.int32]:
        """Impose conditions on `matrix`, `b` and `x` and return the owned unknowns that they fix (collective)."""
        self.impose(conditions)
        return self.load(conditions)

    def impose(self, conditions: SiteConditions) -> None:
        """Impose conditions on `matrix`, unless they are those of last time (collective)."""
        if conditions.same(self._imposed, self.spaces.mesh.comm):
            return
        self._impose_in_cells(self._cells.of(conditions))
        fixed, (_, springs) = self._fixed(self._facets.of(conditions)), self.held_and_springs(conditions)
        self.operator.impose(fixed, self.trace_dofs, springs)
        self._imposed = conditions

    def _impose_in_cells(self, conditions: SiteConditions) -> None:
        """Give each cell the source that its law has under its condition (collective)."""
        if self._data.inside is not None:
            self.sources = sources(self.spaces, self._data, conditions)
            self._assemble_again(self._data)
            self._assemble_load()

    def load(self, conditions: SiteConditions) -> npt.NDArray[np.int32]:
        """Impose conditions on `b` and `x` alone and return the owned unknowns that they fix.

        Collective if the conditions have values.
        """
        fixed = self._fixed(self._facets.of(conditions))
        self.b.array_w[:], held = self.posed(conditions)
        self.b.array_w[fixed] = self.x.array_w[fixed] = held[fixed]
        return fixed

    def posed(self, conditions: SiteConditions) -> tuple[Array, Array]:
        """The right side of the system without conditions, and the part of the solution that they give.

        Collective if the conditions have values.

        Returns:
            The right side for the rest of the solution, and the values of fixed unknowns, 0 elsewhere; both for the
            owned unknowns.
        """
        conditions, load, held = self._facets.of(conditions), self._load.copy(), np.zeros(len(self._load))
        if conditions.has_values:
            is_held = conditions.kind == Condition.ZERO_TRACE
            held[self.trace_dofs[is_held]] = conditions.values_where(is_held)
            values, image = self.matrix.createVecs()
            values.array_w[:] = held
            self.operator.natural.mult(values, image)
            load -= image.array_r
            load[self.trace_dofs[~is_held]] += conditions.values_where(~is_held) * self.spaces.facet_measure[~is_held]
            for vector in (values, image):
                vector.destroy()
        return load, held

    def _fixed(self, conditions: SiteConditions) -> npt.NDArray[np.int32]:
        zero_trace = conditions.kind == Condition.ZERO_TRACE
        return np.concatenate([self.dirichlet_dofs, self.trace_dofs[zero_trace]])

    def recover(self, conditions: SiteConditions, linear_iterations: int) -> Iterate:
        """σ_h, u_h and p_h from `x`, which solves the system under these conditions (collective)."""
        spaces = self.spaces
        sigma, u_cr = fem.Function(spaces.V, name="sigma"), self._with_lift(self.x.array_r)
        if self._jumps is None:
            through = assembled(spaces.kept(_outflow, self._data.kappa_h, self.sources.at(u_cr), u_cr))
            of_cells = through[cell_dofs(spaces.broken_crouzeix_raviart)]
        else:
            of_cells = self._flow(u_cr.x.array[cell_dofs(self.space)] + self._jumps, self.sources.at(u_cr))
        sigma.x.array[cell_dofs(spaces.V)] = of_cells / spaces.outflow
        sigma.x.scatter_forward()
        of_cells = self.sources.values(u_cr)[0]
        flux = spaces.normal_flux(sigma) - self._data.q_Sh
        p, flux = self._pairs(self.x, flux, conditions)
        on_facets = (self._facets.of(flux) + self._data.q_Sh) * spaces.facet_measure
        sigma.x.array[spaces.flux_dofs] = on_facets / spaces.basis_flux
        sigma.x.array[spaces.neumann_dofs] = self._data.sigma_lift.x.array[spaces.neumann_dofs]
        sigma.x.scatter_forward()
        spaces.carry_across(sigma)
        if self._data.inside is not None:
            cells = self._cells.of(conditions)
            held, value = cells.kind == Condition.ZERO_TRACE, self._data.inside.as_linear(cells)[1]
            of_cells[held] = value[held]
        u = function_of(spaces.Q, of_cells, "u")
        return Iterate(p=p, flux=flux, linear_iterations=linear_iterations, sigma=sigma, u=u)

    def respond(
        self,
        conditions: SiteConditions,
        loads: Loads,
        solve: Callable[[PETSc.Vec, PETSc.Vec], None],
    ) -> tuple[fem.Function, fem.Function, Array]:
        """Solve with any right side, without the data, under conditions that were imposed last (collective).

        Args:
            conditions: These conditions; their values do not matter.
            loads: The right side.
            solve: Solves with `matrix`.

        Returns:
            σ and u, and û of each facet that is owned, on inner ones of Γ_S its jump.
        """
        owned, jumps = len(loads.forces), loads.jumps
        through, _ = self._through(jumps, loads)
        sums = self.sides.forces(sums_at(self.space.dofmap.index_map, cell_dofs(self.space), -through))
        b, x = (vector.duplicate() for vector in (self.b, self.x))
        b.array_w[:] = sums[:owned] + loads.forces
        b.array_w[self._fixed(self._facets.of(conditions))] = 0.0
        x.set(0.0)
        solve(b, x)
        trace, u_cr = x.array_r.copy(), fem.Function(self.space)
        u_cr.x.array[:owned] = self.sides.values(trace)
        u_cr.x.scatter_forward()
        through, of_cells = self._through(jumps + u_cr.x.array[cell_dofs(self.space)], loads)
        sigma, u = fem.Function(self.spaces.V, name="sigma"), function_of(self.spaces.Q, of_cells, "u")
        sigma.x.array[cell_dofs(self.spaces.V)] = through / self.spaces.outflow
        sigma.x.scatter_forward()
        self.spaces.carry_across(sigma)
        for vector in (b, x):
            vector.destroy()
        return sigma, u, trace

    def _through(self, values: Array, loads: Loads) -> tuple[Array, Array]:
        """∫σ·n out of each cell through each facet, and u_T, from u on the facets of each cell (collective)."""
        s = np.zeros(len(values)) if self.sources.s is None else owned_values(self.sources.s)
        moments, means = self.sources.moments, np.einsum("cf->c", values) / values.shape[1]
        source = (1 - s * moments) * loads.source + s * (loads.held - means)
        return self._flow(values, function_of(self.spaces.Q, source)), means + moments * source

    def _flow(self, values: Array, source: fem.Function | None = None) -> Array:
        """∫σ·n out of each owned cell through each facet, from u on its facets and −∇·σ (collective)."""
        y, broken = source or fem.Function(self.spaces.Q), fem.Function(self.spaces.broken_crouzeix_raviart)
        dofs = cell_dofs(broken.function_space)
        broken.x.array[dofs] = values
        return np.asarray(assembled(self.spaces.kept(_outflow, self._data.kappa_h, y, broken))[dofs])

    def traces(self, x: PETSc.Vec, conditions: SiteConditions) -> tuple[Array, Array]:
        """Trace and flux per site as `recover` gives them, for an x that need not be a solution (collective).

        A facet of Γ_S has one cell, so its row of the system without conditions is |e|(σ·n − q_S).
        """
        if self._rows is None:
            self._rows = self.operator.rows(self.trace_dofs)
        loads = self._rows.createVecLeft()
        self._rows.mult(x, loads)
        flux: Array = (loads.array_r - self._load[self.trace_dofs]) / self.spaces.facet_measure
        return self._pairs(x, flux, conditions)

    def held_and_springs(self, conditions: SiteConditions) -> tuple[Mask, Array]:
        """Which facets of Γ_S are held under these conditions, and β|e| at each of the others."""
        on_facets = self._facets.of(conditions)
        robin = on_facets.kind == Condition.ROBIN
        added = np.zeros(len(robin))
        added[robin] = on_facets.beta_where(robin) * self.spaces.facet_measure[robin]
        return on_facets.kind == Condition.ZERO_TRACE, added

    def _pairs(self, x: PETSc.Vec, flux: Array, conditions: SiteConditions) -> tuple[Array, Array]:
        """Pairs of all sites: p − ψ and σ·n − q_S of facets, u_T less its reference and −s_T of cells with laws."""
        data, trace = self._data, x.array_r[self.trace_dofs]
        if data.inside is not None:
            u, source = self.sources.values(self._with_lift(x.array_r))
            trace = np.append(trace, u - data.inside.means)
            force = source - owned_values(data.f_h)
            if data.c_h is not None:
                force += owned_values(data.c_h) * u
            flux = np.append(flux, force)
        return conditions.clean(trace, flux, data.conductance)

    def _with_lift(self, x: Array) -> fem.Function:
        """u_CR (collective)."""
        owned = self.sides.values(x)
        u_cr = fem.Function(self.space)
        u_cr.x.array[: len(owned)] = owned
        u_cr.x.scatter_forward()
        u_cr.x.array[:] += self._data.u_lift.x.array
        return u_cr


def _stiffness(spaces: Spaces, kappa: Expr) -> Form:
    space = spaces.crouzeix_raviart
    return stiffness(ufl.TrialFunction(space), ufl.TestFunction(space), ufl.dx, kappa)


def _with_reaction(spaces: Spaces, kappa: Expr, s: Expr) -> Form:
    space = spaces.crouzeix_raviart
    return _stiffness(spaces, kappa) + reaction(ufl.TrialFunction(space), ufl.TestFunction(space), ufl.dx, s)


def _outflow(spaces: Spaces, kappa: Expr, source: Expr, u_cr: Expr) -> Form:
    """At a facet between two cells what flows out of one flows into the other, up to the linear residual."""
    return outflow(u_cr, source, ufl.TestFunction(spaces.broken_crouzeix_raviart), ufl.dx, kappa)
