"""What the loads do within cells and facets, which the stresses of an elastic solution do not balance.

On each cell f − f_h and, on Γ_N, g_N − Π₁g_N are orthogonal to linear fields. Their projections to quadratic fields on
each subcell and to cubic ones on each facet are balanced by local stresses, whose norms are computed. What is left
after that is orthogonal to linear fields as well, and the constants of `korn` bound it. What quadrature may miss of all
this is in `hidden`.
"""

import numpy as np
import numpy.typing as npt

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.discrete.lattices import lagrange, lattice, numbers_in
from signorini_fenicsx.discrete.linear_traces import blocks_of_cells, facet_normals
from signorini_fenicsx.discrete.points import in_facets
from signorini_fenicsx.physics.elasticity.bound.hidden import (
    fit,
    force_near,
    loads_of,
    missed,
    traction_rule,
    without_given,
)
from signorini_fenicsx.physics.elasticity.bound.korn import korn_constants, trace_constants
from signorini_fenicsx.physics.elasticity.bound.local_fields import INSIDE, ON_FACETS, local_stresses
from signorini_fenicsx.physics.elasticity.bound.passed_on import passed_on
from signorini_fenicsx.physics.elasticity.bound.resolution import Resolution, beyond
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import Cells, split_vertices
from signorini_fenicsx.physics.elasticity.discrete.material import regular
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces


def load_oscillation(resolution: Resolution, stresses: Array, squares: Array) -> tuple[Array, float]:
    """How large (f − f_h, w)_T + ⟨g_N − Π₁g_N, w⟩ may be beside |w|_T, for the owned cells (collective).

    At pairs of surfaces what masters lack of the tractions on slaves is in it, see `passed_on`.

    Returns:
        This, but for what quadrature may have missed of the linear parts of loads, and how large these may be beside
        |w| in all cells together.

    Args:
        resolution: Of the data.
        stresses: Values of σ_h, as in `SplitMesh.values`.
        squares: What the gap of each cell adds to the square of the bound besides.
    """
    spaces, data = resolution.spaces, resolution.data
    dim, of_cells = spaces.dim, np.zeros(len(spaces.order))
    cells_of, local, traction = _tractions(spaces, data, of_cells)
    everywhere = compliances_above(spaces, data)
    for numbers in blocks_of_cells(spaces.mesh):
        cells, compliance = Cells(spaces.vertices[numbers]), everywhere[numbers]
        inside, rest = _force(spaces, data, stresses, numbers)
        rows = np.flatnonzero(np.isin(cells_of, numbers))
        on_facets = np.zeros((len(numbers), dim + 1, *traction.shape[1:]))
        np.add.at(on_facets, (cells_of[rows] - numbers[:1], local[rows]), traction[rows])
        of_cells[numbers] += korn_constants(cells.derivative) * rest
        of_cells[numbers] *= np.sqrt(np.linalg.eigvalsh(compliance)[:, -1])
        if len(numbers) > 0 and (inside.any() or on_facets.any()):
            of_cells[numbers] += local_stresses(dim).least_norms(cells, inside, on_facets, compliance)
    if spaces.pairs:
        of_cells += passed_on(spaces, stresses, everywhere)
    beyond, together = missed(resolution, everywhere, np.sqrt(np.maximum(squares, 0.0)) + of_cells)
    return of_cells + beyond, together


def compliances_above(spaces: ElasticSpaces, data: ElasticData) -> Array:
    """On each owned cell a matrix that is at least 𝔸 there, shape (cells, entries, entries) (collective)."""
    number = spaces.dim * (spaces.dim + 1) // 2
    matrices = np.empty((len(spaces.order), number, number))
    for cells in blocks_of_cells(spaces.mesh):
        matrices[cells] = above(data.compliances(spaces, cells))
        matrices[cells] += beyond(spaces, data, cells)[:, None, None] * np.eye(number)
    return matrices


def above(compliance: Array) -> Array:
    """For each cell one compliance that is at least those in its points, and equal to them if they are equal."""
    mean = compliance.mean(axis=1)
    root = np.linalg.inv(np.linalg.cholesky(regular(mean)))[:, None]
    largest = np.linalg.eigvalsh(root @ compliance @ root.swapaxes(-1, -2)).max(axis=(1, 2), initial=0.0)
    return largest[:, None, None] * mean


def _force(
    spaces: ElasticSpaces, data: ElasticData, stresses: Array, numbers: npt.NDArray[np.int32]
) -> tuple[Array, Array]:
    """The part of f − f_h quadratic on subcells, in their lattices, and the L² norm of the rest (collective)."""
    dim, places = spaces.dim, lattice(spaces.dim + 1, INSIDE)
    if data.f.polynomial == 0:
        return np.zeros((len(numbers), dim + 1, len(places), dim)), np.zeros(len(numbers))
    _, near, rest = force_near(spaces, data, numbers)
    cells = Cells(spaces.vertices[numbers])
    volume = cells.measure / (dim + 1)
    inward = -facet_normals(split_vertices(cells.vertices).reshape(-1, dim + 1, dim)) / dim
    inward = inward.reshape(len(numbers), dim + 1, dim + 1, dim) / volume[:, None, None, None]
    balanced = -np.einsum("nsvij,nsvj->nsi", stresses[numbers], inward)
    cell, subcell, vertex = spaces.as_dolfinx(numbers)
    in_order = np.zeros((*vertex.shape[:2], len(places), dim + 1), dtype=np.int64)  # the lattice in DOLFINx's order
    np.put_along_axis(in_order, vertex[:, :, None], np.broadcast_to(places, in_order.shape), axis=3)
    quadratic = near[cell, subcell, numbers_in(in_order, INSIDE)] - balanced[:, :, None]
    return quadratic, np.sqrt(rest.sum(axis=(1, 2)) * volume)


def _tractions(spaces: ElasticSpaces, data: ElasticData, of_cells: Array) -> tuple[Indices, Indices, Array]:
    """g_N − Π₁g_N on facets, in the directions in which u is not given (collective).

    What is left after its cubic parts is added to those of the cells in `of_cells`.

    Returns:
        The cells, the facets by their numbers in these, and the cubic parts in the lattices of the facets, of shape
        (facets, points, d).
    """
    dim = spaces.dim
    places = lattice(dim, ON_FACETS)
    cells, local, cubic = [np.empty(0, int)], [np.empty(0, int)], [np.empty((0, len(places), dim))]
    for part, datum in loads_of(spaces, data):
        if datum.polynomial is not None and datum.polynomial <= 1:
            continue
        points, weights = traction_rule(data, dim, datum)
        hats = np.column_stack([1 - points.sum(axis=1), points])
        values = without_given(spaces, part, datum.values(in_facets(spaces.mesh, part.facets, points)))
        basis = lagrange(hats, ON_FACETS)
        linear, fitted = (np.einsum("aq,nqi->nai", fit(each, weights), values) for each in (hats, basis))
        rest = np.sqrt(part.measure * np.einsum("q,nqi->n", weights, (values - basis @ fitted) ** 2))
        constants = trace_constants(Cells(spaces.vertices[part.cells]).derivative, part.measure)
        np.add.at(of_cells, part.cells, constants * rest)
        fitted -= lattice(dim, ON_FACETS) / ON_FACETS @ linear
        in_order = np.zeros((len(part.facets), len(places), dim), dtype=np.int64)  # the lattice in DOLFINx's order
        np.put_along_axis(in_order, part.ranking[:, None], np.broadcast_to(places, in_order.shape), axis=2)
        cubic.append(np.take_along_axis(fitted, numbers_in(in_order, ON_FACETS)[:, :, None], axis=1))
        cells.append(part.cells)
        local.append(part.local)
    return np.concatenate(cells), np.concatenate(local), np.concatenate(cubic)
