"""Intervals for quantities of diffusion problems, see `bracket` for the theorem.

Beside them stand the quantities of the discrete solution itself, of u_h, p_h and σ_h. Where a part has no p_h its
facets have the mean of u there: that of the function on the cell behind with the gradient κ_h⁻¹σ_h and the mean u_h. By
the first equation of the mixed method it is the multiplier of the facet, as p_h is.
"""

import math
from dataclasses import replace
from typing import Any

import basix
import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import AnyIndices, Array, positions
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.base.reference_cells import positive_quadrature
from signorini_fenicsx.certificate.certificate import reservation
from signorini_fenicsx.certificate.laws import half_gap
from signorini_fenicsx.contact.laws import Signorini
from signorini_fenicsx.discrete.bernstein import jet, nodes
from signorini_fenicsx.discrete.datum import DEGREES, datum_of, quadrature_degree
from signorini_fenicsx.discrete.part_laws import PartLaw
from signorini_fenicsx.discrete.points import CellPoints, FacetPoints, facet_quadrature, facet_type, in_cells, in_facets
from signorini_fenicsx.expressions import TREES
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.expressions.products import products
from signorini_fenicsx.expressions.simplices import barycentric
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.diffusion.bound.certify import (
    LAST_KAPPA,
    Admissible,
    gap_on_gamma_s,
    gap_parts,
)
from signorini_fenicsx.physics.diffusion.bound.equilibrated import ROUNDING, distance
from signorini_fenicsx.physics.diffusion.bound.hidden import degree_near
from signorini_fenicsx.physics.diffusion.bound.kirchhoff import NAMED, linear_solution
from signorini_fenicsx.physics.diffusion.bound.laws import Goal, energies
from signorini_fenicsx.physics.diffusion.bound.local_fields import cell_metric
from signorini_fenicsx.physics.diffusion.bound.near_polynomial import NearPolynomial
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import cell_values, in_points, normal_flux
from signorini_fenicsx.physics.diffusion.discrete.through import flux_through
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.quantities.shifts import check_paired, with_flux, with_trace
from signorini_fenicsx.physics.diffusion.show.water import share_above_table
from signorini_fenicsx.physics.diffusion.soils import FORMS
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.quantities import beside
from signorini_fenicsx.quantities.beside import SHARE, Beside, in_regions
from signorini_fenicsx.quantities.bracket import Half, Quantity
from signorini_fenicsx.quantities.kinds import Energy, Flux, Integral, Kind
from signorini_fenicsx.quantities.of_solution import Quantities

WEIGHT = "weight by quadrature"
"""Why the flux with a weight that is no polynomial is not guaranteed."""
STEP = "the exact solution of the step with the computed u of those before"
"""Of what the quantities of a step in time are."""


def named_for(solution: Solution) -> str:
    """Of which solution the quantities are, in words; empty if it is that of the problem itself."""
    of = [STEP] * (solution.step is not None) + [LAST_KAPPA] * (solution.data.quasilinear is not None)
    return ", ".join(of)


def check(domain: Domain, problem: Problem, kind: Kind) -> None:
    """Refuse what is no quantity of a problem (collective).

    Raises:
        InputError: If a name is unknown, or the quantity is given by the data.
    """
    if isinstance(kind, Energy):
        if problem.boundary.pairs:
            raise InputError("Energy: there is none where surfaces that share no nodes are paired")
        return
    if not isinstance(kind, Flux | Integral):
        raise InputError(f"{type(kind).__name__}: diffusion problems have Integral, Mean, Flux and Energy")
    if isinstance(kind, Integral) and kind.direction is not None:
        raise InputError("direction: is of displacements; u is a scalar here")
    for part in kind.parts:
        check_paired(problem, part, is_flux=isinstance(kind, Flux))
    _moved(domain, problem, kind, 0.0)


def _moved(domain: Domain, problem: Problem, kind: Flux | Integral, tau: float) -> Problem:
    """The problem with data that differ by τ (collective).

    Raises:
        InputError: As `check`.
    """
    problem = problem.parsed(domain.mesh.geometry.dim)
    if isinstance(kind, Flux):
        return with_trace(domain, problem, kind.parts, kind.weight, tau)
    if kind.parts:
        return with_flux(domain, problem, kind.weight, kind.parts, tau)
    return replace(problem, f=in_regions(domain, problem.f, kind.weight, kind.region, tau))


def _half(of_v: Admissible, of_y: Admissible, goal: Goal) -> Half:
    """The right side of the theorem (collective).

    Rounding that the solver leaves in the balance of y' counts like a load.
    """
    resolution, comm = of_y.resolution, of_y.solution.spaces.mesh.comm
    if of_v.trace.hindrance or not math.isfinite(of_y.remainder):
        return Half(math.inf, of_v.trace.hindrance or of_y.unbalanced, np.zeros_like(of_y.metric.volume))
    parts = gap_parts(of_v, of_y, goal, area=half_gap)
    squares = (np.sqrt(parts.mismatch + parts.reaction) + parts.oscillation) ** 2
    at_each = parts.contact - parts.reaction
    local = np.array([squares.sum(), at_each.sum(), resolution.missed.sum()])
    total, at_sites, missed = comm.allreduce(local).tolist()
    value = (math.sqrt(total) + parts.left + 2 * ROUNDING * of_y.size) ** 2 / 4 + max(at_sites, 0.0) / 2
    share = (math.sqrt(missed) + parts.left) / math.sqrt(value) if value > 0 else 0.0
    return Half(value, reason_of(of_y, share), squares / 4 + np.maximum(at_each, 0.0) / 2)


class _Beside(Beside[Admissible]):
    """Diffusion problems beside that of a solution."""

    def __init__(self, solution: Solution, kind: Flux | Integral):
        super().__init__(solution, kind)
        self._given: Problem = solution.problem.parsed(self.spaces.mesh.geometry.dim)
        if solution.data.quasilinear is not None:
            fixed: dict[str, Any] = {"kappa": solution.data.kappa, "b": solution.data.b, "form": FORMS[0]}
            fixed |= {} if solution.data.stored is None else {"c": solution.data.c}
            self._given = replace(self._given, **fixed)
        self.kappa: float = solution.data.conductance * self.spaces.length

    def posed(self, tau: float) -> Problem:
        """The problem with data that differ by τ (collective)."""
        return _moved(self.domain, self._given, self.kind, tau)

    def memory(self, tau: float) -> fem.Function | None:
        """The load that a step takes from those before, which is that of the solution."""
        return self.solution.data.memory

    def start(self, posed: Problem) -> Solution | None:
        """The solution, if its parts are those of the problem."""
        same = posed.boundary == self.solution.boundary and self.solution.method.starts_from_sets
        return self.solution if same else None

    def admissible(self, solution: Solution) -> Admissible:
        """The admissible fields of a solution (collective)."""
        in_steps = self.solution.step is not None
        return Admissible.of(solution, Goal.of(solution, for_signorini=True), returns=in_steps)

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
        names = "xyz"[: self.spaces.mesh.geometry.dim]
        self.weight = datum_of(self.spaces, "weight", parsed(kind.weight, names, "weight"))
        self.by_quadrature = "" if self.weight.polynomial is not None else WEIGHT
        given, problem = self._given, self.posed(0.0)
        self.moves_walls = problem.boundary == given.boundary and problem.u_D is not given.u_D
        facets = [self.domain.facets[part] for part in kind.parts]
        self._rows = np.flatnonzero(np.isin(self.spaces.facets, np.concatenate(facets)))

    def interval(self, near: Quantity | None = None) -> Quantity:
        """The interval (collective)."""
        quantity = replace(super().interval(near), above_table=share_above_table(self.solution, self.kind.parts))
        if math.isfinite(quantity.width) and self.by_quadrature:
            return replace(quantity, proved=False, reason=quantity.reason or self.by_quadrature)
        return quantity

    def half(self, of_v: Admissible, of_y: Admissible) -> Half:
        """The right side with the work on τ of means that quadrature may miss of loads (collective).

        That is where u_D moves as a whole the work of all loads, as v − u + τ is 0 on Γ_D, and otherwise that of the
        means of q_S where it moves, which belong to v − u + τ while v − u is 0 on Γ_D.
        """
        right_side, resolution = super().half(of_v, of_y), of_y.resolution
        unseen, part = resolution.size * of_y.metric.volume, of_v.goal.enclosed(self.spaces)
        if not self.moves_walls:
            rows = self._rows[:0] if part is None else np.intersect1d(part.rows, self._rows)
            unseen = unseen[np.unique(self.spaces.cells[rows])]
        return replace(right_side, unseen=float(self.comm.allreduce(unseen.sum())))

    def value(self, of_v: Admissible, of_y: Admissible, enough: float) -> Array:
        """The flux of y', and under laws with a weight that of η', which has the same means (collective)."""
        if self.weight.number is not None or self.weight.pieces is None:
            total = np.array([flux_through(self.spaces, of_y.y, self.kind.parts, self.weight.ufl), 0.0])
        else:
            total = self.comm.allreduce(self._weighted(of_y, enough))
        if self.weight.number is not None:
            return total
        added = 0.0
        for load in gap_on_gamma_s(of_v, of_y, of_v.goal, half_gap)[1][:1]:
            added = load.points.integrals(load.values * self.weight.values(load.points))[self._rows].sum()
        total[0] += float(self.comm.allreduce(added))
        return np.asarray(total)

    def _weighted(self, of_y: Admissible, enough: float) -> Array:
        """The flux of y' with a weight by text, and by how much it may be wrong, on this rank (collective)."""
        facets = np.unique(np.concatenate([self.domain.facets[part] for part in self.kind.parts]))
        mesh, total = self.spaces.mesh, np.zeros(2)
        on = in_facets(mesh, facets, nodes(facet_type(mesh.topology.dim), 1))
        flux, measures = normal_flux(of_y.flux, on), on.scale / math.factorial(mesh.topology.dim - 1)

        def w(rows: AnyIndices, x: Array) -> Array:
            return jet(flux[rows], barycentric(on.vertices[rows], x))[:, :, 0]

        frame, degree = self.spaces.frame, self.spaces.degree
        for tree, _ in self.weight.pieces or ():
            assert isinstance(tree, TREES)
            total += products(tree, on.vertices, measures, w, degree, frame, enough).total
        return total

    def discrete(self) -> float:
        """The flux of σ_h (collective)."""
        return flux_through(self.spaces, self.solution.sigma, self.kind.parts, self.weight.ufl)

    def response(self) -> float:
        """The size of the flux for a u that is larger by 1 on one side (collective)."""
        return math.sqrt(self.kappa * self.comm.allreduce(self.spaces.cell_measures.sum())) / self.spaces.length


class Integrals(beside.IntegralsBeside[Admissible], _Beside):
    """The integral of u with a weight, or its mean."""

    def __init__(self, solution: Solution, kind: Integral):
        super().__init__(solution, kind)
        if self.spaces.pairs and self.weight.polynomial is None:
            raise InputError("weight: where surfaces are paired it has to be a polynomial")

    def discrete(self) -> float:
        """The integral, or the mean, with u_h in cells and p_h, or the mean of u, on facets (collective)."""
        solution, sums = self.solution, np.zeros(2)
        for points in self.over.points():
            weight = self.weight.values(points)
            u = _on_facets(solution, points) if isinstance(points, FacetPoints) else solution.u_at(points)
            sums += points.integrals(weight * u).sum(), points.integrals(weight).sum()
        return self.of_sums(sums)

    def integral(self, of: Admissible, enough: float) -> Array:
        """The integral of v with the weight, and by how much it may be wrong, on this rank (collective)."""
        near, lacked = NearPolynomial.of(of), self._lacked(of)
        if not self.kind.parts:
            return near.integral(self.weight, self.over.cells, enough) + lacked
        inner, total = self.solution.boundary.inner, np.zeros(2)
        for part in self.kind.parts:
            total += near.on_facets(self.weight, self.domain.facets[part], enough, jump=part in inner)
        return total + lacked

    def _lacked(self, of: Admissible) -> Array:
        """What the d of `certificate.opposite`, which v lacks at pairs, may add, on this rank (collective).

        In cells that is ∫|wd| ≤ ‖w‖ ‖d‖; on a facet e of T it is dim ‖d‖²_e |T|/|e| ≤ dim ‖d‖² + 2 diam(T) ‖d‖ ‖∇d‖.
        """
        missed, dim = 0.0, self.spaces.mesh.topology.dim
        for points in self.over.points(power=2) if self.spaces.pairs else ():
            cells, size = points.cells, np.sqrt(points.integrals(self.weight.values(points) ** 2))
            d, slope = (each[cells] for each in (of.trace.lacked, of.trace.lacking))
            if self.kind.parts:
                far = self.spaces.cell_diameters[cells] / np.sqrt(of.metric.kappa_min[cells])
                share = points.scale / math.factorial(dim - 1) / of.metric.volume[cells] / dim
                d = np.sqrt(share * (dim * d**2 + 2 * far * d * slope))
            missed += float((size * d).sum())
        return np.array([0.0, missed])


SQUARE = 8
"""Degree of a quadrature for the energies of laws in Ω, as for their gap."""


def energy(solution: Solution) -> Quantity:
    """The interval for the energy: J(v) − gap − Σ osc_T‖κ∇v − y‖_T − ½osc² ≤ J(u) ≤ J(v) (collective)."""
    goal = Goal.of(solution, for_signorini=True)
    with np.errstate(all="ignore"):
        admissible = Admissible.of(solution, goal)
        parts = gap_parts(admissible, admissible, goal)
    comm, osc, missing = solution.spaces.mesh.comm, parts.oscillation, parts.left + ROUNDING * admissible.size
    mismatch = np.sqrt(parts.mismatch + parts.reaction)
    local = (parts.mismatch + parts.contact).sum() / 2 + (osc * (mismatch + osc / 2)).sum()
    sums = np.array([local, ((mismatch + osc) ** 2).sum(), admissible.resolution.missed.sum()])
    below, squares, missed = comm.allreduce(sums).tolist()
    below = max(below, 0.0) + missing * (math.sqrt(squares) + missing / 2)
    upper, wrong = _of_v(admissible, parts.hidden, SHARE * below)
    value = _of_energy(solution, goal)
    if admissible.trace.hindrance or not math.isfinite(admissible.remainder):
        return Quantity(value, -math.inf, math.inf, False, admissible.trace.hindrance or admissible.unbalanced)
    lower, upper = upper - below - wrong, upper + wrong
    reason = reason_of(admissible, (math.sqrt(missed) + parts.left) / math.sqrt(below) if below > 0 else 0.0)
    return Quantity(value, lower, upper, not reason, reason)


def reason_of(of_y: Admissible, share: float) -> str:
    """Why what a bound says is not guaranteed, empty if it is; `share` of it comes from enclosures (collective)."""
    unresolved = of_y.resolution.account(share)
    return reservation(unresolved, sorted(of_y.resolution.by_quadrature))


def _of_v(admissible: Admissible, hidden: Array, enough: float) -> list[float]:
    """J(v), and by how much it may be wrong (collective).

    Args:
        admissible: Has v.
        hidden: What quadrature may miss of ‖κ^½∇v‖ on cells.
        enough: As in `products`.
    """
    spaces, data, near = admissible.solution.spaces, admissible.solution.data, NearPolynomial.of(admissible)
    cells, half, minus = owned_cells(spaces.mesh).astype(np.int64), np.array([0.5, 0.5]), np.array([-1.0, 1.0])
    total = half * near.of_gradient(hidden) + minus * near.integral(data.f, cells, enough)
    total += minus * near.on_facets(data.g_N, spaces.neumann_facets, enough)
    if data.c.number != 0:
        total += half * near.integral(data.c, cells, enough, power=2)
    if data.memory is not None:
        load = data.memory
        product = near.seen(lambda at, jet: in_points(load, at) * jet[:, :, 0], cells, near.order + spaces.degree)
        total[0] -= product.sum()
        largest = np.abs(cell_values(load)).reshape(len(cells), -1).max(axis=1)
        total[1] += largest * spaces.cell_measures @ near.off
    for part in data.inside.of_regions:

        def energy_of(at: CellPoints, jet: Array, part: PartLaw = part) -> Array:
            return energies(part, at, jet[:, :, 0])

        degree = max(SQUARE, quadrature_degree(*part.data.values()))
        total[0] += near.seen(energy_of, part.rows, degree).sum()
    return [float(each) for each in spaces.mesh.comm.allreduce(total + _of_laws(admissible, near, enough))]


def _of_laws(admissible: Admissible, near: NearPolynomial, enough: float) -> Array:
    """The energies of the laws on Γ_S, and by how much they may be wrong, of this rank (collective)."""
    spaces, goal, total = admissible.solution.spaces, admissible.goal, np.zeros(2)
    degree = min(max(goal.degree(), degree_near(admissible.trace)), DEGREES[1])
    rule = basix.make_quadrature(facet_type(spaces.mesh.topology.dim), degree)
    v = admissible.trace.on_gamma_s(in_facets(spaces.mesh, spaces.facets, *rule))
    for part in goal.parts:
        if type(part.law) is Signorini:
            for jump in (False, True):
                rows = part.rows[np.isin(part.rows, spaces.inner.rows) == jump]
                total += [-1.0, 1.0] * near.on_facets(part.data["q_S"], spaces.facets[rows], enough, jump=jump)
            continue
        some = in_facets(spaces.mesh, spaces.facets[part.rows], *rule)
        flux_h = None if goal.plain else goal.flux_h[part.rows]
        total[0] += some.integrals(energies(part, some, v[part.rows], flux_h)).sum()
    return total


def _of_energy(solution: Solution, goal: Goal) -> float:
    """½(κ⁻¹σ_h, σ_h) + ½(cu, u) − (f, u) − ⟨g_N, u⟩ on Γ_N, and φ of the laws at p_h and u_h (collective).

    Here u is the function with the gradient κ_h⁻¹(σ_h − b) and the mean u_h on each cell. With b it is less ½(κ⁻¹b, b).
    """
    spaces, data, mesh = solution.spaces, solution.data, solution.spaces.mesh
    laws = (*data.inside.of_regions, *goal.parts)
    given = (data.f, data.c, data.g_N, *(datum for part in laws for datum in part.data.values()))
    degree = quadrature_degree(*given)
    rule = positive_quadrature(mesh.basix_cell(), degree)
    metric = cell_metric(spaces, data)
    total = float(metric.squares(solution.cell_flux).sum()) / 2
    if (less_b := data.less_b(spaces)) is not None:
        total -= float(metric.squares(less_b).sum()) / 2
    for points in in_cells(mesh, owned_cells(mesh), *rule):
        v = solution.cell_potential.at(points)
        load = data.f.values(points) + (0.0 if data.memory is None else in_points(data.memory, points))
        total += points.integrals(data.c.values(points) * v**2 / 2 - load * v).sum()
    for part in data.inside.of_regions:
        for points in in_cells(mesh, part.rows.astype(np.int32), *rule):
            values = np.broadcast_to(solution.u_at(points), points.shape)
            total += points.integrals(energies(part, points, values)).sum()
    loaded = facet_quadrature(mesh, spaces.neumann_facets, degree)
    total -= float(loaded.integrals(data.g_N.values(loaded)) @ _means(solution, loaded))
    for part in goal.parts:
        facets, flux_h = spaces.facets[part.rows], None if goal.plain else goal.flux_h[part.rows]
        on = facet_quadrature(mesh, facets, degree)
        p = np.broadcast_to(solution.trace_at(on, part.rows), on.shape)
        total += on.integrals(energies(part, on, p, flux_h)).sum()
    return float(mesh.comm.allreduce(total))


def _on_facets(solution: Solution, points: FacetPoints) -> Array:
    """The values p_h on the facets of Γ_S, inside the domain the jump, and the mean of u on others (collective)."""
    u = np.repeat(_means(solution, points)[:, None], points.shape[1], axis=1)
    on_gamma_s = np.isin(points.facets, solution.spaces.facets)
    u[on_gamma_s] = solution.trace_at(points, positions(solution.spaces.facets, points.facets[on_gamma_s]))
    return u


def _means(solution: Solution, points: FacetPoints) -> Array:
    """The mean of u on each of some facets (collective)."""
    return points.means(solution.cell_potential.at(points))


class _OfKirchhoff(Fluxes):
    """The flux through some parts by the solution for w, see `kirchhoff`; its value is that of the solution for u."""

    def __init__(self, solution: Solution, of_w: Solution, kind: Flux):
        super().__init__(of_w, kind)
        self._value = flux_through(solution.spaces, solution.sigma, kind.parts, self.weight.ufl)

    def interval(self, near: Quantity | None = None) -> Quantity:
        """The interval (collective)."""
        return replace(super().interval(near), value=self._value, of=NAMED)


def _fluxes(solution: Solution, kind: Flux) -> Fluxes:
    """See `Quantities.fluxes` (collective)."""
    of_w = linear_solution(solution)
    return Fluxes(solution, kind) if of_w is None else _OfKirchhoff(solution, of_w, kind)


QUANTITIES = Quantities(check, energy, Integrals, _fluxes, named_for)
