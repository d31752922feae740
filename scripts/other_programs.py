"""Tells how wrong solutions of other programs are: P1 with a penalty that is too soft, good, and solved carelessly.

uv run --group bench python scripts/other_programs.py scikit-fem
uv run --group bench python scripts/other_programs.py ngsolve
uv run python scripts/other_programs.py numpy                       a P1 program of forty lines

The solution of the problem is known: u = y⁴ − y/2, pressed onto the bottom of the square by a flux ½. The program
gives a matrix A, a load b and the masses m of the nodes of Γ_S. With a penalty u ≥ 0 becomes Au − [u]_- m/ε = b, solved
by active sets. A soft penalty lets u through. A stiff one makes residuals so large that conjugate gradients, which end
at a share of 10⁻⁴ of the first one, leave a large error. Each solution goes through a file to `signorini certify`. A
row has ε, the true error |∇(v − u)|, its bounds, and the distance of the repair.
"""

import argparse
import json
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.linalg import cg, spsolve

type Array = np.ndarray
type Assembled = tuple[csr_array, Array, Array]
"""The matrix, the load, and the masses of the nodes, 0 off Γ_S."""

CASE = """[geometry]
shape = "square"
[boundary]
signorini = ["bottom"]
neumann = ["left", "right"]
[problem]
f = "-12*y^2"
u_D = "1/2"
"""
N = 32
ROUNDS = 50
CARELESS = 1e-4


def grid(n: int) -> tuple[Array, Array]:
    """Points and triangles of the unit square."""
    x, y = (each.ravel() for each in np.meshgrid(*2 * [np.linspace(0, 1, n + 1)], indexing="ij"))
    number = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    corners = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    a, b, c, d = (each.ravel() for each in corners)
    return np.column_stack([x, y]), np.concatenate([np.column_stack([a, b, d]), np.column_stack([b, c, d])])


def by_numpy(points: Array, cells: Array) -> Assembled:
    """P1 by NumPy."""
    slopes, areas = hats(points, cells)
    local = areas[:, None, None] * (slopes @ slopes.transpose(0, 2, 1))
    rows, columns = np.repeat(cells, 3, axis=1).ravel(), np.tile(cells, (1, 3)).ravel()
    middle = points[cells[:, [1, 2, 0]]] / 2 + points[cells[:, [2, 0, 1]]] / 2  # opposite to each vertex
    f = -12 * middle[..., 1] ** 2
    loads = areas[:, None] / 6 * (f.sum(axis=1, keepdims=True) - f)
    bottom = np.flatnonzero(points[:, 1] == 0)
    bottom = bottom[np.argsort(points[bottom, 0])]
    masses, halves = np.zeros(len(points)), np.diff(points[bottom, 0]) / 2
    np.add.at(masses, bottom[:-1], halves)
    np.add.at(masses, bottom[1:], halves)
    return csr_array(coo_array((local.ravel(), (rows, columns)))), np.bincount(cells.ravel(), loads.ravel()), masses


def by_skfem(points: Array, cells: Array) -> Assembled:
    """P1 by scikit-fem."""
    import skfem
    from measuring.conforming import stiffness

    mesh = skfem.MeshTri(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))
    bottom = mesh.facets_satisfying(lambda x: x[1] < 1e-12, boundaries_only=True)
    basis = skfem.Basis(mesh, skfem.ElementTriP1(), intorder=4)
    on_bottom = skfem.FacetBasis(mesh, skfem.ElementTriP1(), facets=bottom)
    masses = skfem.LinearForm(lambda v, w: 1.0 * v).assemble(on_bottom)
    load = skfem.LinearForm(lambda v, w: -12 * w.x[1] ** 2 * v).assemble(basis)
    return csr_array(stiffness.assemble(basis)), load, masses


def by_ngsolve(points: Array, cells: Array) -> Assembled:
    """P1 by NGSolve."""
    import ngsolve
    from measuring.conforming import netgen_mesh
    from ngsolve import ds, dx, grad

    mesh = netgen_mesh(points, cells)
    space = ngsolve.H1(mesh, order=1)
    u, v = space.TnT()
    a = ngsolve.BilinearForm(grad(u) * grad(v) * dx).Assemble()
    f = ngsolve.LinearForm(-12 * ngsolve.y**2 * v * dx(bonus_intorder=3)).Assemble()
    m = ngsolve.LinearForm(v * ds("contact")).Assemble()
    rows, columns, values = (np.array(each) for each in a.mat.COO())
    b, masses = (each.vec.FV().NumPy().copy() for each in (f, m))
    return csr_array(coo_array((values, (rows, columns)), shape=2 * [space.ndof])), b, masses


PROGRAMS: dict[str, Callable[[Array, Array], Assembled]] = {
    "numpy": by_numpy,
    "scikit-fem": by_skfem,
    "ngsolve": by_ngsolve,
}


def hats(points: Array, cells: Array) -> tuple[Array, Array]:
    """Gradients of the hat functions, shape (cells, 3, 2), and areas."""
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    two = np.linalg.inv(edges).transpose(0, 2, 1)
    return np.concatenate([-two.sum(axis=1, keepdims=True), two], axis=1), np.abs(np.linalg.det(edges)) / 2


def penalised(assembled: Assembled, points: Array, eps: float, *, careless: bool) -> Array:
    """The solution with a penalty, by active sets; linear systems by a factorisation, or carelessly."""
    A, b, masses = assembled
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


def true_error(points: Array, cells: Array, u: Array) -> float:
    """|∇(v − u)| by quadrature on triangles that are divided into 64."""
    slopes, areas = hats(points, cells)
    slope = np.einsum("nv,nvi->ni", u[cells], slopes)
    small = np.array([[i, j] for i in range(24) for j in range(24 - i)]) / 24 + 1 / 72
    x = points[cells[:, :1]] + np.einsum("qa,nai->nqi", small, points[cells[:, 1:]] - points[cells[:, :1]])
    exact = np.stack([0 * x[..., 1], 4 * x[..., 1] ** 3 - 0.5], axis=2)
    return float(np.sqrt(areas @ ((exact - slope[:, None]) ** 2).sum(axis=2).mean(axis=1)))


def main() -> None:
    """Print a row for each penalty."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", choices=PROGRAMS)
    arguments = parser.parse_args()
    points, cells = grid(N)
    assembled = PROGRAMS[arguments.program](points, cells)
    print(f"{'ε':>8} {'solver':>10} {'error':>9} {'lower':>9} {'upper':>9} {'repair':>9}")
    for eps, careless in ((0.3, False), (1e-2, False), (1e-4, False), (1e-4, True), (1e-9, True)):
        u = penalised(assembled, points, eps, careless=careless)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "field.vtu")
            meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), [("triangle", cells)], {"u": u}).write(file)
            Path(folder, "case.toml").write_text(CASE)
            command = ["signorini", "certify", f"{folder}/case.toml", "--field", str(file), "--refine", "1", "--json"]
            ended = subprocess.run(
                [*command, "--output", f"{folder}/results"], capture_output=True, text=True, check=True
            )
        field = json.loads(ended.stdout)["field"]
        row = [true_error(points, cells, u), field["lower"], field["bound"], field["repair"]]
        solver = "careless" if careless else "direct"
        print(f"{eps:8.0e} {solver:>10} " + " ".join(f"{value:9.2e}" for value in row), flush=True)


if __name__ == "__main__":
    main()
