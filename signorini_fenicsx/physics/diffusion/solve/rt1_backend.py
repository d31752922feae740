"""The backend of RT1: the hybrid system with a condition per facet vertex of Γ_S, and per vertex of a cell in Ω."""

from dataclasses import replace
from functools import cached_property, partial
from typing import Any, Self

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.tolerances import ROUNDING
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.backend import DataBackend, Inexact
from signorini_fenicsx.contact.chains import SiteConditions
from signorini_fenicsx.contact.sites import SiteKind
from signorini_fenicsx.discrete.field_change import FieldChange
from signorini_fenicsx.discrete.linear_traces import means_of_linear
from signorini_fenicsx.discrete.posed import State
from signorini_fenicsx.discrete.sizes import Sizes
from signorini_fenicsx.discrete.trace_multigrid import facet_solver
from signorini_fenicsx.discrete.vertex_laws import VertexLaws
from signorini_fenicsx.physics.diffusion.discrete.raviart_thomas import Cells, reference
from signorini_fenicsx.physics.diffusion.discrete.rt1_data import RT1Data
from signorini_fenicsx.physics.diffusion.discrete.sources import mean_moments
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces
from signorini_fenicsx.physics.diffusion.solve.flux_backend import FluxBackend
from signorini_fenicsx.physics.diffusion.solve.rt1_residuals import RT1Iterate
from signorini_fenicsx.physics.diffusion.solve.vertex_system import VertexSystem


class VertexBackend(DataBackend):
    """What the backends of RT1 have in common: a condition per facet vertex of Γ_S.

    There p is the mean of û − ψ by the hat, and the flux the value of σ·n − Π₁q_S.
    """

    noun = ("vertex", "vertices")
    comm: MPI.Comm
    sites: int
    spaces: RT1Spaces
    data: RT1Data

    @property
    def laws(self) -> VertexLaws:
        """The laws at the vertices."""
        return self.data.laws_at

    def iterate_of(
        self, conditions: SiteConditions, p: Array, sigma: fem.Function, u: fem.Function, iterations: int
    ) -> RT1Iterate:
        """The iterate from means of û less the references and from fields."""
        data, laws, spaces = self.data, self.laws, self.spaces
        flux = spaces.through(spaces.contact, spaces.flux_values(sigma)).ravel() - laws.flux_h
        at_laws = laws.openings(laws.chains.segments(conditions[: len(p)]), p, flux)
        means = p + data.lift[spaces.site_kinds.unknown]
        if data.inside:
            above, force = data.in_cells(spaces, spaces.flux_values(sigma), spaces.scalar_values(u))
            segment = data.cells_at.chains.segments(conditions[len(p) :])
            at_laws, flux = np.append(at_laws, data.cells_at.openings(segment, above, force)), np.append(flux, force)
        return RT1Iterate(*conditions.clean(at_laws, flux, data.conductance), iterations, sigma, u, means)

    def without_flux(self, iterate: Any, where: Mask) -> RT1Iterate:
        """The iterate with σ·n = q_S at some vertices, and the trace that belongs to it by (37) (collective).

        If the flux changes by δσ on a facet, û changes at the vertices of the facets of Γ_S of the same cell by
        (κ⁻¹δσ, τ), where τ has the hat of the vertex for its moment.
        """
        spaces, dim, contact = self.spaces, self.spaces.dim, self.spaces.contact
        added = np.where(where, -iterate.flux, 0.0).reshape(-1, dim)
        cells, row = np.unique(contact.cells, return_inverse=True)
        moments, places = np.zeros((len(cells), dim + 1, dim)), (row, contact.local)
        moments[places] = contact.of_linear(added)
        shapes, basis = Cells(spaces.vertices[cells], cells), reference(dim).nodal[:, : dim * (dim + 1)]
        change = moments.reshape(-1, dim * (dim + 1)) @ basis.T
        sigma, product = spaces.flux_values(iterate.sigma), self.data.products(spaces, shapes)
        sigma[cells] += shapes.at_nodes(change)
        moved = np.einsum("nbc,nc->nb", product, change) @ basis
        means = means_of_linear(moved.reshape(-1, dim + 1, dim)[places]).ravel()
        flux = np.where(where, 0.0, iterate.flux)
        return replace(iterate, sigma=spaces.flux(sigma), p=iterate.p + means, means=iterate.means + means, flux=flux)

    @cached_property
    def change(self) -> FieldChange:
        """Norms of what changed, see `Backend.change`."""
        return FieldChange(self.spaces.flux_space, self.spaces.scalar_space)


class RT1Backend(VertexBackend, FluxBackend):
    """The backend with one condition per facet vertex of Γ_S, with the mean of û − ψ by its hat for p.

    The flux is the value of σ·n − Π₁q_S at the vertex. With laws in Ω the vertices of cells follow, with the mean
    of u by the hat less the reference, and the value of −s at the vertex; their conditions change the matrix.
    """

    name = "hybrid RT1"
    spaces: RT1Spaces
    system: VertexSystem
    data: RT1Data

    def __init__(self, spaces: RT1Spaces, data: RT1Data, tuning: Tuning | None = None):
        """Assemble and choose the solver (collective).

        Args:
            spaces: The spaces.
            data: The data.
            tuning: Has the size from which CG with multigrid is the default.

        Raises:
            InputError: If PETSc refuses an option.
        """
        sites = np.arange(len(spaces.site_kinds.unknown))
        near = sites.reshape(-1, spaces.dim).repeat(spaces.dim, axis=0)
        choose = partial(facet_solver, spaces, tuning)
        FluxBackend.__init__(self, VertexSystem(spaces, data), spaces, data, data.fixed, (near, sites[:, None]), choose)
        self.precise = self._corrected_to_rounding
        self._take(data)

    def _corrected_to_rounding(self) -> Self:
        """The backend itself, whose fluxes are corrected until the rest is rounding."""
        self.exact_to = ROUNDING
        return self

    def _take(self, data: RT1Data) -> None:
        """Take data with this matrix (collective)."""
        self.data, self._state, self.conductance = data, State.START, data.conductance
        loads = (self.system.load, data.load)
        loaded = self.comm.allreduce(any(bool(load.any()) for load in loads), MPI.LOR)
        self.sizes = Sizes(self.comm, data.lift, self.stiffness, loaded=loaded)

    @property
    def with_laws(self) -> list[tuple[SiteKind, VertexLaws]]:
        """The kinds of sites that have `VertexLaws`, with these."""
        return [*super().with_laws, (self._cells, self.data.cells_at)]

    @property
    def inexact(self) -> Inexact | None:
        """The backend itself, as traces cost less than fields."""
        return self

    def iterate(self, conditions: SiteConditions, sigma: Array, u: Array) -> RT1Iterate:
        """The iterate from the values of σ and u (collective)."""
        self.sizes.take(u, sigma)
        fields = self.spaces.flux(sigma), self.spaces.scalar(u)
        return self.iterate_of(conditions, self.means(self._x), *fields, self._iterations)

    def scales(self, iterate: Any) -> tuple[Array, Array]:
        """See `TraceBackend.scales`; in cells that of −s is the scale of u over m_T, as of RT0 (collective)."""
        of_u, of_flux = super().scales(iterate)
        if not self.by_traces:
            moments = np.repeat(mean_moments(self.spaces, self.data), self.spaces.dim + 1)
            self._cells.of(of_flux)[:] = self._cells.of(of_u) / moments
        return of_u, of_flux

    def places(self) -> Array:
        """See `TraceBackend.places`; of cells the vertex, the sum of those of the cell, and 1."""
        places, vertices = super().places(), self.spaces.vertices
        if self.by_traces:
            return places
        sums = np.broadcast_to(np.sort(vertices, axis=1).sum(axis=1, keepdims=True), vertices.shape)
        of_cells = np.concatenate([vertices, sums, np.ones((*vertices.shape[:2], 1))], axis=2)
        return np.vstack([places, of_cells.reshape(-1, of_cells.shape[2])])
