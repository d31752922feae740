"""Elastic contact by conforming P2 displacements and primal-dual active set, as a second program: SciPy, one process.

The coefficients are those of Bernstein's basis, so that v_n ≤ g holds on whole facets if the coefficients satisfy it.
Then the energy of v is above that of the exact u, and the complementary energy of an admissible stress below.
"""

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import basix.ufl
import dolfinx.mesh
import numpy as np
import scipy.sparse.linalg
import ufl
from dolfinx import fem
from mpi4py import MPI

sys.path.append(str(Path(__file__).parent / "benchmark"))
from pdas import primal_dual_active_set

SINGULAR = 1e-10
"""Pivots below this share of the largest one are rounding."""


@dataclass(frozen=True)
class Box:
    """An elastic box whose last coordinate is 0 on Γ_C.

    Attributes:
        mesh: Its mesh, on one process.
        young: E, a number or UFL on the mesh.
        poisson: ν.
        g_N: Tractions by side: the coordinate and its value there.
        fixed: For a side the components of v that are 0.
        gap: g, a number.
        f: Force per volume; none if it is empty.
    """

    mesh: dolfinx.mesh.Mesh
    young: float | ufl.core.expr.Expr
    poisson: float
    g_N: Mapping[tuple[int, float], Sequence[float]]
    fixed: Mapping[tuple[int, float], Sequence[int]]
    gap: float
    f: Sequence[float] = ()


@dataclass(frozen=True)
class P2Contact:
    """A solution by P2 displacements.

    Attributes:
        v: The displacement.
        energy: ½(ℂε(v), ε(v)) − (f, v) − ⟨g_N, v⟩.
        touching: Number of coefficients in contact.
        steps: Set updates.
        unknowns: Unknowns of the linear systems.
        seconds: Of the processor, from the mesh to v.
    """

    v: fem.Function
    energy: float
    touching: int
    steps: int
    unknowns: int
    seconds: float


def stress(v: ufl.core.expr.Expr, young: float | ufl.core.expr.Expr, poisson: float) -> ufl.core.expr.Expr:
    """ℂε(v), plane strain in two dimensions."""
    strain = ufl.sym(ufl.grad(v))
    mu, lame = young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    return 2 * mu * strain + lame * ufl.tr(strain) * ufl.Identity(len(v))


def solve_p2(box: Box, *, between: bool = False) -> P2Contact:
    """Solve on a box.

    If Γ_C is between two bodies, the mesh is cut there, and the body above is pressed onto that below. Then all of Γ_C
    is in contact in the first step: nothing else may hold the body above.

    Args:
        box: The box.
        between: Whether Γ_C is between two bodies.

    Raises:
        RuntimeError: If the sets do not settle, or one of them lets a body move freely.
    """
    began = time.process_time()
    space, A, b, held, contact = assembled(box)
    jumps = scipy.sparse.eye_array(len(b)).tocsr()
    if between:
        contact, jumps = _jumps(space, contact, len(b))
        A, b = (jumps.T @ A @ jumps).tocsr(), jumps.T @ b

    def under(active: np.ndarray, _before: np.ndarray) -> np.ndarray:
        x = np.where(active, -box.gap, 0.0)
        free = np.setdiff1d(np.flatnonzero(~active), held)
        x[free] = factorised(A[free][:, free]).solve((b - A @ x)[free])
        return x

    first = np.isin(np.arange(len(b)), contact) if between else None
    settled = primal_dual_active_set(under, lambda x: A @ x - b, contact, np.zeros(len(b)), -box.gap, first)
    x, touching = settled.u, int(settled.active.sum())
    v = fem.Function(space)
    v.x.array[:] = jumps @ x
    energy, unknowns = float(x @ (A @ x) / 2 - b @ x), len(b) - len(held) - touching
    return P2Contact(v, energy, touching, settled.steps, unknowns, time.process_time() - began)


def factorised(matrix: scipy.sparse.csr_array) -> scipy.sparse.linalg.SuperLU:
    """The factors of a matrix.

    Raises:
        RuntimeError: If it is singular up to rounding.
    """
    factors = scipy.sparse.linalg.splu(matrix.tocsc())
    pivots = np.abs(factors.U.diagonal())
    if pivots.min() <= SINGULAR * pivots.max():
        raise RuntimeError("the matrix is singular: a body moves freely")
    return factors


def assembled(box: Box) -> tuple[fem.FunctionSpace, scipy.sparse.csr_array, np.ndarray, np.ndarray, np.ndarray]:
    """The space, A, b, the unknowns that are 0, and the normal ones on Γ_C."""
    mesh = box.mesh
    assert mesh.comm.size == 1
    dim = mesh.geometry.dim
    element = basix.ufl.element("P", mesh.basix_cell(), 2, basix.LagrangeVariant.bernstein, shape=(dim,))
    space = fem.functionspace(mesh, element)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    load = ufl.dot(fem.Constant(mesh, np.array(box.f or [0.0] * dim, dtype=float)), v) * ufl.dx
    sides = [_facets(mesh, side) for side in box.g_N]
    numbers = np.concatenate([np.full(len(facets), number, dtype=np.int32) for number, facets in enumerate(sides)])
    facets = np.concatenate(sides)
    order = np.argsort(facets)
    tags = dolfinx.mesh.meshtags(mesh, dim - 1, facets[order], numbers[order])
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    for number, traction in enumerate(box.g_N.values()):
        load += ufl.dot(ufl.as_vector([float(x) for x in traction]), v) * ds(number)
    form = ufl.inner(stress(u, box.young, box.poisson), ufl.sym(ufl.grad(v))) * ufl.dx
    A = fem.assemble_matrix(fem.form(form)).to_scipy().tocsr()
    b = fem.assemble_vector(fem.form(load)).array
    zero = [_dofs(space, mesh, side, k) for side, components in box.fixed.items() for k in components]
    held = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *zero]))
    contact = np.setdiff1d(_dofs(space, mesh, (dim - 1, 0.0), dim - 1), held)
    return space, A, b, held, contact


def stress_norm(mesh: dolfinx.mesh.Mesh, sigma: ufl.core.expr.Expr, young: float, poisson: float) -> float:
    """‖σ‖ in the energy norm."""
    theta = poisson if mesh.geometry.dim == 2 else poisson / (1 + poisson)
    product = (1 + poisson) / young * (ufl.inner(sigma, sigma) - theta * ufl.tr(sigma) ** 2)
    return float(np.sqrt(mesh.comm.allreduce(fem.assemble_scalar(fem.form(product * ufl.dx)), MPI.SUM)))


def _jumps(space: fem.FunctionSpace, both: np.ndarray, size: int) -> tuple[np.ndarray, scipy.sparse.csr_array]:
    """The unknowns of the upper body among normal ones of both bodies, and the basis in which they are jumps."""
    mesh, dim = space.mesh, space.mesh.geometry.dim
    cells = np.arange(mesh.topology.index_map(dim).size_local, dtype=np.int32)
    above = dolfinx.mesh.compute_midpoints(mesh, dim, cells)[:, dim - 1] > 0
    of_upper = np.unique(space.dofmap.list[above].ravel()) * dim + dim - 1
    upper, lower = both[np.isin(both, of_upper)], both[~np.isin(both, of_upper)]
    lagrange = fem.functionspace(mesh, ("P", 2))  # with the nodes of Bernstein's basis at its points
    x = lagrange.tabulate_dof_coordinates()[:, : dim - 1]
    upper, lower = (side[np.lexsort(np.round(x[side // dim], 9).T)] for side in (upper, lower))
    ones = scipy.sparse.coo_array((np.ones(len(upper)), (upper, lower)), (size, size))
    return upper, (scipy.sparse.eye_array(size) + ones).tocsr()


def _facets(mesh: dolfinx.mesh.Mesh, side: tuple[int, float]) -> np.ndarray:
    axis, place = side
    return dolfinx.mesh.locate_entities_boundary(mesh, mesh.geometry.dim - 1, lambda x: np.isclose(x[axis], place))


def _dofs(space: fem.FunctionSpace, mesh: dolfinx.mesh.Mesh, side: tuple[int, float], component: int) -> np.ndarray:
    """Unknowns of a component on a side; in Bernstein's basis as in Lagrange's."""
    nodes = fem.locate_dofs_topological(space, mesh.geometry.dim - 1, _facets(mesh, side))
    return nodes.astype(np.int64) * mesh.geometry.dim + component
