"""Γ_S with the pieces of the laws near which the trace of a bound is to be, see `conforming`."""

import math
from dataclasses import dataclass

import basix
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.certificate.laws import LawPoints
from signorini_fenicsx.discrete.bernstein import basis
from signorini_fenicsx.discrete.bernstein import nodes as lattice
from signorini_fenicsx.discrete.points import FacetPoints, Points, facet_type, in_facets
from signorini_fenicsx.physics.diffusion.bound.laws import Goal, ends_beside, pieces_beside, trace_on
from signorini_fenicsx.physics.diffusion.bound.local_fields import CellMetric
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux, normal_flux
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solution import Solution

RIGID = 1e4
"""A sloped segment with βh/κ above this is rigid: what v = a costs there is far below the error."""
BEYOND = "what a law of a pair lets through varies within facets, so that fluxes that are linear there pass it"
ROUNDING = 1e-9
"""Share of the largest y·n that is rounding."""
STIFF = 1.0
"""A sloped segment with βh/κ above this is stiff: it holds v, as a vertical one does."""


@dataclass(frozen=True)
class OnGammaS:
    """Γ_S with the pieces of the laws near which v is to be.

    Attributes:
        goal: The problem.
        spaces: The discrete spaces.
        segment: The segment of each facet; for RT1 that of a vertex that a vertical one holds, if there is any.
        piece: The sloped or flat segment that v is near on each facet; rigid only if no other is beside.
        flux: Mean of y·n per facet.
        tilt: y·n less this in the vertices of each facet; 0 for RT0.
        level: σ·n + βp on the piece, per facet.
        steep: The segments of each facet that hold v: vertical ones, and stiff ones, shape (facets, segments).
        rigid: Those of them that hold v as vertical ones do.
        by_nodes: Whether a vertical segment holds only some nodes of a facet, which `relaxation` finds: for RT1.
    """

    goal: Goal
    spaces: Spaces
    segment: Indices
    piece: Indices
    flux: Array
    tilt: Array
    level: Array
    steep: Mask
    rigid: Mask
    by_nodes: bool

    @classmethod
    def of(cls, solution: Solution, goal: Goal, metric: CellMetric, y: fem.Function, of_cells: CellFlux) -> "OnGammaS":
        """The terms on Γ_S for a solution and a flux."""
        spaces, data, law = solution.spaces, solution.data, goal.chains
        kind, iterate, by_nodes = spaces.site_kinds["facet"], solution.outcome.iterate, spaces.degree > 0
        chains = kind.of(solution.law if goal.of_penalty else data.chains)
        of_sites = chains.segments(kind.of(solution.outcome.conditions), (kind.of(iterate.p), kind.of(iterate.flux)))
        number, rows = len(spaces.facets), np.arange(len(spaces.facets))
        vertical = np.isinf(chains.slope[np.arange(len(of_sites)), of_sites]).reshape(number, math.prod(kind.shape))
        segment = of_sites.reshape(vertical.shape)[rows, vertical.argmax(axis=1)]
        if by_nodes:
            ends = in_facets(spaces.mesh, spaces.facets, lattice(facet_type(spaces.mesh.topology.dim), 1))
            tilt = normal_flux(of_cells, ends)
            flux = tilt.mean(axis=1)
            tilt -= flux[:, None]
        else:
            flux, tilt = spaces.normal_flux(y), np.zeros((number, spaces.mesh.topology.dim))
        height = metric.volume[spaces.cells] / spaces.facet_measure
        resistance = np.trace(metric.inverse, axis1=1, axis2=2)[spaces.cells] / metric.inverse.shape[1]
        steepness = law.slope * (height * resistance)[:, None]
        piece = pieces_beside(law, segment, flux - data.q_Sh, steepness > RIGID)
        slope = np.where(np.isinf(law.slope[rows, piece]), 0.0, law.slope[rows, piece])
        level = law.value[rows, piece] + data.q_Sh + slope * data.psi_h
        steep, rigid = steepness > STIFF, steepness > RIGID
        return cls(goal, spaces, segment, piece, flux, tilt, level, steep, rigid, by_nodes)

    def flux_at(self, points: Points) -> Array:
        """y·n in points of the facets."""
        return self.flux[:, None] + self.tilts(points)

    def tilts(self, points: Points) -> Array:
        """y·n less its means, in points of the facets."""
        return self.tilt @ np.column_stack([1 - points.points.sum(axis=1), points.points]).T

    def slope(self, at: LawPoints[FacetPoints]) -> Array:
        """β of the piece in points; 0 on a vertical one."""
        slope, _ = at.on(self.piece)
        return np.where(np.isinf(slope), 0.0, slope)

    def flux_of_piece(self, at: LawPoints[FacetPoints], v: Array) -> tuple[Array, Array]:
        """β and σ·n on the piece at u = v, in points; 0 for both where the facet's own segment is rigid."""
        rigid = self.rigid[np.arange(len(self.segment)), self.segment][:, None]
        rigid[self.spaces.slave_rows] = True  # there y·n stays as it is, see `LawGap`
        slope = np.where(rigid, 0.0, self.slope(at))
        return slope, np.where(rigid, 0.0, at.on(self.piece)[1] - slope * v)

    def flux_ends(self, at: LawPoints[FacetPoints]) -> tuple[Array, Array]:
        """The least and the largest σ·n in points: those of the law, or of a rigid segment if y·n is between them."""
        low, high = at.extent()[2:]
        segment, last = self.segment, self.goal.chains.corners - 1
        first, beyond = (segment == 0)[:, None], (segment == self.goal.chains.count)[:, None]
        least = np.where(beyond, low, at.flux_at(np.minimum(segment, last)))
        largest = np.where(first, high, at.flux_at(np.maximum(segment - 1, 0)))
        weights = at.points.weights / at.points.weights.sum()
        between = (least @ weights <= self.flux) & (self.flux <= largest @ weights)
        stiff = (self.rigid[np.arange(len(segment)), segment] & between)[:, None]
        return np.where(stiff, least, low), np.where(stiff, largest, high)

    @property
    def holding(self) -> Indices:
        """The facets on the boundary of the domain whose law may hold u: it has vertical segments."""
        vertical = np.isinf(self.goal.chains.slope).any(axis=1)
        return np.intersect1d(np.flatnonzero(vertical), self.spaces.outer_rows)

    def beyond(self) -> str:
        """Why laws of pairs of surfaces do not allow y·n in all points; empty if they do (collective)."""
        facet, comm = facet_type(self.spaces.mesh.topology.dim), self.spaces.mesh.comm
        at = self.goal.at(self.spaces, *basix.make_quadrature(facet, self.goal.degree()))
        flux, (low, high) = self.flux_at(at.points), at.extent()[2:]
        past, size = np.maximum(low - flux, flux - high)[self.spaces.slave_rows], np.abs(flux)
        past, size = (comm.allreduce(float(each.max(initial=0.0)), MPI.MAX) for each in (past, size))
        return BEYOND if past > ROUNDING * size else ""

    def held(self, nodes: LawPoints[FacetPoints]) -> tuple[Array, Mask, Mask]:
        """The values at which v is held in the nodes of facets, and the facets that hold it: fully, and nearly."""
        rows = np.arange(len(self.segment))
        slope, value = nodes.on(self.segment)
        fully = self.rigid[rows, self.segment] & (not self.by_nodes or self.rigid[rows, self.piece])
        nearly = self.steep[rows, self.segment] & ~fully & (slope > 0).all(axis=1)
        return trace_on(slope, value, self.flux[:, None]), fully, nearly

    def ends(self, nodes: LawPoints[FacetPoints]) -> list[Array]:
        """Between which u v has to be, and should be for the sake of its piece, in the nodes of facets.

        Returns:
            The least and the largest u that the law allows, and those that also are as `ends_beside` says.
        """
        (low, high, *_), (value, held, _) = nodes.extent(), self.held(nodes)
        only = self.rigid[np.arange(len(self.piece)), self.piece]
        soft_low, soft_high = ends_beside(nodes, self.segment, self.piece, self.steep, held, only, value)
        return [low, high, np.maximum(low, soft_low), np.minimum(high, soft_high)]

    def loads(self, at: LawPoints[FacetPoints]) -> Array:
        """∫ (y·n − level)φ per facet and node φ of it, with the level in points on sloped pieces.

        The slope in it is the mean: where β varies the line is turned about its point with y·n, or that nearest to it.
        """
        points, slope = at.points, self.slope(at)
        value, sloped = at.on(self.piece)[1], slope > 0
        flux = self.flux_at(points)
        on_line = np.clip(trace_on(slope, value, flux), *at.traces(self.piece))
        turned = (slope - slope.mean(axis=1, keepdims=True)) * on_line
        level = np.where(sloped, value - turned, value if self.by_nodes else self.level[:, None])
        only = self.rigid[np.arange(len(self.piece)), self.piece]
        density = np.where(only[:, None], 0.0, flux - level)
        cell, degree = facet_type(points.mesh.topology.dim), self.spaces.degree + 2
        return points.scale[:, None] * ((density * points.weights) @ basis(cell, degree, points.points))
