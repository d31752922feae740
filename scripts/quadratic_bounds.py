"""Tells how far quadratic elements pass a bound that holds in their nodes, and how wrong they are.

uv run python scripts/quadratic_bounds.py [--h 0.16] [--refine 2]

Muskat's dam, w ≥ 0: continuous quadratic elements with w ≥ 0 in all nodes, by PETSc's vinewtonrsls, which issue 30098
of MOOSE is about. It prints the smallest w in 55 points of each cell, the share of the points where w < 0, and bounds
of the energy error of w, by a flux on a mesh that is refined so often. Then it prints the smallest mean of w in a cell
by the method of this program on the first mesh, and the bound of its error.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import argparse

import dolfinx.fem.petsc
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from signorini_fenicsx import certify, load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.uniform import refined_uniformly

MOST = 500
"""Most iterations of SNES."""
SIDE, NOISE = 9, 1e-14
"""Points of a cell divide its edges into so many pieces; what is no more below 0 than the second is rounding."""


def u_D(x: np.ndarray) -> np.ndarray:
    """The levels: w on the boundary."""
    return (1 - x[0] / 1.62) * (3.22 - x[1]) ** 2 / 2 + x[0] / 1.62 * np.maximum(0.84 - x[1], 0) ** 2 / 2


def quadratic(domain: Domain) -> fem.Function:
    """The w of quadratic elements with w ≥ 0 in their nodes."""
    mesh = domain.mesh
    space = fem.functionspace(mesh, ("Lagrange", 2))
    u, v, w = ufl.TrialFunction(space), ufl.TestFunction(space), fem.Function(space, name="w")
    lifted = fem.Function(space)
    lifted.interpolate(u_D)
    mesh.topology.create_connectivity(1, 2)
    outer = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    fixed = [fem.dirichletbc(lifted, fem.locate_dofs_topological(space, 1, outer))]
    form = fem.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)
    A = dolfinx.fem.petsc.assemble_matrix(form, bcs=fixed)
    A.assemble()
    b = dolfinx.fem.petsc.assemble_vector(fem.form(-1.0 * v * ufl.dx))
    dolfinx.fem.petsc.apply_lifting(b, [form], bcs=[fixed])
    dolfinx.fem.petsc.set_bc(b, fixed)
    snes = PETSc.SNES().create(mesh.comm)
    snes.setType("vinewtonrsls")
    snes.setFunction(lambda _, x, out: out.waxpy(-1.0, b, A * x), b.duplicate())
    snes.setJacobian(lambda *_: None, A)
    least, most = b.duplicate(), b.duplicate()
    least.set(0.0)
    most.set(PETSc.INFINITY)
    snes.setVariableBounds(least, most)
    snes.setTolerances(atol=1e-12, rtol=1e-12, max_it=MOST)
    snes.getKSP().setType("preonly")
    snes.getKSP().getPC().setType("lu")
    x = b.duplicate()
    snes.solve(None, x)
    w.x.array[:] = x.array
    if snes.getConvergedReason() <= 0:
        raise SystemExit(f"error: SNES does not converge, reason {snes.getConvergedReason()}")
    return w


def refined(domain: Domain, w: fem.Function, levels: int) -> tuple[Domain, fem.Function]:
    """The mesh refined so often, and w on it, where it is the same function."""
    for _ in range(levels):
        domain = refined_uniformly(domain)
    mesh = domain.mesh
    fine = fem.Function(fem.functionspace(mesh, ("Lagrange", 2)))
    cells = np.arange(domain.cells, dtype=np.int32)
    search = fem.create_interpolation_data(fine.function_space, w.function_space, cells, padding=1e-12)
    fine.interpolate_nonmatching(w, cells, search)
    return domain, fine


def main() -> None:
    """Print the bounds."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--h", default="0.16", help="size of the cells")
    options.add_argument("--refine", type=int, default=2, help="how often the mesh is refined for the bounds")
    arguments = options.parse_args()
    case = load_case("muskat").with_values({"solve.h": arguments.h})
    solution = solve_case(case)
    domain = solution.spaces.domain
    w = quadratic(domain)
    places = np.array([[i, j] for i in range(SIDE + 1) for j in range(SIDE + 1 - i)]) / SIDE
    shapes = w.function_space.element.basix_element.tabulate(0, places)[0, :, :, 0]
    values = shapes @ w.x.array[w.function_space.dofmap.list].T
    finer, v = refined(domain, w, arguments.refine)
    of_v, ours = certify(solve_case(case, domain=finer), v=v), certify(solution)
    print(f"{domain.cells} triangles, {len(w.x.array)} quadratic unknowns, {solution.outcome.dofs} of this program")
    print(f"quadratic: w ≥ {w.x.array.min():.1e} in nodes, {values.min():.1e} in points", end="")
    print(f", w < 0 in {100 * (values < -NOISE).mean():.1f} % of the points")
    print(f"           {of_v.lower:.3g} ≤ energy error ≤ {of_v.bound:.3g}, {of_v.repair:.2g} from w ≥ 0 and u_D")
    print(f"here:      w ≥ {solution.u.x.array.min():.1e} as means, energy error ≤ {ours.bound:.3g}")


if __name__ == "__main__":
    main()
