"""Seconds and memory of gradients beside those of solves from known sets, for some h.

python scripts/gradient_cost.py diffusion 0.006 0.003     by κ in each cell
python scripts/gradient_cost.py coulomb 0.03 0.015        by E in each cell and by μ, with Coulomb's friction
"""

import gc
import resource
import sys
import time
from typing import Any

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries
import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx import Contact, Coulomb, Diffusion, Dirichlet, Elasticity, Neumann, Signorini, Solver
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import build_domain

REPEATS = 4


def diffusion(domain: Domain, values: fem.Function, number: fem.Constant) -> Any:
    """A problem with κ in each cell and a load."""
    x = ufl.SpatialCoordinate(domain.mesh)
    conditions = [Signorini("bottom", psi=-0.05), Neumann("right")]
    return Diffusion(f=40 * number * (x[0] - 0.6), kappa=values, conditions=conditions)


def coulomb(domain: Domain, values: fem.Function, number: fem.Constant) -> Any:
    """A block that is pressed and pushed, with E in each cell and μ."""
    pushed = Dirichlet("top", ["0.05", "-0.1"])
    conditions = [Contact("bottom", friction=Coulomb(0.3 * number)), pushed, Neumann(["left", "right"])]
    return Elasticity(young=values, poisson=0.3, conditions=conditions)


def peak() -> float:
    """The most memory that the process has held, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measure(h: float, make: Any) -> None:
    """Print seconds of some solves and gradients."""
    domain = build_domain(MPI.COMM_WORLD, "square", h, mesh="structured")
    values = fem.Function(fem.functionspace(domain.mesh, ("DG", 0)))
    values.x.array[:] = 1.0
    number = fem.Constant(domain.mesh, 1.0)
    problem = make(domain, values, number)
    solver = Solver(domain, problem)
    solution = solver.solve(problem)
    for _ in range(REPEATS):
        values.x.array[:] *= 1.01
        began = time.perf_counter()
        solution = solver.solve(problem, start=solution)
        solved, memory = time.perf_counter(), peak()
        u = solution.u if make is diffusion else solution.u[0]
        solution.gradient(u**2 * ufl.dx, [values, number])
        seconds = time.perf_counter() - solved
        print(
            f"{domain.cells} cells: solve {solved - began:.2f} s, gradient {seconds:.2f} s, "
            f"{seconds / (solved - began):.2f} of it; {memory:.0f} MB before, {peak():.0f} MB after"
        )


if __name__ == "__main__":
    gc.disable()
    for argument in sys.argv[2:]:
        measure(float(argument), {"diffusion": diffusion, "coulomb": coulomb}[sys.argv[1]])
