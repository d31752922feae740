"""(MVI)_h in the form of theorem 2, the projection of 0 onto a convex set: minimise ½‖τ‖² over τ ∈ Ṽ_h, ∇·τ = −f_h.

For general data ½(κ⁻¹τ, τ) − (u_D, τ·n)_ΓD − (ψ, τ·n)_ΓS is minimised with τ·n ≥ q_S on Γ_S, τ·n = g_N on Γ_N. The
unknown is τ − σ_lift.

An interior-point solver gets only the mass matrix of RT0, the divergence and the signs: no facet conditions, no sets,
no multipliers. Its own multipliers of ∇·τ = −f_h are u_h, and (12) gives p_h. It runs on rank 0 and is not parallel.

Where c > 0 the constraint is ∇·τ − cu = −f_h with ½(cu, u) added: u is one more unknown there, equal to its multiplier.

With laws in Ω the balance is ∇·τ − cu + λ = −f_h with λ = −s, and the integral of Φ*(−λ) is added: for an obstacle
λ ≥ 0 is one more unknown per cell, with −(ψ, λ); in general λ is a sum of unknowns as τ·n is below.

For other laws on Γ_S the integral of φ*(−τ·n) is added, −p being the slope of φ* as a function of τ·n: linear on a
vertical segment of the graph, quadratic on a sloped one, and flat segments are kinks. Where there are kinks τ·n is a
sum of unknowns, one for each segment that is not flat.
"""

from dataclasses import dataclass

import numpy as np
import piqp
import scipy.sparse
import ufl
from dolfinx.fem.petsc import assemble_matrix
from petsc4py import PETSc

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import function_of, owned_values
from signorini_fenicsx.base.parallel import gather_rows, on_root_only
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.base.tolerances import LINEAR, ROUNDING
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.contact.set_rules import ALGORITHM_2
from signorini_fenicsx.discrete.mesh_spaces import assembled
from signorini_fenicsx.forms.mixed import flux_product, load, mass_balance, trace_term
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.jumps import with_one_flux
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solve.classical.gathered import RootRows, matrix_on_root
from signorini_fenicsx.physics.diffusion.solve.recorder import Recorder
from signorini_fenicsx.physics.diffusion.solve.residuals import with_cells
from signorini_fenicsx.physics.diffusion.solve.task import DiffusionTask, nothing_yet


def quadratic_programme(task: DiffusionTask) -> Outcome:
    """Solve by PIQP (collective).

    The history has one step, because the solver does not show its iterates. The step's `linear_iterations` is their
    number.
    """
    spaces, data = task.spaces, task.data
    V, Q, comm = spaces.V, spaces.Q, spaces.mesh.comm
    flux_size, cells = V.dofmap.index_map.size_local, Q.dofmap.index_map.size_local
    tau = ufl.TestFunction(V)
    hessian, divergence = (matrix_on_root(matrix) for matrix in _matrices(spaces, data))
    linear = assembled(
        flux_product(data.sigma_lift, tau, ufl.dx, data.kappa_h)
        - trace_term(data.u_lift, tau, spaces.n, spaces.ds_dirichlet + spaces.ds)
    )[:flux_size]
    spaces.join_across(linear)
    flux_rows, cell_rows = RootRows(comm, flux_size), RootRows(comm, cells)
    bounds, pieces = _laws(task, flux_size)
    of_flux = flux_rows.gather(np.column_stack([linear, bounds]))
    in_cells = _of_cells(spaces, data)
    of_cell = cell_rows.gather(in_cells)
    of_pieces, of_loads = gather_rows(comm, pieces), gather_rows(comm, _laws_inside(data, in_cells))

    def on_one_rank() -> tuple[Array, Array, Array, str, int]:
        assert hessian is not None
        assert divergence is not None
        assert of_flux is not None
        assert of_cell is not None
        assert of_pieces is not None
        assert of_loads is not None
        scaled = scipy.sparse.diags_array(of_cell[:, 0]) @ divergence
        parts = _with_reaction(hessian, scaled, of_flux, of_cell[:, 2])
        parts = _with_laws_inside(*parts, of_loads) if len(of_loads) > 0 else parts
        x, y, status, iterations = _with_laws(*parts, of_cell[:, 1], of_pieces).solve(task.max_iterations)
        values, balance = x[: len(of_flux)], y[: len(of_cell)]
        return values, balance, hessian @ values + of_flux[:, 0] + scaled.T @ balance, status, iterations

    *arrays, status, iterations = on_root_only(comm, on_one_rank) or (None, None, None, "", 0)
    values, balance, left = arrays
    status, iterations = comm.bcast((status, iterations))

    sigma_h = function_of(V, flux_rows.scatter(values), "sigma")
    u_h = function_of(Q, cell_rows.scatter(balance) * in_cells[:, 0], "u")
    p = flux_rows.scatter(left)[spaces.flux_dofs] / spaces.basis_flux
    flux = spaces.normal_flux(sigma_h)
    sigma_h.x.array[:] += data.sigma_lift.x.array
    spaces.carry_across(sigma_h)
    iterate = Iterate(p=p, flux=flux, linear_iterations=iterations, sigma=sigma_h, u=u_h)
    iterate, conditions = with_cells(spaces, data, iterate, ALGORITHM_2.following(data.laws.chains, p, flux, 1.0))

    recorder = Recorder(spaces, *nothing_yet(spaces), task.on_step)
    recorder.add(iterate, spaces.site_kinds["facet"].of(conditions))
    dofs = V.dofmap.index_map.size_global + Q.dofmap.index_map.size_global
    reason, system = f"PIQP: {status} in {counted(iterations, 'iteration')}", ("mixed", dofs, "PIQP")
    return recorder.outcome((iterate, conditions), reason, system, converged=status == piqp.PIQP_SOLVED.name)


def _matrices(spaces: Spaces, data: Data) -> list[PETSc.Mat]:
    """The mass matrix and the divergence, for fluxes that are equal on both sides of inner facets (collective)."""
    sigma, tau, v = ufl.TrialFunction(spaces.V), ufl.TestFunction(spaces.V), ufl.TestFunction(spaces.Q)
    blocks = flux_product(sigma, tau, ufl.dx, data.kappa_h), mass_balance(sigma, v, ufl.dx)
    matrices = [assemble_matrix(fenicsx.form(form)) for form in blocks]
    for matrix in matrices:
        matrix.assemble()
    basis = with_one_flux(spaces, spaces.V.dofmap.index_map.size_local)
    if basis is None:
        return matrices
    mass, divergence = matrices[0].ptap(basis), matrices[1].matMult(basis)
    mass.zeroRowsColumns(spaces.fluxes_across[0] + mass.getOwnershipRange()[0])
    return [mass, divergence]


def _of_cells(spaces: Spaces, data: Data) -> Array:
    """For each owned cell, for an orthonormal basis of Q_h: scale and right side of its balance, c (collective).

    With laws in Ω the part of λ that is no unknown is in the right side.
    """
    v, cells = ufl.TestFunction(spaces.Q), spaces.Q.dofmap.index_map.size_local
    weight = 1 / np.sqrt(spaces.cell_measures)
    right = -assembled(load(data.f_h, v, ufl.dx) + mass_balance(data.sigma_lift, v, ufl.dx))[:cells]
    c = np.zeros(cells) if data.c_h is None else owned_values(data.c_h)
    if data.inside:
        law, rows = data.inside.chains, np.arange(cells)
        steep = law.slope > 0
        last = steep.shape[1] - 1 - np.argmax(steep[:, ::-1], axis=1)
        lowest = law.ends[1][:, 1:]
        meets = steep & (np.arange(steep.shape[1]) < last[:, None])
        corners = -np.where(meets, lowest, 0.0).sum(axis=1)
        right -= np.where(steep.any(axis=1), corners, law.value[rows, 0]) / weight**2
    return np.column_stack([weight, weight * right, c])


def _laws_inside(data: Data, of_cells: Array) -> Array:
    """The unknowns of which λ is a sum, one for each steep segment of each owned cell (collective).

    Returns:
        Number of the cell over all ranks, root of its measure, β, value of the segment from u = 0, and its bounds,
        shape (unknowns, 6).
    """
    if not data.inside:
        return np.empty((0, 6))
    law, comm = data.inside.chains, data.f_h.function_space.mesh.comm
    at = np.nonzero(law.slope > 0)
    rows, (_, ends) = at[0], law.ends
    vertical = np.isinf(law.slope[at])
    value = law.value[at] + np.where(vertical, 1.0, law.slope[at]) * data.inside.means[rows]
    first = comm.exscan(len(of_cells)) or 0
    bounds = ends[:, 1:][at], ends[:, :-1][at]
    return np.column_stack([first + rows, 1 / of_cells[rows, 0], law.slope[at], value, *bounds])


def _laws(task: DiffusionTask, flux_size: int) -> tuple[Array, Array]:
    """The laws as bounds of unknowns and as what is added to the function (collective).

    Returns:
        For each owned unknown of the flux its bounds and the quadratic and linear term, shape (unknowns, 4); for each
        piece of τ·n on a facet with several of them: number of the facet's unknown, ∫φ·n of its basis function, |e|, β
        (∞ for none), value and bounds of the segment, shape (pieces, 7).
    """
    spaces, law = task.spaces, task.data.laws.chains
    bounds = np.tile([-np.inf, np.inf, 0.0, 0.0], (flux_size, 1))
    bounds[spaces.neumann_dofs, :2] = 0.0
    if spaces.inner.present:
        bounds[spaces.fluxes_across[0], :2] = 0.0
    e, basis, steep = spaces.facet_measure, spaces.basis_flux, law.slope > 0
    several = steep.sum(axis=1) > 1
    ends = np.stack(law.extent()[2:], axis=1) * (e / basis)[:, None]
    bounds[spaces.flux_dofs, :2] = np.where(several[:, None], [-np.inf, np.inf], np.sort(ends, axis=1))
    only = steep & ~several[:, None]
    beta, value = (np.where(only, values, 0.0).sum(axis=1) for values in (law.slope, law.value))
    has = only.any(axis=1)
    weight = np.divide(1.0, beta, out=np.zeros(len(e)), where=has & np.isfinite(beta))
    bounds[spaces.flux_dofs, 2] = weight * basis**2 / e
    bounds[spaces.flux_dofs, 3] = -np.where(np.isinf(beta), value, weight * value) * basis
    rows, columns = np.nonzero(steep & several[:, None])
    first = spaces.mesh.comm.exscan(flux_size) or 0
    at, (_, fluxes) = (rows, columns), law.ends
    pieces = [
        first + spaces.flux_dofs[rows],
        basis[rows],
        e[rows],
        law.slope[at],
        law.value[at],
        fluxes[:, 1:][at],
        fluxes[:, :-1][at],
    ]
    return bounds, np.column_stack(pieces).astype(np.float64)


@dataclass(frozen=True)
class _Programme:
    """Minimise ½xᵀHx + cᵀx subject to Bx = g, lower ≤ x ≤ upper (rank 0); `size` is about that of each unknown."""

    hessian: scipy.sparse.csr_array
    linear: Array
    matrix: scipy.sparse.csr_array
    right: Array
    lower: Array
    upper: Array
    size: Array

    def solve(self, max_iterations: int) -> tuple[Array, Array, str, int]:
        """Solve by PIQP, with unknowns and rows of one size, whatever κ and the cells are like.

        As far as rounding allows: where p and σ·n are both nearly 0, an interior-point method knows them only up to the
        root of its gap.

        Returns:
            x, the multipliers of Bx = g, PIQP's status and its number of iterations.
        """
        of_unknown = scipy.sparse.diags_array(self.size)
        matrix = self.matrix @ of_unknown
        of_row = 1 / np.sqrt(matrix.power(2).sum(axis=1))
        linear, right = self.size * self.linear, of_row * self.right
        ends = np.concatenate([self.lower / self.size, self.upper / self.size])
        scale = max(float(np.abs(part).max(initial=0.0)) for part in (right, linear, ends[np.isfinite(ends)]))
        if scale == 0:
            return np.zeros(len(linear)), np.zeros(len(right)), piqp.PIQP_SOLVED.name, 0
        solver = piqp.SparseSolver()
        solver.settings.max_iter = max_iterations
        lower, upper = np.split(ends / scale, 2)
        solver.setup(
            scipy.sparse.csc_matrix(of_unknown @ self.hessian @ of_unknown),
            linear / scale,
            scipy.sparse.csc_matrix(scipy.sparse.diags_array(of_row) @ matrix),
            right / scale,
            x_l=lower,
            x_u=upper,
        )
        for tolerance in (ROUNDING, LINEAR):  # for data of size 1
            solver.settings.eps_abs = solver.settings.eps_duality_gap_abs = tolerance
            solver.settings.eps_rel = solver.settings.eps_duality_gap_rel = tolerance
            status = solver.solve()
            if status == piqp.PIQP_SOLVED:
                break
        result = solver.result
        x, y = scale * self.size * np.asarray(result.x), scale * of_row * np.asarray(result.y)
        return x, y, status.name, int(result.info.iter)


def _with_reaction(
    hessian: scipy.sparse.csr_array, divergence: scipy.sparse.csr_array, of_flux: Array, c: Array
) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array, Array]:
    """The flux, and u where c > 0, with ½‖c^½u‖² and ∇·τ − cu = −f: the multiplier is u there too (rank 0)."""
    cells = np.flatnonzero(c)
    if len(cells) == 0:
        return hessian, divergence, of_flux
    of_u = scipy.sparse.coo_array((-c[cells], (cells, np.arange(len(cells)))), (len(c), len(cells)))
    free = np.tile([0.0, -np.inf, np.inf, 0.0, 0.0], (len(cells), 1))
    return (
        scipy.sparse.csr_array(scipy.sparse.block_diag([hessian, scipy.sparse.diags_array(c[cells])])),
        scipy.sparse.csr_array(scipy.sparse.hstack([divergence, of_u])),
        np.concatenate([of_flux, free]),
    )


def _with_laws_inside(
    hessian: scipy.sparse.csr_array, divergence: scipy.sparse.csr_array, of_flux: Array, loads: Array
) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array, Array]:
    """The unknowns and those of which λ is a sum, for an orthonormal basis of Q_h (rank 0)."""
    root, slope, value, lowest, highest = loads[:, 1:].T
    with np.errstate(invalid="ignore"):
        weight = np.where(np.isinf(slope), 0.0, 1 / slope)
    nothing, linear = np.zeros_like(root), -root * np.where(np.isinf(slope), value, value / slope)
    forces = np.column_stack([linear, root * lowest, root * highest, nothing, nothing])
    columns = np.arange(len(loads))
    of_forces = scipy.sparse.coo_array(
        (np.ones(len(loads)), (loads[:, 0].astype(np.int64), columns)), (divergence.shape[0], len(loads))
    )
    return (
        scipy.sparse.csr_array(scipy.sparse.block_diag([hessian, scipy.sparse.diags_array(weight)])),
        scipy.sparse.csr_array(scipy.sparse.hstack([divergence, of_forces])),
        np.concatenate([of_flux, forces]),
    )


def _with_laws(
    hessian: scipy.sparse.csr_array, divergence: scipy.sparse.csr_array, of_flux: Array, right: Array, pieces: Array
) -> _Programme:
    """The programme on rank 0: the flux, then the pieces, with a row for each facet that has some.

    The pieces s_k of a facet lie in intervals that meet in corners of the graph, and τ·n = Σ s_k − Σ corners. As the
    function is convex, it is lowest with all pieces but one at an end, so that τ·n is that one.
    """
    linear, lower, upper, quadratic, of_laws = of_flux.T
    basis, e, slope, value, lowest, highest = pieces.T[1:]
    unknown = pieces[:, 0].astype(np.int64)
    of_facet, first, row = np.unique(unknown, return_index=True, return_inverse=True)
    meets_next = np.append(unknown[1:] == unknown[:-1], np.zeros(min(len(unknown), 1), dtype=bool))
    corners = np.bincount(row, np.where(meets_next, e * np.where(meets_next, lowest, 0.0), 0.0), len(of_facet))
    diagonal = hessian.diagonal()
    size = np.divide(1.0, np.sqrt(diagonal), out=np.zeros_like(diagonal), where=diagonal > 0)
    of_rows = np.sqrt((divergence @ scipy.sparse.diags_array(size)).power(2).sum(axis=1))
    forces = np.flatnonzero(diagonal == 0)  # each in one row
    size[forces] = of_rows[divergence.tocsc()[:, forces].indices]
    hessian = hessian + scipy.sparse.diags_array(quadratic)
    matrix = divergence
    if len(unknown) > 0:
        shape = len(of_facet), len(linear)
        ties = scipy.sparse.coo_array((basis[first], (np.arange(len(of_facet)), of_facet)), shape)
        shares = scipy.sparse.coo_array((-e, (row, np.arange(len(e)))), (len(of_facet), len(e)))
        matrix = scipy.sparse.block_array([[divergence, None], [ties, shares]])
        hessian = scipy.sparse.block_diag([hessian, scipy.sparse.diags_array(e / slope)])
    return _Programme(
        hessian=scipy.sparse.csr_array(hessian),
        linear=np.concatenate([linear + of_laws, -e * np.where(np.isinf(slope), value, value / slope)]),
        matrix=scipy.sparse.csr_array(matrix),
        right=np.concatenate([right, -corners]),
        lower=np.concatenate([lower, lowest]),
        upper=np.concatenate([upper, highest]),
        size=np.concatenate([size, size[unknown] * np.abs(basis) / e]),
    )
