"""Proximal Galerkin beside this program: a P1 program of its own, on two problems with the same meshes.

Usage: uv run python scripts/proximal_galerkin.py [sphere|block] [N ...]       (default: both, 16 32 64)

Proximal Galerkin (Keith and Surowiec) finds the least energy E(u) under u ≥ φ by a sequence of smooth problems: with a
latent variable ψ, u − φ = exp ψ, and steps α_k it solves α_k E'(u_k) + M(ψ_k − ψ_(k−1)) = 0 by Newton's method. Here u
and ψ are in P1, M is lumped, so that u − φ = exp ψ holds at the nodes, and α_k grows by a factor. The density of the
contact force is (ψ_(k−1) − ψ_k)/α_k.

`sphere` is the shipped case, whose solution is known: a membrane over a ball. `block` is an elastic block, E = 2·10⁴
and ν = 0.3 in plane strain, whose top is clamped and moved down by 0.1 onto a plane without friction.
"""

import argparse
from dataclasses import dataclass

from mpi4py import MPI  # isort: skip
import basix
import dolfinx.mesh
import numpy as np
from dolfinx import fem
from scipy.sparse import block_array, coo_array, csr_array, diags_array
from scipy.sparse.linalg import splu

from signorini_fenicsx import (
    Contact,
    Dirichlet,
    Elasticity,
    Neumann,
    certify,
    domain_of,
    load_case,
    solve,
    solve_case,
)
from signorini_fenicsx.quantities import Force

type Array = np.ndarray

GROWS, FIRST, ENOUGH, MOST = 2.0, 1.0, 1e-10, 60
"""α_k grows by the first, from the second. Steps end when u moves by this share, or after so many."""
NEWTON, ITERATIONS, LONGEST = 1e-9, 40, 2.0
"""Newton's method ends where u and exp ψ move by this share, or after so many iterations; none raises ψ by more."""
YOUNG, POISSON, DOWN = 2e4, 0.3, 0.1
SIDES = {"left": (0, 0), "right": (0, 1), "bottom": (1, 0), "top": (1, 1)}
TOUCHES, A, B = 0.697965148223374, -0.680259411891719, 0.471519893402112
"""The membrane touches the ball up to the first radius; beyond u is A log r + B."""


@dataclass(frozen=True)
class Found:
    """What proximal Galerkin has found.

    Attributes:
        u: The unknowns.
        force: The contact force at each bounded unknown.
        steps: Proximal steps.
        solves: Linear solves, one for each of Newton's iterations.
    """

    u: Array
    force: Array
    steps: int
    solves: int


def proximal(
    stiffness: csr_array, load: Array, u: Array, fixed: Array, bounded: Array, low: Array, mass: Array
) -> Found:
    """Minimise ½uᵀKu − bᵀu under u ≥ φ at some unknowns.

    Args:
        stiffness: K.
        load: b.
        u: Where to begin, with the given values.
        fixed: Which unknowns are given.
        bounded: Numbers of those with a bound.
        low: φ there.
        mass: Their lumped masses.
    """
    latent, alpha, solves, free = np.zeros(len(bounded)), FIRST, 0, np.flatnonzero(~fixed)
    pick = csr_array((mass, (bounded, np.arange(len(bounded)))), shape=(len(u), len(bounded)))[free]
    before, last, step = u.copy(), latent, 0
    while step < MOST:
        step, last = step + 1, latent.copy()
        for _ in range(ITERATIONS):
            solves, gap, residual = solves + 1, np.exp(latent), alpha * (load - stiffness @ u)
            residual[bounded] -= mass * (latent - last)
            block = [[alpha * stiffness[free][:, free], pick], [pick.T, diags_array(-mass * gap)]]
            right = np.concatenate([residual[free], mass * (low + gap - u[bounded])])
            found, change = splu(block_array(block).tocsc()).solve(right), np.zeros(len(u))
            change[free], moved = found[: len(free)], found[len(free) :]
            u, latent = u + change, latent + np.minimum(moved, LONGEST)
            if (
                np.abs(change).max() <= NEWTON * np.abs(u).max()
                and np.abs(gap * moved).max() <= NEWTON * np.abs(u).max()
            ):
                break
        if np.linalg.norm(u - before) <= ENOUGH * np.linalg.norm(u):
            break
        before, alpha = u.copy(), alpha * GROWS
    return Found(u, mass * (last - latent) / alpha, step, solves)


def triangles(mesh: dolfinx.mesh.Mesh) -> tuple[Array, Array, Array, Array]:
    """Points, cells, their areas and the gradients of hats, shape (cells, 3, 2)."""
    points, cells = mesh.geometry.x[:, :2], mesh.geometry.dofmaps[0]
    x = points[cells]
    edges = x[:, [2, 0, 1]] - x[:, [1, 2, 0]]  # opposite to each vertex
    twice = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    slopes = np.stack([-edges[:, :, 1], edges[:, :, 0]], axis=2) / twice[:, None, None]
    return points, cells, np.abs(twice) / 2, slopes


def assembled(local: Array, numbers: Array, size: int) -> csr_array:
    """The matrix from those of the cells."""
    k = numbers.shape[1]
    at = np.repeat(numbers, k, axis=1).ravel(), np.tile(numbers, (1, k)).ravel()
    return coo_array((local.ravel(), at), shape=(size, size)).tocsr()


def on_mesh(mesh: dolfinx.mesh.Mesh, values: Array) -> fem.Function:
    """A function of DOLFINx with these values at the points."""
    shape = values.shape[1:]
    v = fem.Function(fem.functionspace(mesh, ("P", 1, shape)))
    v.x.array.reshape(-1, *shape)[v.function_space.dofmap.list] = values[mesh.geometry.dofmaps[0]]
    return v


def sphere(n: int) -> list[str]:
    """A row for the membrane over a ball."""
    solution = solve_case(load_case("sphere").with_values({"solve.h": 4 / n * 2**0.5, "geometry.mesh": "structured"}))
    mesh, errors = solution.spaces.mesh, solution.errors()
    points, cells, areas, slopes = triangles(mesh)
    r = np.linalg.norm(points, axis=1)
    ball = np.sqrt(np.maximum(1 - r**2, 0.19)) * (r < 0.9)
    low, edge = np.where(r < 0.9, ball, 0.19**0.5 - 0.9 / 0.19**0.5 * (r - 0.9)), np.abs(points).max(axis=1) > 2 - 1e-9
    stiffness = assembled(areas[:, None, None] * (slopes @ slopes.transpose(0, 2, 1)), cells, len(points))
    mass, inside = np.bincount(cells.ravel(), np.repeat(areas / 3, 3), len(points)), np.flatnonzero(~edge)
    start = np.where(edge, known(r), low + 1)
    found = proximal(stiffness, np.zeros(len(points)), start, edge, inside, low[inside], mass[inside])
    rule, weights = basix.make_quadrature(basix.CellType.triangle, 6)
    hats = np.column_stack([1 - rule.sum(axis=1), rule])
    x = np.einsum("qk,nki->nqi", hats, points[cells])
    r, weights = np.linalg.norm(x, axis=2), 2 * areas[:, None] * weights
    off = found.u[cells] @ hats.T - known(r)
    slope = np.einsum("nk,nki->ni", found.u[cells], slopes)[:, None] - (falls(r) / r)[..., None] * x
    error, energy = (float(np.sqrt((weights * square).sum())) for square in (off**2, (slope**2).sum(axis=2)))
    bound = certify(solution, v=on_mesh(mesh, found.u))
    ours = [len(solution.outcome.history), solution.outcome.dofs, errors["u_L2"], errors["u_potential_L2"]]
    theirs = [found.steps, found.solves, len(inside), error, energy, bound.lower, bound.bound, bound.guaranteed]
    return [str(n), *words(theirs), *words(ours)]


def block(n: int) -> list[str]:
    """A row for the elastic block."""
    mesh = dolfinx.mesh.create_unit_square(MPI.COMM_SELF, n, n)
    sides = {name: lambda x, at=at: np.isclose(x[at[0]], at[1]) for name, at in SIDES.items()}
    domain = domain_of(mesh, sides)
    rest = [Contact("bottom"), Dirichlet("top", [0, -DOWN]), Neumann(["left", "right"])]
    solution = solve(domain, Elasticity(young=YOUNG, poisson=POISSON, conditions=rest))
    force = solution.quantity(Force("bottom", [0, 1]))
    mesh = solution.spaces.mesh
    points, cells, areas, slopes = triangles(mesh)
    strain = np.zeros((len(cells), 3, 6))  # ε_xx, ε_yy, 2ε_xy of the six unknowns of a cell
    strain[:, 0, 0::2], strain[:, 1, 1::2] = slopes[:, :, 0], slopes[:, :, 1]
    strain[:, 2, 0::2], strain[:, 2, 1::2] = slopes[:, :, 1], slopes[:, :, 0]
    factor = YOUNG / ((1 + POISSON) * (1 - 2 * POISSON))
    law = factor * np.array([[1 - POISSON, POISSON, 0], [POISSON, 1 - POISSON, 0], [0, 0, 0.5 - POISSON]])
    unknowns = (2 * cells[:, :, None] + np.arange(2)).reshape(len(cells), 6)
    local = areas[:, None, None] * (strain.transpose(0, 2, 1) @ law @ strain)
    stiffness = assembled(local, unknowns, 2 * len(points))
    top, low = points[:, 1] > 1 - 1e-9, np.flatnonzero(points[:, 1] < 1e-9)
    length = np.where(np.abs(points[low, 0] - 0.5) > 0.5 - 1e-9, 0.5, 1.0) / n
    start = np.where(np.repeat(top, 2), np.tile([0.0, -DOWN], len(points)), np.tile([0.0, 1e-2], len(points)))
    load, none = np.zeros(2 * len(points)), np.zeros(len(low))
    found = proximal(stiffness / YOUNG, load, start, np.repeat(top, 2), 2 * low + 1, none, length)
    bound = certify(solution, v=on_mesh(mesh, found.u.reshape(-1, 2)))
    theirs = [
        found.steps,
        found.solves,
        int(2 * (~top).sum()),
        YOUNG * found.force.sum(),
        bound.lower,
        bound.bound,
        bound.guaranteed,
    ]
    ours = [len(solution.outcome.history), solution.outcome.dofs, force.lower, force.upper]
    return [str(n), *words(theirs), *words(ours)]


def known(r: Array) -> Array:
    """The membrane over the ball."""
    far = A * np.log(np.maximum(r, TOUCHES)) + B
    return np.where(r < TOUCHES, np.sqrt(np.maximum(1 - r**2, 0.0)), far)


def falls(r: Array) -> Array:
    """The derivative of it by r."""
    return np.where(r < TOUCHES, -r / np.sqrt(np.maximum(1 - r**2, 1e-9)), A / r)


def words(values: list[object]) -> list[str]:
    """Numbers as text."""
    return [f"{value:.7g}" if isinstance(value, float) else str(value) for value in values]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problem", nargs="?", choices=["sphere", "block", "both"], default="both")
    parser.add_argument("sizes", nargs="*", type=int, default=[16, 32, 64])
    options = parser.parse_args()
    of_both = ["n", "steps", "solves", "unknowns"]
    of_field = ["error ≥", "error ≤", "guaranteed", "our solves", "our unknowns"]
    tables = {
        "sphere": (sphere, [*of_both, "‖u − u_h‖", "error", *of_field, "our ‖u − u_h‖", "in points"]),
        "block": (block, [*of_both, "force", *of_field, "force ≥", "force ≤"]),
    }
    for name, (row, heads) in tables.items():
        if options.problem in (name, "both"):
            print(f"\n{name}\n| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
            for n in options.sizes:
                print(f"| {' | '.join(row(n))} |", flush=True)


if __name__ == "__main__":
    main()
