"""The facet system of RT0: one SPD problem with one unknown per facet, from which the mixed solution is recovered."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix
from petsc4py import PETSc
from ufl import Form
from ufl.core.expr import Expr

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import cell_dofs, owned_values, sums_at
from signorini_fenicsx.contact.chains import SiteConditions
from signorini_fenicsx.discrete.hybrid_system import Sides, copies
from signorini_fenicsx.discrete.mesh_spaces import assembled, cells_and_dofs
from signorini_fenicsx.forms.crouzeix_raviart import outflow, reaction, stiffness
from signorini_fenicsx.linear.constrained_matrix import assemble_again, image_of
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.sources import sources
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solve.soil_traces import SoilTraces


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


class FacetSystem(SoilTraces):
    """The mixed method by its Crouzeix-Raviart form (see `forms/crouzeix_raviart.py`), which eliminates in closed form.

    It is assembled several times as fast as by the elimination of `HybridSystem`. Inside the domain the unknown of a
    facet of Γ_S is the jump of u, see `Sides`. Laws in Ω change the sources under the conditions of the cells, and so
    the matrix and the load. σ is given by ∫σ·n out of each cell through each facet.

    Attributes:
        spaces: The discrete spaces.
        sources: Those of the cells under the conditions last imposed.
    """

    def __init__(self, spaces: Spaces, data: Data):
        """Assemble (collective)."""
        self.spaces, self._data, self.sources = spaces, data, sources(spaces, data)
        space = spaces.crouzeix_raviart
        self._neumann_dofs = cells_and_dofs(space, spaces.neumann_facets)[1]
        named = cells_and_dofs(space, spaces.facets)[1][spaces.inner.rows]
        across = cells_and_dofs(space, spaces.inner.facets)[1]
        sides = Sides(space, copies(space, named, across), present=spaces.inner.present)
        super().__init__(space, cell_dofs(space), sides)
        self._take(data)

    @property
    def follows_cells(self) -> bool:
        """Whether conditions of cells, or u, change the matrix."""
        return bool(self._data.inside) or self._data.quasilinear is not None

    @property
    def lift(self) -> Array:
        """See `TraceSystem.lift`."""
        return np.asarray(self._data.u_lift.x.array)

    def _assembled(self) -> PETSc.Mat:
        """Assemble the matrix (collective)."""
        self._of_traces = assemble_matrix(self._form())
        self._of_traces.assemble()
        return self.sides.of_unknowns(self._of_traces)

    def _assemble_again(self) -> None:
        """Give the matrix the entries of another κ, or of other sources (collective)."""
        assemble_again(self._of_traces, self._form(), self.sides.basis, self.matrix)

    def _form(self) -> fem.Form:
        """The bilinear form (collective)."""
        spaces, kappa, s = self.spaces, self._data.kappa_h, self.sources.s
        form: fem.Form = spaces.kept(_stiffness, kappa) if s is None else spaces.kept(_with_reaction, kappa, s)
        return form

    def _take(self, data: Data) -> None:
        """Assemble the right side (collective)."""
        self._data, self._jumps = data, data.jumps(self.spaces)
        self._take_load()

    def _take_load(self) -> None:
        """Add up the right side: sources and given fluxes, less what the lift has of them (collective)."""
        data, spaces, sites = self._data, self.spaces, self.spaces.site_kinds["facet"]
        y = owned_values(self.sources.b)
        if self.sources.s is not None:
            y = y - owned_values(self.sources.s) * self.sources.jumps
        per_facet = np.repeat((y * spaces.cell_measures / self._dofs.shape[1])[:, None], self._dofs.shape[1], axis=1)
        if self._jumps is not None:
            per_facet = per_facet - self._flow(self._jumps)
        load = self.gathered(per_facet)
        load[sites.unknown] += data.q_Sh * sites.measure
        load[self._neumann_dofs] += data.sigma_lift.x.array[spaces.neumann_dofs] * spaces.neumann_basis_flux
        self.load = load - image_of(self.matrix, self.lift[: len(load)])

    def renew(self, data: Data) -> bool:
        """Go on with other data; whether the matrix stays (collective)."""
        same = data.same_operator(self._data, self.spaces)
        kept = same and not data.inside and data.b is self._data.b
        self._data, self.sources = data, self.sources.renewed(data) if kept else sources(self.spaces, data)
        if not kept:
            self._assemble_again()
        self._take(data)
        return kept

    def take_kappa(self, data: Data) -> None:
        """Go on with the same data but for κ (collective)."""
        self.renew(data)

    def impose_in_cells(self, conditions: SiteConditions) -> None:
        """Give each cell the source that its law has under its condition (collective)."""
        self.sources = sources(self.spaces, self._data, conditions)
        self._assemble_again()
        self._take_load()

    def traces_on_cells(self, unknowns: Array) -> Array:
        """See `SoilTraces`, shape (cells, d + 1) (collective)."""
        return np.asarray(self.sides.values(unknowns)[self._dofs])

    def means_of_cells(self, traces: Array) -> Array:
        """See `SoilTraces` (collective)."""
        return sums_at(self._numbers, self._dofs, traces) / self.cells_around

    @cached_property
    def fixed(self) -> npt.NDArray[np.int32]:
        """See `SoilTraces`."""
        return cells_and_dofs(self.spaces.crouzeix_raviart, self.spaces.dirichlet_facets)[1]

    def by_kappa(self, x: PETSc.Vec) -> Array:
        """The derivatives of ∫σ·n on the facets of each cell by its κ, shape (cells, d + 1, 1) (collective).

        With a source y also u_T depends on κ, by m_T.
        """
        traces = self.on_cells(x)
        of_cells = self.by_kappa_for(traces)
        if self.sources.s is not None:
            y = self.sources.values(traces)[1] * owned_values(self.sources.s) * self.sources.moments
            share = y * self.spaces.cell_measures / of_cells.shape[1]
            of_cells -= (share[:, None] / self._data.kappa_values)[:, :, None]
        return of_cells

    def by_kappa_for(self, traces: Array) -> Array:
        """`by_kappa`, from û on the facets of the owned cells, without what sources have of u (collective)."""
        b = self._data.b
        if b is not None and b.by_kappa and self._jumps is not None:
            traces = traces + self._jumps
        return np.asarray((self._flow(traces) / self._data.kappa_values)[:, :, None])

    def of_cells(self, matrices: Array) -> PETSc.Mat:
        """The sum of matrices of the owned cells, between û on their facets (collective)."""
        return self.sum_of([(self._dofs, matrices)])

    def recover(self, x: Array) -> tuple[Array, Array]:
        """∫σ·n out of each owned cell through its facets, shape (cells, d + 1), and u_T (collective)."""
        traces = self.traces_on_cells(x)
        u, y = self.sources.values(traces)
        return self._flow(traces if self._jumps is None else traces + self._jumps, y), u

    def in_cells(self, x: PETSc.Vec) -> tuple[Array, Array]:
        """The u_T less its reference, and −s_T, of each owned cell with laws in Ω (collective)."""
        data = self._data
        u, y = self.sources.values(self.on_cells(x))
        force = y - owned_values(data.f_h)
        if data.c_h is not None:
            force += owned_values(data.c_h) * u
        return u - data.inside.means, force

    def respond(self, loads: Loads, *, solve: Callable[[Array], Array]) -> tuple[Array, Array, Array]:
        """Solve with any right side, without the data (collective).

        Args:
            loads: The right side.
            solve: Gives x, ghosts too, from the right side for the owned unknowns.

        Returns:
            σ and u as `recover` gives them, and x.
        """
        x = solve(loads.forces - self.gathered(self._through(loads.jumps, loads)[0]))
        return *self._through(loads.jumps + self.traces_on_cells(x), loads), x

    def _through(self, values: Array, loads: Loads) -> tuple[Array, Array]:
        """∫σ·n out of each cell through each facet, and u_T, from u on the facets of each cell (collective)."""
        s = np.zeros(len(values)) if self.sources.s is None else owned_values(self.sources.s)
        moments, means = self.sources.moments, np.einsum("cf->c", values) / values.shape[1]
        source = (1 - s * moments) * loads.source + s * (loads.held - means)
        return self._flow(values, source), means + moments * source

    def _flow(self, values: Array, source: Array | None = None) -> Array:
        """∫σ·n out of each owned cell through each facet, from u on its facets and −∇·σ (collective)."""
        spaces = self.spaces
        y, broken = fem.Function(spaces.Q), fem.Function(spaces.broken_crouzeix_raviart)
        if source is not None:
            owned_values(y)[:] = source
        dofs = cell_dofs(broken.function_space)
        broken.x.array[dofs] = values
        return np.asarray(assembled(spaces.kept(_outflow, self._data.kappa_h, y, broken))[dofs])


def _stiffness(spaces: Spaces, kappa: Expr) -> Form:
    space = spaces.crouzeix_raviart
    return stiffness(ufl.TrialFunction(space), ufl.TestFunction(space), ufl.dx, kappa)


def _with_reaction(spaces: Spaces, kappa: Expr, s: Expr) -> Form:
    space = spaces.crouzeix_raviart
    return _stiffness(spaces, kappa) + reaction(ufl.TrialFunction(space), ufl.TestFunction(space), ufl.dx, s)


def _outflow(spaces: Spaces, kappa: Expr, source: Expr, u_cr: Expr) -> Form:
    """At a facet between two cells what flows out of one flows into the other, up to the linear residual."""
    return outflow(u_cr, source, ufl.TestFunction(spaces.broken_crouzeix_raviart), ufl.dx, kappa)
