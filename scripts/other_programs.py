"""Other programs' solutions beside ours, and what `certify` says of them: P1 with a penalty, and proximal Galerkin.

    uv run python scripts/other_programs.py penalty
    uv run python scripts/other_programs.py sphere|block [N ...]         (default: 16 32 64)

`penalty`: P1 with a penalty that is too soft, good, and solved carelessly. The solution is known: u = y⁴ − y/2, pressed
onto the bottom of the square by a flux ½. With a matrix A, a load b and the masses m of the nodes of Γ_S, u ≥ 0 becomes
Au − [u]_- m/ε = b, solved by active sets. A soft penalty lets u through. A stiff one makes residuals so large that
conjugate gradients, which end at a share of 10⁻⁴ of the first one, leave a large error. Each solution goes through a
file to `signorini certify`. A row has ε, the true error |∇(v − u)|, its bounds, and the distance of the repair.

Proximal Galerkin (Keith and Surowiec) finds the least energy E(u) under u ≥ φ by a sequence of smooth problems: with a
latent variable ψ, u − φ = exp ψ, and steps α_k it solves α_k E'(u_k) + M(ψ_k − ψ_(k−1)) = 0 by Newton's method. Here u
and ψ are in P1, M is lumped, so that u − φ = exp ψ holds at the nodes, and α_k grows by a factor. The density of the
contact force is (ψ_(k−1) − ψ_k)/α_k. `sphere` is the shipped case, whose solution is known: a membrane over a ball.
`block` is an elastic block, E = 2·10⁴ and ν = 0.3 in plane strain, whose top is clamped and moved down by 0.1 onto a
plane without friction.
"""

import argparse
import json
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI  # isort: skip
import basix
import dolfinx.mesh
import meshio
import numpy as np
from boxes import box, grid
from dolfinx import fem
from dolfinx.mesh import DiagonalType
from scipy.sparse import block_array, coo_array, csr_array, diags_array
from scipy.sparse.linalg import cg, splu, spsolve

from signorini_fenicsx import (
    Contact,
    Dirichlet,
    Elasticity,
    Neumann,
    certify,
    load_case,
    solve,
    solve_case,
)
from signorini_fenicsx.quantities import Force

type Array = np.ndarray

CASE = """problem = {f = "-12*y^2", u_D = "1/2"}
geometry.shape = "square"
boundary = {signorini = ["bottom"], neumann = ["left", "right"]}
"""
N = 32
ROUNDS = 50
CARELESS = 1e-4
GROWS, FIRST, ENOUGH, MOST = 2.0, 1.0, 1e-10, 60
"""α_k grows by the first, from the second. Steps end when u moves by this share, or after so many."""
NEWTON, ITERATIONS, LONGEST = 1e-9, 40, 2.0
"""Newton's method ends where u and exp ψ move by this share, or after so many iterations; none raises ψ by more."""
YOUNG, POISSON, DOWN = 2e4, 0.3, 0.1
TOUCHES, A, B = 0.697965148223374, -0.680259411891719, 0.471519893402112
"""The membrane touches the ball up to the first radius; beyond u is A log r + B."""


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


def stiffness(areas: Array, slopes: Array, cells: Array, size: int) -> csr_array:
    """That of P1: (∇u, ∇v)."""
    return assembled(areas[:, None, None] * (slopes @ slopes.transpose(0, 2, 1)), cells, size)


def on_mesh(mesh: dolfinx.mesh.Mesh, values: Array) -> fem.Function:
    """A function of DOLFINx with these values at the points."""
    shape = values.shape[1:]
    v = fem.Function(fem.functionspace(mesh, ("P", 1, shape)))
    v.x.array.reshape(-1, *shape)[v.function_space.dofmap.list] = values[mesh.geometry.dofmaps[0]]
    return v


def penalty() -> None:
    """Print a row for each penalty."""
    points, cells, areas, slopes = triangles(grid([0, 0], [1, 1], [N, N], MPI.COMM_SELF, DiagonalType.left))
    A = stiffness(areas, slopes, cells, len(points))
    middle = (points[cells[:, [1, 2, 0]]] + points[cells[:, [2, 0, 1]]]) / 2  # opposite to each vertex
    f = -12 * middle[..., 1] ** 2
    b = np.bincount(cells.ravel(), (areas[:, None] / 6 * (f.sum(axis=1, keepdims=True) - f)).ravel())
    ends = np.where(np.abs(points[:, 0] - 0.5) == 0.5, 0.5, 1.0)
    masses = np.where(points[:, 1] == 0, ends / N, 0.0)
    print(f"{'ε':>8} {'solver':>10} {'error':>9} {'lower':>9} {'upper':>9} {'repair':>9}")
    for eps, careless in ((0.3, False), (1e-2, False), (1e-4, False), (1e-4, True), (1e-9, True)):
        u = penalised(A, b, masses, points, eps, careless=careless)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "field.vtu")
            meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), [("triangle", cells)], {"u": u}).write(file)
            Path(folder, "case.toml").write_text(CASE)
            command = ["signorini", "certify", f"{folder}/case.toml", "--field", str(file), "--refine", "1", "--json"]
            ended = subprocess.run(
                [*command, "--output", f"{folder}/results"], capture_output=True, text=True, check=True
            )
        field = json.loads(ended.stdout)["field"]
        row = [true_error(points, cells, areas, slopes, u), field["lower"], field["bound"], field["repair"]]
        solver = "careless" if careless else "direct"
        print(f"{eps:8.0e} {solver:>10} " + " ".join(f"{value:9.2e}" for value in row), flush=True)


def penalised(A: csr_array, b: Array, masses: Array, points: Array, eps: float, *, careless: bool) -> Array:
    """The solution with a penalty, by active sets; linear systems by a factorisation, or carelessly."""
    fixed = points[:, 1] == 1
    u = np.where(fixed, 0.5, 0.0)
    free, active = ~fixed, np.zeros(len(u), dtype=bool)
    for _ in range(ROUNDS):
        K = csr_array(A + diags_array(np.where(active, masses / eps, 0.0)))
        matrix, rest = K[free][:, free], (b - K @ u)[free]
        u[free] += cg(matrix, rest, rtol=CARELESS)[0] if careless else spsolve(matrix.tocsc(), rest)
        before, active = active, (u < 0) & (masses > 0) & free
        if np.array_equal(before, active):
            break
    return u


def true_error(points: Array, cells: Array, areas: Array, slopes: Array, u: Array) -> float:
    """|∇(v − u)| by quadrature on triangles that are divided into 64."""
    slope = np.einsum("nv,nvi->ni", u[cells], slopes)
    small = np.array([[i, j] for i in range(24) for j in range(24 - i)]) / 24 + 1 / 72
    x = points[cells[:, :1]] + np.einsum("qa,nai->nqi", small, points[cells[:, 1:]] - points[cells[:, :1]])
    exact = np.stack([0 * x[..., 1], 4 * x[..., 1] ** 3 - 0.5], axis=2)
    return float(np.sqrt(areas @ ((exact - slope[:, None]) ** 2).sum(axis=2).mean(axis=1)))


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


def sphere(n: int) -> list[str]:
    """A row for the membrane over a ball."""
    solution = solve_case(load_case("sphere").with_values({"solve.h": 4 / n * 2**0.5, "geometry.mesh": "structured"}))
    mesh, errors = solution.spaces.mesh, solution.errors()
    points, cells, areas, slopes = triangles(mesh)
    r = np.linalg.norm(points, axis=1)
    ball = np.sqrt(np.maximum(1 - r**2, 0.19)) * (r < 0.9)
    low, edge = np.where(r < 0.9, ball, 0.19**0.5 - 0.9 / 0.19**0.5 * (r - 0.9)), np.abs(points).max(axis=1) > 2 - 1e-9
    mass, inside = np.bincount(cells.ravel(), np.repeat(areas / 3, 3), len(points)), np.flatnonzero(~edge)
    start = np.where(edge, known(r), low + 1)
    matrix, none = stiffness(areas, slopes, cells, len(points)), np.zeros(len(points))
    found = proximal(matrix, none, start, edge, inside, low[inside], mass[inside])
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
    domain = box([0, 0], [1, 1], [n, n], MPI.COMM_SELF)
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
    matrix = assembled(local, unknowns, 2 * len(points))
    top, low = points[:, 1] > 1 - 1e-9, np.flatnonzero(points[:, 1] < 1e-9)
    length = np.where(np.abs(points[low, 0] - 0.5) > 0.5 - 1e-9, 0.5, 1.0) / n
    start = np.where(np.repeat(top, 2), np.tile([0.0, -DOWN], len(points)), np.tile([0.0, 1e-2], len(points)))
    load, none = np.zeros(2 * len(points)), np.zeros(len(low))
    found = proximal(matrix / YOUNG, load, start, np.repeat(top, 2), 2 * low + 1, none, length)
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


ROWS = {
    "sphere": (sphere, "‖u − u_h‖ | error", "our ‖u − u_h‖ | in points"),
    "block": (block, "force", "force ≥ | force ≤"),
}
"""What makes a row of proximal Galerkin, and the heads of its columns besides those of both."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problem", choices=["penalty", *ROWS])
    parser.add_argument("sizes", nargs="*", type=int, default=[16, 32, 64])
    options = parser.parse_args()
    if options.problem == "penalty":
        penalty()
        return
    row, theirs, ours = ROWS[options.problem]
    bounds = "error ≥ | error ≤ | guaranteed | our solves | our unknowns"
    heads = f"n | steps | solves | unknowns | {theirs} | {bounds} | {ours}"
    print(f"| {heads} |\n|{'---|' * (heads.count('|') + 1)}")
    for n in options.sizes:
        print(f"| {' | '.join(row(n))} |", flush=True)


if __name__ == "__main__":
    main()
