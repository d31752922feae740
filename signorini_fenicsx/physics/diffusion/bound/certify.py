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

With a given flux b in σ = κ∇u + b the square in the gap is ‖κ∇v + b − y‖², see `added_flux`.

With a term cu the balance is ∇·y = −f_h + c_h u* with u* near u_h, the gap and osc have the terms of `reaction`, and
|∇w|² + ‖c^½w‖² takes the place of |∇w|². The two errors are bounded as before, and with them ‖c^½(v − u)‖.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import basix
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.certificate.certificate import Certificate, Gap
from signorini_fenicsx.certificate.laws import Area, gap
from signorini_fenicsx.discrete.points import facet_type, in_facets
from signorini_fenicsx.physics.diffusion.bound.added_flux import beside_b
from signorini_fenicsx.physics.diffusion.bound.admissible_trace import Trace
from signorini_fenicsx.physics.diffusion.bound.conforming import law_trace
from signorini_fenicsx.physics.diffusion.bound.equilibrated import admissible_flux, load_left
from signorini_fenicsx.physics.diffusion.bound.hidden import PressedBound, hidden_parts
from signorini_fenicsx.physics.diffusion.bound.inside import Inside
from signorini_fenicsx.physics.diffusion.bound.kirchhoff import bound_by, linear_solution
from signorini_fenicsx.physics.diffusion.bound.laws import Goal, LawGap, not_polynomial
from signorini_fenicsx.physics.diffusion.bound.local_fields import CellMetric, FacetLoad, Projection, cell_metric
from signorini_fenicsx.physics.diffusion.bound.mismatch import Energies, enclosed
from signorini_fenicsx.physics.diffusion.bound.on_gamma_s import OnGammaS
from signorini_fenicsx.physics.diffusion.bound.oscillation import Memory, load_oscillation, on_facets
from signorini_fenicsx.physics.diffusion.bound.passed_on import passed_on
from signorini_fenicsx.physics.diffusion.bound.reaction import reaction_terms
from signorini_fenicsx.physics.diffusion.bound.resolution import Resolution
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces
from signorini_fenicsx.physics.diffusion.solution import Solution

LITTLE = 0.01
"""For RT1 loads that make up this share of the error need not be measured sharply."""
ENOUGH = 5e-3
"""A bound of missed loads below this share of the bound need not be sharp."""
SHARPER = 0.125
"""Data that return are enclosed as if the error were this share of what it is."""
LAST_KAPPA = "the exact solution of the problem with the last κ"
OF_PENALTY = "the exact solution of the penalty problem"


def certificate_of(solution: Solution, *, for_signorini: bool = False) -> Certificate:
    """Bound the energy error of a converged solution (collective).

    The cost is some assembly, and up to three linear solves if the linear solver, a penalty or quadrature leaves an
    error. u_D and ψ have to be continuous. Integrals of resolved data are by quadrature, see `resolution`.

    Args:
        solution: A solution by any algorithm.
        for_signorini: Whether u is the solution of the Signorini problem, not that of a penalty, also if a penalty
            method was used.
    """
    if (of_w := linear_solution(solution)) is not None:
        return bound_by(solution, of_w, certificate_of(of_w))
    with np.errstate(all="ignore"):  # of data that are unbounded the certificate tells
        admissible = Admissible.of(solution, Goal.of(solution, for_signorini=for_signorini))
        return summed(admissible, gap_parts(admissible, admissible, admissible.goal))


def summed(admissible: Admissible, parts: GapParts) -> Certificate:
    """The bound that admissible fields of one solution give (collective)."""
    spaces, resolution = admissible.solution.spaces, admissible.resolution
    missed = spaces.mesh.comm.allreduce(float(resolution.missed.sum()))
    enclosed = np.sqrt(missed) + parts.left
    gap = Gap(
        squares=parts.mismatch + parts.contact,
        oscillation=_with_more(parts.oscillation, parts.left, admissible.metric, spaces.mesh.comm),
        remainder=admissible.remainder,
        size=admissible.size,
        v=admissible.trace.v,
        hindrance=admissible.trace.hindrance,
        unbalanced=admissible.unbalanced,
        by_quadrature=tuple(sorted(resolution.by_quadrature)),
        account=lambda bound: (resolution.account(enclosed / bound if bound > 0 else 0.0), resolution.coarse),
    )
    certificate = gap.certificate(spaces)
    if admissible.goal.of_penalty:
        return replace(certificate, of=OF_PENALTY, about={"of_penalty": True})
    if admissible.solution.data.quasilinear is None:
        return certificate
    about = {"guaranteed": False, "of_last_kappa": True}
    return replace(
        certificate, of=LAST_KAPPA, about=about | ({"guaranteed_for": LAST_KAPPA} if certificate.proved else {})
    )


@dataclass(frozen=True)
class Admissible:
    """The admissible v and y of a solution.

    Attributes:
        solution: The solution.
        goal: The problem to which the distance is bounded.
        metric: Metric of the owned cells.
        size: ‖σ_h‖, at most by rounding too large.
        resolution: Encloses the data, and records what quadrature may miss.
        energies: Squares of energy norms.
        y: y.
        flux: y cell by cell.
        driving: y less the given flux b, or less quadratics near it.
        off_b: ‖κ^-½(b − these)‖ of each owned cell, at most.
        level: u*.
        remainder: Bound of ‖y − σ_h‖; infinite if y is not admissible.
        unbalanced: Why it is infinite; empty if it is not.
        inside: The laws in Ω.
        on: Γ_S with the pieces of the laws, and y·n.
        trace: v.
    """

    solution: Solution
    goal: Goal
    metric: CellMetric
    size: float
    resolution: Resolution
    energies: Energies
    y: fem.Function
    flux: CellFlux
    driving: CellFlux
    off_b: Array
    level: fem.Function
    remainder: float
    unbalanced: str
    inside: Inside
    on: OnGammaS
    trace: Trace

    @classmethod
    def of(
        cls, solution: Solution, goal: Goal, field: fem.Function | None = None, *, returns: bool = False
    ) -> Admissible:
        """The admissible fields of a solution; v is near a field if there is one, see `conforming` (collective).

        `returns` as in `Resolution`.
        """
        spaces, data = solution.spaces, solution.data
        comm = spaces.mesh.comm
        metric = cell_metric(spaces, data)
        driving = data.driving(solution.cell_flux)
        size, of_driving = (
            math.sqrt(comm.allreduce(metric.squares(each).sum())) for each in (solution.cell_flux, driving)
        )
        cells, dim = spaces.Q.dofmap.index_map.size_global, spaces.mesh.topology.dim
        error = max(size, of_driving) * cells ** (-(spaces.degree + 1) / dim)
        if returns and 0 < error < math.inf:  # the same in many problems, and sharp, as much is kept
            error = SHARPER * 2.0 ** math.floor(math.log2(error))
        resolution = Resolution(spaces, data, error, comm.allreduce(metric.volume.sum()), returns)
        metric = enclosed(resolution, metric, data.kappa, size)
        energies = Energies(resolution, metric, data.kappa)
        if data.kappa.number is None:
            size = math.sqrt(comm.allreduce(energies.squares(solution.cell_flux).least.sum()))
        y, flux, level, remainder, unbalanced = admissible_flux(solution, metric, goal)
        inside = Inside.of(solution, metric, y, level, resolution)
        on = OnGammaS.of(solution, goal, metric, y, flux)
        driving, off_b = data.driving(flux), beside_b(resolution, metric)
        trace = law_trace(solution, metric, y, on, inside, field)
        of_y = y, flux, driving, off_b, level, remainder, unbalanced
        return cls(solution, goal, metric, size, resolution, energies, *of_y, inside, on, trace)


@dataclass(frozen=True)
class GapParts:
    """What v and y, of one solution or of two, leave of the gap, per owned cell.

    Attributes:
        mismatch: ‖κ∇v − y‖².
        reaction: ‖c^-½ g‖², see `reaction`; a part of `contact`.
        contact: Twice what laws and cu add to the gap.
        oscillation: osc_T, without `left`.
        left: What the means of the loads may add, beside |w| in all cells together.
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
        memory: For a step in time, the load that it takes from those before; None for `Data.memory`, which is constant
            on each cell. On each cell both have the same mean.
        area: What a law adds for values of v and η, see `laws`.
    """
    solution, resolution, metric, inside, flux = of_y.solution, of_y.resolution, of_y.metric, of_y.inside, of_y.flux
    spaces, data, trace, comm = solution.spaces, solution.data, of_v.trace, solution.spaces.mesh.comm
    contact, load, pressure = gap_on_gamma_s(of_v, of_y, goal, area)
    gap_inside, of_laws = inside.gap(trace, metric, resolution, area)
    contact = contact + gap_inside
    terms = () if memory is None else memory.terms
    reaction = reaction_terms(spaces, data, metric, trace, of_y.level, resolution, terms)
    if reaction is not None:
        reaction = reaction.beside(trace.lacked)
    mismatch = of_y.energies.squares(of_y.driving, trace).most
    mismatch = (np.sqrt(np.maximum(mismatch, 0.0)) + of_y.off_b + trace.lacking) ** 2
    total, number = comm.allreduce(np.array([mismatch.sum(), len(mismatch)])).tolist()
    enough = LITTLE * math.sqrt(max(total, 0.0) / number) if spaces.degree else 0.0
    oscillation = load_oscillation(
        spaces, data, metric, flux, load, reaction, memory, resolution, of_laws, inside.takes_f, enough
    )
    if isinstance(spaces, RT1Spaces) and spaces.pairs:
        oscillation = oscillation + passed_on(spaces, metric, of_y.y)
    of_reaction = np.zeros(len(metric.volume)) if reaction is None else reaction.gap
    if reaction is not None:
        contact = contact + reaction.gap
    bound_so_far = math.sqrt(comm.allreduce((mismatch + contact + oscillation**2).sum()))
    hidden = hidden_parts(resolution, trace, of_v.solution.data.u_D, metric, pressure, inside, bound_so_far)
    contact = contact + hidden.gap
    mismatch = (np.sqrt(np.maximum(mismatch, 0.0)) + hidden.slope) ** 2
    if reaction is not None:
        oscillation = oscillation + reaction.hidden(hidden.value, metric, resolution)
    least = None if reaction is None else reaction.least
    left = resolution.load_left(lambda load: load_left(spaces, data, metric, load, least, ENOUGH * bound_so_far))
    return GapParts(mismatch, of_reaction, contact, oscillation, left, hidden.slope, of_laws)


def _with_more(oscillation: Array, added: float, metric: CellMetric, comm: MPI.Comm) -> Array:
    """osc_T such that osc grows by `added`, shared out by osc_T, or by volumes if osc = 0 (collective)."""
    total, volume = comm.allreduce(np.array([(oscillation**2).sum(), metric.volume.sum()])).tolist()
    if total > 0:
        return oscillation * (1 + added / np.sqrt(total))
    return added * np.sqrt(metric.volume / volume)


def gap_on_gamma_s(
    of_v: Admissible, of_y: Admissible, goal: Goal, area: Area
) -> tuple[Array, list[FacetLoad], PressedBound | None]:
    """Twice the gap on Γ_S per owned cell, the loads η − y·n, and what presses v against ψ alone (collective)."""
    solution, metric, resolution, on = of_y.solution, of_y.metric, of_y.resolution, of_y.on
    spaces, trace, number = solution.spaces, of_v.trace, len(metric.volume)
    part = None if of_y.inside.rays else goal.enclosed(spaces)  # bounds in Ω would be in v on Γ_S
    resolution.by_quadrature |= not_polynomial(each for each in goal.parts if each is not part)
    degree = goal.degree_of_gap(of_v.solution.data.u_D)
    points, weights = basix.make_quadrature(facet_type(spaces.mesh.topology.dim), degree)
    missed, corners = np.zeros(len(spaces.facets)), None
    if part is not None:
        facets = in_facets(spaces.mesh, spaces.facets[part.rows], points, weights)
        q_S, missed[part.rows] = on_facets(
            part.key("q_S"), part.data["q_S"], facets, goal.flux_h[part.rows], metric, resolution
        )
        corners = part, q_S
    at = goal.at(spaces, points, weights, corners)
    v = trace.on_gamma_s(at.points)
    law_gap = LawGap.of(
        spaces, metric, at, v, on.flux, on.tilts(at.points), on.flux_ends(at), on.flux_of_piece(at, v), missed, area
    )
    pressure = None
    if part is not None:
        excess = law_gap.load.values[part.rows] + on.flux_at(at.points)[part.rows] - q_S
        free = ~trace.parts.is_on(part.data["psi"], facets.facets)  # elsewhere v − ψ is 0
        pressure = PressedBound(part.key("psi"), part.data["psi"], facets, free * excess.max(axis=1, initial=0.0))
    return law_gap.per_cell(number), [] if goal.keeps_flux else law_gap.loads(spaces), pressure
