"""A flux near σ_h that balances f_h − c_h u* and has y·n ≥ q_S on Γ_S in the mean, and its distance from σ_h.

The residual c = ∇·σ_h + f_h is corrected by a flux z ∈ RT0 with −∇·z = c, z·n = 0 on Γ_N and Γ_S. This is one more
solve, needed only if c is more than rounding. Without Γ_D, z may be nonzero on those facets of Γ_S where y·n − q_S is
large. In this way the bound contains no constant of the domain, except in a term for rounding.

*Bounds of loads that are known per cell only by enclosures of their means*: sup (c, w)/|w| over w = 0 on Γ_D.

Take z with −∇·z = 1, z·n = 0 on Γ_N and Γ_S, and let s be the largest κ^-½|z|. For all w = 0 on Γ_D

    |w|² ≥ (2tw z, ∇w) − ‖tκ^-½ wz‖² ≥ (t − t²s²)‖w‖² = ‖w‖²/4s²   with t = 1/2s²,   so (c, w) ≤ 2s‖c‖ |w|.

If c is large in few cells only, this is far too much. With z_c for the load |c| and its largest κ^-½|z_c|, s_c,

    (|c|, w²) = (2w z_c, ∇w) ≤ 2s_c‖w‖ |w| ≤ 4s s_c|w|²,   so (c, w) ≤ ‖c‖₁^½ (|c|, w²)^½ ≤ 2(‖c‖₁ s s_c)^½ |w|.

If c is known well, the flux z for it gives (c, w) = (z, ∇w) ≤ ‖z‖ |w|. Where c ≥ γ > 0 in a term cu, also (c, w) ≤
‖γ^-½c‖ ‖γ^½w‖.
"""

import contextlib
import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any, cast

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, squares_of
from signorini_fenicsx.base.errors import LinearSolveFailure
from signorini_fenicsx.base.owned import function_of, owned_values
from signorini_fenicsx.base.text import place_in_words
from signorini_fenicsx.certificate.certificate import first_places
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Chains, Condition, Kinds, Penalty, SiteConditions
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.expressions.intervals import Interval
from signorini_fenicsx.physics.diffusion.bound.inside import room, selected
from signorini_fenicsx.physics.diffusion.bound.laws import Goal
from signorini_fenicsx.physics.diffusion.bound.local_fields import CellMetric
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux, RT1Flux, cell_values, means_in_cells
from signorini_fenicsx.physics.diffusion.discrete.cell_laws import CellLaws
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces, Spaces
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.solve.hybrid import HybridBackend
from signorini_fenicsx.physics.diffusion.solve.rt1_backend import RT1Backend
from signorini_fenicsx.physics.diffusion.solve.rt1_residuals import passed

ROUNDING = 1e-9
"""If L‖c‖/√κ is below this share of ‖σ_h‖, c is rounding. The bound contains the share instead of L‖c‖/√κ or of a
smaller ‖y − σ_h‖, which depend on the order of sums: the bound is the same on any number of ranks."""
FAILED = "a linear solve failed, by which the flux would be balanced"
OF_PAIRS = "the linear solver leaves too much of what masters have to take from their slaves"
LEFT = "the linear solver leaves too much of the balance of the flux"
OF_SUMS = 1e-14
"""Share of the loads that is rounding: where f − cu is 0, so are c and σ_h but for the rounding of this difference."""
CORRECTIONS = 4
"""Largest number of solves until c is rounding; one is enough unless the linear solver stops early."""


type Limits = tuple[Array, ...]
"""The least and the largest y·n per facet of Γ_S."""
NONE = (np.empty(0), np.empty(0))
"""Where there is a Γ_D no limits are needed."""


def admissible_flux(
    solution: Solution, metric: CellMetric, goal: Goal
) -> tuple[fem.Function, CellFlux, fem.Function, float, str]:
    """The flux y near σ_h with ∇·y = −f_h + c_h u*, y·n = g_h on Γ_N and y·n ≥ q_Sh on Γ_S (collective).

    Under other laws y·n is between the least and the largest flux that they allow. With laws in Ω the balance has an s
    that they allow. For RT1 all this is about means over cells and facets: there a flux of RT0 is added to σ_h.

    Returns:
        y, y cell by cell, u* in P0, ‖y − σ_h‖ including the term for rounding, infinite if the residual cannot be
        corrected, and why it cannot.
    """
    spaces = solution.spaces
    sigma, u = _without_penalty(solution) if goal.plain else (solution.sigma, solution.u)
    flux = solution.cell_flux if sigma is solution.sigma else CellFlux.of(spaces, sigma)
    if isinstance(spaces, RT1Spaces) and not _passes(spaces, sigma):
        return sigma, flux, u, np.inf, OF_PAIRS
    if not isinstance(flux, RT1Flux):
        y, flux, u, rounding, why = _balanced(solution, metric, goal, sigma, flux, u)
    else:
        y, lowest, level = sigma, flux.function(), function_of(spaces.Q, _level(solution, flux, u))
        near, _, u, rounding, why = _balanced(solution, metric, goal, lowest, CellFlux.of(spaces, lowest), level)
        if near is not lowest:
            change, added = near.copy(), fem.Function(sigma.function_space)
            change.x.array[:] -= lowest.x.array
            added.interpolate(change)
            y = sigma.copy()
            y.x.array[:] += added.x.array
            flux = CellFlux.of(spaces, y)
    return y, flux, u, rounding + max(rounding, distance(spaces, metric, y, solution.sigma)), why


def _passes(spaces: RT1Spaces, sigma: fem.Function) -> bool:
    """Whether masters take what goes through slaves, but for rounding (collective)."""
    values = spaces.flux_values(sigma)
    left = max([np.abs(each).max(initial=0.0) for _, each in passed(spaces, values)]) if spaces.pairs else 0.0
    sizes = float(left), float(np.abs(values).max(initial=0.0))
    most, size = (spaces.mesh.comm.allreduce(each, MPI.MAX) for each in sizes)
    return bool(most <= ROUNDING * size)


def _level(solution: Solution, flux: RT1Flux, u: fem.Function) -> Array:
    """u* per owned cell: where c_h > 0 it makes up for cu_h having another mean than c_h times that of u_h."""
    means, data = cell_values(u).mean(axis=1), solution.data
    if data.c_h is None:
        return means
    c_h, most = owned_values(data.c_h), np.abs(cell_values(u)).max(axis=1)
    off = flux.divergence.mean(axis=1) + owned_values(data.f_h) - c_h * means
    if data.inside:
        off += means_in_cells(solution.force())
    near = np.abs(off) <= c_h * most
    return means + np.divide(off, c_h, out=np.zeros_like(off), where=near & (c_h > 0))


def _balanced(
    solution: Solution, metric: CellMetric, goal: Goal, sigma: fem.Function, flux: CellFlux, u: fem.Function
) -> tuple[fem.Function, CellFlux, fem.Function, float, str]:
    """Y in RT0 near σ, and cell by cell, u* near u in P0, the term for rounding, infinite without, why (collective)."""
    spaces, data = solution.spaces, solution.data
    comm, volume = spaces.mesh.comm, metric.volume
    kappa_min = comm.allreduce(metric.kappa_min.min(initial=np.inf), MPI.MIN)
    constant = comm.allreduce(volume.sum()) ** (1 / spaces.mesh.topology.dim) / np.sqrt(kappa_min)
    limits = tuple(data.q_Sh + end for end in goal.chains.extent()[2:])
    y = _within(spaces, limits, sigma)
    flux = flux if y is sigma else CellFlux.of(spaces, y)
    c_h = 0.0 if data.c_h is None else owned_values(data.c_h)
    loads = np.abs(owned_values(data.f_h)) + c_h * np.abs(owned_values(u))
    of_fluxes = [metric.squares(each).sum() for each in (flux, data.driving(flux))]
    *of_fluxes, of_loads = np.sqrt(comm.allreduce(np.array([*of_fluxes, volume @ loads**2])))
    rounding = float(ROUNDING * max(of_fluxes) + OF_SUMS * constant * of_loads)
    for _ in range(CORRECTIONS):
        s, may = flux.divergence + owned_values(data.source(u)), None
        off = s
        if data.inside:
            off = s - selected(solution, data.inside, s, owned_values(u), metric)
            may = room(data.inside, solution.cell_conditions, s, owned_values(u))
        left = constant * np.sqrt(comm.allreduce(volume @ off**2))
        if left <= rounding:
            return y, flux, u, rounding, ""
        try:
            correction = balancing_flux(spaces, data, y, function_of(spaces.Q, off), limits, may)
        except LinearSolveFailure:
            return y, flux, u, np.inf, FAILED
        correction.sigma.x.array[:] += y.x.array
        correction.u.x.array[:] += u.x.array
        y, u = _within(spaces, limits, correction.sigma), correction.u
        flux = CellFlux.of(spaces, y)
    return y, flux, u, np.inf, LEFT if kappa_min > 0 else _without_ellipticity(spaces, metric)


def _without_ellipticity(spaces: Spaces, metric: CellMetric) -> str:
    """Where κ is not above 0 in a node, so that no flux has a finite norm for sure, in words (collective)."""
    places = corners(spaces.mesh)[~(metric.kappa_min > 0)].mean(axis=1).tolist()
    ((_, place), *_) = first_places([("kappa", tuple(x)) for x in places], spaces.mesh.comm)
    return f"kappa is not above 0 in all of the cell around {place_in_words(place)}"


def distance(spaces: Spaces, metric: CellMetric, y: fem.Function, sigma: fem.Function) -> float:
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
            backend: Any = RT1Backend if solution.spaces.degree else HybridBackend
            iterate = backend(solution.spaces, solution.data).solve(SiteConditions(kind))
            return iterate.sigma, iterate.u
    return solution.sigma, solution.u


def _within(spaces: Spaces, limits: Limits, y: fem.Function) -> fem.Function:
    """The flux y with y·n moved to its limits where it is beyond (collective)."""
    flux = spaces.normal_flux(y)
    allowed = np.clip(flux, *limits)
    beyond = flux != allowed
    if spaces.degree:
        beyond &= np.abs(flux - allowed) > ROUNDING * spaces.mesh.comm.allreduce(np.abs(flux).max(initial=0.0), MPI.MAX)
    if not spaces.mesh.comm.allreduce(bool(beyond.any()), MPI.LOR):
        return y
    y = y.copy()
    y.x.array[spaces.flux_dofs[beyond]] = (allowed * spaces.facet_measure / spaces.basis_flux)[beyond]
    y.x.scatter_forward()
    spaces.carry_across(y)
    return y


def balancing_flux(
    spaces: Spaces,
    data: Data,
    y: fem.Function,
    imbalance: fem.Function,
    limits: Limits = NONE,
    may: Array | None = None,
) -> Iterate:
    """The flux z of the module for the load `imbalance`; where c > 0 with −∇·z + cu = imbalance (collective).

    `may` says by how much the s of laws in Ω may change, per owned cell.

    Raises:
        LinearSolveFailure: If the solve fails.
    """
    spaces, data = _lowest(spaces, Spaces), _lowest(data, Data)
    kind, inside = np.full(len(spaces.facets), Condition.NO_FLUX, dtype=np.int8), CellLaws()
    if not data.holds(spaces):
        flux = spaces.normal_flux(y)
        excess = np.minimum(flux - limits[0], limits[1] - flux)
        excess[spaces.inner.rows] = 0.0  # what flows through these stays in the domain
        kind = _most_room(excess, spaces.mesh.comm)
        if may is not None:
            number = len(may)
            inside = replace(data.inside, means=np.zeros(number), chains=Chains.at_corner(number))
            kind = np.append(kind, _most_room(may, spaces.mesh.comm))
    nothing = np.zeros(len(spaces.facets))
    loads = replace(
        data,
        f_h=imbalance,
        sigma_lift=fem.Function(spaces.V),
        u_lift=fem.Function(data.u_lift.function_space),
        psi_h=nothing,
        q_Sh=nothing,
        inside=inside,
        b=None,
    )
    return HybridBackend(spaces, loads).solve(SiteConditions(kind))


def _lowest[T](of_linear: T, kind: type[T]) -> T:
    """The spaces or the data of RT0 that those of RT1 have in them."""
    names = [each.name for each in fields(cast(Any, kind))]
    return of_linear if type(of_linear) is kind else kind(**{name: getattr(of_linear, name) for name in names})


def _most_room(excess: Array, comm: MPI.Comm) -> Kinds:
    """ZERO_TRACE on the sites whose y·n or λ may well become less, NO_FLUX on the others (collective)."""
    largest = comm.allreduce(excess.max(initial=0.0), MPI.MAX)
    room = (excess >= largest / 2) & (excess > 0)
    return np.where(room, Condition.ZERO_TRACE, Condition.NO_FLUX).astype(np.int8)


DIGITS = 1e-5
"""A constant that comes from a linear solve is rounded up to about this relative size, so that it does not depend on
the number of ranks."""
WORTH = 0.5
"""A load is balanced by a flux only if at most this share of it is uncertain."""
EVERYWHERE = 1e-3
"""So much of the mean of |c| is added to |c|, so that z_c is no rounding where c = 0."""


def load_left(
    spaces: Spaces, data: Data, metric: CellMetric, load: Interval, least: Array | None, enough: float
) -> float:
    """Bound of a load that is enclosed per owned cell, as small as is enough (collective).

    It is infinite if there is neither a Γ_D nor a term cu, or if a linear solve fails.

    Args:
        spaces: The discrete spaces.
        data: The data.
        metric: Metric of the owned cells.
        load: The load.
        least: Lower bound of the factor in the term cu per owned cell; None without one.
        enough: No better bound is looked for below this.
    """
    comm, volume = spaces.mesh.comm, metric.volume
    ends = load.largest
    middle = (load.lo + load.hi) / 2
    rest = np.nextafter(np.maximum(load.hi - middle, middle - load.lo), np.inf)
    whole, left = np.sqrt(comm.allreduce(np.array([volume @ ends**2, volume @ rest**2]))).tolist()
    if whole == 0:
        return 0.0
    bound = np.inf
    if least is not None:
        with np.errstate(all="ignore"):
            squares = np.where(ends > 0, ends**2 / least, 0.0)
        bound = math.sqrt(comm.allreduce(volume @ squares))
    if not spaces.held or not np.isfinite(whole) or bound <= enough:
        return bound
    bounds = _Bounds(spaces, replace(data, c_h=None, inside=CellLaws()), metric)
    try:
        bound = min(bound, bounds.constant() * whole)
        if bound > enough:
            bound = min(bound, bounds.of_size(ends))
        if bound > enough and left <= WORTH * whole:
            uncertain = min(bounds.constant() * left, bounds.of_size(rest))
            bound = min(bound, bounds.of_load(middle) + uncertain)
    except LinearSolveFailure:
        pass
    return bound


class _Bounds:
    """The bounds of ‖z‖ that the module proves."""

    def __init__(self, spaces: Spaces, data: Data, metric: CellMetric):
        self._spaces, self._data, self._metric = spaces, data, metric
        self._constant: float | None = None

    def constant(self) -> float:
        """The constant 2s: a bound of ‖z‖ beside ‖c‖ (collective)."""
        if self._constant is None:
            self._constant = 2 * self._largest(np.ones(len(self._metric.volume)))
        return self._constant

    def of_size(self, size: Array) -> float:
        """2(‖c‖₁ s s_c)^½ for |c| ≤ size (collective)."""
        comm, volume = self._spaces.mesh.comm, self._metric.volume
        integral, measure = comm.allreduce(np.array([volume @ size, volume.sum()])).tolist()
        if integral == 0:
            return 0.0
        spread = EVERYWHERE * integral / measure
        return math.sqrt(2 * (1 + EVERYWHERE) * integral * self.constant() * self._largest(size + spread))

    def of_load(self, load: Array) -> float:
        """The norm ‖z‖ for a load (collective)."""
        return self._kept(
            "load", load, lambda: distance(self._spaces, self._metric, self._flux(load), fem.Function(self._spaces.V))
        )

    def _kept(self, name: str, load: Array, make: Callable[[], float]) -> float:
        """What depends on a load, on κ and on the mesh alone, and is kept there (collective)."""
        given = load, self._metric.inverse, self._metric.low
        return self._spaces.kept_results.get(self._spaces.mesh.comm, name, None, given, make)

    def _flux(self, load: Array) -> fem.Function:
        of_cells = function_of(self._spaces.Q, load)
        return balancing_flux(self._spaces, self._data, fem.Function(self._spaces.V), of_cells).sigma

    def _largest(self, size: Array) -> float:
        """The largest κ^-½|z| for a z with −∇·z ≥ size > 0 (collective)."""
        return self._kept("largest", size, lambda: self._made_largest(size))

    def _made_largest(self, size: Array) -> float:
        comm, flux = self._spaces.mesh.comm, CellFlux.of(self._spaces, self._flux(size))
        squares = squares_of(flux.in_vertices(), self._metric.inverse).max(axis=1, initial=0.0) / self._metric.low
        s = comm.allreduce(np.sqrt(squares.max(initial=0.0)), MPI.MAX)
        m = comm.allreduce((-flux.divergence / size).min(initial=np.inf), MPI.MIN)
        return _rounded_up(s / m) if m > 0 else np.inf


def _rounded_up(value: float) -> float:
    """The next multiple of a power of 2 that is about DIGITS of a positive value."""
    step = 2.0 ** math.floor(math.log2(DIGITS * value))
    return math.ceil(value / step) * step
