"""(MVI)_h in the form of theorem 2, the projection of 0 onto a convex set: minimise ½‖τ‖² over τ ∈ Ṽ_h, ∇·τ = −f_h.

For general data ½(κ⁻¹τ, τ) − (u_D, τ·n)_ΓD − (ψ, τ·n)_ΓS is minimised with τ·n ≥ q_S on Γ_S, τ·n = g_N on Γ_N. The
unknown is τ − σ_lift.

An interior-point solver gets only the mass matrix of RT0, the divergence and the signs: no facet conditions, no sets,
no multipliers. Its own multipliers of ∇·τ = −f_h and of τ·n ≥ 0 are u_h and p_h. It runs on rank 0 and is not parallel.
"""

import numpy as np
import piqp
import scipy.sparse
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix

from signorini_fenicsx.backends.contract import Iterate
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.tolerances import LINEAR
from signorini_fenicsx.discrete.conditions import Condition, SiteConditions
from signorini_fenicsx.discrete.spaces import assembled, cell_measures
from signorini_fenicsx.forms.mixed import flux_product, load, mass_balance, trace_term
from signorini_fenicsx.methods.classical.gathered import RootRows, matrix_on_root
from signorini_fenicsx.methods.history import Outcome, Recorder
from signorini_fenicsx.methods.task import Task, nothing_yet

FIXED = 2.0
"""Marks an unknown that is fixed to 0, in place of a sign."""


def quadratic_programme(task: Task) -> Outcome:
    """Solve by PIQP (collective).

    The history has one step, because the solver does not show its iterates. The step's `linear_iterations` is their
    number.
    """
    spaces = task.spaces
    V, Q, comm = spaces.V, spaces.Q, spaces.mesh.comm
    flux_size, cells = V.dofmap.index_map.size_local, Q.dofmap.index_map.size_local
    data = task.data
    sigma, tau, v = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.TestFunction(Q)
    blocks = flux_product(sigma, tau, ufl.dx, data.kappa_h), mass_balance(sigma, v, ufl.dx)
    matrices = [assemble_matrix(fem.form(form)) for form in blocks]
    for matrix in matrices:
        matrix.assemble()
    hessian, divergence = (matrix_on_root(matrix) for matrix in matrices)
    sign = np.zeros(flux_size)
    sign[spaces.flux_dofs] = np.sign(spaces.basis_flux)
    sign[spaces.neumann_dofs] = FIXED
    weight = 1 / np.sqrt(cell_measures(Q)[:cells])  # rows of the divergence for an orthonormal basis of Q_h
    linear = assembled(
        flux_product(data.sigma_lift, tau, ufl.dx, data.kappa_h)
        - trace_term(data.u_lift, tau, spaces.n, spaces.ds_dirichlet + spaces.ds)
    )[:flux_size]
    right = -assembled(load(data.f_h, v, ufl.dx) + mass_balance(data.sigma_lift, v, ufl.dx))[:cells]

    flux_rows, cell_rows = RootRows(comm, flux_size), RootRows(comm, cells)
    of_flux = flux_rows.gather(np.column_stack([linear, sign]))
    of_cell = cell_rows.gather(np.column_stack([weight, weight * right]))
    values = balance = pressure = None
    status, iterations = "", 0
    if hessian is not None and divergence is not None and of_flux is not None and of_cell is not None:
        scaled = scipy.sparse.diags_array(of_cell[:, 0]) @ divergence
        values, balance, pressure, status, iterations = _minimise(
            hessian, of_flux[:, 0], scaled, of_cell[:, 1], of_flux[:, 1], task.max_iterations
        )
    status, iterations = comm.bcast((status, iterations))

    sigma_h, u_h = fem.Function(V, name="sigma"), fem.Function(Q, name="u")
    sigma_h.x.array[:flux_size] = flux_rows.scatter(values)
    u_h.x.array[:cells] = cell_rows.scatter(balance) * weight
    for function in (sigma_h, u_h):
        function.x.scatter_forward()
    p = flux_rows.scatter(pressure)[spaces.flux_dofs] / np.abs(spaces.basis_flux)
    flux = spaces.normal_flux(sigma_h)
    sigma_h.x.array[:] += data.sigma_lift.x.array
    iterate = Iterate(p=p, flux=flux, linear_iterations=iterations, sigma=sigma_h, u=u_h)
    conditions = SiteConditions(np.where(flux > p, Condition.ZERO_TRACE, Condition.NO_FLUX).astype(np.int8))

    recorder = Recorder(spaces, *nothing_yet(spaces), task.on_step)
    recorder.add(iterate, conditions)
    return Outcome(
        iterate=iterate,
        conditions=conditions,
        history=recorder.steps,
        reason=f"PIQP: {status} in {iterations} iterations",
        converged=status == piqp.PIQP_SOLVED.name,
        backend="mixed",
        dofs=V.dofmap.index_map.size_global + Q.dofmap.index_map.size_global,
        linear_solver="PIQP",
    )


def _minimise(
    hessian: scipy.sparse.csr_array,
    linear: Array,
    divergence: scipy.sparse.csr_array,
    right: Array,
    sign: Array,
    max_iterations: int,
) -> tuple[Array, Array, Array, str, int]:
    """Minimise ½xᵀHx + cᵀx subject to Bx = g, sign·x ≥ 0 where the sign is ±1 and x = 0 where it is FIXED (rank 0).

    Returns:
        x, the multipliers of both constraints, PIQP's status and its number of iterations.
    """
    of_flux = 1 / np.sqrt(hessian.diagonal())  # scaling: unknowns and rows of one size for any κ and any cells
    divergence = divergence @ scipy.sparse.diags_array(of_flux)
    of_row = 1 / np.sqrt(divergence.power(2).sum(axis=1))
    linear, right = of_flux * linear, of_row * right
    scale = max(float(np.abs(right).max()), float(np.abs(linear).max()))
    if scale == 0:
        return np.zeros(len(sign)), np.zeros(len(right)), np.zeros(len(sign)), piqp.PIQP_SOLVED.name, 0
    solver = piqp.SparseSolver()
    solver.settings.eps_abs = solver.settings.eps_duality_gap_abs = LINEAR  # for data of size 1
    solver.settings.eps_rel = solver.settings.eps_duality_gap_rel = LINEAR  # for data of size 1
    solver.settings.max_iter = max_iterations
    solver.setup(
        scipy.sparse.csc_matrix(scipy.sparse.diags_array(of_flux) @ hessian @ scipy.sparse.diags_array(of_flux)),
        linear / scale,
        scipy.sparse.csc_matrix(scipy.sparse.diags_array(of_row) @ divergence),
        right / scale,
        x_l=np.where(sign > 0, 0.0, -np.inf),
        x_u=np.where((sign < 0) | (sign == FIXED), 0.0, np.inf),
    )
    status = solver.solve()
    result = solver.result
    values, balance, pressure = (
        scale * factor * np.asarray(part)
        for factor, part in ((of_flux, result.x), (of_row, result.y), (1 / of_flux, result.z_bl + result.z_bu))
    )
    return values, balance, pressure, status.name, int(result.info.iter)
