"""A discrete solution with RT1: fluxes of order two, u in P1 on cells, p linear on the facets of Γ_S."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.discrete.contact_sets import FacetSet
from signorini_fenicsx.discrete.linear_traces import linear_from_means, means_of_linear
from signorini_fenicsx.discrete.part_laws import PartLaw
from signorini_fenicsx.discrete.points import FacetPoints
from signorini_fenicsx.physics.diffusion.discrete.cell_laws import at_vertices
from signorini_fenicsx.physics.diffusion.discrete.data import project_data
from signorini_fenicsx.physics.diffusion.discrete.rt1_data import RT1Data, rt1_data
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.show import rt1_shown
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.solve.rt1_residuals import RT1Iterate


@dataclass(frozen=True, repr=False, kw_only=True)
class RT1Solution(Solution):
    """A discrete solution with RT1, see `Solution`; p is linear on each facet."""

    spaces: RT1Spaces
    data: RT1Data
    order = 2
    table, other_tables, traces = rt1_shown.table, rt1_shown.other_tables, rt1_shown.traces

    @property
    def iterate(self) -> RT1Iterate:
        """The last iterate."""
        assert isinstance(self.outcome.iterate, RT1Iterate)
        return self.outcome.iterate

    def of_problem(self, problem: Problem) -> Self:
        """The solution as one of a problem whose data have the same values but are given otherwise (collective)."""
        data = rt1_data(self.spaces, project_data(self.spaces, problem)).after(self.data.memory)
        return replace(self, problem=problem, data=data)

    def linearised(self, tolerance: float) -> Any:
        """The problem linearised at this solution, see `linearised.Linearised` (collective).

        Raises:
            InputError: If it is a step in time, or there are laws in Ω.
        """
        from signorini_fenicsx.physics.diffusion.derivative.rt1_linearised import linearised  # which knows solutions

        if self.step is not None or self.data.inside:
            raise InputError("element: with RT1 there are no derivatives in time, nor with laws in Ω; take RT0")
        return linearised(self, tolerance)

    @property
    def p_at(self) -> Array:
        """p_h at the vertices of the facets of Γ_S, as in `LinearTraces.contact`, shape (facets, d)."""
        return linear_from_means(self.spaces.site_kinds["facet"].rows_of(self.iterate.means))

    @property
    def flux_at(self) -> Array:
        """σ_h·n at these vertices."""
        return self.spaces.through(self.spaces.contact, self.sigma_values)

    @cached_property
    def sigma_values(self) -> Array:
        """σ_h at the nodes of the owned cells, see `RT1Spaces.flux_values` (collective when first used)."""
        return self.spaces.flux_values(self.sigma)

    def trace_at(self, points: FacetPoints, rows: Indices | slice = slice(None)) -> Array:
        """p_h in points of facets of Γ_S, by default of all, shape (facets, points)."""
        hats = np.column_stack([1 - points.points.sum(axis=1), points.points])[:, self.spaces.contact.ranking[rows]]
        return np.asarray(np.einsum("qfa,fa->fq", hats, self.p_at[rows]))

    @property
    def p_means(self) -> Array:
        """The means of p_h on the facets of Γ_S of this rank."""
        return np.asarray(self.p_at.mean(axis=1))

    @property
    def divergences(self) -> Array:
        """The mean of ∇·σ_h on each owned cell."""
        return np.asarray(self.cell_flux.divergence.mean(axis=1))

    @property
    def u_values(self) -> Array:
        """u_h at the vertices of the owned cells, see `RT1Spaces.scalar_values`."""
        return self.spaces.scalar_values(self.u)

    def flux_on_signorini(self) -> fem.Function:
        """σ_h·n on the mesh of Γ_S, linear on each facet (collective)."""
        return self.spaces.linear_multiplier(self.flux_at)

    @property
    def touching(self) -> Mask:
        """Mask of the facet vertices in contact, shape (facets, d)."""
        holds: Mask = self.outcome.conditions.kind == self.method.contact
        return self.spaces.site_kinds["facet"].rows_of(holds) & self.data.laws.leave_open[:, None]

    def contact_set(self) -> FacetSet:
        """The Γ_S facets with a vertex in contact."""
        return FacetSet(self.spaces, self.touching.any(axis=1))

    @property
    def cell_segments(self) -> Indices:
        """The segment of each owned cell: the median of those of its vertices; empty without laws in Ω."""
        rows = self.spaces.site_kinds["cell"].rows_of(self.segments().segment)
        return np.asarray(np.sort(rows, axis=1)[:, rows.shape[1] // 2])

    @property
    def cell_conditions(self) -> SiteConditions:
        """The conditions of the owned cells, by their segments."""
        return self.data.inside.chains.conditions(self.cell_segments)

    @property
    def blurred_cells(self) -> Mask:
        """See `Solution.blurred_cells`."""
        rows = self.spaces.site_kinds["cell"].rows_of(self.segments().segment)
        return np.asarray((rows != rows[:, :1]).any(axis=1) | (self.cell_conditions.kind == Condition.ROBIN))

    @property
    def held_cells(self) -> Mask:
        """Mask of the owned cells on a segment where a law holds u, see `Solution.held_cells`."""
        kinds = self.data.cells_at.chains.kinds[:: self.spaces.dim + 1]
        return np.asarray(kinds[np.arange(len(kinds)), self.cell_segments] == Condition.ZERO_TRACE)

    @property
    def force_at(self) -> Array:
        """See `Solution.force_at`."""
        if not self.data.inside:
            return np.zeros_like(self.u_values)
        return np.asarray(self.spaces.site_kinds["cell"].rows_of(self.iterate.flux))

    def _beside_corners(self, part: PartLaw) -> tuple[Array, Array]:
        laws = at_vertices(self.spaces, replace(self.data.inside, of_regions=(part,)))
        sites = self.spaces.site_kinds["cell"].numbers(part.rows)
        return (laws.chains.p + laws.p_h[:, None])[sites], means_of_linear(self.u_values).ravel()[sites]

    @property
    def _above(self) -> tuple[Array, Array]:
        laws = self.data.laws_at
        return self.iterate.means - laws.p_h, self.flux_at.ravel() - laws.flux_h
