"""What quadrature may miss of data that v contains themselves: u_D, ψ, bounds in Ω.

v contains χe near Γ_D and Γ_S, with such a datum e and a χ that is linear, or a product of two such functions, on each
cell. Quadrature integrates the squares of polynomials exactly. So it misses of ‖κ^½∇v − κ^-½y‖_T,

- if e is on T within ρ of a polynomial, and ∇e within ρ' of its gradient, at most 2κ_max^½|T|^½ (ρ' + |∇χ|ρ);
- with d = e − P for any polynomial P, at most κ_max^½ (‖∇d‖ + ‖∇d‖_Q + |∇χ|(‖d‖ + ‖d‖_Q)), where the norms ‖·‖_Q are
  by this quadrature.

The smaller of both is added, unless this were more than all other terms of the bound. Then, and where no bound of ∇d
is known, the datum is not resolved: the bound relies on quadrature there, and this is said.

Of v itself it misses at most 2ρ, or ‖d‖ + ‖d‖_Q as means: with c at most so many times that is a load more.

On Γ_S the gap has ⟨λ, v − ψ⟩, of which quadrature may miss λ_max times 2ρ, or ‖d‖ + ‖d‖_Q as means. With a
bound in Ω the gap has (λ, v − ψ) in the same way.
"""

import math
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.owned import cell_dofs
from signorini_fenicsx.base.reference_cells import SIMPLEX
from signorini_fenicsx.discrete.bernstein import coefficients_of, degree_of, degree_with, exponents, in_nodes, to_values
from signorini_fenicsx.discrete.continuity import facet_nodes
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.points import FacetPoints, in_cells
from signorini_fenicsx.expressions import Tree
from signorini_fenicsx.expressions.enclosures import distances, means, projected, ranges, shown, slopes, tilts
from signorini_fenicsx.expressions.series import DEGREE
from signorini_fenicsx.expressions.simplices import barycentric_gradients, constant, quadratic
from signorini_fenicsx.expressions.tree import Negative
from signorini_fenicsx.physics.diffusion.bound.admissible_trace import Trace
from signorini_fenicsx.physics.diffusion.bound.inside import Inside
from signorini_fenicsx.physics.diffusion.bound.local_fields import CellMetric
from signorini_fenicsx.physics.diffusion.bound.rays import Ray, jumps_in_nodes
from signorini_fenicsx.physics.diffusion.bound.resolution import SHARE, SMALLEST, Resolution
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces

CUT_OFFS = 4.0
"""|∇χ| is at most this times the largest gradient of a barycentric coordinate."""
LEBESGUE = 2.0
"""A quadratic is at most so many times its largest value in the points of a quadrature."""
ROUNDING = 1e-12
"""Relative size of what is no jump."""


@dataclass(frozen=True)
class Hidden:
    """Squares and lengths that hidden data add to the bound, per owned cell.

    Attributes:
        slope: To ‖κ^½∇v − κ^-½y‖_T.
        gap: To twice the gap.
        value: To the root mean square of v on T.
    """

    slope: Array
    gap: Array
    value: Array


def hidden_parts(
    resolution: Resolution,
    trace: Trace,
    u_D: Datum,
    metric: CellMetric,
    pressure: "PressedBound | None",
    inside: Inside,
    of_discrete: float,
) -> Hidden:
    """Bound what may be hidden (collective).

    v contains ψ where it touches, and where it was raised to ψ. It cannot have been raised on facets where
    v − I_hψ ≥ sup |ψ − I_hψ|, or where the least coefficient of v is proved to be above ψ.

    Args:
        resolution: Encloses the data.
        trace: Has v.
        u_D: What v is on Γ_D.
        metric: Metric of the owned cells.
        pressure: What presses v against ψ on Γ_S under the law of Signorini alone; None under others.
        inside: The laws in Ω.
        of_discrete: The bound without what is hidden.
    """
    slope, gap, value = np.zeros((3, len(metric.volume)))
    of_v, altered = trace.v.x.array[cell_dofs(trace.v.function_space)], np.isin(np.arange(len(gap)), trace.altered)
    missed = _Missed(resolution, metric, (degree_of(trace.v.function_space), degree_near(trace)), of_discrete)
    if (tree := resolution.tree("u_D", u_D)) is not None:
        cells = trace.at_dirichlet.astype(np.int64)
        steep, value[cells] = missed.of("u_D", tree, cells, _on_dirichlet(resolution.spaces, trace, cells))
        slope[cells] += steep
    if pressure is not None and (tree := resolution.tree(pressure.name, pressure.datum)) is not None:
        on_facets = trace.v.x.array[facet_nodes(trace.v.function_space, pressure.points.facets)]
        beyond = _beyond(resolution, tree, pressure.points.vertices, on_facets, 1.0)
        cells = np.union1d(trace.touching, pressure.points.cells[beyond]).astype(np.int64)
        steep, size = missed.of(pressure.name, tree, cells)
        slope[cells] += steep
        value[cells] += size
        gap += pressure.missed(resolution, tree, len(gap))
    for ray in inside.rays:
        if (tree := resolution.tree(ray.name, ray.datum)) is not None:
            beyond = _beyond(resolution, tree, resolution.vertices, of_v, ray.sign, altered)
            beyond |= ray.pressed & ~ray.touched  # of RT1, where λ varies, so that means are not enough
            cells = np.flatnonzero(beyond)
            steep, size = missed.of(ray.name, tree, cells)
            slope[cells] += steep
            value[cells] += size
            gap[cells] += 2 * inside.largest[cells] * metric.volume[cells] * size
            pressed = np.setdiff1d(np.flatnonzero(ray.pressed & (inside.largest > 0)), cells)
            gap[pressed] += _missed_of_means(resolution, trace, tree, ray, inside, pressed)
    return Hidden(slope, gap, value)


def degree_near(trace: Trace) -> int:
    """Degree of the quadrature in `Trace.cells`: exact for squares of gradients of χe, e of degree K, and two χ."""
    return max(trace.degree, 2 * (DEGREE + 1))


def _beyond(
    resolution: Resolution, tree: Tree, vertices: Array, of_v: Array, sign: float, altered: Mask | None = None
) -> Mask:
    """Mask of the simplices where v may be beyond a bound, or is altered (collective).

    Args:
        resolution: Has the domain.
        tree: The bound.
        vertices: Of the simplices.
        of_v: The coefficients of v on them, shape (n, nodes).
        sign: 1 for a lower bound, −1 for an upper one.
        altered: Mask of those on which v is altered; None for none.
    """
    cell, frame = SIMPLEX[vertices.shape[1] - 1], resolution.spaces.frame
    p, degree = quadratic(vertices, in_nodes(tree, vertices)), degree_with(cell, of_v.shape[1])
    arms = exponents(cell, degree) / degree @ (vertices - vertices.mean(axis=1, keepdims=True))
    of_p, least = coefficients_of(p.at(arms)[:, :, 0], cell), (sign * of_v).min(axis=1, initial=np.inf)
    altered = np.zeros(len(vertices), dtype=bool) if altered is None else altered
    above = np.where(altered, 0.0, np.maximum((sign * (of_v - of_p)).min(axis=1, initial=np.inf), 0.0))
    small = above <= ROUNDING * np.abs(p.value).max(initial=0.0)
    end = np.where(small, np.inf, above)
    beyond = np.asarray(small | (ranges(tree, vertices, p, frame, -end, end).sup > above))
    rows = np.flatnonzero(beyond & ~altered)  # unless the least coefficient of v is proved to be within the bound
    below = Negative(tree) if sign > 0 else tree
    beyond[rows] = ranges(below, vertices[rows], None, frame, -least[rows], np.inf).lo < -least[rows]
    return beyond


def _missed_of_means(
    resolution: Resolution, trace: Trace, tree: Tree, ray: Ray, inside: Inside, cells: Indices
) -> Array:
    """What quadrature may miss of twice (λ, v − ψ) on owned cells where v is quadratic: the mean of ψ (collective)."""
    mesh, vertices, near = resolution.spaces.mesh, resolution.vertices[cells], np.isin(cells, trace.cells)
    seen = np.empty(len(cells))
    for close in (False, True):
        for points in in_cells(mesh, cells[near == close].astype(np.int32), *inside.rule(trace, near=close)):
            seen[np.searchsorted(cells, points.cells)] = points.means(ray.datum.values(points))
    factor = 2 * inside.largest[cells] * resolution.spaces.cell_measures[cells]
    number = max(mesh.comm.allreduce(len(cells)), 1)
    weight = number * (factor / max((SHARE * resolution.error) ** 2, SMALLEST)) ** 2
    mean = means(
        tree, vertices, constant(np.zeros(len(cells)), vertices.shape[2]), resolution.spaces.frame, weight
    ).mean
    missed = np.maximum(ray.sign * seen - np.minimum(ray.sign * mean.lo, ray.sign * mean.hi), 0.0)
    unknown = ~np.isfinite(missed)
    resolution.note(ray.name, vertices[unknown].mean(axis=1), cells[unknown])
    missed[unknown] = 0.0
    resolution.record_missed(ray.name, cells, factor * missed)
    return factor * missed


@dataclass(frozen=True)
class _Missed:
    """What quadrature may miss on cells; gradients that add more than the bound are left out, and noted.

    The degrees are that of v, and that of the quadrature.
    """

    resolution: Resolution
    metric: CellMetric
    degrees: tuple[int, int]
    of_discrete: float

    def of(self, name: str, tree: Tree, cells: Indices, nodes: Array | None = None) -> tuple[Array, Array]:
        """What is missed of ‖κ^½∇(χd)‖ and of the mean of |d|, per cell (collective).

        Args:
            name: Name of the datum.
            tree: The datum.
            cells: Owned cells.
            nodes: Values in their nodes that are interpolated, NaN where any will do; None for those of the datum.
        """
        resolution, metric, vertices = self.resolution, self.metric, self.resolution.vertices[cells]
        comm, frame = resolution.spaces.mesh.comm, resolution.spaces.frame
        factor = metric.volume[cells] * metric.kappa_max[cells]
        rough_kappa = np.sqrt(2 * np.maximum(metric.rho[cells], 0.0) / metric.kappa_min[cells])
        factor = factor * np.where(np.isfinite(rough_kappa), 1 + rough_kappa, 1.0) ** 2  # see `mismatch`
        weight = factor / max(SHARE * resolution.error, SMALLEST) ** 2
        limit = 1 / np.sqrt(max(comm.allreduce(len(cells)), 1) * weight)
        value, gradient = (2 * each for each in slopes(tree, vertices, frame, limit / 4))
        decay = CUT_OFFS * np.linalg.norm(barycentric_gradients(vertices), axis=2).max(axis=1, initial=0.0)
        with np.errstate(invalid="ignore"):
            slope, place = gradient + decay * value, vertices.mean(axis=1)
        rough = ~(gradient <= limit / 2)
        p = projected(tree, vertices[rough])
        rough_tilts = tilts(tree, vertices[rough], p, frame, weight[rough])
        seen = shown(tree, vertices[rough], p, self.degrees[1])
        of_value, of_slope = np.array([rough_tilts.norm, rough_tilts.tilt]) + seen
        slope[rough] = np.fmin(slope[rough], of_slope + decay[rough] * of_value)
        value[rough] = np.fmin(value[rough], of_value)
        place[rough] = rough_tilts.place
        unknown = ~np.isfinite(slope + value) | jumps_in_nodes(tree, vertices, self.degrees[0], nodes).any(axis=1)
        resolution.note(f"the gradient of {name}", place[unknown], cells[unknown])
        slope[unknown], value[unknown] = 0.0, 0.0
        missed = np.sqrt(factor) * slope
        total = math.sqrt(comm.allreduce((missed**2).sum()))
        if total > self.of_discrete:
            worst = missed >= comm.allreduce(missed.max(initial=0.0), MPI.MAX) / 4
            resolution.note(name, place[worst], cells[worst])
            return np.zeros_like(missed), value
        resolution.record_missed(name, cells, missed**2)
        return missed, value


def _on_dirichlet(spaces: Spaces, trace: Trace, cells: Indices) -> Array:
    """The values of v in those nodes of owned cells that are on Γ_D, else NaN; from each side of a cut its own."""
    space, dim = trace.v.function_space, spaces.mesh.topology.dim
    fixed = fem.locate_dofs_topological(space, dim - 1, spaces.dirichlet_facets)
    dofs = space.dofmap.list[cells]
    values = trace.v.x.array[dofs] @ to_values(spaces.mesh.basix_cell(), degree_of(space)).T
    return np.where(np.isin(dofs, fixed), values, np.nan)


@dataclass(frozen=True)
class PressedBound:
    """What presses v against a bound on some facets of Γ_S.

    Attributes:
        name: Name of the bound.
        datum: The bound.
        points: Points of the quadrature for the gap.
        largest: The largest λ in them, per facet; of a λ that is quadratic at most half of its largest value.
    """

    name: str
    datum: Datum
    points: FacetPoints
    largest: Array

    def missed(self, resolution: Resolution, tree: Tree, number: int) -> Array:
        """What quadrature may miss of twice ⟨λ, v − ψ⟩, per owned cell of so many (collective)."""
        points, vertices, comm = self.points, self.points.vertices, resolution.spaces.mesh.comm
        size = points.integrals(2 * LEBESGUE * np.repeat(self.largest[:, None], points.shape[1], axis=1))
        enough = max((SHARE * resolution.error) ** 2 / max(comm.allreduce(size.sum()), SMALLEST), SMALLEST)
        rho = 2 * distances(tree, vertices, resolution.spaces.frame, np.full(len(vertices), enough / 4))
        rough = ~(rho <= enough / 2) & (size > 0)
        p = quadratic(vertices, in_nodes(tree, vertices)).of(rough)
        weight = np.full(len(p.value), 1 / (enough**2 * max(comm.allreduce(np.count_nonzero(rough)), 1)))
        means_of_rough = means(tree, vertices[rough], p, resolution.spaces.frame, weight)
        arms = points.x[rough] - vertices[rough].mean(axis=1, keepdims=True)
        rest = self.datum.values(points)[rough] - p.at(arms)[:, :, 0]
        shown = np.sqrt(rest**2 @ points.weights / points.weights.sum())
        rho[rough] = np.fmin(rho[rough], means_of_rough.norm + shown)
        missed = np.where(size > 0, size * rho, 0.0)
        resolution.record_missed(self.name, points.cells.astype(np.int64), missed)
        return points.per_cell(missed, number)
