"""A discrete solution: its fields, sets and residuals, and numbers that summarise them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import basix
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import cell_dofs, owned_values, sums_at
from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.contact.chains import Chains, Condition, SiteConditions
from signorini_fenicsx.discrete.contact_sets import FacetSet, Segments, by_part, by_state
from signorini_fenicsx.discrete.linear_traces import squares_of
from signorini_fenicsx.discrete.part_laws import PartLaw
from signorini_fenicsx.discrete.points import FacetPoints, Points
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux, in_points, means_in_cells
from signorini_fenicsx.physics.diffusion.discrete.cell_laws import corners_passed
from signorini_fenicsx.physics.diffusion.discrete.data import Data, project_data
from signorini_fenicsx.physics.diffusion.discrete.potential import Potential
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.discrete.through import flux_through
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.show import heads, phreatic, shown
from signorini_fenicsx.physics.diffusion.show.differences import differences
from signorini_fenicsx.physics.diffusion.show.errors import exact_errors, missed_contact
from signorini_fenicsx.physics.diffusion.show.notes import notes_of
from signorini_fenicsx.physics.diffusion.show.seepage import DamSeepage, seepage
from signorini_fenicsx.physics.diffusion.show.states import sizes
from signorini_fenicsx.physics.diffusion.show.water import balance, discharges, in_words, of_step
from signorini_fenicsx.solution import Solution as AnySolution
from signorini_fenicsx.solving.solved import Columns


@dataclass(frozen=True, repr=False, kw_only=True)
class Solution(AnySolution):
    """A discrete solution and how it was found. Functions hold owned and up-to-date ghost values.

    A notebook shows it as a table and a picture. Some examples:

    >>> solution
    <Solution of problem: alg1, 128 cells, converged after 4 iterations>
    >>> u, sigma = solution.at([[0.5, 0.5], [2.0, 2.0]])
    >>> bool(u[0] < 0), sigma.shape, bool(np.isnan(u[1]))
    (True, (2, 2), True)
    >>> abs(solution.flux_through() + 40 * (0.5 - 0.6)) < 1e-12
    True

    The mesh of p is that of the facets of Γ_S. In UFL p is an ordinary coefficient on the measure `spaces.ds`.
    `spaces.form` compiles forms with p, and `spaces.integrate` gives their integrals over all ranks:

    >>> p, v, ds = solution.p, ufl.TestFunction(fem.functionspace(solution.spaces.mesh, ("P", 1))), solution.spaces.ds
    >>> load = fem.assemble_vector(solution.spaces.form(p * v * ds))
    >>> mean = solution.spaces.integrate(p * ds)
    >>> bool(abs(mean - load.array.sum()) < 1e-12)
    True

    Attributes:
        name: Name of the results.
        title: A longer name in words.
        boundary: The parts that are Γ_S and Γ_N.
        problem: The data as given.
        options: Algorithm, backend and their parameters.
        spaces: The discrete spaces; `spaces.mesh` is the mesh.
        data: The data on the mesh, and their means.
        p: Trace p_h in P0(Γ_S), on the facet submesh.
        outcome: How the method ended, with σ_h and u_h; `converged` means here that the residuals are small as well.
        kkt: Residuals of the discrete Signorini problem.
        source: The `physics.diffusion.case.Case` from which the problem was read; None if it was given in Python.
        step: Number of the step of a problem in time, from 1; None for others.
        system: What has solved it, as long as that is alive; its factors serve derivatives. None if it is not known.
        timings: Seconds per phase, the longest over all ranks.
        peak_memory: Peak memory of the processes so far in bytes, summed over ranks.
    """

    problem: Problem
    spaces: Spaces
    data: Data
    p: fem.Function
    order = 1
    offers = (*AnySolution.offers, "cell_flux", "flux_through", "force", "free_boundary", "p")
    fields, lines = shown.fields, shown.lines
    table, columns, other_tables, traces = shown.table, shown.columns, shown.other_tables, shown.traces
    differences = differences

    def of_problem(self, problem: Problem) -> Self:
        """The solution as one of a problem whose data have the same values but are given otherwise (collective)."""
        return replace(self, problem=problem, data=project_data(self.spaces, problem).like(self.data, self.spaces))

    def linearised(self, tolerance: float) -> Any:
        """The problem linearised at this solution, see `linearised.Linearised` (collective).

        Raises:
            InputError: If the method solves another discrete problem.
        """
        from signorini_fenicsx.physics.diffusion.derivative.linearised import linearised  # which knows solutions

        return linearised(self, tolerance)

    @collector_off()
    def flux_through(self, parts: str | Sequence[str] | None = None) -> float:
        """∫ σ_h·n over parts of the boundary (collective).

        Over all of ∂Ω it is ∫cu − ∫f up to rounding, except for the stabilised method, where ∇·σ_h has εu_h as well.

        Args:
            parts: Name of a part, or of several, whose facets count once where they overlap; None for all of ∂Ω.

        Raises:
            InputError: If there is no such part, or it has facets inside the domain.
        """
        return flux_through(self.spaces, self.sigma, parts)

    @cached_property
    def cell_flux(self) -> CellFlux:
        """σ_h on each cell of this rank."""
        return CellFlux.of(self.spaces, self.sigma)

    @cached_property
    def cell_potential(self) -> Potential:
        """The potential of second order on each cell of this rank."""
        return Potential.of(self.data, self.cell_flux, self.u)

    @cached_property
    def potential(self) -> fem.Function:
        """U of second order, quadratic on each cell: its mean is u_h and its gradient κ_h⁻¹σ_h (collective)."""
        return self.cell_potential.function()

    def potential_at(self, points: Points) -> Array:
        """`potential` in points, shape (n, points)."""
        return self.cell_potential.at(points)

    def u_at(self, points: Points) -> Array:
        """u_h in points, shape (n, points or 1)."""
        return in_points(self.u, points)

    def trace_at(self, points: FacetPoints, rows: Indices | slice = slice(None)) -> Array:
        """p_h in points of facets of Γ_S, by default of all, shape (facets, points or 1)."""
        return self.p_means[rows, None]

    @property
    def p_at(self) -> Array:
        """p_h on the facets of Γ_S of this rank, shape (facets,); of RT1 at their vertices, shape (facets, d)."""
        return self.p.x.array[: len(self.spaces.facets)]

    @property
    def flux_at(self) -> Array:
        """σ_h·n there."""
        return self.spaces.normal_flux(self.sigma)

    @property
    def p_means(self) -> Array:
        """The means of p_h on these facets."""
        return self.p_at

    @property
    def divergences(self) -> Array:
        """The mean of ∇·σ_h on each owned cell."""
        return self.cell_flux.divergence

    @property
    def u_means(self) -> Array:
        """u_h on the owned cells, or its means."""
        return means_in_cells(self.u)

    @property
    def u_values(self) -> Array:
        """u_h on the owned cells; of RT1 at their vertices, shape (cells, d + 1)."""
        return owned_values(self.u)

    def flux_on_signorini(self) -> fem.Function:
        """σ_h·n on the mesh of Γ_S (collective)."""
        return self.spaces.multiplier(self.flux_at)

    @collector_off()
    def norms(self) -> dict[str, float]:
        """L² norms of σ, ∇·σ, u over Ω and of p, σ·n over Γ_S (collective)."""
        return self._norms.copy()

    @cached_property
    def _norms(self) -> dict[str, float]:
        """The norms that `norms` copies (collective when first used)."""
        spaces, flux = self.spaces, self.cell_flux
        squares = [
            flux.squares(1.0).sum(),
            *(squares_of(spaces.cell_measures, values) for values in (flux.divergence, self.u_values)),
            *(squares_of(spaces.facet_measure, values) for values in (self.p_at, self.flux_at)),
        ]
        norms = np.sqrt(spaces.mesh.comm.allreduce(np.array(squares))).tolist()
        return dict(zip(("sigma_L2", "div_sigma_L2", "u_L2", "p_L2", "flux_L2"), norms, strict=True))

    @collector_off()
    def errors(self) -> dict[str, float] | None:
        """Errors if the exact solution is known, otherwise None (collective).

        They are the error of σ in the energy norm, which a certificate bounds, the L² norms of the errors of σ, ∇·σ,
        u_h and `potential` over Ω and of p over Γ_S, and the Hausdorff distance between the contact set and the facets
        at whose midpoints the exact u is ψ. With obstacles in Ω the measure of the cells where one of u and u_h only is
        on one takes the place of the error of ∇·σ.
        """
        exact, laws = self.data.exact, self.data.inside
        if exact is None:
            return None
        norms = exact_errors(self, exact)
        if laws.bounds_alone:
            norms["missed_contact"] = missed_contact(self.spaces, laws, exact, self.held_cells)
        return norms

    def contact_set(self) -> FacetSet:
        """The Γ_S facets in contact, by their final condition: where a law holds u that leaves it open."""
        holds = self.spaces.site_kinds["facet"].of(self.outcome.conditions.kind) == self.method.contact
        return FacetSet(self.spaces, holds & self.data.laws.leave_open)

    @property
    def cell_conditions(self) -> SiteConditions:
        """Conditions of the owned cells; of none without laws in Ω."""
        conditions: SiteConditions = self.spaces.site_kinds["cell"].of(self.outcome.conditions)
        return conditions

    @property
    def held_cells(self) -> Mask:
        """Mask of the owned cells where a law holds u, as an obstacle in contact does; empty without laws in Ω."""
        return self.cell_conditions.kind == Condition.ZERO_TRACE

    @property
    def blurred_cells(self) -> Mask:
        """Mask of the owned cells with RT1 that are on a slope, or in vertices on several segments; none with RT0."""
        return np.zeros(len(self.held_cells), dtype=bool)

    @property
    def cell_segments(self) -> Indices:
        """The segment of each owned cell; empty without laws in Ω."""
        return self.segments().of("cell")

    @collector_off()
    def free_boundary(self) -> npt.NDArray[np.int32]:
        """The owned facets between cells on different segments of their laws in Ω (collective)."""
        if not self.data.inside:
            return np.empty(0, dtype=np.int32)
        space, segment = self.spaces.crouzeix_raviart, self.cell_segments
        of_cells, index_map = np.column_stack([np.ones(len(segment)), segment, segment**2]), space.dofmap.index_map
        sums = sums_at(index_map, cell_dofs(space), of_cells[:, None])
        number, total, squares = sums[: index_map.size_local].T
        return np.flatnonzero((number == 2) & (2 * squares != total**2)).astype(np.int32)

    @property
    def force_at(self) -> Array:
        """λ_h on the owned cells, see `force`; of RT1 at their vertices, shape (cells, d + 1)."""
        if not self.data.inside:
            return np.zeros_like(self.u_values)
        beta, load = self.data.inside.as_linear(self.cell_conditions)
        held = np.isinf(beta)
        by_law = load - np.where(held, 0.0, beta) * owned_values(self.u)
        return np.where(held, -self.divergences - owned_values(self.data.source(self.u)), by_law)

    @collector_off()
    def force(self) -> fem.Function:
        """λ_h = −s of the laws in Ω, of an obstacle its force, with the moments of −∇·σ_h − f + cu_h (collective).

        It is exactly what the law says in cells on flat and sloped segments, such as 0 off an obstacle; with RT1, where
        it is linear on each cell, at vertices on flat segments.
        """
        force = self.spaces.scalar(self.force_at)
        force.name = "force"
        return force

    @collector_off()
    def in_regions(self) -> dict[str, dict[str, Any]]:
        """Number and measure of the cells on each segment of each law in Ω, by "law.0" and so on (collective).

        The laws are listed as in the problem; an obstacle by its key is "obstacle". With RT1 the vertices are counted.
        """
        states, kind = {}, self.spaces.site_kinds["cell"]
        for part in self.data.inside.of_regions:
            segment, measure = part.law.named(self.segments_of_law(part)), kind.measure[kind.numbers(part.rows)]
            states[part.name] = by_state(self.spaces.mesh.comm, part.law.segments, segment, measure, kind.called)
        return states

    def segments_of_law(self, part: PartLaw) -> Indices:
        """The segment of one law in Ω that each of its cells is on, or with RT1 each of their vertices (collective)."""
        if len(self.data.inside.of_regions) == 1:
            return self.segments().of("cell")[self.spaces.site_kinds["cell"].numbers(part.rows)]
        return corners_passed(*self._beside_corners(part))

    def _beside_corners(self, part: PartLaw) -> tuple[Array, Array]:
        """The u of the corners of a law in Ω at its sites, and the u there (collective)."""
        chains = np.concatenate([part.chains(points).p for points in part.quadrature(self.spaces, 1)])
        return chains, owned_values(self.u)[part.rows]

    @collector_off()
    def on_obstacle(self) -> dict[str, float]:
        """Number of the cells in contact with the obstacle, the measure of their sites, and ∫λ_h (collective)."""
        kind = self.spaces.site_kinds["cell"]
        held = kind.of(self.outcome.conditions.kind == Condition.ZERO_TRACE)
        local = np.array([self.held_cells.sum(), kind.measure @ held, kind.measure @ self.force_at.ravel()])
        cells, measure, force = self.spaces.mesh.comm.allreduce(local).tolist()
        return {"contact_cells": int(cells), "contact_measure": measure, "force": force}

    @property
    def law(self) -> Chains:
        """The law that each site has in the end: with a penalty, that of the penalty."""
        return self.data.chains.with_penalty(self.method.penalty, self.options.eps)

    def segments(self) -> Segments:
        """The segment of its law that each Γ_S facet is on, and each cell if there are laws in Ω."""
        iterate, u = self.outcome.iterate, self.u_vertices if self.data.quasilinear else None
        return Segments(self.spaces, self.law.segments(self.outcome.conditions, (iterate.p, iterate.flux)), u=u)

    @collector_off()
    def sites_in_contact(self) -> tuple[int, float]:
        """Number of facets in contact, with laws in Ω of cells that they hold, and their measure (collective)."""
        if not self.data.inside:
            return super().sites_in_contact()
        cells = self.on_obstacle()
        return int(cells["contact_cells"]), cells["contact_measure"]

    @collector_off()
    def segments_of_parts(self) -> dict[str, dict[str, dict[str, float]]]:
        """Number and measure of the Γ_S facets, or vertices, on each segment, by part and its name (collective)."""
        return by_part(self.spaces, self.data.laws.of_parts, self.segments().of("facet"))

    @property
    def _above(self) -> tuple[Array, Array]:
        """How far p is above ψ, and σ·n above q_S, at the facets, or at their vertices as sites."""
        return self.p_at - self.data.psi_h, self.flux_at - self.data.q_Sh

    @collector_off()
    def violation(self) -> dict[str, float]:
        """The error by ε in the Signorini condition, ‖[p − ψ]_-‖_Λ and ‖[σ·n − q_S]_-‖_Λ, or in (9b) (collective)."""
        spaces, kind = self.spaces, self.spaces.site_kinds["facet"]
        negative = [kind.measure @ np.minimum(values, 0) ** 2 for values in self._above]
        trace, flux = np.sqrt(spaces.mesh.comm.allreduce(np.array(negative))).tolist()
        left = {"trace": trace, "flux": flux}
        if self.method.stabilised:
            imbalance = ufl.div(self.sigma) + self.data.source(self.u)
            left["mass_balance"] = float(np.sqrt(spaces.integrate(l2(imbalance, ufl.dx))))
        return left

    def sizes(self) -> dict[str, float]:
        """The norms of σ, u and p in the spaces of the slides (collective)."""
        norms = self.norms()
        sigma = math.hypot(norms["sigma_L2"], norms["div_sigma_L2"])
        return {"sigma_V": sigma, "u_Q": norms["u_L2"], "p_Lambda": norms["p_L2"]}

    def of_step(self) -> dict[str, float]:
        """The numbers that `steps.csv` has of laws in Ω (collective).

        Of an obstacle the cells in contact and its force, of other laws the measures of the cells on each segment, and
        of water what flows in.
        """
        if not self.data.inside.is_obstacle:
            of_laws = self.in_regions().items()
            sizes = {f"{law} {name}": on["measure"] for law, of in of_laws for name, on in of.items()}
            return sizes | of_step(self)
        numbers = self.on_obstacle()
        measure, force = numbers["contact_measure"], numbers["force"]
        return {"contact_cells": numbers["contact_cells"], "cells_measure": measure, "force": force} | of_step(self)

    def contradiction(self) -> str | None:
        """Whether σ·n and p do not have the values that the conditions prescribe, see `Solved.contradiction`."""
        spaces, facet, iterate = self.spaces, self.spaces.site_kinds["facet"], self.outcome.iterate
        conditions = facet.of(self.outcome.conditions)
        squares = [
            facet.measure @ np.where(conditions.kind == condition, facet.of(values) - conditions.value, 0.0) ** 2
            for values, condition in ((iterate.flux, Condition.NO_FLUX), (iterate.p, Condition.ZERO_TRACE))
        ]
        left = spaces.length * spaces.mesh.comm.allreduce(np.array(squares))
        sizes = [spaces.integrate(l2(field, ufl.dx)) for field in (self.sigma, self.u)]
        holds = np.all(np.sqrt(left) <= KKT * np.sqrt(sizes))
        return None if holds else "its facet conditions are not those of its values"

    def _sets(self) -> dict[str, Any]:
        facets, measure = self.contact
        return {
            "element": self.options.element or "RT0",
            "signorini_facets": self.spaces.Lambda.dofmap.index_map.size_global,
            "dofs": self.outcome.dofs,
            "contact_facets": facets,
            "contact_measure": measure,
            **({"segments": self.segments_of_parts()} if self.data.laws.listed else {}),
            **({"states": found} if (found := sizes(self)) else {}),
            **self._inside(),
        }

    def _inside(self) -> dict[str, Any]:
        """The contact with an obstacle, or the cells on the segments of other laws in Ω."""
        if self.data.inside.is_obstacle:
            return {"obstacle": self.on_obstacle()}
        return {"regions": self.in_regions()} if self.data.inside else {}

    def notes(self) -> list[str]:
        """See `Solved.notes`."""
        return [*notes_of(self.spaces, self.data), *super().notes(), *in_words(self.water)]

    @cached_property
    def water(self) -> dict[str, dict[str, float]]:
        """What flows in through parts with laws of groundwater, see `discharges` (collective when first used)."""
        return discharges(self)

    water_kind = cached_property(heads.water_of)

    @cached_property
    def phreatic(self) -> list[Array]:
        """The phreatic lines, in space triangles, on rank 0; none without water (collective when first used)."""
        return [] if self.water_kind is None else phreatic.phreatic(self)

    @property
    def u_vertices(self) -> Array:
        """The potential of second order in the vertices of the cells, shape (cells, dim + 1) (collective)."""
        return self.cell_potential.in_nodes(basix.geometry(self.spaces.mesh.basix_cell()))

    @collector_off()
    def probe(self, points: npt.ArrayLike) -> Columns:
        """See `Solved.probe`; of water also "pressure", the pressure head, and of soils "saturation" (collective)."""
        found, x = super().probe(points), np.asarray(points, dtype=np.float64)
        return {**found, **heads.at_points(self, x, found["u"], found["sigma"])}

    @cached_property
    def readings(self) -> dict[str, Columns]:
        """See `Solved.readings`; of water also the phreatic line (collective when first used)."""
        tables = super().readings
        return tables if self.water_kind is None else tables | {"phreatic": phreatic.table(self)}

    @cached_property
    def seepage(self) -> DamSeepage | None:
        """The seepage through a dam of a case with [dam]; None for others (collective when first used)."""
        return seepage(self)

    def read_off(self) -> dict[str, float]:
        """See `Solved.read_off`; of water also what flows in through each part (collective)."""
        return super().read_off() | {f"inflow {part}": about["inflow"] for part, about in self.water.items()}

    def _particular(self) -> dict[str, Any]:
        residual = self.outcome.own_residual
        return {
            **({} if residual is None else {"own_residual": residual}),
            **({"eps": self.options.eps, "violation": self.violation()} if self.method.has_eps else {}),
            **({"water": self.water, "water_balance": balance(self)} if self.water else {}),
            **({} if self.seepage is None else {"seepage": self.seepage.summary()}),
            "details": self.outcome.details,
        }
