"""What the loads do within cells and facets, which the stresses of an elastic solution do not balance."""

from __future__ import annotations

import basix
import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.certificate.korn import korn_constants, trace_constants
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.points import CellPoints, in_facets
from signorini_fenicsx.physics.elasticity.data import MOST, ElasticData, blocks_of_cells
from signorini_fenicsx.physics.elasticity.johnson_mercier import (
    SIMPLEX,
    Cells,
    SplitQuadrature,
)
from signorini_fenicsx.physics.elasticity.problem import NORMAL
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.vector_datum import VectorDatum


def load_oscillation(solution: ElasticSolution) -> Array:
    """(C_T ‖f − f_h‖_T + Σ t_T ‖g_N − Π₁g_N‖_e)/√min(2μ, 2μ + dλ) of the owned cells (collective)."""
    spaces, data = solution.spaces, solution.data
    found = _of_force(solution)
    facets = spaces.neumann
    edges = Cells(spaces.vertices[facets.cells]).derivative
    constants = trace_constants(edges, facets.measure)
    np.add.at(found, facets.cells, constants * np.sqrt(_of_tractions(spaces, data)))
    for cells in blocks_of_cells(spaces):
        inverse, theta = data.moduli(data.points(spaces, cells))
        soft = np.minimum(1.0, 1 / np.maximum(1 - spaces.dim * theta, 1e-300)).min(axis=1) / inverse.max(axis=1)
        found[cells] /= np.sqrt(soft)
    return found


def _of_force(solution: ElasticSolution) -> Array:
    """C_T ‖f − f_h‖_T (collective)."""
    spaces, data, dim = solution.spaces, solution.data, solution.spaces.dim
    found = np.zeros(len(spaces.order))
    if data.f.polynomial == 0:
        return found
    rule = SplitQuadrature.of_degree(dim, _degree_of_square(data, data.f))
    for numbers in blocks_of_cells(spaces):
        cells = Cells(spaces.vertices[numbers])
        volume = cells.measure / (dim + 1)
        inward = cells.hat_gradients / volume[:, None, None, None]
        divergence = np.einsum("nsvij,nsvj->nsi", solution.stresses[numbers], inward)
        points = CellPoints(spaces.mesh, numbers, rule.points, rule.weights)
        load = data.f.values(points).reshape(len(numbers), dim + 1, len(rule.weights), dim)
        load = np.take_along_axis(load, spaces.order[numbers][:, :, None, None], axis=1)
        left = np.einsum("q,nsqi->n", rule.weights, (load + divergence[:, :, None]) ** 2) * volume
        found[numbers] = korn_constants(cells.derivative) * np.sqrt(left)
    return found


def _of_tractions(spaces: ElasticSpaces, data: ElasticData) -> Array:
    """‖g_N − Π₁g_N‖²_e over the facets `neumann`, in the directions in which u is not given (collective)."""
    facets, dim = spaces.neumann, spaces.dim
    products = np.zeros((len(facets.facets), dim, dim))
    for name, datum in data.g_N.items():
        if datum.polynomial is not None and datum.polynomial <= 1:
            continue
        part = spaces.part(name) if name else facets
        points, weights = basix.make_quadrature(SIMPLEX[dim - 1], _degree_of_square(data, datum))
        hats, weights = np.column_stack([1 - points.sum(axis=1), points]), weights / weights.sum()
        linear = hats @ np.linalg.solve((weights * hats.T) @ hats, weights * hats.T)
        values = datum.values(in_facets(spaces.mesh, part.facets, points))
        left = values - np.einsum("qp,npi->nqi", linear, values)
        products[np.searchsorted(facets.facets, part.facets)] = np.einsum(
            "n,q,nqi,nqj->nij", part.measure, weights, left, left
        )
    squares: Array = np.einsum("nii->n", products)
    for part, k, letter in spaces.fixed[dim:]:
        here = np.searchsorted(facets.facets, part.facets)
        given = part.normals if letter == NORMAL else np.broadcast_to(np.eye(dim)[k], part.normals.shape)
        squares[here] -= np.einsum("ni,nij,nj->n", given, products[here], given)
    return np.maximum(squares, 0.0)


def _degree_of_square(data: ElasticData, datum: Datum | VectorDatum) -> int:
    """Degree of a quadrature that is exact for the square of a datum, if there is one."""
    degree = data.quadrature.degree if datum.polynomial is None else min(2 * datum.polynomial, MOST)
    return max(degree, data.quadrature.degree)
