"""Elastic contact by conforming P2 displacements, as a second program: SciPy, one process.

The coefficients are those of Bernstein's basis, so that v_n ≤ g holds on whole facets if the coefficients satisfy it.
Then the energy of v is above that of the exact u, and the complementary energy of an admissible stress below. Without
friction a primal-dual active set finds v. With friction, condensed to Γ_C, u is u₀ + Fλ with the forces λ of the
coefficients. These satisfy λ_n ≥ 0, u_n ≤ g, λ_n(g − u_n) = 0, and |λ_t| ≤ k, −λ_t·u_t = k|u_t|; k is ∫ gB with a
bound g of the shear (Tresca), and μλ_n by Coulomb's law. Block by block, projections find them (Gauss and Seidel).
|u_t| is at most the mean of the lengths of its coefficients, so with Tresca's law the energy is above that of the exact
u.

Usage: python scripts/p2.py [--cells N …]     print the block of `oblique` beside the solution of the package
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import basix.ufl
import dolfinx.mesh
import numpy as np
import scipy.sparse.linalg
import ufl
from boxes import box
from dolfinx import fem
from measuring.problem import primal_dual_active_set
from mpi4py import MPI

from signorini_fenicsx import Contact, Coulomb, Dirichlet, Elasticity, Neumann, Tresca, solve

SINGULAR = 1e-10
"""Pivots below this share of the largest one are rounding."""
NEAR = 1e-9
"""Distance within which a point is on a side."""

type Side = tuple[int, float]
"""A coordinate and its value there."""


@dataclass(frozen=True)
class Box:
    """An elastic box whose last coordinate is 0 on Γ_C.

    Attributes:
        mesh: Its mesh, on one process.
        young: E, a number or UFL on the mesh.
        poisson: ν.
        g_N: Tractions by side.
        fixed: For a side the components of v that are 0.
        gap: g, a number.
        f: Force per volume; none if it is empty.
    """

    mesh: dolfinx.mesh.Mesh
    young: float | ufl.core.expr.Expr
    poisson: float
    g_N: Mapping[Side, Sequence[float]]
    fixed: Mapping[Side, Sequence[int]]
    gap: float
    f: Sequence[float] = ()


@dataclass(frozen=True)
class P2:
    """A solution by P2 displacements.

    Attributes:
        v: The displacement.
        energy: ½(ℂε(v), ε(v)) − (f, v) − ⟨g_N, v⟩ + Σ k|v_t|.
        forces: Those of the coefficients on Γ_C, the normal ones, or with friction vectors.
        steps: Set updates, or sweeps.
    """

    v: fem.Function
    energy: float
    forces: np.ndarray
    steps: int

    @property
    def touching(self) -> int:
        """Number of coefficients in contact."""
        return int(np.count_nonzero(self.forces))


def stress(v: ufl.core.expr.Expr, young: float | ufl.core.expr.Expr, poisson: float) -> ufl.core.expr.Expr:
    """ℂε(v), plane strain in two dimensions."""
    strain = ufl.sym(ufl.grad(v))
    mu, lame = young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    return 2 * mu * strain + lame * ufl.tr(strain) * ufl.Identity(len(v))


def solve_p2(box: Box, *, between: bool = False) -> P2:
    """Solve on a box.

    If Γ_C is between two bodies, the mesh is cut there, and the body above is pressed onto that below. Then all of Γ_C
    is in contact in the first step: nothing else may hold the body above.

    Args:
        box: The box.
        between: Whether Γ_C is between two bodies.

    Raises:
        RuntimeError: If the sets do not settle, or one of them lets a body move freely.
    """
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
    x, v = settled.u, fem.Function(space)
    v.x.array[:] = jumps @ x
    return P2(v, float(x @ (A @ x) / 2 - b @ x), settled.force[contact], settled.steps)


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


def assembled(
    box: Box, degree: int = 2
) -> tuple[fem.FunctionSpace, scipy.sparse.csr_array, np.ndarray, np.ndarray, np.ndarray]:
    """The space, A, b, the unknowns that are 0, and the normal ones on Γ_C."""
    mesh = box.mesh
    assert mesh.comm.size == 1
    dim = mesh.geometry.dim
    basis = basix.LagrangeVariant.bernstein if degree > 1 else basix.LagrangeVariant.gll_warped
    element = basix.ufl.element("P", mesh.basix_cell(), degree, basis, shape=(dim,))
    space = fem.functionspace(mesh, element)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    load = ufl.dot(fem.Constant(mesh, np.array(box.f or [0.0] * dim, dtype=float)), v) * ufl.dx
    for side, traction in box.g_N.items():
        load += on(mesh, side) * ufl.dot(ufl.as_vector([float(x) for x in traction]), v) * ufl.ds
    form = ufl.inner(stress(u, box.young, box.poisson), ufl.sym(ufl.grad(v))) * ufl.dx
    A = fem.assemble_matrix(fem.form(form)).to_scipy().tocsr()
    b = fem.assemble_vector(fem.form(load)).array
    zero = [_dofs(space, side, k) for side, components in box.fixed.items() for k in components]
    held = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *zero]))
    return space, A, b, held, np.setdiff1d(_dofs(space, (dim - 1, 0.0), dim - 1), held)


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


def on(mesh: dolfinx.mesh.Mesh, side: Side) -> ufl.core.expr.Expr:
    """1 on a side and 0 on the others."""
    axis, place = side
    return ufl.conditional(ufl.lt(abs(ufl.SpatialCoordinate(mesh)[axis] - place), NEAR), 1.0, 0.0)


def _dofs(space: fem.FunctionSpace, side: Side, component: int) -> np.ndarray:
    """Unknowns of a component on a side; in Bernstein's basis as in Lagrange's."""
    mesh, (axis, place) = space.mesh, side
    last = mesh.geometry.dim - 1
    facets = dolfinx.mesh.locate_entities_boundary(mesh, last, lambda x: np.isclose(x[axis], place))
    nodes = fem.locate_dofs_topological(space, last, facets)
    return nodes.astype(np.int64) * mesh.geometry.dim + component


SWEEPS, ENOUGH = 20_000, 1e-8
"""Sweeps at most, and the change of the forces in one, as a share of the largest, with which they end."""
GAP, PUSH, LIFT = 0.01, [0.05, 0.03, -0.1], [0.0, 0.0, 0.03]
"""Of the block of `oblique`: the gap, and the tractions on its top and on its end."""
LAWS = (Tresca(0.02), Coulomb(0.1), Coulomb(0.3), Coulomb(1.0))


def solve_p2_friction(box: Box, law: Tresca | Coulomb) -> P2:
    """Solve on a box with this law on Γ_C.

    Raises:
        RuntimeError: If the forces do not settle, or nothing else holds the body.
    """
    mesh, dim = box.mesh, box.mesh.geometry.dim
    space, A, b, held, contact = assembled(box)
    free = np.setdiff1d(np.arange(len(b)), held)
    nodes = contact[np.isin(contact, free)] // dim
    rows = np.searchsorted(free, nodes[:, None] * dim + np.arange(dim))
    factors = factorised(A[free][:, free])
    pulls = np.zeros((len(free), rows.size))
    pulls[rows.ravel(), np.arange(rows.size)] = 1.0
    flexible, at_rest = factors.solve(pulls), factors.solve(b[free])
    mu, given = (law.mu, None) if isinstance(law, Coulomb) else (0.0, None)
    if isinstance(law, Tresca):
        weight = on(mesh, (dim - 1, 0.0)) * ufl.TestFunction(space)[dim - 1] * ufl.ds
        given = law.g * fem.assemble_vector(fem.form(weight)).array[nodes * dim + dim - 1]
    forces, sweeps = _forces(flexible[rows.ravel()], at_rest[rows], box.gap, mu, given)
    x = np.zeros(len(b))
    x[free] = at_rest + flexible @ forces.ravel()
    slips = np.linalg.norm(x[nodes[:, None] * dim + np.arange(dim - 1)], axis=1)
    bound = mu * forces[:, -1] if given is None else given
    v = fem.Function(space)
    v.x.array[:] = x
    return P2(v, float(x @ (A @ x) / 2 - b @ x + bound @ slips), forces, sweeps)


def _forces(
    flexible: np.ndarray, at_rest: np.ndarray, gap: float, mu: float, given: np.ndarray | None
) -> tuple[np.ndarray, int]:
    """The forces on the coefficients of Γ_C, the normal one upwards and last, and the number of sweeps.

    Args:
        flexible: F.
        at_rest: u₀, shape (nodes, d).
        gap: g; −u_last ≤ g.
        mu: μ of Coulomb's law.
        given: The k of Tresca's law.
    """
    number, dim = at_rest.shape
    forces, u = np.zeros((number, dim)), at_rest.copy()
    blocks, columns = flexible.reshape(number, dim, number, dim), flexible.T.copy().reshape(number, dim, -1)
    normal = np.array([blocks[i, -1, i, -1] for i in range(number)])
    along = np.array([np.linalg.norm(blocks[i, :-1, i, :-1], 2) for i in range(number)])
    for sweeps in range(1, SWEEPS + 1):
        change = 0.0
        for i in range(number):
            new = forces[i].copy()
            new[-1] = max(new[-1] - (u[i, -1] + gap) / normal[i], 0.0)
            u_t = u[i, :-1] + blocks[i, :-1, i, -1] * (new[-1] - forces[i, -1])
            new[:-1] -= u_t / along[i]
            bound, size = mu * new[-1] if given is None else given[i], np.linalg.norm(new[:-1])
            new[:-1] *= min(1.0, bound / size) if size > 0 else 1.0
            u += ((new - forces[i]) @ columns[i]).reshape(number, dim)
            change, forces[i] = max(change, float(np.abs(new - forces[i]).max())), new
        if change <= ENOUGH * np.abs(forces).max():
            return forces, sweeps
    raise RuntimeError("the forces do not settle")


def oblique(n: int, law: Tresca | Coulomb) -> tuple[Any, P2]:
    """A block, n cells high, that is held at one end and pushed obliquely on a plane: by the package, and by P2."""
    domain = box([0.0, 0.0, 0.0], [2.0, 1.0, 1.0], [2 * n, n, n], MPI.COMM_SELF)
    rest = [Neumann("top", PUSH), Neumann("right", LIFT), Neumann(["front", "back"]), Dirichlet("left", 0)]
    body = Elasticity(1.0, 0.3, conditions=[Contact("bottom", gap=GAP, friction=law), *rest])
    loads = {(2, 1.0): PUSH, (0, 2.0): LIFT}
    return solve(domain, body), solve_p2_friction(Box(domain.mesh, 1.0, 0.3, loads, {(0, 0.0): [0, 1, 2]}, GAP), law)


def main() -> None:
    """Print a line for each law and mesh."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, nargs="*", default=[2, 3], help="cells along the height")
    print("law, cells: energies: P2, ours; stress: P2, ours; force on the plane: P2; ours")
    for law in LAWS:
        for n in parser.parse_args().cells:
            solution, other = oblique(n, law)
            norms = solution.norms()
            complementary = norms["energy"] ** 2 / 2 + GAP * norms["contact_force"]
            size = stress_norm(solution.spaces.mesh, stress(other.v, 1.0, 0.3), 1.0, 0.3)
            pulls = other.forces.sum(axis=0), solution.resultants()["bottom"]
            told = ";  ".join("  ".join(f"{x:.5f}" for x in each[:3]) for each in pulls)
            print(f"{law}, {n}: {other.energy:.6f} {-complementary:.6f}; {size:.5f} {norms['energy']:.5f}; {told}")


if __name__ == "__main__":
    main()
