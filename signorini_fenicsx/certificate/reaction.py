"""What the term cu adds to the certificate.

Errors are measured by ‖w‖² = |∇w|² + ‖c^½w‖², and the gap has ½‖c^-½ r‖² with r = f + ∇·y − cv, see
`forms/certificate.py`. Let ∇·y = −f_h + c_h u* on each cell T, with a number u* near u_h. Of r the part g = δc is left
in the gap, with the number δ for which r − g has mean 0 on T: ‖c^-½ g‖² = δ²∫c. With all of r the gap would be 3 to 32
times too large. r − g is a load like f − f_h, for which

    (r − g, w)_T ≤ min(the factor of `local_fluxes`, c^-½‖r − g‖_T) ‖w‖_T.

For c a quadratic p stands, with mean p_T, and S ≥ |c − p|: r is f − f_h + (p_T u* − pv), δ = ∫p(u* − v)/∫p, and

    |(c_h − p_T)u* + (p − c)(v + δ)| ≤ |c_h − p_T| |u*| + S(|v| + |δ|)

is a load whose mean is not known. Where p_T ≤ 0, δ is 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.small_matrices import squares_of
from signorini_fenicsx.certificate.admissible_trace import Trace
from signorini_fenicsx.certificate.enclosures import cell_vertices
from signorini_fenicsx.certificate.interpolants import bernstein
from signorini_fenicsx.certificate.local_fluxes import OF_LOAD, Projection, positive_quadrature, projected
from signorini_fenicsx.certificate.metric import CellMetric
from signorini_fenicsx.certificate.resolution import Resolution
from signorini_fenicsx.discrete.datum import quadrature_degree
from signorini_fenicsx.discrete.points import CellPoints, in_cells, owned_cells
from signorini_fenicsx.expressions import TREES, polynomial_degree
from signorini_fenicsx.expressions.quadratics import Quadratic, constant, interpolated
from signorini_fenicsx.physics.diffusion.data import Data
from signorini_fenicsx.physics.diffusion.spaces import Spaces

SQUARE = 8
"""Degree of (pv)² for two quadratics."""


@dataclass(frozen=True)
class ReactionTerms:
    """The terms of cu, per owned cell.

    Attributes:
        gap: ‖c^-½ g‖².
        load: r − g without f − f_h.
        least: Lower bound of c.
    """

    gap: Array
    load: Projection
    least: Array


@dataclass(frozen=True)
class _Coefficient:
    """The datum c as p and S per owned cell.

    Attributes:
        values: p in points.
        deviation: S.
        least: Lower bound of c.
    """

    values: Callable[[CellPoints], Array]
    deviation: Array
    least: Array


def reaction_terms(
    spaces: Spaces, data: Data, metric: CellMetric, trace: Trace, u: fem.Function, resolution: Resolution
) -> ReactionTerms | None:
    """The terms for the admissible function of a trace and u* in P0; None where c = 0 (collective)."""
    if data.c_h is None:
        return None
    mesh, number = spaces.mesh, len(metric.volume)
    cell, dim = mesh.basix_cell(), mesh.topology.dim
    nodes = np.abs(trace.v.x.array[trace.v.function_space.dofmap.list[:number]]).max(axis=1)
    coefficient = _coefficient(data, metric, resolution, np.maximum(nodes, np.abs(u.x.array)))
    delta, mean, missed = np.zeros(number), np.zeros(number), np.zeros(number)
    load = Projection(np.zeros((number, dim)), np.zeros(number))
    squares = SQUARE if "c" not in resolution.by_quadrature else max(SQUARE, quadrature_degree(data.c, power=2))
    far = np.setdiff1d(owned_cells(mesh), trace.cells)
    for near, cells, degree in ((False, far, squares), (True, trace.cells, max(trace.degree, squares))):
        points, weights = positive_quadrature(cell, degree)
        for some in in_cells(mesh, cells, points, weights):
            own = some.cells
            v, p, level = trace.jet(some, near=near)[:, :, 0], coefficient.values(some), u.x.array[own]
            mean[own] = some.means(p)
            lacking = some.means(p * (level[:, None] - v))
            known = mean[own] > 0
            delta[own] = np.divide(lacking, mean[own], out=np.zeros(len(own)), where=known)
            values = (mean[own] * level)[:, None] - p * (v + delta[own, None])
            missed[own] = np.where(known, 0.0, np.abs(lacking))
            largest = np.maximum(nodes[own], np.abs(v).max(axis=1, initial=0.0))
            missed[own] += coefficient.deviation[own] * (largest + np.abs(delta[own]))
            part = projected(values - some.means(values)[:, None], cell, OF_LOAD, points, weights)
            load.coefficients[own], load.rest[own] = part.coefficients, part.rest
    missed += np.abs(data.c_h.x.array - mean) * np.abs(u.x.array)
    resolution.add_load(missed, metric)
    load.rest[:] = (np.sqrt(load.rest) + missed * np.sqrt(weights.sum())) ** 2
    gap = delta**2 * (np.maximum(mean, 0.0) + coefficient.deviation) * metric.volume
    return ReactionTerms(gap, load, coefficient.least)


def _coefficient(data: Data, metric: CellMetric, resolution: Resolution, size: Array) -> _Coefficient:
    """Both p and S for a c that is given as text; other c as they are (collective). `size`: that of u on each cell."""
    number, dim = len(metric.volume), metric.jacobian.shape[1]
    deviation, least = np.zeros(number), np.zeros(number)
    if not resolution.given_as_text("c"):
        return _Coefficient(data.c.values, deviation, least)
    vertices, p = cell_vertices(resolution.spaces.mesh), constant(np.zeros(number), dim)
    length = resolution.volume ** (1 / dim)
    tolerance = resolution.flux(metric) / (length * np.maximum(size, 1e-300))
    for tree, cells in resolution.of_regions("c"):
        assert isinstance(tree, TREES)
        q = interpolated(tree, vertices[cells])
        p.value[cells], p.gradient[cells], p.hessian[cells] = q.value, q.gradient, q.hessian
        degree = polynomial_degree(tree)
        if degree is None or degree > 2:
            found = resolution.enclosed("c", tree, vertices[cells], q, tolerance[cells], cells, "sup")
            deviation[cells] = found.sup
    least = np.maximum(bernstein(p, vertices).min(axis=1) - deviation, 0.0)
    return _Coefficient(lambda points: _values(p, points), deviation, least)


def _values(p: Quadratic, points: CellPoints) -> Array:
    own = points.cells
    linear = p.value[own, None] + (points.arms @ p.gradient[own, :, None])[:, :, 0]
    found: Array = linear + squares_of(points.arms, p.hessian[own]) / 2
    return found
