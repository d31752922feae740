"""What the loads do within cells and facets, which the stresses of an elastic solution do not balance.

On each cell f − f_h and, on Γ_N, g_N − Π₁g_N are orthogonal to linear fields. Their projections to quadratic fields on
each subcell and to cubic ones on each facet are balanced by local stresses, whose norms are computed. What is left
after that is orthogonal to linear fields as well, and the constants of `korn` bound it.
"""

from __future__ import annotations

import basix
import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.discrete.lattices import lagrange, lattice, numbers_in
from signorini_fenicsx.discrete.points import CellPoints, in_facets
from signorini_fenicsx.physics.elasticity.bound.korn import korn_constants, trace_constants
from signorini_fenicsx.physics.elasticity.bound.local_fields import INSIDE, ON_FACETS, local_stresses
from signorini_fenicsx.physics.elasticity.bound.resolution import beyond
from signorini_fenicsx.physics.elasticity.data import MOST, ElasticData, blocks_of_cells
from signorini_fenicsx.physics.elasticity.johnson_mercier import (
    SIMPLEX,
    Cells,
    SplitQuadrature,
    facet_normals,
    split_vertices,
)
from signorini_fenicsx.physics.elasticity.problem import NORMAL
from signorini_fenicsx.physics.elasticity.spaces import BoundaryFacets, ElasticSpaces
from signorini_fenicsx.physics.elasticity.vector_datum import PressureDatum, VectorDatum


def load_oscillation(spaces: ElasticSpaces, data: ElasticData, stresses: Array) -> Array:
    """How large (f − f_h, w)_T + ⟨g_N − Π₁g_N, w⟩ may be beside |w|_T, for the owned cells (collective).

    Args:
        spaces: The spaces.
        data: The data.
        stresses: Values of σ_h, as in `SplitMesh.values`.
    """
    dim, found = spaces.dim, np.zeros(len(spaces.order))
    cells_of, local, traction = _tractions(spaces, data, found)
    for numbers in blocks_of_cells(spaces):
        cells = Cells(spaces.vertices[numbers])
        compliance = above(data.compliances(spaces, numbers))
        compliance += beyond(spaces, data, numbers)[:, None, None] * np.eye(compliance.shape[1])
        inside, missed = _force(spaces, data, stresses, numbers)
        rows = np.flatnonzero(np.isin(cells_of, numbers))
        on_facets = np.zeros((len(numbers), dim + 1, *traction.shape[1:]))
        np.add.at(on_facets, (cells_of[rows] - numbers[:1], local[rows]), traction[rows])
        found[numbers] += korn_constants(cells.derivative) * missed
        found[numbers] *= np.sqrt(np.linalg.eigvalsh(compliance)[:, -1])
        if len(numbers) > 0 and (inside.any() or on_facets.any()):
            found[numbers] += local_stresses(dim).least_norms(cells, inside, on_facets, compliance)
    return found


def above(compliance: Array) -> Array:
    """For each cell one compliance that is at least those in its points, and equal to them if they are equal."""
    mean = compliance.mean(axis=1)
    root = np.linalg.inv(np.linalg.cholesky(mean))[:, None]
    largest = np.linalg.eigvalsh(root @ compliance @ root.swapaxes(-1, -2)).max(axis=(1, 2), initial=0.0)
    found: Array = largest[:, None, None] * mean
    return found


def _force(
    spaces: ElasticSpaces, data: ElasticData, stresses: Array, numbers: npt.NDArray[np.int32]
) -> tuple[Array, Array]:
    """The part of f − f_h quadratic on subcells, in their lattices, and the L² norm of the rest (collective)."""
    dim, places = spaces.dim, lattice(spaces.dim + 1, INSIDE)
    if data.f.polynomial == 0:
        return np.zeros((len(numbers), dim + 1, len(places), dim)), np.zeros(len(numbers))
    rule = SplitQuadrature.of_degree(dim, _degree_of_square(data, data.f))
    points = CellPoints(spaces.mesh, numbers, rule.points, rule.weights)
    values = data.f.values(points).reshape(len(numbers), dim + 1, len(rule.weights), dim)
    basis = lagrange(rule.local, INSIDE)
    quadratic = np.einsum("nsqi,aq->nsai", values, _fit(basis, rule.weights))
    rest = values - np.einsum("qa,nsai->nsqi", basis, quadratic)
    cells = Cells(spaces.vertices[numbers])
    volume = cells.measure / (dim + 1)
    inward = -facet_normals(split_vertices(cells.vertices).reshape(-1, dim + 1, dim)) / dim
    inward = inward.reshape(len(numbers), dim + 1, dim + 1, dim) / volume[:, None, None, None]
    balanced = -np.einsum("nsvij,nsvj->nsi", stresses[numbers], inward)
    cell, subcell, vertex = spaces.as_dolfinx(numbers)
    there = np.zeros((*vertex.shape[:2], len(places), dim + 1), dtype=np.int64)  # the lattice in DOLFINx's order
    np.put_along_axis(there, vertex[:, :, None], np.broadcast_to(places, there.shape), axis=3)
    found = quadratic[cell, subcell, numbers_in(there, INSIDE)] - balanced[:, :, None]
    return found, np.sqrt(np.einsum("q,nsqi->n", rule.weights, rest**2) * volume)


def _tractions(spaces: ElasticSpaces, data: ElasticData, found: Array) -> tuple[Indices, Indices, Array]:
    """g_N − Π₁g_N on facets, in the directions in which u is not given (collective).

    What is left after its cubic parts is added to those of the cells in `found`.

    Returns:
        The cells, the facets by their numbers in these, and the cubic parts in the lattices of the facets, of shape
        (facets, points, d).
    """
    dim = spaces.dim
    places = lattice(dim, ON_FACETS)
    cells, local, cubic = [np.empty(0, int)], [np.empty(0, int)], [np.empty((0, len(places), dim))]
    given = [(spaces.part(name) if name else spaces.neumann, datum) for name, datum in data.g_N.items()]
    for part, datum in (*given, *((pull.facets, pull.datum) for pull in data.pulls)):
        if datum.polynomial is not None and datum.polynomial <= 1:
            continue
        points, weights = basix.make_quadrature(SIMPLEX[dim - 1], _degree_of_square(data, datum))
        hats, weights = np.column_stack([1 - points.sum(axis=1), points]), weights / weights.sum()
        values = _without_given(spaces, part, datum.values(in_facets(spaces.mesh, part.facets, points)))
        basis = lagrange(hats, ON_FACETS)
        linear, fitted = (np.einsum("aq,nqi->nai", _fit(each, weights), values) for each in (hats, basis))
        rest = np.sqrt(part.measure * np.einsum("q,nqi->n", weights, (values - basis @ fitted) ** 2))
        constants = trace_constants(Cells(spaces.vertices[part.cells]).derivative, part.measure)
        np.add.at(found, part.cells, constants * rest)
        fitted -= lattice(dim, ON_FACETS) / ON_FACETS @ linear
        there = np.zeros((len(part.facets), len(places), dim), dtype=np.int64)  # the lattice in DOLFINx's order
        np.put_along_axis(there, part.ranking[:, None], np.broadcast_to(places, there.shape), axis=2)
        cubic.append(np.take_along_axis(fitted, numbers_in(there, ON_FACETS)[:, :, None], axis=1))
        cells.append(part.cells)
        local.append(part.local)
    return np.concatenate(cells), np.concatenate(local), np.concatenate(cubic)


def _fit(basis: Array, weights: Array) -> Array:
    """The matrix from values in points to the coefficients of their best approximation, shape (basis, points)."""
    weighted = weights[:, None] * basis
    found: Array = np.linalg.solve(basis.T @ weighted, weighted.T)
    return found


def _without_given(spaces: ElasticSpaces, part: BoundaryFacets, values: Array) -> Array:
    """Tractions on a part without their components along which u is given there, shape (facets, points, d)."""
    values = values.copy()
    for fixed, k, letter in spaces.fixed[spaces.dim :]:
        mine = np.flatnonzero(np.isin(part.facets, fixed.facets))
        axes = np.broadcast_to(np.eye(spaces.dim)[k], (len(mine), spaces.dim))
        axes = part.normals[mine] if letter == NORMAL else axes
        values[mine] -= np.einsum("nqj,nj,ni->nqi", values[mine], axes, axes)
    return values


def _degree_of_square(data: ElasticData, datum: VectorDatum | PressureDatum) -> int:
    """Degree of a quadrature that is exact for the square of a datum, if there is one."""
    degree = data.quadrature.degree if datum.polynomial is None else min(2 * datum.polynomial, MOST)
    return max(degree, data.quadrature.degree, 2 * ON_FACETS)
