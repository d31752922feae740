"""Intervals for quantities of diffusion problems, see `bracket` for the theorem."""

from __future__ import annotations

import math
from dataclasses import replace

import basix
import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.base.reference_cells import positive_quadrature
from signorini_fenicsx.certificate.certificate import reservation
from signorini_fenicsx.certificate.laws import half_gap
from signorini_fenicsx.discrete.datum import DEGREES, datum_of, quadrature_degree
from signorini_fenicsx.discrete.points import CellPoints, facet_quadrature, facet_type, in_cells, in_facets
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.diffusion.bound.admissible_trace import Trace
from signorini_fenicsx.physics.diffusion.bound.certify import UNBALANCED, Admissible, gap_on_gamma_s, gap_parts
from signorini_fenicsx.physics.diffusion.bound.equilibrated import ROUNDING, distance
from signorini_fenicsx.physics.diffusion.bound.hidden import degree_near
from signorini_fenicsx.physics.diffusion.bound.laws import Goal, energies
from signorini_fenicsx.physics.diffusion.bound.mismatch import QUADRATIC, scaled
from signorini_fenicsx.physics.diffusion.solution import Solution, flux_through
from signorini_fenicsx.quantities import beside
from signorini_fenicsx.quantities.beside import Beside
from signorini_fenicsx.quantities.bracket import Half, Quantity
from signorini_fenicsx.quantities.kinds import Energy, Flux, Integral, Kind
from signorini_fenicsx.quantities.shifts import Posed, in_regions, with_flux, with_trace

WEIGHT = "weight by quadrature"
"""Why the flux with a weight that is no polynomial is not guaranteed."""
STEP = "the exact solution of the step with the computed u of those before"
"""Of what the quantities of a step in time are."""


def named_for(solution: Solution) -> str:
    """Of which solution the quantities are, in words; empty if it is that of the problem itself."""
    return "" if solution.step is None else STEP


def check(domain: Domain, posed: Posed, kind: Kind) -> None:
    """Refuse what is no quantity of a problem (collective).

    Raises:
        InputError: If a name is unknown, or the quantity is given by the data.
    """
    if isinstance(kind, Energy):
        return
    if not isinstance(kind, Flux | Integral):
        raise InputError(f"{type(kind).__name__}: diffusion problems have Integral, Mean, Flux and Energy")
    if isinstance(kind, Integral) and kind.direction is not None:
        raise InputError("direction: is of displacements; u is a scalar here")
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
    boundary, problem = posed
    return boundary, replace(problem, f=in_regions(domain, problem.f, kind.weight, kind.region, tau))


def _half(of_v: Admissible, of_y: Admissible, goal: Goal) -> Half:
    """The right side of the theorem (collective).

    Rounding that the solver leaves in the balance of y' counts like a load.
    """
    resolution, comm = of_y.resolution, of_y.solution.spaces.mesh.comm
    if of_v.trace.hindrance or not math.isfinite(of_y.remainder):
        return Half(math.inf, of_v.trace.hindrance or UNBALANCED, np.zeros_like(of_y.metric.volume))
    parts = gap_parts(of_v, of_y, goal, area=half_gap)
    squares = (np.sqrt(parts.mismatch + parts.reaction) + parts.oscillation) ** 2
    at_each = parts.contact - parts.reaction
    local = np.array([squares.sum(), at_each.sum(), resolution.missed.sum()])
    total, at_sites, missed = comm.allreduce(local).tolist()
    value = (math.sqrt(total) + 2 * ROUNDING * of_y.size) ** 2 / 4 + max(at_sites, 0.0) / 2
    share = (math.sqrt(missed) + parts.left) / math.sqrt(value) if value > 0 else 0.0
    return Half(value, reason_of(of_y, share), squares / 4 + np.maximum(at_each, 0.0) / 2)


class _Beside(Beside[Admissible]):
    """Diffusion problems beside that of a solution."""

    def __init__(self, solution: Solution, kind: Flux | Integral):
        super().__init__(solution, kind)
        self._posed: Posed = (solution.boundary, solution.problem.parsed(self.spaces.mesh.geometry.dim))
        names = "xyz"[: self.spaces.mesh.geometry.dim]
        self.weight = datum_of(self.spaces, "weight", parsed(kind.weight, names, "weight"))
        self.kappa: float = solution.data.conductance * self.spaces.length

    def posed(self, tau: float) -> Posed:
        """The problem with data that differ by τ (collective)."""
        return _moved(self.domain, self._posed, self.kind, tau)

    def memory(self, tau: float) -> fem.Function | None:
        """The load that a step takes from those before, which is that of the solution."""
        earlier: fem.Function | None = self.solution.data.memory
        return earlier

    def start(self, posed: Posed) -> Solution | None:
        """The solution, if its parts are those of the problem."""
        same = posed[0] == self.solution.boundary and self.solution.method.starts_from_sets
        return self.solution if same else None

    def admissible(self, solution: Solution) -> Admissible:
        """The admissible fields of a solution (collective)."""
        return Admissible.of(solution, Goal.of(solution, for_signorini=True))

    def half(self, of_v: Admissible, of_y: Admissible) -> Half:
        """The right side of the theorem, with the laws that have moved (collective)."""
        return _half(of_v, of_y, of_v.goal if self.of_flux else of_y.goal)

    def apart(self, one: Admissible, other: Admissible) -> float:
        """The energy norm of the difference of both fluxes (collective)."""
        return distance(self.spaces, one.metric, one.solution.sigma, other.solution.sigma)

    def size(self) -> float:
        """‖σ_h‖, about (collective)."""
        norms: dict[str, float] = self.solution.norms()
        return norms["sigma_L2"] * self.softness()

    def distance(self) -> float:
        """The largest |u_D| and |ψ| (collective)."""
        return max(map(abs, self.solution.data.extent(self.spaces)))

    def softness(self) -> float:
        """The root of κ⁻¹, about."""
        return 1 / math.sqrt(self.kappa)


class Fluxes(_Beside):
    """The flux through some parts."""

    of_flux = True

    def __init__(self, solution: Solution, kind: Flux):
        super().__init__(solution, kind)
        self.by_quadrature = "" if self.weight.polynomial is not None else WEIGHT
        boundary, problem = self.posed(0.0)
        self.moves_walls = boundary == self._posed[0] and problem.u_D is not self._posed[1].u_D
        facets = [self.domain.facets[part] for part in kind.parts]
        self._rows = np.flatnonzero(np.isin(self.spaces.facets, np.concatenate(facets)))

    def interval(self) -> Quantity:
        """The interval (collective)."""
        quantity = super().interval()
        if math.isfinite(quantity.width) and self.by_quadrature:
            return replace(quantity, guaranteed=False, reason=quantity.reason or self.by_quadrature)
        return quantity

    def half(self, of_v: Admissible, of_y: Admissible) -> Half:
        """The right side; where all of u_D moves with what means may hide of loads on that constant (collective)."""
        right_side = super().half(of_v, of_y)
        if not self.moves_walls:
            return right_side
        unseen = float(self.comm.allreduce(of_y.resolution.load.largest @ of_y.metric.volume))
        return replace(right_side, unseen=unseen)

    def value(self, of_v: Admissible, of_y: Admissible) -> float:
        """The flux of y', and under laws with a weight that of η', which has the same means (collective)."""
        flux = flux_through(self.spaces, of_y.y, self.kind.parts, self.weight.ufl)
        if self.weight.number is not None:
            return flux
        more = 0.0
        for load in gap_on_gamma_s(of_v, of_y, of_v.goal, half_gap)[1][:1]:
            more = load.points.integrals(load.values * self.weight.values(load.points))[self._rows].sum()
        return flux + float(self.comm.allreduce(more))

    def discrete(self) -> float:
        """The flux of σ_h (collective)."""
        return flux_through(self.spaces, self.solution.sigma, self.kind.parts, self.weight.ufl)

    def response(self) -> float:
        """The size of the flux for a u that is larger by 1 on one side (collective)."""
        return math.sqrt(self.kappa * self.comm.allreduce(self.spaces.cell_measures.sum())) / self.spaces.length


class Integrals(_Beside, beside.Integrals[Admissible]):
    """The integral of u with a weight, or its mean."""

    def integral(self, of: Admissible | None = None, power: int = 1) -> float:
        """The integral of v, or for None of 1, times a power of the weight (collective)."""
        mesh, total, trace = self.spaces.mesh, 0.0, None if of is None else of.trace
        degree = min(QUADRATIC + power * quadrature_degree(self.weight), DEGREES[1])
        fine = degree if trace is None else max(degree, degree_near(trace))
        for part in self.kind.parts:
            total += self._on_part(part, fine, trace, power)
        if not self.kind.parts:
            cells = owned_cells(mesh)
            if self.kind.region:
                cells = np.unique(np.concatenate([self.domain.regions[name] for name in self.kind.region]))
            near = np.isin(cells, [] if trace is None else trace.cells)
            for close, some, of_degree in ((False, cells[~near], degree), (True, cells[near], fine)):
                for points in in_cells(mesh, some.astype(np.int32), *positive_quadrature(mesh.basix_cell(), of_degree)):
                    v = 1.0 if trace is None else trace.jet(points, near=close)[:, :, 0]
                    total += points.integrals(self.weight.values(points) ** power * v).sum()
        return float(self.comm.allreduce(total))

    def _on_part(self, part: str, degree: int, trace: Trace | None, power: int) -> float:
        """The share of this rank in the integral over a part; inside the domain of the jump of v (collective)."""
        mesh, facets = self.spaces.mesh, self.domain.facets[part]
        if trace is not None and part in self.solution.boundary.inner:
            on = facet_quadrature(mesh, self.spaces.facets, degree)
            everywhere, v = np.isin(self.spaces.facets, facets), trace.on_gamma_s(on)
        else:
            on = facet_quadrature(mesh, facets, degree)
            everywhere = np.ones(len(facets), dtype=bool)
            v = np.ones(on.shape) if trace is None else trace.jet(on, near=True)[:, :, 0]
        return float(on.integrals(self.weight.values(on) ** power * v)[everywhere].sum())


SQUARE = 8
"""Degree of a quadrature for the energies of laws in Ω, as for their gap."""


def energy(solution: Solution) -> Quantity:
    """The interval for the energy: J(v) − gap − Σ osc_T‖κ∇v − y‖_T − ½osc² ≤ J(u) ≤ J(v) (collective)."""
    goal = Goal.of(solution, for_signorini=True)
    with np.errstate(all="ignore"):
        own = Admissible.of(solution, goal)
        parts = gap_parts(own, own, goal)
    comm, resolution = solution.spaces.mesh.comm, own.resolution
    mismatch = np.sqrt(parts.mismatch + parts.reaction)
    local = (parts.mismatch + parts.contact).sum() / 2 + (parts.oscillation * (mismatch + parts.oscillation / 2)).sum()
    below, missed = comm.allreduce(np.array([local, resolution.missed.sum()])).tolist()
    upper = _of_v(solution, goal, own.trace)
    if own.trace.hindrance or not math.isfinite(own.remainder):
        return Quantity(upper, -math.inf, math.inf, False, own.trace.hindrance or UNBALANCED)
    rounding = ROUNDING * own.size * (math.sqrt(2 * max(below, 0.0)) + own.size * ROUNDING)
    lower = upper - max(below, 0.0) - rounding
    reason = reason_of(own, (math.sqrt(missed) + parts.left) / math.sqrt(below) if below > 0 else 0.0)
    return Quantity((lower + upper) / 2, lower, upper, not reason, reason)


def reason_of(of_y: Admissible, share: float) -> str:
    """Why what a bound says is not guaranteed, empty if it is; `share` of it comes from enclosures (collective)."""
    unresolved = of_y.resolution.account(share)
    return reservation(unresolved, sorted(of_y.resolution.by_quadrature))


def _of_v(solution: Solution, goal: Goal, trace: Trace) -> float:
    """J(v) (collective)."""
    spaces, data, mesh = solution.spaces, solution.data, solution.spaces.mesh
    near = np.isin(owned_cells(mesh), trace.cells)
    laws = () if data.inside is None else data.inside.of_regions
    of_data = quadrature_degree(data.f, data.kappa, data.c) + 2 * QUADRATIC
    if laws:
        of_data = max(of_data, SQUARE, quadrature_degree(*(datum for part in laws for datum in part.data.values())))
    total = 0.0
    for close, cells, degree in ((False, ~near, of_data), (True, near, max(of_data, degree_near(trace)))):
        rule = positive_quadrature(mesh.basix_cell(), min(degree, DEGREES[1]))
        for points in in_cells(mesh, owned_cells(mesh)[cells], *rule):
            total += points.integrals(_density(solution, trace, points, close=close)).sum()
        for part in laws:
            for points in in_cells(mesh, part.rows[cells[part.rows]].astype(np.int32), *rule):
                v = trace.jet(points, near=close)[:, :, 0]
                total += points.integrals(energies(part, points, v)).sum()
    degree = min(max(quadrature_degree(data.g_N), degree_near(trace)), DEGREES[1])
    on = facet_quadrature(mesh, spaces.neumann_facets, degree)
    total -= on.integrals(data.g_N.values(on) * trace.jet(on, near=True)[:, :, 0]).sum()
    degree = min(max(goal.degree(), degree_near(trace)), DEGREES[1])
    rule = basix.make_quadrature(facet_type(mesh.topology.dim), degree)
    on = in_facets(mesh, spaces.facets, *rule)
    v = trace.on_gamma_s(on)
    for part in goal.parts:
        some = in_facets(mesh, spaces.facets[part.rows], *rule)
        flux_h = None if goal.plain else goal.flux_h[part.rows]
        total += some.integrals(energies(part, some, v[part.rows], flux_h)).sum()
    return float(mesh.comm.allreduce(total))


def _density(solution: Solution, trace: Trace, points: CellPoints, *, close: bool) -> np.ndarray:
    """½κ|∇v|² + ½cv² − fv in points, with the load that a step in time takes from those before (collective)."""
    data = solution.data
    jet, kappa = trace.jet(points, near=close, gradient=True), data.kappa.values(points)
    v, slope = jet[:, :, 0], jet[:, :, 1:]
    load = data.f.values(points)
    if data.memory is not None:
        load = load + data.memory.x.array[points.cells, None]
    density: np.ndarray = (scaled(kappa, slope) * slope).sum(axis=2) / 2 + data.c.values(points) * v**2 / 2 - load * v
    return density
