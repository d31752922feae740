"""A constant of Korn of a whole body: how far loads can move it that are linear on each cell, and on facets.

Let p be linear on each cell and r on each of some facets with tractions. For all displacements w that are 0 where u is
given, also in some components alone,

    Σ (p, w)_T + Σ ⟨r, w⟩_e ≤ C (Σ ‖p‖_T² + Σ ‖r‖_e²/l)^½ |w|,   C = θ^-½ + q max a_T c_T,

with any length l, if the matrix K_θ is positive definite; a_T² is the largest eigenvalue of 𝔸 on T, c_T and q as in
`korn`.

Proof. Let τ_h be the stress of Johnson and Mercier of least energy with −∇·τ_h = Qp in Ω, τ_h n = r on these facets and
0 on Γ_C and the rest of Γ_N, in the components that are not given. Then (Qp, w) + Σ⟨r, w⟩_e = (τ_h, ε(w)) ≤ ‖τ_h‖ |w|,
and (p − Qp, w)_T ≤ c_T q ‖p‖_T a_T |w|_T, as p − Qp is orthogonal to linear fields on T. ‖τ_h‖² is m·Bm + (Rm + t)·
K⁻¹(Rm + t) with the moments m and t of p and r against hats, K the facet matrix, and B and R what `eliminate` makes of
m on each cell: the energy without traces, and the load on these. ‖p‖² = m·H⁻¹m and ‖r‖² = t·M⁻¹t with the matrices of
mass. So ‖τ_h‖² < (‖p‖² + ‖r‖²/l)/θ for all p and r, if K and the Schur complement of K in the matrix with the blocks K,
[R I] and diag(H⁻¹/θ − B, M⁻¹/θl) are positive definite; that is if X = H⁻¹/θ − B is, cell by cell, and

    K_θ = K − R X⁻¹Rᵀ − θl M,

the Schur complement of the other block. A factorisation counts the negative eigenvalues of K_θ by Sylvester's law. ∎

*Loads on facets alone.* Let p = 0, and M have weights ρ_e > 0. Then ‖τ_h‖² = t·K⁻¹t ≤ Σ ‖r‖_e²/μρ_e if K − μM is
positive definite, as it is if K_θ with μρ_e for θl is. So

    Σ ⟨r, w⟩_e ≤ (Σ ‖r‖_e²/μρ_e)^½ |w|.

Where 𝔸 varies in a cell, or leaves the volume as it is, it is replaced by one matrix that is at least 𝔸 in all points,
with which ‖τ_h‖ is larger.
"""

import math

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.discrete.linear_traces import blocks_of_cells, facet_normals
from signorini_fenicsx.discrete.matrices import OfCells, of_cells
from signorini_fenicsx.linear.petsc import MUMPS_WORKSPACE, LinearSolver, set_direct
from signorini_fenicsx.physics.elasticity.bound.korn import MOMENTS, korn_constants
from signorini_fenicsx.physics.elasticity.discrete.johnson_mercier import Cells, compliance_product, reference
from signorini_fenicsx.physics.elasticity.discrete.material import regular
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.discrete.supports import Supports
from signorini_fenicsx.physics.elasticity.solve.rigid_motions import RigidBodies

ON_FACETS = 1 / 8
"""l is this share of |Ω|^(1/d)."""
FIRST, FINER, TRIES = 6.0, 16.0, 6
"""The first θ is one over so many times |Ω|^(2/d) max a_T², the next ones smaller by so many times, and how many."""
ALONE = 1e-6
"""For r alone θ is so many times 1/(|Ω|^(2/d) max a_T²)."""
MOST = {2: 1_000_000, 3: 100_000}
"""For each dimension the largest number of unknowns that are factorised."""
INERTIA = MUMPS_WORKSPACE | {"mat_mumps_icntl_13": "1", "mat_mumps_icntl_24": "1"}
"""MUMPS counts eigenvalues of each sign if it leaves no block to ScaLAPACK and looks for zeros."""


def why_no_constant(spaces: ElasticSpaces) -> str:
    """Why no constant is looked for, in words; empty if what is given of u alone holds each body (collective)."""
    unknowns = spaces.dim**2 * spaces.facets_of_mesh
    no_facets = spaces.boundary_facets(np.empty(0, dtype=np.int32))
    empty = np.empty((0, spaces.dim**2, spaces.dim**2))
    none = Supports(no_facets, np.empty((0, spaces.dim, spaces.dim)), empty, np.zeros(len(spaces.rough.facets)))
    if RigidBodies.of(spaces, ()).not_given(none).shape[1] > 0:
        return "as what is given of u does not hold each body"
    return "as the mesh is large" if unknowns > MOST[spaces.dim] else ""


def constant_of_body(spaces: ElasticSpaces, compliance: Array, loaded: Mask) -> float:
    """C, or ∞ if no θ that was tried is small enough (collective).

    Args:
        spaces: The spaces.
        compliance: On each owned cell a matrix that is at least 𝔸 there, shape (cells, entries, entries).
        loaded: Mask of the facets with r, opposite to the vertices of each cell, shape (cells, d + 1).
    """
    given, kept = (regular(compliance), loaded), spaces.kept_results
    return kept.get(spaces.mesh.comm, "constant of body", None, given, lambda: _by_factorisations(spaces, *given))


def _by_factorisations(spaces: ElasticSpaces, compliance: Array, loaded: Mask) -> float:
    """C, found anew (collective)."""
    comm, softness = spaces.mesh.comm, np.linalg.eigvalsh(compliance)[:, -1]
    constants = korn_constants(Cells(spaces.vertices).derivative) * np.sqrt(softness)
    ends = softness.max(initial=0.0), constants.max(initial=0.0)
    softest, of_cells = (comm.allreduce(each, MPI.MAX) for each in ends)
    theta = 1 / (FIRST * softest * spaces.length**2)
    for _ in range(TRIES):
        if _is_positive(spaces, compliance, theta * length_of_facets(spaces) * loaded, theta):
            return float(1 / math.sqrt(theta) + MOMENTS[spaces.dim] * of_cells)
        theta /= FINER
    return math.inf


def constant_of_facets(spaces: ElasticSpaces, compliance: Array, weights: Array) -> float:
    """1/√μ, which bounds loads on facets alone; ∞ if no μ that was tried is small enough (collective).

    Args:
        spaces: The spaces.
        compliance: As in `constant_of_body`.
        weights: ρ of the facets, opposite to the vertices of each cell, 0 where r = 0, shape (cells, d + 1).
    """
    given, kept = (regular(compliance), weights), spaces.kept_results
    return kept.get(spaces.mesh.comm, "constant of facets", None, given, lambda: _of_facets(spaces, *given))


def _of_facets(spaces: ElasticSpaces, compliance: Array, weights: Array) -> float:
    """1/√μ, found anew, μ by bisection of its exponent (collective)."""
    softness = spaces.mesh.comm.allreduce(np.linalg.eigvalsh(compliance)[:, -1].max(initial=0.0), MPI.MAX)
    mu, least, most = 1 / (softness * spaces.length), 0.0, math.inf
    for _ in range(TRIES):
        positive = _is_positive(spaces, compliance, mu * weights, ALONE / (softness * spaces.length**2))
        least, most = (mu, most) if positive else (least, mu)
        mu = math.sqrt(least * most) if least > 0 and most < math.inf else mu * FINER ** (1 if positive else -1)
    return 1 / math.sqrt(least) if least > 0 else math.inf


def length_of_facets(spaces: ElasticSpaces) -> float:
    """The length l for tractions (collective when first used)."""
    return ON_FACETS * spaces.length


def _is_positive(spaces: ElasticSpaces, compliance: Array, of_facets: Array, theta: float) -> bool:
    """Whether K_θ with these θl is proved to be positive definite, but for rounding (collective)."""
    comm, index_map, size = spaces.mesh.comm, spaces.traces.dofmap.index_map, spaces.dim**2
    inside, parts = True, list[OfCells]()
    for numbers in blocks_of_cells(spaces.mesh):
        cells = Cells(spaces.vertices[numbers])
        matrices, positive = _on_cells(cells, compliance[numbers], of_facets[numbers], theta)
        inside &= positive
        for each in (matrices, matrices.swapaxes(1, 2)):
            spaces.to_unknowns(each, numbers)
        parts.append((spaces.dofs[numbers], matrices))
    if not comm.allreduce(inside, MPI.LAND):
        return False
    matrix = spaces.sides.of_unknowns(of_cells(comm, index_map, size, [spaces.dofs], parts))
    fixed = np.concatenate([spaces.unknowns(facets, k).ravel() for facets, k, *_ in spaces.fixed])
    matrix.zeroRowsColumns(fixed + size * index_map.local_range[0])
    return _negative(matrix) == 0


def _negative(matrix: PETSc.Mat) -> int:
    """The number of eigenvalues that are not positive; all if it cannot be had (collective)."""
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    solver = LinearSolver(matrix, "certificate_", defaults=INERTIA)
    set_direct(solver.ksp, "cholesky")
    try:
        with solver.options():
            solver.ksp.setUp()
            _, _, positive = solver.ksp.getPC().getFactorMatrix().getInertia()
    except PETSc.Error:
        positive = 0
    return int(matrix.getSize()[0] - positive)


def _on_cells(cells: Cells, compliance: Array, of_facets: npt.NDArray[np.floating], theta: float) -> tuple[Array, bool]:
    """What cells add to K_θ, shape (cells, (d + 1) d², (d + 1) d²), and whether X is positive definite on all.

    θl is 0 on facets without r.
    """
    dim, element = cells.dim, reference(cells.dim)
    free, rest = slice(None, element.free), slice(element.free, None)
    hats = (1 + np.eye(dim + 1)) / ((dim + 1) * (dim + 2))
    masses = np.einsum("n,ab,nij->naibj", cells.measure / (dim + 1), hats, compliance)
    masses = masses.reshape(len(masses), 1, *[hats.shape[0] * compliance.shape[1]] * 2).repeat(dim + 1, axis=1)
    products = compliance_product(cells.stresses(element.stresses), masses)
    tractions = cells.tractions(element.tractions)
    balance = -np.kron(np.eye(dim + 1), np.linalg.inv(cells.derivative))
    of_free, of_rest = tractions[:, :, free], tractions[:, :, rest] @ balance
    coupled = products[:, free, rest] @ balance
    both = np.linalg.solve(products[:, free, free], np.concatenate([of_free.swapaxes(1, 2), coupled], axis=2))
    of_traces, of_loads = np.split(both, [of_free.shape[1]], axis=2)
    alone = balance.swapaxes(1, 2) @ products[:, rest, rest] @ balance - coupled.swapaxes(1, 2) @ of_loads
    right = of_free @ of_loads - of_rest
    inverse = np.kron(np.linalg.inv(hats), np.eye(dim)) / (theta * cells.measure)[:, None, None]
    matrices = of_free @ of_traces - right @ np.linalg.solve(inverse - alone, right.swapaxes(1, 2))
    mass = np.kron((1 + np.eye(dim)) / (dim * (dim + 1)), np.eye(dim))
    areas = np.linalg.norm(facet_normals(cells.vertices), axis=2) * of_facets
    for facet in range(dim + 1):
        block = slice(facet * dim**2, (facet + 1) * dim**2)
        matrices[:, block, block] -= areas[:, facet, None, None] * mass
    positive = np.linalg.eigvalsh(inverse - alone).min(initial=np.inf) > 0
    return (matrices + matrices.swapaxes(1, 2)) / 2, bool(positive)
