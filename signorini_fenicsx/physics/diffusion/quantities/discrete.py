"""Quantities of a discrete solution itself, beside which their intervals stand: of u_h, p_h and σ_h.

Where a part has no p_h its facets have the mean of u there: that of the function on the cell behind with the gradient
κ_h⁻¹σ_h and the mean u_h. By the first equation of the mixed method it is the multiplier of the facet, as p_h is.
"""

from __future__ import annotations

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import owned_cells, owned_values
from signorini_fenicsx.base.reference_cells import positive_quadrature
from signorini_fenicsx.discrete.datum import Datum, quadrature_degree
from signorini_fenicsx.discrete.points import FacetPoints, facet_quadrature, in_cells
from signorini_fenicsx.physics.diffusion.bound.admissible_trace import reconstructed
from signorini_fenicsx.physics.diffusion.bound.laws import Goal, energies
from signorini_fenicsx.physics.diffusion.bound.metric import cell_metric
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.quantities.discrete import mean_of, where
from signorini_fenicsx.quantities.kinds import Integral


def of_trace(solution: Solution, kind: Integral, weight: Datum) -> float:
    """The integral of weight·u, or its mean, with u_h in cells and p_h, or the mean of u, on facets (collective)."""
    spaces, sums = solution.spaces, np.zeros(2)
    for points in where(solution.spaces, kind, weight):
        weights = points.integrals(weight.values(points))
        u = _on_facets(solution, points) if isinstance(points, FacetPoints) else owned_values(solution.u)[points.rows]
        sums += weights @ u, weights.sum()
    return mean_of(kind, spaces.mesh.comm.allreduce(sums))


def of_energy(solution: Solution, goal: Goal) -> float:
    """½(κ⁻¹σ_h, σ_h) + ½(cu, u) − (f, u) − ⟨g_N, u⟩ on Γ_N, and φ of the laws at p_h and u_h (collective).

    Here u is the function with the gradient κ_h⁻¹σ_h and the mean u_h on each cell.
    """
    spaces, data, mesh = solution.spaces, solution.data, solution.spaces.mesh
    u, laws = owned_values(solution.u), () if data.inside is None else data.inside.of_regions
    given = (data.f, data.c, data.g_N, *(datum for part in (*laws, *goal.parts) for datum in part.data.values()))
    degree = quadrature_degree(*given)
    rule = positive_quadrature(mesh.basix_cell(), degree)
    metric = cell_metric(spaces, data)
    total = float(metric.squares(solution.cell_flux).sum()) / 2
    if data.memory is not None:
        total -= float(spaces.cell_measures @ (owned_values(data.memory) * u))
    for points in in_cells(mesh, owned_cells(mesh), *rule):
        v = reconstructed(solution, metric, points)
        total += points.integrals(data.c.values(points) * v**2 / 2 - data.f.values(points) * v).sum()
    for part in laws:
        for points in in_cells(mesh, part.rows.astype(np.int32), *rule):
            values = np.broadcast_to(u[points.rows, None], points.shape)
            total += points.integrals(energies(part, points, values)).sum()
    loaded = facet_quadrature(mesh, spaces.neumann_facets, degree)
    total -= float(loaded.integrals(data.g_N.values(loaded)) @ _means(solution, loaded))
    for part in goal.parts:
        facets, flux_h = spaces.facets[part.rows], None if goal.plain else goal.flux_h[part.rows]
        on = facet_quadrature(mesh, facets, degree)
        p = np.broadcast_to(solution.p.x.array[part.rows, None], on.shape)
        total += on.integrals(energies(part, on, p, flux_h)).sum()
    return float(mesh.comm.allreduce(total))


def _on_facets(solution: Solution, points: FacetPoints) -> Array:
    """p_h on the facets of Γ_S, inside the domain the jump, and the mean of u on others (collective)."""
    u, facets = _means(solution, points), solution.spaces.facets
    order = np.argsort(facets)
    on_gamma_s = np.isin(points.facets, facets)
    rows = order[np.searchsorted(facets[order], points.facets[on_gamma_s])]
    u[on_gamma_s] = solution.p.x.array[rows]
    return u


def _means(solution: Solution, points: FacetPoints) -> Array:
    """The mean of u on each of some facets (collective)."""
    return points.means(reconstructed(solution, cell_metric(solution.spaces, solution.data), points))
