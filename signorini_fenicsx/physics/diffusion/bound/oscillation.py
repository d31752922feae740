"""The part of the load that RT0 does not balance: osc.

Let y ∈ RT0 with ∇·y = −f_h, y·n = g_h on Γ_N and y·n in the mean within what the laws on Γ_S allow, and r = η − y·n
as in `laws`. So y is admissible for the problem with the laws moved by r, which is a load like f − f_h and g_N − g_h:

    R(w) = (f − f_h, w) + ⟨g_N − g_h, w⟩ on Γ_N + ⟨r, w⟩ on Γ_S,   R(w) ≤ osc |w| for w = 0 on Γ_D,

osc² = Σ osc_T² by `local_fields`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import basix
import numpy as np

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.owned import owned_cells, owned_values
from signorini_fenicsx.base.reference_cells import orthonormal, positive_quadrature
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.points import (
    CellPoints,
    FacetPoints,
    facet_quadrature,
    facet_type,
    in_cells,
    quadratic_nodes,
)
from signorini_fenicsx.expressions.intervals import Interval
from signorini_fenicsx.expressions.simplices import Polynomial, barycentric_gradients, quadratic
from signorini_fenicsx.physics.diffusion.bound.local_fields import (
    HIGH,
    OF_FLUX,
    OF_LAW,
    OF_LOAD,
    CellMetric,
    FacetLoad,
    Projection,
    at_points,
    load_norms,
    projected,
)
from signorini_fenicsx.physics.diffusion.bound.reaction import ReactionTerms, Term
from signorini_fenicsx.physics.diffusion.bound.resolution import Resolution, Rest
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux, RT1Flux, normal_flux
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces

OF_MEMORY = 8
"""Degree of the square of a bubble, also in space."""
ENCLOSED = {2: 4, 3: 3}
"""Degree of Π of RT1 by dimension where f is enclosed, at most that of the series and of `local_fields.HIGH`."""
DEGREE = 2
"""Degree of the polynomials in the place of a capacity."""
ROUNDING = 1e-12
"""Means of what is left of a load of this size, relative to the load itself, are rounding."""


@dataclass(frozen=True)
class Memory:
    """What a step in time takes from those before.

    Attributes:
        values: The load in points of cells, shape (cells, points).
        missed: What it may have beside these values: a bound of its size per owned cell; None for nothing.
        initial: The content at the start, where it is a part of this load.
        factor: By what this part is more than that.
        terms: The terms of which it is the sum; empty if these are not known.
    """

    values: Callable[[CellPoints], Array]
    missed: Array | None = None
    initial: Datum | None = None
    factor: float = 0.0
    terms: tuple[Term, ...] = ()


def load_oscillation(
    spaces: Spaces,
    data: Data,
    metric: CellMetric,
    flux: CellFlux,
    on_signorini: list[FacetLoad],
    reaction: ReactionTerms | None,
    memory: Memory | None,
    resolution: Resolution,
    of_laws: Projection | None,
    takes_f: Mask,
    enough: float,
) -> Array:
    """osc_T per owned cell (collective).

    Args:
        spaces: The discrete spaces.
        data: The data.
        metric: Metric of the owned cells.
        flux: y.
        on_signorini: The load r on Γ_S, none if it is 0.
        reaction: The terms of cu.
        memory: What a step in time takes from those before; None if it is constant on each cell.
        resolution: Records what quadrature may have missed.
        of_laws: The load s_T − η of laws in Ω, see `inside`; None without laws.
        takes_f: Mask of the owned cells where f − f_h is no load, as a law takes f as it is.
        enough: What a cell may have without a sharper look.
    """
    mesh = spaces.mesh
    facet_loads = [*on_signorini]
    if data.g_N.number is None:
        on_neumann = facet_quadrature(mesh, spaces.neumann_facets, quadrature_degree(data.g_N, power=2))
        g_h = normal_flux(flux, on_neumann)
        g_N, missed = on_facets("g_N", data.g_N, on_neumann, on_neumann.means(g_h), metric, resolution)
        rest = g_N - g_h
        facet_loads.append(FacetLoad(on_neumann, rest - on_neumann.means(rest)[:, None], missed))
    of_load, cell = OF_LAW if of_laws is not None else OF_LOAD, mesh.basix_cell()
    of_load = ENCLOSED[mesh.topology.dim] if spaces.degree else of_load
    load = _load(spaces, data, metric, flux, resolution, takes_f, of_load)
    if of_laws is not None:
        load = of_laws if load is None else load.plus(of_laws)
    if memory is not None and data.memory is not None:
        taken = np.zeros(len(metric.volume), dtype=bool) if reaction is None else reaction.takes
        remembered = _remembered(spaces, data.means_of_memory, metric, memory, resolution, taken)
        load = remembered if load is None else load.plus(remembered)
    if reaction is None:
        return load_norms(cell, metric, load, facet_loads, enough)
    load = reaction.load if load is None else reaction.load.plus(load)
    size = load.norms(math.factorial(mesh.topology.dim) * metric.volume)
    with np.errstate(divide="ignore"):
        by_reaction = load_norms(cell, metric, None, facet_loads) + np.where(
            size > 0, size / np.sqrt(reaction.least), 0.0
        )
    return np.minimum(load_norms(cell, metric, load, facet_loads, enough), by_reaction)


def on_facets(
    name: str, datum: Datum, points: FacetPoints, means: Array, metric: CellMetric, resolution: Resolution
) -> tuple[Array, Array]:
    """A flux in the points of a quadrature, as quadratics if it is enclosed, and the L² norm of the rest (collective).

    Args:
        name: Name of the flux.
        datum: The flux.
        points: The points, in all facets where it is given.
        means: Its mean per facet.
        metric: Metric of the owned cells.
        resolution: Records what quadrature may have missed.
    """
    values = datum.values(points)
    if not resolution.encloses(name, datum):
        return values, np.zeros(len(values))
    facet, weights = facet_type(points.mesh.topology.dim), points.weights / points.weights.sum()
    projection = projected(values - means[:, None], facet, OF_FLUX, points.points, points.weights)
    places = points.points, quadratic_nodes(facet)
    in_points, in_nodes = (means[:, None] + at_points(projection, facet, OF_FLUX, x) for x in places)
    seen = Rest(quadratic(points.vertices, in_nodes), *_moments(values - in_points, weights))
    return in_points, resolution.on_facets(name, datum, seen, points, metric)


def _moments(values: Array, weights: Array) -> tuple[Array, Array]:
    """Root mean square and mean over points with weights whose sum is 1."""
    return np.sqrt(values**2 @ weights), values @ weights


def _remembered(
    spaces: Spaces, load_h: Array, metric: CellMetric, memory: Memory, resolution: Resolution, taken: Mask
) -> Projection:
    """What a step takes from those before, without its means; 0 in cells where it is taken already (collective)."""
    u, cell, number = memory.initial, spaces.mesh.basix_cell(), len(load_h)
    degree = OF_MEMORY + 2 * spaces.degree + (0 if memory.missed is None else 2 * DEGREE)
    of_load = HIGH[metric.jacobian.shape[1]] if spaces.degree else OF_LOAD
    volume = 1 / math.factorial(metric.jacobian.shape[1])

    def less(points: CellPoints) -> Array:
        return memory.values(points) - load_h[points.rows, None]

    def recorded(load: Projection, means: Array, name: str, missed: Array) -> Projection:
        """A load with means that are more than rounding and with what may be missed of it; both are recorded."""
        load, means, missed = load.without(taken), np.where(taken, 0.0, means), np.where(taken, 0.0, missed)
        resolution.add_means(name, np.where(np.abs(means) > ROUNDING * np.abs(load_h), means, 0.0), metric)
        resolution.add_load(name, Interval(-missed, missed), missed, metric)
        return replace(load, rest=(np.sqrt(load.rest) + missed * np.sqrt(volume)) ** 2)

    if u is None:
        load, means = _projected(spaces, less, degree, of_load)
        return load.without(taken) if memory.missed is None else recorded(load, means, "capacity", memory.missed)
    degree = max(degree, quadrature_degree(u, power=2))
    missed = np.zeros(number) if memory.missed is None else memory.missed
    if not resolution.encloses("initial", u):
        return recorded(*_projected(spaces, less, degree, of_load), "initial", missed)
    nodes = np.concatenate(
        [u.values(some) for some in in_cells(spaces.mesh, owned_cells(spaces.mesh), quadratic_nodes(cell))]
    )
    p, norm, mean = quadratic(resolution.vertices, nodes), np.empty(number), np.empty(number)

    def values(points: CellPoints) -> Array:
        rest = u.values(points) - p.of(points.cells).at(points.arms)[:, :, 0]
        norm[points.cells], mean[points.cells] = _moments(rest, points.weights / points.weights.sum())
        return less(points) - memory.factor * rest

    load, means = _projected(spaces, values, degree, of_load)
    load, others = recorded(load, means, "initial", missed), np.flatnonzero(~taken)
    seen, factor, rest = Rest(p, norm, mean).of(others), np.full(len(others), memory.factor), np.zeros(number)
    rest[others] = resolution.on_cells("initial", u, seen, metric, others, factor)
    return replace(load, rest=(np.sqrt(load.rest) + rest * np.sqrt(volume)) ** 2)


def _projected(
    spaces: Spaces, load: Callable[[CellPoints], Array], degree: int, of_load: int = OF_LOAD
) -> tuple[Projection, Array]:
    """A load on the owned cells less its means, and these; the quadrature is for squares of `degree` (collective)."""
    cell = spaces.mesh.basix_cell()
    points, weights = positive_quadrature(cell, degree)
    parts, means = [], []
    for some in in_cells(spaces.mesh, owned_cells(spaces.mesh), points, weights):
        values = load(some)
        means.append(some.means(values))
        parts.append(projected(values - means[-1][:, None], cell, of_load, points, weights))
    names = ("coefficients", "rest")
    return Projection(*(np.concatenate([getattr(part, name) for part in parts]) for name in names)), np.concatenate(
        means
    )


def _load(
    spaces: Spaces, data: Data, metric: CellMetric, flux: CellFlux, resolution: Resolution, takes_f: Mask, of_load: int
) -> Projection | None:
    """The load f − f_h on the owned cells, f_h without `Data.memory`; None if it is 0, as f is a number (collective).

    For RT1 f_h has the mean of this one, and the slope of −∇·y. Where f is enclosed, its projection has the degree
    `of_load`.
    """
    if data.f.number is not None and not isinstance(flux, RT1Flux):
        return None
    cell, means_of_f, degree = spaces.mesh.basix_cell(), data.means_of_f, quadrature_degree(data.f, power=2)
    enclosed = resolution.encloses("f", data.f)
    if enclosed and resolution.returns and not isinstance(flux, RT1Flux):  # what is made of f alone returns
        of_f = _projected(spaces, data.f.values, degree)[1]
        off = np.where(takes_f, 0.0, of_f - means_of_f)
        is_more = np.abs(off) > ROUNDING * np.abs(owned_values(data.f_h))
        resolution.add_means("f", np.where(is_more, off, 0.0), metric)
        means_of_f = of_f

    def f_h(points: CellPoints) -> Array:
        means = np.repeat(means_of_f[points.rows, None], points.shape[1], axis=1)
        if not isinstance(flux, RT1Flux):
            return means
        divergence = flux.divergence_at(points)
        return means + flux.divergence[points.rows].mean(axis=1, keepdims=True) - divergence

    high = HIGH[spaces.mesh.topology.dim]
    of_load = of_load if enclosed else OF_LOAD if data.f.number is not None else high
    load, means = _projected(spaces, lambda points: data.f.values(points) - f_h(points), degree, of_load)
    load = load.without(takes_f)
    if enclosed:
        cells, (places, weights) = owned_cells(spaces.mesh)[~takes_f], basix.make_quadrature(cell, 2 * of_load)
        f_there = [f_h(points) for points in in_cells(spaces.mesh, owned_cells(spaces.mesh), places)]
        basis = orthonormal(cell, of_load).tabulate(0, places)[0][:, :, 0]
        coefficients = np.concatenate(f_there) @ (weights[:, None] * basis)
        coefficients[:, 1:] += load.coefficients
        p = Polynomial(coefficients, barycentric_gradients(resolution.vertices), of_load)
        volume = 1 / math.factorial(metric.jacobian.shape[1])
        seen = Rest(p, np.hypot(np.sqrt(load.rest / volume), means), means).of(cells)
        load.rest[cells] = resolution.on_cells("f", data.f, seen, metric, cells) ** 2 * volume
    return load.padded(orthonormal(cell, high).dim - 1) if spaces.degree and of_load > OF_LOAD else load
