"""Seconds of a gradient by κ in each cell beside those of a solve from known sets, for some h.

python scripts/gradient_cost.py 0.006 0.003
"""

import gc
import sys
import time

import ufl
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx import Diffusion, Neumann, Signorini, Solver
from signorini_fenicsx.meshes.meshing import build_domain

REPEATS = 4


def measure(h: float) -> None:
    """Print seconds of some solves and gradients."""
    domain = build_domain(MPI.COMM_WORLD, "square", h, mesh="structured")
    x = ufl.SpatialCoordinate(domain.mesh)
    kappa = fem.Function(fem.functionspace(domain.mesh, ("DG", 0)))
    kappa.x.array[:] = 1.0
    load = fem.Constant(domain.mesh, 40.0)
    conditions = [Signorini("bottom", psi=-0.05), Neumann("right")]
    problem = Diffusion(f=load * (x[0] - 0.6), kappa=kappa, conditions=conditions)
    solver = Solver(domain, problem)
    solution = solver.solve(problem)
    for _ in range(REPEATS):
        kappa.x.array[:] *= 1.01
        began = time.perf_counter()
        solution = solver.solve(problem, start=solution)
        solved = time.perf_counter()
        solution.gradient(solution.u**2 * ufl.dx, [kappa, load])
        print(f"{domain.cells} cells: solve {solved - began:.2f} s, gradient {time.perf_counter() - solved:.2f} s")


if __name__ == "__main__":
    gc.disable()
    for argument in sys.argv[1:]:
        measure(float(argument))
