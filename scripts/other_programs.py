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

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import argparse
import json
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import ufl
from boxes import box, grid
from dolfinx import fem
from dolfinx.mesh import DiagonalType
from mpi4py import MPI
from p2 import Box, assembled, on
from scipy.sparse import block_array, csr_array, diags_array
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


def vector(form: Any) -> Array:
    """The vector of a linear form."""
    return np.asarray(fem.assemble_vector(fem.form(form)).array)


def stiffness(space: fem.FunctionSpace) -> csr_array:
    """(∇u, ∇v)."""
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    return fem.assemble_matrix(fem.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)).to_scipy().tocsr()


def norm(off: Any) -> float:
    """‖off‖."""
    return float(fem.assemble_scalar(fem.form(ufl.inner(off, off) * ufl.dx(metadata={"quadrature_degree": 6}))) ** 0.5)


def field_of(space: fem.FunctionSpace, values: Array) -> fem.Function:
    """A function with these coefficients."""
    v = fem.Function(space)
    v.x.array[:] = values
    return v


def penalty() -> None:
    """Print a row for each penalty."""
    mesh = grid([0, 0], [1, 1], [N, N], MPI.COMM_SELF, DiagonalType.left)
    space, y = fem.functionspace(mesh, ("P", 1)), ufl.SpatialCoordinate(mesh)[1]
    v, points = ufl.TestFunction(space), space.tabulate_dof_coordinates()
    A, b, masses = stiffness(space), vector(-12 * y**2 * v * ufl.dx), vector(on(mesh, (1, 0.0)) * v * ufl.ds)
    print(f"{'ε':>8} {'solver':>10} {'error':>9} {'lower':>9} {'upper':>9} {'repair':>9}")
    for eps, careless in ((0.3, False), (1e-2, False), (1e-4, False), (1e-4, True), (1e-9, True)):
        u = penalised(A, b, masses, points, eps, careless=careless)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "field.vtu")
            meshio.Mesh(points, [("triangle", space.dofmap.list)], {"u": u}).write(file)
            Path(folder, "case.toml").write_text(CASE)
            command = ["signorini", "certify", f"{folder}/case.toml", "--field", str(file), "--refine", "1", "--json"]
            ended = subprocess.run(
                [*command, "--output", f"{folder}/results"], capture_output=True, text=True, check=True
            )
        field = json.loads(ended.stdout)["field"]
        error = norm(ufl.grad(field_of(space, u)) - ufl.as_vector([0, 4 * y**3 - 0.5]))
        solver = "careless" if careless else "direct"
        numbers = " ".join(f"{value:9.2e}" for value in (error, field["lower"], field["bound"], field["repair"]))
        print(f"{eps:8.0e} {solver:>10} {numbers}", flush=True)


def penalised(A: csr_array, b: Array, masses: Array, points: Array, eps: float, *, careless: bool) -> Array:
    """The solution with a penalty, by active sets; linear systems by a factorisation, or carelessly."""
    fixed = points[:, 1] > 1 - 1e-9
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
            if max(np.abs(change).max(), np.abs(gap * moved).max()) <= NEWTON * np.abs(u).max():
                break
        if np.linalg.norm(u - before) <= ENOUGH * np.linalg.norm(u):
            break
        before, alpha = u.copy(), alpha * GROWS
    return Found(u, mass * (last - latent) / alpha, step, solves)


def sphere(n: int) -> list[str]:
    """A row for the membrane over a ball."""
    solution = solve_case(load_case("sphere").with_values({"solve.h": 4 / n * 2**0.5, "geometry.mesh": "structured"}))
    mesh, errors = solution.spaces.mesh, solution.errors()
    space, x = fem.functionspace(mesh, ("P", 1)), ufl.SpatialCoordinate(mesh)
    points = space.tabulate_dof_coordinates()[:, :2]
    r, edge = np.linalg.norm(points, axis=1), np.abs(points).max(axis=1) > 2 - 1e-9
    ball = np.sqrt(np.maximum(1 - r**2, 0.19)) * (r < 0.9)
    low = np.where(r < 0.9, ball, 0.19**0.5 - 0.9 / 0.19**0.5 * (r - 0.9))
    mass, inside = vector(ufl.TestFunction(space) * ufl.dx), np.flatnonzero(~edge)
    start = np.where(edge, A * np.log(np.maximum(r, TOUCHES)) + B, low + 1)
    found = proximal(stiffness(space), 0 * r, start, edge, inside, low[inside], mass[inside])
    u, s = field_of(space, found.u), ufl.sqrt(ufl.dot(x, x))
    far, height = ufl.max_value(s, TOUCHES), ufl.sqrt(ufl.max_value(1 - s**2, 1e-9))
    known = ufl.conditional(s < TOUCHES, height, A * ufl.ln(far) + B)
    slope = ufl.conditional(s < TOUCHES, -1 / height, A / far**2) * x
    bound = certify(solution, v=u)
    ours = [len(solution.outcome.history), solution.outcome.dofs, errors["u_L2"], errors["u_potential_L2"]]
    theirs = [found.steps, found.solves, len(inside), norm(u - known), norm(ufl.grad(u) - slope)]
    return words([n, *theirs, bound.lower, bound.bound, bound.guaranteed, *ours])


def block(n: int) -> list[str]:
    """A row for the elastic block."""
    domain = box([0, 0], [1, 1], [n, n], MPI.COMM_SELF)
    rest = [Contact("bottom"), Dirichlet("top", [0, -DOWN]), Neumann(["left", "right"])]
    solution = solve(domain, Elasticity(young=YOUNG, poisson=POISSON, conditions=rest))
    force, mesh = solution.quantity(Force("bottom", [0, 1])), solution.spaces.mesh
    space, matrix, load, held, low = assembled(Box(mesh, 1.0, POISSON, {}, {(1, 1.0): [0, 1]}, 0.0), degree=1)
    top = np.isin(np.arange(len(load)), held)
    length = vector(on(mesh, (1, 0.0)) * ufl.TestFunction(space)[1] * ufl.ds)[low]
    start = np.where(top, np.tile([0.0, -DOWN], len(load) // 2), np.tile([0.0, 1e-2], len(load) // 2))
    found = proximal(matrix, load, start, top, low, 0 * length, length)
    bound = certify(solution, v=field_of(space, found.u))
    theirs = [found.steps, found.solves, len(load) - len(held), YOUNG * found.force.sum()]
    ours = [len(solution.outcome.history), solution.outcome.dofs, force.lower, force.upper]
    return words([n, *theirs, bound.lower, bound.bound, bound.guaranteed, *ours])


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
