"""What quadrature may miss of data that v contains themselves: u_D, ψ, other bounds and levels, an obstacle.

Let d be the difference between such a datum and its P2 interpolant. v contains χd near Γ_D and Γ_S, with a χ that is
linear, or a product of two such functions, on each cell.

- If d is on T within ρ of a polynomial, and ∇d within ρ' of its gradient, quadrature misses of ‖κ^½∇v − κ^-½y‖_T at
  most 2κ_max^½|T|^½ (ρ' + |∇χ|ρ), because it integrates the squares of polynomials exactly.
- In any case it misses at most κ_max^½ (‖∇d‖ + ‖∇d‖_Q + |∇χ|(‖d‖ + ‖d‖_Q)), with the norms by quadrature ‖·‖_Q.

The smaller of both is added. Where such bounds of ∇d are not known, this is said.

On Γ_S the gap has ⟨λ, v − ψ⟩, of which quadrature may miss |e| λ_max times 2ρ, or ‖d‖ + ‖d‖_Q as means. With an obstacle
in Ω the gap has (λ, v − ψ) in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.certificate.admissible_trace import Trace
from signorini_fenicsx.certificate.interpolants import in_nodes, quadratic_of
from signorini_fenicsx.certificate.local_fluxes import positive_quadrature
from signorini_fenicsx.certificate.metric import CellMetric
from signorini_fenicsx.certificate.obstacle import Force
from signorini_fenicsx.certificate.resolution import SHARE, SMALLEST, Resolution, of_all_cells
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.expressions import Tree
from signorini_fenicsx.expressions.enclosures import slopes, tilts
from signorini_fenicsx.expressions.quadratics import barycentric_gradients

CUT_OFFS = 4.0
"""|∇χ| is at most this times the largest gradient of a barycentric coordinate."""


@dataclass(frozen=True)
class Hidden:
    """What is added per owned cell.

    Attributes:
        slope: To ‖κ^½∇v − κ^-½y‖_T.
        gap: To twice the gap.
    """

    slope: Array
    gap: Array


def hidden_parts(
    resolution: Resolution, trace: Trace, metric: CellMetric, pressures: list[Pressure], force: Force | None
) -> Hidden:
    """Bound what may be hidden (collective).

    Args:
        resolution: Encloses the data.
        trace: Has v.
        metric: Metric of the owned cells.
        pressures: What presses v against bounds on Γ_S.
        force: λ of an obstacle in Ω, None without one.
    """
    slope, gap = np.zeros((2, len(metric.volume)))
    for held in trace.held:
        tree = resolution.tree(held.name, held.datum)
        if tree is not None:
            slope[held.cells] += _missed(resolution, held.name, tree, held.cells, metric, trace.degree)[0]
    for pressure in pressures:
        tree = resolution.tree(pressure.name, pressure.datum)
        if tree is not None:
            gap += pressure.missed(resolution, tree, len(gap))
    obstacle = resolution.data.obstacle
    tree = None if obstacle is None else resolution.tree("obstacle", obstacle.psi)
    if tree is not None and force is not None:
        cells = _cells_of_obstacle(resolution, trace, tree)
        steep, size = _missed(resolution, "obstacle", tree, cells, metric, trace.degree)
        slope[cells] += steep
        gap[cells] += 2 * force.largest[cells] * metric.volume[cells] * size
    return Hidden(slope, gap)


def _missed(
    resolution: Resolution, name: str, tree: Tree, cells: Indices, metric: CellMetric, degree: int
) -> tuple[Array, Array]:
    """What quadrature of a degree may miss on cells of ‖κ^½∇(χd)‖, and of the mean of |d| (collective)."""
    comm, vertices = resolution.spaces.mesh.comm, resolution.vertices[cells]
    inverse = of_all_cells(metric.inverse, len(metric.volume))[cells]
    factor = metric.volume[cells] * metric.high[cells] / np.linalg.eigvalsh(inverse)[:, 0]
    weight = factor / max(SHARE * resolution.error, SMALLEST) ** 2
    limit = 1 / np.sqrt(max(comm.allreduce(len(cells)), 1) * weight)
    value, gradient = (2 * each for each in slopes(tree, vertices, resolution.frame, limit / 4))
    rough = gradient > limit / 2
    p = quadratic_of(vertices, in_nodes(tree, vertices)).of(rough)
    found = tilts(tree, vertices[rough], p, resolution.frame, weight[rough])
    seen = _seen(tree, vertices[rough], p, degree)
    decay = CUT_OFFS * np.linalg.norm(barycentric_gradients(vertices), axis=2).max(axis=1, initial=0.0)
    with np.errstate(invalid="ignore"):
        one = gradient + decay * value
        other = found.tilt + seen[1] + decay[rough] * (found.norm + seen[0])
    better = np.zeros(len(cells), dtype=bool)
    better[rough] = other < one[rough]
    one[rough], value[rough] = np.fmin(one[rough], other), np.fmin(value[rough], found.norm + seen[0])
    unknown = ~np.isfinite(one)
    place = vertices.mean(axis=1)
    place[rough] = found.place
    resolution.doubt(f"no bound of the gradient of {name} is known", place[unknown], cells[unknown])
    missed = np.sqrt(factor) * np.where(unknown, 0.0, one)
    resolution.record_size(name, cells, missed**2)
    return missed, value


def _seen(tree: Tree, vertices: Array, p: Quadratic, degree: int) -> tuple[Array, Array]:
    """Root mean squares of d and of |∇d| over the points of a quadrature."""
    points, weights = positive_quadrature(SIMPLEX[vertices.shape[1]], degree)
    x, weights = vertices[:, :1] + points @ (vertices[:, 1:] - vertices[:, :1]), weights / weights.sum()
    value, gradient = values_and_gradient(tree, dict(zip("xyz", np.moveaxis(x, -1, 0), strict=False)))
    jet = p.at(x - vertices.mean(axis=1, keepdims=True))
    return np.sqrt((value - jet[:, :, 0]) ** 2 @ weights), np.sqrt(
        ((gradient - jet[:, :, 1:]) ** 2).sum(axis=2) @ weights
    )


@dataclass(frozen=True)
class Pressure:
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
        points, vertices = self.points, self.points.vertices
        size = points.integrals(2 * LEBESGUE * np.repeat(self.largest[:, None], points.shape[1], axis=1))
        enough = (SHARE * resolution.error) ** 2 / np.maximum(
            resolution.spaces.mesh.comm.allreduce(size.sum()), SMALLEST
        )
        rho = 2 * distances(tree, vertices, resolution.frame, np.full(len(vertices), enough / 4))
        rough = (rho > enough / 2) & (size > 0)
        p = quadratic_of(vertices, in_nodes(tree, vertices)).of(rough)
        weight = size[rough] / enough
        found = means(
            tree, vertices[rough], p, resolution.frame, np.ones(np.count_nonzero(rough)) / max(enough, SMALLEST) ** 2
        )
        seen = _seen(tree, vertices[rough], p, 8)[0]
        rho[rough] = np.fmin(rho[rough], found.norm + seen)
        missed = np.where(size > 0, size * rho, 0.0)
        resolution.record_size(self.name, points.cells, missed)
        return points.per_cell(missed, number)
