"""A guaranteed bound of the energy error of a solution, computed from that solution alone.

A flux y ∈ RT0, which is σ_h or near it, and a continuous v made of u_h and σ_h are admissible in the gap identity of
`forms/certificate.py`, except for the part of the load that RT0 does not balance. All norms are energy norms: ‖σ‖² =
(κ⁻¹σ, σ), |∇w|² = (κ∇w, ∇w).

1. `admissible_flux`: ∇·y = −f_h, y·n = g_h on Γ_N, y·n at least the mean of q_S on each facet of Γ_S; and remainder ≥
   ‖y − σ_h‖.
2. `oscillation`: r ≥ q_S − y·n on Γ_S, and osc with R(w) ≤ osc |∇w| for w = 0 on Γ_D, where R(w) = (f − f_h, w) +
   ⟨g_N − g_h, w⟩ on Γ_N + ⟨r, w⟩ on Γ_S.
3. `law_trace`: v = u_D on Γ_D, v ≥ ψ on Γ_S.

Let ũ be the solution for the loads −∇·y, y·n on Γ_N and q_S − r on Γ_S. For this problem v and y are admissible, with

    gap = ½‖κ∇v − y‖² + ⟨y·n − q_S + r, v − ψ⟩ on Γ_S,

so |∇(v − ũ)| and ‖y − κ∇ũ‖ are ≤ √(2 gap). The variational inequality is (κ∇u, ∇(w − u)) ≥ (f, w − u) + ⟨g_N, w − u⟩ on
Γ_N + ⟨q_S, w − u⟩ on Γ_S for all w ≥ ψ. Test the inequality of u with ũ and that of ũ with u; their sum gives
|∇(u − ũ)| ≤ sup R(w)/|∇w| ≤ osc. Hence

    |∇(v − u)| and ‖σ − σ_h‖ are both at most   √(2 gap) + osc + remainder = bound.

If the gap identity is written with the loads of u, its right side has the additional term R(u − v) ≤ osc |∇(v − u)|.
Then Young's inequality gives √(2 gap + osc²) + remainder as a bound of ‖σ − σ_h‖ alone.

Other laws than Signorini's take the place of ψ and q_S in steps 1 to 3, see `laws`; for laws in Ω see
`inside`. After a penalty method u is the exact solution of the penalty problem, or of the Signorini problem if
one asks for that. Its domain is the one that the mesh covers: a polygon or polyhedron if the boundary is curved.

With a term cu the balance is ∇·y = −f_h + c_h u* with u* near u_h, the gap and osc have the terms of `reaction`, and
|∇w|² + ‖c^½w‖² takes the place of |∇w|². The two errors are bounded as before, and with them ‖c^½(v − u)‖.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.parallel import Stopwatch, collector_off
from signorini_fenicsx.certificate.admissible_flux import admissible_flux
from signorini_fenicsx.certificate.admissible_trace import Trace
from signorini_fenicsx.certificate.hidden import Pressure, degree_near, hidden_parts
from signorini_fenicsx.certificate.inside import Inside
from signorini_fenicsx.certificate.law_trace import law_trace
from signorini_fenicsx.certificate.laws import Area, Goal, LawGap, gap, not_polynomial
from signorini_fenicsx.certificate.local_fluxes import FacetLoad, Projection, positive_quadrature
from signorini_fenicsx.certificate.mean_loads import load_left
from signorini_fenicsx.certificate.metric import CellMetric, cell_metric
from signorini_fenicsx.certificate.on_gamma_s import OnGammaS
from signorini_fenicsx.certificate.oscillation import Memory, contact_excess, load_oscillation
from signorini_fenicsx.certificate.reaction import reaction_terms
from signorini_fenicsx.certificate.resolution import Resolution
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.points import Points, facet_type, in_cells, owned_cells
from signorini_fenicsx.physics.diffusion.cell_flux import CellFlux
from signorini_fenicsx.physics.diffusion.solution import Solution

QUADRATIC = 2
"""Degree of |κ∇v − y|² where v is quadratic and κ a number."""
ENOUGH = 5e-3
"""A bound of missed loads below this share of the bound need not be sharp."""

API = (
    "bound",
    "gap",
    "guaranteed",
    "indicator",
    "numbers",
    "oscillation",
    "relative",
    "remainder",
    "sigma_bound",
    "summary",
)
"""What a notebook offers of a certificate."""


@dataclass(frozen=True)
class Certificate:
    """A bound for |∇(v − u)| and for ‖σ − σ_h‖, see the module; infinite if u_D < ψ where Γ_D meets Γ_S.

    Attributes:
        bound: √(2 gap) + oscillation + remainder, for either error.
        sigma_bound: √(2 gap + oscillation²) + remainder, for ‖σ − σ_h‖ alone.
        gap: ½‖κ∇v − y‖² + ⟨y·n − q_S + r, v − ψ⟩ on Γ_S.
        oscillation: osc: of f in cells, of g_N and q_S on facets, and of their means that quadrature may have missed.
        remainder: Bound of ‖y − σ_h‖, which comes from the linear solver or a penalty, including rounding.
        relative: bound/‖σ_h‖.
        guaranteed: Whether all data are enclosed and resolved.
        by_quadrature: The data that are not enclosed: those given in Python, and loads without Γ_D.
        unresolved: Data that are not resolved, each with a place; the same on all ranks.
        coarse: Mask of the owned cells where data are not resolved.
        indicator: η_T in P0 with Σ η_T² = 2 gap + oscillation².
        of_penalty: Whether u is the solution of a penalty's own problem.
        v: The continuous v in P2, with interpolated u_D and ψ.
        of_laws: The load s_T − η of laws in Ω; None without any.
        seconds: Wall time of the certificate, the longest over all ranks.
        if_none: Why the bound is infinite; empty if it is not.
    """

    bound: float
    sigma_bound: float
    gap: float
    oscillation: float
    remainder: float
    relative: float
    guaranteed: bool
    by_quadrature: tuple[str, ...]
    unresolved: tuple[tuple[str, tuple[float, ...]], ...]
    coarse: npt.NDArray[np.bool_]
    indicator: fem.Function
    v: fem.Function
    of_laws: Projection | None = None
    of_penalty: bool = False
    seconds: float = 0.0
    if_none: str = ""
    if_by_quadrature: ClassVar[str] = "by quadrature"
    """What is missing for the data in `by_quadrature`."""

    def __repr__(self) -> str:
        if not math.isfinite(self.bound):
            return f"<{type(self).__name__}: no bound, {self.if_none}>"
        trust = "guaranteed" if self.guaranteed else "not guaranteed"
        return (
            f"<{type(self).__name__}: energy error{self.of} ≤ {self.bound:.4g}, relative {self.relative:.3g}, {trust}>"
        )

    def __dir__(self) -> list[str]:
        return sorted(API)

    def summary(self) -> dict[str, Any]:
        """All but the fields, ready for JSON."""
        unresolved = [{"data": name, "x": list(place)} for name, place in self.unresolved]
        lists = {"by_quadrature": list(self.by_quadrature), "unresolved": unresolved}
        of = {"of_penalty": True} if self.of_penalty else {}
        return self.numbers() | {"guaranteed": self.guaranteed} | lists | of

    @property
    def of(self) -> str:
        """To which solution the error is, in words; empty if it is that of the problem."""
        return " to the exact solution of the penalty problem" if self.of_penalty else ""

    @property
    def reservation(self) -> str:
        """Why it is not guaranteed, in words; empty if nothing is to be said."""
        if self.unresolved:
            name, place = self.unresolved[0]
            return f"{name} is not resolved near ({', '.join(f'{x:.4g}' for x in place)})"
        return f"{', '.join(self.by_quadrature)} {self.if_by_quadrature}" if self.by_quadrature else ""

    @property
    def smaller_than_flux(self) -> bool:
        """Whether the bound is below ‖σ_h‖; otherwise its share of ‖σ_h‖ says nothing: σ may be 0."""
        return self.relative < 1

    def numbers(self) -> dict[str, float]:
        """The bounds and their parts."""
        names = ("bound", "sigma_bound", "gap", "oscillation", "remainder", "relative")
        return {name: getattr(self, name) for name in names}


@collector_off()
def certify(solution: Solution, *, for_signorini: bool = False, memory: Memory | None = None) -> Certificate:
    """Bound the energy error of a converged solution (collective).

    The cost is some assembly, and up to three linear solves if the linear solver, a penalty or quadrature leaves an
    error. u_D and ψ have to be continuous. Integrals of resolved data are by quadrature, see `resolution`.

    Args:
        solution: A solution by any algorithm.
        for_signorini: Whether u is the solution of the Signorini problem, not that of a penalty, also if a penalty
            method was used.
        memory: For a step in time, the load that it takes from those before; None for `Data.memory`, which is constant
            on each cell. On each cell both have the same mean.
    """
    check_kind("solution", solution, Solution)
    watch = Stopwatch()
    with watch.phase("certificate"), np.errstate(all="ignore"):  # of data that are unbounded the certificate tells
        own = Admissible.of(solution, Goal.of(solution, for_signorini=for_signorini))
        certificate = certificate_of(own, gap_parts(own, own, own.goal, memory))
    return replace(certificate, seconds=watch.longest(solution.spaces.mesh.comm)["certificate"])


def certificate_of(own: Admissible, parts: GapParts) -> Certificate:
    """The bound that admissible fields of one solution give (collective)."""
    spaces, resolution, trace, remainder = own.solution.spaces, own.resolution, own.trace, own.remainder
    comm, size = spaces.mesh.comm, own.size
    indicator = fem.Function(spaces.Q, name="indicator")
    squares = parts.mismatch + parts.contact + parts.oscillation**2
    indicator.x.array[:] = np.sqrt(np.maximum(squares, 0.0))  # no ghost cells; < 0: no bound
    gap = (parts.mismatch + parts.contact).sum() / 2
    sums = np.array([gap, (parts.oscillation**2).sum(), resolution.missed.sum()])
    total_gap, total_oscillation, missed = comm.allreduce(sums).tolist()
    bound = sigma_bound = np.inf
    if not trace.hindrance and np.isfinite(total_gap + total_oscillation):
        total_gap = max(total_gap, 0.0)  # < 0 by rounding
        bound = np.sqrt(2 * total_gap) + np.sqrt(total_oscillation) + remainder
        sigma_bound = np.sqrt(2 * total_gap + total_oscillation) + remainder
    enclosed = np.sqrt(missed) + parts.left
    unresolved = resolution.account(enclosed / bound if bound > 0 else 0.0)
    PETSc.garbage_cleanup(comm)
    return Certificate(
        bound=float(bound),
        sigma_bound=float(sigma_bound),
        gap=total_gap,
        oscillation=float(np.sqrt(total_oscillation)),
        remainder=remainder,
        relative=float(bound / size) if size > 0 else (0.0 if bound == 0 else np.inf),
        guaranteed=bool(np.isfinite(bound)) and not unresolved and not resolution.by_quadrature,
        by_quadrature=tuple(sorted(resolution.by_quadrature)),
        unresolved=unresolved,
        coarse=resolution.coarse,
        indicator=indicator,
        v=trace.v,
        of_laws=parts.of_laws,
        of_penalty=own.goal.of_penalty,
        if_none="" if np.isfinite(bound) else _why_none(trace, remainder),
    )


@dataclass(frozen=True)
class Admissible:
    """The admissible v and y of a solution.

    Attributes:
        solution: The solution.
        goal: The problem to which the distance is bounded.
        metric: Metric of the owned cells.
        size: ‖σ_h‖.
        resolution: Encloses the data, and records what quadrature may miss.
        deviation: S of κ, see `resolution`.
        y: y.
        flux: y cell by cell.
        level: u*.
        remainder: Bound of ‖y − σ_h‖.
        inside: The laws in Ω; None without any.
        on: Γ_S with the pieces of the laws, and y·n.
        trace: v.
    """

    solution: Solution
    goal: Goal
    metric: CellMetric
    size: float
    resolution: Resolution
    deviation: Array
    y: fem.Function
    flux: CellFlux
    level: fem.Function
    remainder: float
    inside: Inside | None
    on: OnGammaS
    trace: Trace

    @classmethod
    def of(cls, solution: Solution, goal: Goal, field: fem.Function | None = None) -> Admissible:
        """The admissible fields of a solution; v is near a field if there is one, see `law_trace` (collective)."""
        spaces, data = solution.spaces, solution.data
        comm = spaces.mesh.comm
        metric = cell_metric(spaces, data)
        size = math.sqrt(comm.allreduce(metric.squares(solution.cell_flux).sum()))
        cells, dim = spaces.Q.dofmap.index_map.size_global, spaces.mesh.topology.dim
        resolution = Resolution(spaces, data, size * cells ** (-1 / dim), comm.allreduce(metric.volume.sum()))
        metric, deviation = resolution.conductivity(metric, size)
        y, flux, level, remainder = admissible_flux(solution, metric, goal)
        inside = Inside.of(solution, y, level, resolution)
        on = OnGammaS.of(solution, goal, metric, y)
        trace = law_trace(solution, metric, y, on, inside, field)
        return cls(solution, goal, metric, size, resolution, deviation, y, flux, level, remainder, inside, on, trace)


@dataclass(frozen=True)
class GapParts:
    """What v and y, of one solution or of two, leave of the gap, per owned cell.

    Attributes:
        mismatch: ‖κ∇v − y‖².
        reaction: ‖c^-½ g‖², see `reaction`; a part of `contact`.
        contact: Twice what laws and cu add to the gap.
        oscillation: osc_T, with its share of `left`.
        left: What the means of the loads may add.
        hidden: What quadrature may miss of ‖κ^½∇v‖; it is in the mismatch.
        of_laws: The load s_T − η of laws in Ω; None without any.
    """

    mismatch: Array
    reaction: Array
    contact: Array
    oscillation: Array
    left: float
    hidden: Array
    of_laws: Projection | None


def gap_parts(
    of_v: Admissible, of_y: Admissible, goal: Goal, memory: Memory | None = None, area: Area = gap
) -> GapParts:
    """The gap of v and y, with the loads that y balances (collective).

    Args:
        of_v: Has v, with u_D and the bounds that it obeys.
        of_y: Has y, with the loads that it balances. It is `of_v` for the bound of one solution.
        goal: The laws on Γ_S between v and y·n.
        memory: For a step in time, the load that it takes from those before, see `certify`.
        area: What a law adds for values of v and η, see `laws`.
    """
    solution, resolution, metric, inside, flux = of_y.solution, of_y.resolution, of_y.metric, of_y.inside, of_y.flux
    spaces, data, trace, comm = solution.spaces, solution.data, of_v.trace, solution.spaces.mesh.comm
    contact, load, pressure = _on_gamma_s(of_v, of_y, goal, area)
    of_laws = None
    if inside is not None:
        gap_inside, of_laws = inside.gap(trace, metric, resolution, area)
        contact = contact + gap_inside
    reaction = reaction_terms(spaces, data, metric, trace, of_y.level, resolution)
    takes_f = None if inside is None else inside.takes_f
    oscillation = load_oscillation(spaces, data, metric, load, reaction, memory, resolution, of_laws, takes_f)
    of_reaction = np.zeros(len(metric.volume)) if reaction is None else reaction.gap
    if reaction is not None:
        contact = contact + reaction.gap
    mismatch = mismatches(of_y, trace, flux)
    known = math.sqrt(comm.allreduce((mismatch + contact + oscillation**2).sum()))
    hidden = hidden_parts(resolution, trace, of_v.solution.data.u_D, metric, pressure, inside, known)
    contact = contact + hidden.gap
    mismatch = (np.sqrt(np.maximum(mismatch, 0.0)) + hidden.slope) ** 2
    least = None if reaction is None else reaction.least
    left = resolution.load_left(lambda load: load_left(spaces, data, metric, load, least, ENOUGH * known))
    oscillation = _with_more(oscillation, left, metric, comm)
    return GapParts(mismatch, of_reaction, contact, oscillation, left, hidden.slope, of_laws)


def _why_none(trace: Trace, remainder: float) -> str:
    """Why a bound is infinite."""
    if trace.hindrance:
        return trace.hindrance
    if not np.isfinite(remainder):
        return "a linear solve failed, by which the flux would be balanced"
    return "data or the gradients of u_D and ψ are not bounded"


def _with_more(oscillation: Array, more: float, metric: CellMetric, comm: MPI.Comm) -> Array:
    """osc_T such that osc grows by `more`, shared out by osc_T, or by volumes if osc = 0 (collective)."""
    total, volume = comm.allreduce(np.array([(oscillation**2).sum(), metric.volume.sum()])).tolist()
    if total > 0:
        return oscillation * (1 + more / np.sqrt(total))
    return more * np.sqrt(metric.volume / volume)


def _on_gamma_s(
    of_v: Admissible, of_y: Admissible, goal: Goal, area: Area
) -> tuple[Array, list[FacetLoad], Pressure | None]:
    """Twice the gap on Γ_S per owned cell, the loads η − y·n, and what presses v against ψ alone (collective)."""
    solution, metric, resolution, on = of_y.solution, of_y.metric, of_y.resolution, of_y.on
    spaces, trace, number = solution.spaces, of_v.trace, len(metric.volume)
    if goal.plain and of_y.inside is None:
        psi = of_v.solution.data.psi
        points, excess, load = contact_excess(spaces, solution.data, metric, on.flux, resolution)
        above = np.maximum(trace.on_gamma_s(points) - psi.values(points), 0.0)
        per_cell = points.per_cell(2 * points.integrals(excess * above), number)
        return per_cell, load, Pressure("psi", psi, points, excess.max(axis=1, initial=0.0))
    resolution.by_quadrature |= not_polynomial(goal)
    at = goal.at(spaces, *basix.make_quadrature(facet_type(spaces.mesh.topology.dim), goal.degree()))
    v = trace.on_gamma_s(at.points)
    found = LawGap.of(spaces, metric, at, v, on.flux, on.flux_ends(at), on.flux_of_piece(at, v), area)
    return found.per_cell(number), found.loads(spaces), None


@dataclass(frozen=True)
class FluxOf:
    """κ∇v of a quadratic v, with κ itself: of ‖κ^½∇(w − v)‖² enclosures add to κ alone."""

    v: fem.Function
    kappa: Datum

    def at(self, points: Points) -> Array:
        """κ∇v in points, shape (n, points, dim)."""
        return scaled(self.kappa.values(points), points.quadratic(self.v, gradient=True)[:, :, 1:])

    def squares(self, _: float) -> Array:
        """What changes with κ − κ̃: nothing."""
        return np.zeros(1)


def scaled(kappa: Array, slope: Array) -> Array:
    """κ times vectors in points; κ is a number in each, or a matrix."""
    return kappa[:, :, None] * slope if kappa.ndim == 2 else np.asarray((kappa @ slope[..., None])[..., 0])


def mismatches(own: Admissible, trace: Trace, flux: CellFlux | FluxOf) -> Array:
    """Bound of ‖κ^½∇v − κ^-½y‖² per owned cell, from κ̃ and S = sup |κ − κ̃|, see `resolution` (collective).

    Args:
        own: Has κ.
        trace: Has v.
        flux: y.
    """
    spaces, kappa = own.solution.spaces, own.solution.data.kappa
    mesh, far = spaces.mesh, np.delete(owned_cells(spaces.mesh), trace.cells)
    of_kappa = QUADRATIC if kappa.number is not None else quadrature_degree(kappa)
    found = np.zeros(spaces.Q.dofmap.index_map.size_local)
    for near, cells, degree in ((False, far, of_kappa), (True, trace.cells, degree_near(trace))):
        for points in in_cells(mesh, cells, *positive_quadrature(mesh.basix_cell(), max(degree, QUADRATIC))):
            slope = trace.jet(points, near=near, gradient=True)[:, :, 1:]
            found[points.rows] = points.integrals(_flux_gap(slope, flux.at(points), kappa.values(points)))
    deviation, lowest = own.deviation, own.metric.kappa_min
    if not mesh.comm.allreduce(bool((deviation > 0).any()), MPI.LOR):
        return found
    root = np.sqrt((1 + deviation / lowest) * np.maximum(found, 0.0))
    root += deviation * np.sqrt(flux.squares(1.0)) / lowest**1.5
    return np.asarray(root**2, dtype=np.float64)


def _flux_gap(slope: Array, y: Array, kappa: Array) -> Array:
    """κ⁻¹(κ∇v − y)·(κ∇v − y) in points; infinite where κ has no inverse."""
    gap = scaled(kappa, slope) - y
    if kappa.ndim == 2:
        return np.asarray(np.einsum("nqi,nqi->nq", gap, gap) / kappa)
    regular = np.linalg.det(kappa) != 0
    inverse = np.linalg.inv(np.where(regular[..., None, None], kappa, np.eye(kappa.shape[-1])))
    return np.where(regular, np.einsum("nqi,nqij,nqj->nq", gap, inverse, gap), np.inf)
