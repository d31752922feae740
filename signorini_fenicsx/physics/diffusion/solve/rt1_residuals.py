"""The residuals of a discrete problem with RT1, see `KKTResiduals` in `residuals.py`."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import function_of, sums_at
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Penalty
from signorini_fenicsx.contact.residuals import relative, squares_off
from signorini_fenicsx.discrete.linear_traces import BoundaryFacets, linear_from_means, linear_values
from signorini_fenicsx.physics.diffusion.discrete.cell_flux import CellFlux
from signorini_fenicsx.physics.diffusion.discrete.raviart_thomas import reference
from signorini_fenicsx.physics.diffusion.discrete.rt1_data import RT1Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces
from signorini_fenicsx.physics.diffusion.solve.residuals import KKTResiduals, by_gradient, sizes_of_solution


@dataclass(frozen=True)
class RT1Iterate(Iterate):
    """An `Iterate` of RT1: σ in RT1, u in P1 on cells.

    Attributes:
        means: The mean of û by the hat of each facet vertex of Γ_S; p is this less ψ, or that of `VertexLaws.openings`.
    """

    means: Array


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # what is not finite is no solution
def rt1_kkt(spaces: RT1Spaces, data: RT1Data, iterate: RT1Iterate, penalty: Penalty | None, eps: float) -> KKTResiduals:
    """Residuals of a discrete solution of RT1, computed from its fields (collective).

    Sites are the vertices of facets, with their share of |e|. Stationarity is tested with the basis of RT1 that is dual
    to the moments of σ·n against hats and to those inside cells; the mass balance with Π₁f.

    Args:
        spaces: The spaces.
        data: The data.
        iterate: The solution.
        penalty: Penalty law; None for the Signorini condition.
        eps: ε of the penalty.
    """
    constant, means = data.common_constant(spaces), iterate.means.copy()
    data, means[spaces.outer_sites] = data.less(spaces, constant), means[spaces.outer_sites] - constant
    u = spaces.scalar_values(iterate.u) - constant
    scales = sizes_of_solution(spaces, CellFlux.of(spaces, iterate.sigma), function_of(spaces.Q, u.mean(axis=1)), data)
    sigma = spaces.flux_values(iterate.sigma)
    (kind, cell), k, length = spaces.site_kinds, data.conductivities(spaces), spaces.length
    k_e = np.repeat(k[spaces.cells], spaces.dim)
    pair = kind.of(iterate.p), spaces.through(spaces.contact, sigma).ravel() - data.laws_at.flux_h
    if penalty is not None:
        pair = penalty.shift(*pair, eps)
    squares = squares_off(data.laws_at.chains, pair, k_e / length, length * kind.measure, k_e, 1.0)
    if data.inside:
        k_T, h = (np.repeat(each, spaces.dim + 1) for each in (k, spaces.cell_diameters))
        laws, unit, (above, force) = data.cells_at, k_T / (length * h), data.in_cells(spaces, sigma, u)
        known = cell.of(iterate.p), force
        above = laws.openings(laws.chains.off_segments(known, known, unit).argmin(axis=1), above, force)
        squares += squares_off(laws.chains, (above, force), unit, cell.measure * h**2, k_T, 1.0)
    of_cells = _of_cells(spaces, data, sigma, u, kind.rows_of(means))
    given = [(spaces.neumann, spaces.through(spaces.neumann, sigma) - data.given_flux)]
    for facets, left in [*given, *passed(spaces, sigma)]:
        lacking = (left**2).mean(axis=1)
        of_cells[1] += [length * (facets.measure / scale**2) @ lacking for scale in (k[facets.cells], 1.0)]
    residuals = np.sqrt(spaces.mesh.comm.allreduce(np.vstack([squares, of_cells])))
    return KKTResiduals(*(relative(each, scales) for each in residuals))


def _of_cells(spaces: RT1Spaces, data: RT1Data, sigma: Array, u: Array, means: Array) -> Array:
    """The squares of stationarity and of the mass balance, each as a gradient and as a flux, shape (2, 2) (collective).

    (9a) on a cell says what û is at the vertices of its facets: the residual at a facet inside Ω is the difference of
    both sides, on Γ_S and Γ_D that to what is given.
    """
    dim, element, (taken, h) = spaces.dim, reference(spaces.dim), (by_gradient(spaces, data), spaces.cell_diameters)
    free, traces = element.free, len(element.tractions)
    count, squares = len(spaces.order), np.zeros((2, 2))
    trace, sizes = np.empty((count, traces)), np.empty((count, traces, 2))
    for cells in spaces.blocks():
        numbers, product = cells.numbers, data.products(spaces, cells)
        missing, reaction = data.moments_of_f(spaces, cells), data.reactions(spaces, cells)
        identity = np.broadcast_to(np.eye(dim), (len(numbers), dim, dim))
        of_sigma = cells.coefficients(sigma[numbers])
        residual = np.einsum("nbc,nc->nb", product, of_sigma)
        residual[:, free:] += u[numbers]  # the moments of ∇· of the basis are 1
        if (of_b := data.of_b(spaces, cells)) is not None:
            residual -= of_b
        residual = residual @ element.nodal
        trace[numbers] = residual[:, :traces]
        M, W = (((each @ element.nodal) * element.nodal).sum(axis=1) for each in (cells.product(identity), product))
        sizes[numbers] = np.stack([M, W], axis=2)[:, :traces]
        inner, m, w = (each[:, traces:] for each in (residual, M, W))
        squares[0] += (inner**2 / m).sum(), (m * (inner / w) ** 2).sum()
        missing += of_sigma[:, free:]
        if reaction is not None:
            missing -= np.einsum("nvw,nw->nv", reaction, u[numbers])
        if data.inside:  # whatever is missing is −s
            missing[:] = 0.0
        of_hats = np.einsum("nv,nv->n", missing, np.linalg.solve(cells.hat_masses(), missing[:, :, None])[:, :, 0])
        squares[1] += (h[numbers] / taken[numbers]) ** 2 @ of_hats, h[numbers] ** 2 @ of_hats
    return squares + _of_traces(spaces, data, trace, sizes, means)


def passed(spaces: RT1Spaces, sigma: Array) -> Iterator[tuple[BoundaryFacets, Array]]:
    """What masters do not take of what goes through slaves, and what goes through slaves without one (collective)."""
    nothing = np.empty(0, dtype=np.int32)
    facets = np.unique(np.concatenate([nothing, *(pair.masters for pair in spaces.pairs)]))
    masters = spaces.boundary_facets(facets)
    left = spaces.through(masters, sigma)
    for pair in spaces.pairs:
        flux = spaces.through(spaces.boundary_facets(pair.slaves), sigma)[:, :, None]
        rows, passed = np.searchsorted(facets, pair.masters), pair.onto_masters(spaces.mesh.comm, flux)[:, :, 0]
        left[rows] += linear_values(passed, masters.measure[rows])
    yield masters, left
    free = spaces.boundary_facets(np.concatenate([nothing, *(pair.left_out for pair in spaces.pairs)]))
    yield free, spaces.through(free, sigma)


def _of_traces(spaces: RT1Spaces, data: RT1Data, trace: Array, sizes: Array, means: Array) -> Array:
    """The part of the facets, see `_of_cells`, from û as each cell has it and the sizes of the basis functions."""
    dim, numbers, inner = spaces.dim, spaces.traces.dofmap.index_map, spaces.inner.rows
    by_facet = trace.reshape(-1, dim + 1, dim)
    mean = sums_at(numbers, spaces.dofs, by_facet) / sums_at(numbers, spaces.dofs)[:, None]
    size = sums_at(numbers, spaces.dofs, sizes.reshape(len(trace), dim + 1, dim, 2))
    squares = 2 * sums_at(numbers, spaces.dofs, (by_facet - mean[spaces.dofs]) ** 2)  # of the difference of both sides
    for facets, given in (
        (spaces.dirichlet, data.lift[spaces.unknowns(spaces.dirichlet)]),
        (spaces.contact, linear_from_means(means)),
    ):
        squares[facets.blocks] = (mean[facets.blocks] - given) ** 2
    for pair in spaces.pairs:
        slaves, masters = map(spaces.boundary_facets, (pair.slaves, pair.masters))
        opposite = linear_from_means(pair.opposite(spaces.mesh.comm, mean[masters.blocks]))
        jump = 0.0 if pair.parts.tied else linear_from_means(means)[spaces.rows_of(pair)]
        squares[slaves.blocks] = (mean[slaves.blocks] - opposite - jump) ** 2
    named, across = spaces.contact.blocks[inner], spaces.across.blocks
    squares[named] = (mean[named] - mean[across] - linear_from_means(means)[inner]) ** 2
    size[named] += size[across]
    (M, W), squares = np.moveaxis(size[: numbers.size_local], 2, 0), squares[: numbers.size_local]
    return np.array([[(squares / M).sum(), (M * squares / W**2).sum()], [0.0, 0.0]])
