"""A flux near σ_h that balances f_h − c_h u* and has y·n ≥ q_S on Γ_S in the mean, and its distance from σ_h.

The residual c = ∇·σ_h + f_h is corrected by a flux z ∈ RT0 with −∇·z = c, z·n = 0 on Γ_N and Γ_S. This is one more
solve, needed only if c is more than rounding. Without Γ_D, z may be nonzero on those facets of Γ_S where y·n − q_S is
large. In this way the bound contains no constant of the domain, except in a term for rounding.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import LinearSolveFailure
from signorini_fenicsx.base.small_matrices import squares_of
from signorini_fenicsx.certificate.laws import Goal
from signorini_fenicsx.certificate.metric import CellMetric
from signorini_fenicsx.certificate.obstacle import force
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.conditions import Condition, Kinds, Penalty, SiteConditions
from signorini_fenicsx.expressions.intervals import Interval
from signorini_fenicsx.physics.diffusion.cell_flux import CellFlux
from signorini_fenicsx.physics.diffusion.data import Data
from signorini_fenicsx.physics.diffusion.hybrid import HybridBackend
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.spaces import Spaces

ROUNDING = 1e-9
"""If L‖c‖/√κ is below this share of ‖σ_h‖, c is rounding. The bound contains the share instead of L‖c‖/√κ or of a
smaller ‖y − σ_h‖, which depend on the order of sums: the bound is the same on any number of ranks."""
OF_SUMS = 1e-14
"""The same share of the loads: where f − cu is 0, so are c and σ_h but for the rounding of this difference."""
DIGITS = 1e-5
"""For the same reason a constant that comes from a linear solve is rounded up to about this relative size."""
WORTH = 0.5
"""A load is balanced by a flux only if at most this share of it is uncertain."""
CORRECTIONS = 4
"""Largest number of solves until c is rounding; one is enough unless the linear solver stops early."""


type Limits = tuple[Array, ...]
"""The least and the largest y·n per facet of Γ_S."""
NONE = (np.empty(0), np.empty(0))
"""Where there is a Γ_D no limits are needed."""


def admissible_flux(
    solution: Solution, metric: CellMetric, goal: Goal
) -> tuple[fem.Function, CellFlux, fem.Function, float]:
    """The flux y ∈ RT0 with ∇·y = −f_h + c_h u*, y·n = g_h on Γ_N and y·n ≥ q_Sh on Γ_S (collective).

    Under other laws y·n is between the least and the largest flux that they allow. In contact with an obstacle ≤ is
    enough in the balance.

    Returns:
        y, y cell by cell, u*, and ‖y − σ_h‖ including the term for rounding, infinite if the residual cannot be
        corrected.
    """
    spaces, data, touched = solution.spaces, solution.data, solution.outcome.iterate.contact
    comm, volume = spaces.mesh.comm, metric.volume
    kappa_min = comm.allreduce(metric.kappa_min.min(initial=np.inf), MPI.MIN)
    constant = comm.allreduce(volume.sum()) ** (1 / spaces.mesh.topology.dim) / np.sqrt(kappa_min)
    limits = tuple(data.q_Sh + end for end in goal.chains.extent()[2:])
    sigma, u = _without_penalty(solution) if goal.plain else (solution.sigma, solution.u)
    y = _within(spaces, limits, sigma)
    flux = solution.cell_flux if y is solution.sigma else CellFlux.of(spaces, y)
    loads = np.abs(data.f_h.x.array) + (0.0 if data.c_h is None else data.c_h.x.array * np.abs(u.x.array))
    squares = comm.allreduce(np.array([metric.squares(flux).sum(), volume @ loads**2]))
    rounding = float(np.sqrt(squares) @ [ROUNDING, OF_SUMS * constant])
    for _ in range(CORRECTIONS):
        imbalance = fem.Function(spaces.Q)
        imbalance.x.array[:] = flux.divergence + data.source(u).x.array
        if touched is not None:  # there what is negative is the force of the obstacle
            imbalance.x.array[touched] = np.maximum(imbalance.x.array[touched], 0.0)
        left = constant * np.sqrt(comm.allreduce(volume @ imbalance.x.array**2))
        if left <= rounding:
            return y, flux, u, rounding + max(rounding, _distance(spaces, metric, y, solution.sigma))
        try:
            correction = _balancing_flux(spaces, data, y, imbalance, limits, touched)
        except LinearSolveFailure:
            break
        correction.sigma.x.array[:] += y.x.array
        correction.u.x.array[:] += u.x.array
        y, u = _within(spaces, limits, correction.sigma), correction.u
        flux = CellFlux.of(spaces, y)
    return y, flux, u, np.inf


def _distance(spaces: Spaces, metric: CellMetric, y: fem.Function, sigma: fem.Function) -> float:
    """The bound ‖(low κ_h)^-½ (y − σ_h)‖ of ‖y − σ_h‖ (collective)."""
    if y is sigma:
        return 0.0
    difference = y.copy()
    difference.x.array[:] -= sigma.x.array
    return math.sqrt(spaces.mesh.comm.allreduce((metric.squares(CellFlux.of(spaces, difference)) / metric.low).sum()))


def _without_penalty(solution: Solution) -> tuple[fem.Function, fem.Function]:
    """σ_h and u_h; for (MPε-II), whose σ_h·n is < q_S off the contact set, by a step of Algorithm 1 (collective)."""
    if solution.method.penalty is Penalty.FLUX:
        open_facets = solution.outcome.conditions.kind == Condition.ROBIN
        kind = np.where(open_facets, Condition.NO_FLUX, Condition.ZERO_TRACE).astype(np.int8)
        with contextlib.suppress(LinearSolveFailure):
            found = HybridBackend(solution.spaces, solution.data).solve(SiteConditions(kind))
            return found.sigma, found.u
    return solution.sigma, solution.u


def _within(spaces: Spaces, limits: Limits, y: fem.Function) -> fem.Function:
    """The same flux with y·n moved to its limits where it is beyond (collective)."""
    flux = spaces.normal_flux(y)
    allowed = np.clip(flux, *limits)
    beyond = flux != allowed
    if not spaces.mesh.comm.allreduce(bool(beyond.any()), MPI.LOR):
        return y
    y = y.copy()
    y.x.array[spaces.flux_dofs[beyond]] = (allowed * spaces.facet_measure / spaces.basis_flux)[beyond]
    y.x.scatter_forward()
    spaces.carry_across(y)
    return y


def _balancing_flux(
    spaces: Spaces,
    data: Data,
    y: fem.Function,
    imbalance: fem.Function,
    limits: Limits = NONE,
    touched: Mask | None = None,
) -> Iterate:
    """The flux z of the module, for the load `imbalance`; where c > 0 with −∇·z + cu = imbalance (collective).

    Raises:
        LinearSolveFailure: If the solve fails.
    """
    kind, obstacle = np.full(len(spaces.facets), Condition.NO_FLUX, dtype=np.int8), None
    if not data.holds(spaces):
        flux = spaces.normal_flux(y)
        excess = np.minimum(flux - limits[0], limits[1] - flux)
        excess[spaces.inner.rows] = 0.0  # what flows through these stays in the domain
        kind = _most_room(excess, spaces.mesh.comm)
        if data.obstacle is not None:
            obstacle = replace(data.obstacle, means=np.zeros_like(data.obstacle.means))
            kind = np.append(kind, _most_room(force(spaces, y, data.f_h, touched), spaces.mesh.comm))
    nothing = np.zeros(len(spaces.facets))
    loads = replace(
        data,
        f_h=imbalance,
        sigma_lift=fem.Function(spaces.V),
        u_lift=fem.Function(data.u_lift.function_space),
        psi_h=nothing,
        q_Sh=nothing,
        obstacle=obstacle,
    )
    return HybridBackend(spaces, loads).solve(SiteConditions(kind))


def _most_room(excess: Array, comm: MPI.Comm) -> Kinds:
    """ZERO_TRACE on the sites whose y·n or λ may well become less, NO_FLUX on the others (collective)."""
    largest = comm.allreduce(excess.max(initial=0.0), MPI.MAX)
    room = (excess >= largest / 2) & (excess > 0)
    return np.where(room, Condition.ZERO_TRACE, Condition.NO_FLUX).astype(np.int8)


def load_left(spaces: Spaces, data: Data, metric: CellMetric, load: Interval) -> float:
    """Bound of sup (c, w)/|w| over w = 0 on Γ_D for a load c that is enclosed per owned cell (collective).

    The constant of `_load_constant` gives a bound. If the enclosures are narrow, a flux z with (c, w) = (z, ∇w) for c
    in the middle of the enclosures may give a smaller one. The bound is infinite without Γ_D, or if a linear solve
    fails.
    """
    comm, volume = spaces.mesh.comm, metric.volume
    ends = np.maximum(np.abs(load.lo), np.abs(load.hi))
    middle = fem.Function(spaces.Q)
    middle.x.array[:] = (load.lo + load.hi) / 2
    rest = np.nextafter(np.maximum(load.hi - middle.x.array, middle.x.array - load.lo), np.inf)
    whole, left = np.sqrt(comm.allreduce(np.array([volume @ ends**2, volume @ rest**2]))).tolist()
    if whole == 0:
        return 0.0
    if not spaces.has_dirichlet or not np.isfinite(whole):
        return np.inf
    one, nothing = fem.Function(spaces.Q), fem.Function(spaces.V)
    one.x.array[:] = 1.0
    data = replace(data, c_h=None)
    try:
        constant = _load_constant(spaces, metric, _balancing_flux(spaces, data, nothing, one).sigma)
        if left > WORTH * whole:
            return constant * whole
        z = _balancing_flux(spaces, data, nothing, middle).sigma
    except LinearSolveFailure:
        return np.inf
    return min(constant * whole, constant * left + _distance(spaces, metric, z, nothing))


def _load_constant(spaces: Spaces, metric: CellMetric, z: fem.Function) -> float:
    """C with ‖w‖ ≤ C|w| for all w = 0 on Γ_D, from the flux z for the load 1; see `resolution` (collective)."""
    comm, flux = spaces.mesh.comm, CellFlux.of(spaces, z)
    squares = squares_of(flux.in_vertices(), metric.inverse).max(axis=1, initial=0.0) / metric.low
    s = comm.allreduce(np.sqrt(squares.max(initial=0.0)), MPI.MAX)
    m = comm.allreduce((-flux.divergence).min(initial=np.inf), MPI.MIN)
    return _rounded_up(2 * s / m) if m > 0 else np.inf


def _rounded_up(value: float) -> float:
    """The next multiple of a power of 2 that is about DIGITS of a positive value."""
    step = 2.0 ** math.floor(math.log2(DIGITS * value))
    return math.ceil(value / step) * step
