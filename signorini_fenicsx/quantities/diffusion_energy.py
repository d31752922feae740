"""The interval for the energy of diffusion: J(v) − gap − Σ osc_T‖κ∇v − y‖_T − ½osc² ≤ J(u) ≤ J(v)."""

from __future__ import annotations

import math

import basix
import numpy as np

from signorini_fenicsx.base.owned import owned_cells
from signorini_fenicsx.base.reference_cells import positive_quadrature
from signorini_fenicsx.certificate.certificate import reservation
from signorini_fenicsx.discrete.datum import DEGREES, quadrature_degree
from signorini_fenicsx.discrete.points import CellPoints, facet_quadrature, facet_type, in_cells, in_facets
from signorini_fenicsx.physics.diffusion.bound.admissible_trace import Trace
from signorini_fenicsx.physics.diffusion.bound.certify import QUADRATIC, UNBALANCED, Admissible, gap_parts, scaled
from signorini_fenicsx.physics.diffusion.bound.equilibrated import ROUNDING
from signorini_fenicsx.physics.diffusion.bound.hidden import degree_near
from signorini_fenicsx.physics.diffusion.bound.laws import Goal, energies
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.quantities.bracket import Quantity

SQUARE = 8
"""Degree of a quadrature for the energies of laws in Ω, as for their gap."""


def energy(solution: Solution) -> Quantity:
    """The interval for J(u) (collective)."""
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
