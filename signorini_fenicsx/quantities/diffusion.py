"""Intervals for quantities of diffusion problems, see `bracket` for the theorem."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import ufl
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.certificate.laws import half_gap
from signorini_fenicsx.discrete.datum import DEGREES, datum_of, quadrature_degree
from signorini_fenicsx.discrete.points import Points, facet_quadrature, in_cells, owned_cells
from signorini_fenicsx.expressions import TREES, to_ufl
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.diffusion.bound.admissible_trace import Trace
from signorini_fenicsx.physics.diffusion.bound.certify import QUADRATIC, Admissible, gap_parts, scaled
from signorini_fenicsx.physics.diffusion.bound.equilibrated import ROUNDING, distance
from signorini_fenicsx.physics.diffusion.bound.hidden import degree_near
from signorini_fenicsx.physics.diffusion.bound.laws import Goal
from signorini_fenicsx.physics.diffusion.bound.local_fields import positive_quadrature
from signorini_fenicsx.physics.diffusion.solution import Solution, flux_through
from signorini_fenicsx.quantities.bracket import UNBOUNDED, Ends, Half, Quantity, bracket
from signorini_fenicsx.quantities.kinds import Energy, Flux, Integral, Kind, Mean
from signorini_fenicsx.quantities.shifts import Posed, with_flux, with_load, with_trace
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import Solver

WEIGHT = "weight by quadrature"
"""Why the flux with a weight that is no polynomial is not guaranteed."""
type Values = Callable[[Points, bool], Array]
"""Values in points of cells, or of facets, and whether these may be near data of v."""


def quantity(solution: Solution, kind: Kind) -> Quantity:
    """The interval for a quantity of a problem that a solution approximates (collective).

    Of a solution by a penalty method it is that of the problem without the penalty.

    Raises:
        InputError: If it is a step of a problem in time.
    """
    if solution.step is not None:
        raise InputError("quantities of a step of a problem in time have no bounds")
    if isinstance(kind, Energy):
        return _energy(solution)
    if isinstance(kind, Flux):
        return _Fluxes(solution, kind).interval()
    assert isinstance(kind, Integral)
    return _Integrals(solution, kind).interval()


def check(domain: Domain, posed: Posed, kind: Kind) -> None:
    """Refuse what is no quantity of a problem (collective).

    Raises:
        InputError: If a name is unknown, or the quantity is given by the data.
    """
    if isinstance(kind, Energy):
        if posed[1].laws or posed[1].obstacle is not None:
            raise InputError("the energy has bounds under the law of Signorini alone")
    elif not isinstance(kind, Flux | Integral):
        raise InputError(f"{type(kind).__name__}: diffusion problems have Integral, Mean, Flux and Energy")
    elif isinstance(kind, Integral) and kind.direction is not None:
        raise InputError("direction: is of displacements; u is a scalar here")
    else:
        _moved(domain, posed, kind, 0.0)


def _moved(domain: Domain, posed: Posed, kind: Flux | Integral, tau: float) -> Posed:
    """The problem with data that differ by τ (collective).

    Raises:
        InputError: As `check`.
    """
    posed = posed[0], posed[1].parsed(domain.mesh.geometry.dim)
    if isinstance(kind, Flux):
        return with_trace(domain, posed, kind.parts, kind.weight, tau)
    if kind.parts:
        return with_flux(domain, posed, kind.weight, kind.parts, tau)
    return with_load(domain, posed, kind.weight, kind.region, tau)


def _half(of_v: Admissible, of_y: Admissible, goal: Goal) -> Half:
    """The right side of the theorem (collective).

    Rounding that the solver leaves in the balance of y' counts like a load.
    """
    resolution, comm = of_y.resolution, of_y.solution.spaces.mesh.comm
    if of_v.trace.hindrance or not math.isfinite(of_y.remainder):
        why = of_v.trace.hindrance or "a linear solve failed, by which the flux would be balanced"
        return Half(math.inf, why, np.zeros_like(of_y.metric.volume))
    parts = gap_parts(of_v, of_y, goal, area=half_gap)
    squares = (np.sqrt(parts.mismatch + parts.reaction) + parts.oscillation) ** 2
    at_each = parts.contact - parts.reaction
    local = np.array([squares.sum(), at_each.sum(), resolution.missed.sum()])
    total, at_sites, missed = comm.allreduce(local).tolist()
    value = (math.sqrt(total) + 2 * ROUNDING * of_y.size) ** 2 / 4 + max(at_sites, 0.0) / 2
    share = (math.sqrt(missed) + parts.left) / math.sqrt(value) if value > 0 else 0.0
    return Half(value, _reason(of_y, share), squares / 4 + np.maximum(at_each, 0.0) / 2)


def _reason(of_y: Admissible, share: float) -> str:
    """Why what a bound says is not guaranteed, empty if it is; `share` of it comes from enclosures (collective)."""
    for name, place in of_y.resolution.account(share)[:1]:
        return f"{name} is not resolved near ({', '.join(f'{x:.4g}' for x in place)})"
    by = sorted(of_y.resolution.by_quadrature)
    return f"{', '.join(by)} by quadrature" if by else ""


class _Shifted:
    """Problems on either side of that of a solution, with data that differ by ±τ, and what they say."""

    def __init__(self, solution: Solution, kind: Flux | Integral):
        self.solution, self.spaces, self._kind = solution, solution.spaces, kind
        self.domain: Domain = solution.spaces.domain
        self.posed: Posed = (solution.boundary, solution.problem.parsed(self.spaces.mesh.geometry.dim))
        self.comm = self.spaces.mesh.comm
        self._solver: Solver | None = None
        self._options = Options(tuning=solution.options.tuning)

    def shifted(self, tau: float) -> Posed:
        """The problem with data that differ by τ (collective)."""
        return _moved(self.domain, self.posed, self._kind, tau)

    def ends(self, tau: float) -> Ends:
        """The bounds from one τ (collective)."""
        try:
            with np.errstate(all="ignore"):  # of data that are unbounded the bounds tell
                below, above = self._admissible(-tau), self._admissible(tau)
                (lower, one), (upper, other) = self.sides(below, above, tau)
                shares = (_half(below, below, below.goal).of_cells + _half(above, above, above.goal).of_cells) / tau
        except (NumericalFailure, InputError) as failure:
            return Ends(-math.inf, math.inf, 0.0, f"a problem beside it: {failure}")
        size, metric = above.size, above.metric
        moved = distance(above.solution.spaces, metric, above.solution.sigma, below.solution.sigma) / (2 * tau)
        PETSc.garbage_cleanup(self.comm)
        return Ends(lower, upper, size / moved if moved > 0 else 0.0, one.reason or other.reason, shares)

    def sides(self, below: Admissible, above: Admissible, tau: float) -> list[tuple[float, Half]]:
        """The bounds, each with the right side of the theorem (collective)."""
        raise NotImplementedError

    def _admissible(self, tau: float) -> Admissible:
        posed = self.shifted(tau)
        if self._solver is None:
            self._solver = Solver(self.domain, posed)
        same = posed[0] == self.solution.boundary and self.solution.method.starts_from_sets
        found = self._solver.solve(posed, self._options, start=self.solution if same else None)
        return Admissible.of(found, Goal.of(found, for_signorini=True))

    def size(self) -> float:
        """‖σ_h‖, about (collective)."""
        kappa = self.solution.data.conductance * self.spaces.length
        return self.solution.norms()["sigma_L2"] / math.sqrt(kappa)

    def first(self, response: float) -> float:
        """A τ of the right size, from the size of the flux that belongs to τ = 1 (collective)."""
        size = self.size()
        found = size / response if response > 0 else 0.0
        return 2.0 ** round(math.log2(found)) if 0 < found < math.inf else 1.0


class _Fluxes(_Shifted):
    """The flux through some parts."""

    def __init__(self, solution: Solution, kind: Flux):
        super().__init__(solution, kind)
        self.parts, names = kind.parts, "xyz"[: self.spaces.mesh.geometry.dim]
        weight = parsed(kind.weight, names, "weight")
        self.weight = to_ufl(weight, ufl.SpatialCoordinate(self.spaces.mesh)) if isinstance(weight, TREES) else weight
        self.by_quadrature = "" if datum_of(self.spaces, "weight", weight).polynomial is not None else WEIGHT
        boundary, problem = self.shifted(0.0)
        self.moves_walls = boundary == self.posed[0] and problem.u_D is not self.posed[1].u_D

    def interval(self) -> Quantity:
        """The interval (collective)."""
        kappa, measures = self.solution.data.conductance * self.spaces.length, self.spaces.cell_measures
        response = math.sqrt(kappa * self.comm.allreduce(measures.sum())) / self.spaces.length
        discrete = flux_through(self.spaces, self.solution.sigma, self.parts, self.weight)
        found = bracket(self.ends, self.first(response), discrete)
        if math.isfinite(found.width) and self.by_quadrature:
            return replace(found, guaranteed=False, reason=found.reason or self.by_quadrature)
        return found if math.isfinite(found.width) else replace(found, reason=f"{UNBOUNDED}: {found.reason}")

    def sides(self, below: Admissible, above: Admissible, tau: float) -> list[tuple[float, Half]]:
        """The bounds; F(y') is the flux of y', as η' has the same means."""
        found = []
        for of_v, of_y, sign in ((below, above, -1.0), (above, below, 1.0)):
            half = _half(of_v, of_y, of_v.goal)
            flux = flux_through(of_y.solution.spaces, of_y.y, self.parts, self.weight)
            found.append((flux + sign * (half.value / tau + self._unseen(of_y)), half))
        return found

    def _unseen(self, of_y: Admissible) -> float:
        """What means of loads may hide where all of u_D moves: a load on the constant by which it does (collective)."""
        if not self.moves_walls:
            return 0.0
        return float(self.comm.allreduce(of_y.resolution.load.largest @ of_y.metric.volume))


class _Integrals(_Shifted):
    """The integral of u with a weight, or its mean."""

    def __init__(self, solution: Solution, kind: Integral):
        super().__init__(solution, kind)
        names = "xyz"[: self.spaces.mesh.geometry.dim]
        self.kind, self.weight = kind, datum_of(self.spaces, "weight", parsed(kind.weight, names, "weight"))

    def interval(self) -> Quantity:
        """The interval (collective)."""
        square = self._integral(lambda points, near: np.ones(points.shape), power=2)
        kappa, length = self.solution.data.conductance * self.spaces.length, self.spaces.length
        if self.kind.parts:
            square *= length
        own = Admissible.of(self.solution, Goal.of(self.solution, for_signorini=True))
        found = bracket(self.ends, self.first(math.sqrt(square / kappa) * length / 4), self._of(own.trace))
        if isinstance(self.kind, Mean):
            return found.divided(self._integral(lambda points, near: np.ones(points.shape)))
        return found

    def sides(self, below: Admissible, above: Admissible, tau: float) -> list[tuple[float, Half]]:
        """The bounds."""
        found = []
        for of_v, of_y, sign in ((above, below, -1.0), (below, above, 1.0)):
            half = _half(of_v, of_y, of_y.goal)
            found.append((self._of(of_v.trace) + sign * half.value / tau, half))
        return found

    def _of(self, trace: Trace) -> float:
        """The integral of v (collective)."""
        return self._integral(lambda points, near: trace.jet(points, near=near)[:, :, 0], trace)

    def _integral(self, values: Values, trace: Trace | None = None, power: int = 1) -> float:
        """The integral of values times a power of the weight, with v near and far from its data (collective)."""
        mesh, total = self.spaces.mesh, 0.0
        degree = min(QUADRATIC + power * quadrature_degree(self.weight), DEGREES[1])
        fine = degree if trace is None else max(degree, degree_near(trace))
        for part in self.kind.parts:
            on = facet_quadrature(mesh, self.domain.facets[part], fine)
            total += on.integrals(self.weight.values(on) ** power * values(on, True)).sum()
        if not self.kind.parts:
            cells = owned_cells(mesh)
            if self.kind.region:
                cells = np.unique(np.concatenate([self.domain.regions[name] for name in self.kind.region]))
            near = np.isin(cells, [] if trace is None else trace.cells)
            for close, some, of_degree in ((False, cells[~near], degree), (True, cells[near], fine)):
                for points in in_cells(mesh, some.astype(np.int32), *positive_quadrature(mesh.basix_cell(), of_degree)):
                    total += points.integrals(self.weight.values(points) ** power * values(points, close)).sum()
        return float(self.comm.allreduce(total))


def _energy(solution: Solution) -> Quantity:
    """The interval for the energy J(u): J(v) − gap − Σ osc_T‖κ∇v − y‖_T − ½osc² ≤ J(u) ≤ J(v) (collective)."""
    goal = Goal.of(solution, for_signorini=True)
    with np.errstate(all="ignore"):
        own = Admissible.of(solution, goal)
        parts = gap_parts(own, own, goal)
    comm, resolution = solution.spaces.mesh.comm, own.resolution
    mismatch = np.sqrt(parts.mismatch + parts.reaction)
    local = (parts.mismatch + parts.contact).sum() / 2 + (parts.oscillation * (mismatch + parts.oscillation / 2)).sum()
    below, missed = comm.allreduce(np.array([local, resolution.missed.sum()])).tolist()
    upper = _energy_of(solution, own.trace)
    if own.trace.hindrance or not math.isfinite(own.remainder):
        return Quantity(upper, -math.inf, math.inf, False, own.trace.hindrance or "a linear solve failed")
    rounding = ROUNDING * own.size * (math.sqrt(2 * max(below, 0.0)) + own.size * ROUNDING)
    lower = upper - max(below, 0.0) - rounding
    reason = _reason(own, (math.sqrt(missed) + parts.left) / math.sqrt(below) if below > 0 else 0.0)
    return Quantity((lower + upper) / 2, lower, upper, not reason, reason)


def _energy_of(solution: Solution, trace: Trace) -> float:
    """J(v) (collective)."""
    spaces, data, mesh = solution.spaces, solution.data, solution.spaces.mesh
    near = np.isin(owned_cells(mesh), trace.cells)
    total, of_data = 0.0, quadrature_degree(data.f, data.kappa, data.c)
    for close, cells, degree in (
        (False, owned_cells(mesh)[~near], of_data + 2 * QUADRATIC),
        (True, owned_cells(mesh)[near], max(of_data + 2 * QUADRATIC, degree_near(trace))),
    ):
        rule = positive_quadrature(mesh.basix_cell(), min(degree, DEGREES[1]))
        for points in in_cells(mesh, cells, *rule):
            jet, kappa = trace.jet(points, near=close, gradient=True), data.kappa.values(points)
            v, slope = jet[:, :, 0], jet[:, :, 1:]
            density = (
                (scaled(kappa, slope) * slope).sum(axis=2) / 2
                + data.c.values(points) * v**2 / 2
                - data.f.values(points) * v
            )
            total += points.integrals(density).sum()
    for datum, facets in ((data.g_N, spaces.neumann_facets), (data.q_S, spaces.facets)):
        on = facet_quadrature(mesh, facets, min(max(quadrature_degree(datum), degree_near(trace)), DEGREES[1]))
        total -= on.integrals(datum.values(on) * trace.jet(on, near=True)[:, :, 0]).sum()
    return float(mesh.comm.allreduce(total))
