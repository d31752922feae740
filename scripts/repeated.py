"""Solves per second on one mesh: separate calls of `solve` beside one `Solver`, which is set up once.

Usage: python scripts/repeated.py [--unknowns 5000] [--solves 20] [--rounds 3]

In each round both ways solve the same problems: new f and ψ each time, then a new κ as well.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from mpi4py import MPI

from signorini_fenicsx.meshes.domain import Boundary
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.solving.solver import Solver, solve


def problems(number: int, *, new_kappa: bool) -> list[Problem]:
    """Problems whose contact sets differ."""
    return [
        Problem(
            f=f"{15 + i % 7}*(x - 0.6) + {i % 3}*y",
            psi=f"-0.01*({i % 5} + x)",
            kappa=f"1 + {i % 9}/10*x" if new_kappa else 1.0,
        )
        for i in range(number)
    ]


def per_second(way: Callable[[Problem], Solution], todo: Sequence[Problem]) -> float:
    """Solves per second."""
    began = time.perf_counter()
    for problem in todo:
        way(problem)
    return len(todo) / (time.perf_counter() - began)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--unknowns", type=int, default=5000, help="facets of the mesh, about")
    parser.add_argument("--solves", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    domain = build_domain(MPI.COMM_WORLD, "square", (6 / options.unknowns) ** 0.5, mesh="unstructured")
    boundary = Boundary(signorini=["bottom", "left"])
    solver = Solver(domain, Problem(0, boundary=boundary))
    ways = {"separate": lambda problem: solve(domain, replace(problem, boundary=boundary)), "Solver": solver.solve}
    if MPI.COMM_WORLD.rank == 0:
        print(f"{solver.spaces.crouzeix_raviart.dofmap.index_map.size_global} unknowns; solves per second, min to max")
    for new_kappa in (False, True):
        todo = problems(options.solves, new_kappa=new_kappa)
        rates: dict[str, list[float]] = {name: [] for name in ways}
        for way in ways.values():
            per_second(way, todo[:3])  # compiled forms, warm caches
        for _ in range(options.rounds):
            for name, way in ways.items():
                rates[name].append(per_second(way, todo))
        if MPI.COMM_WORLD.rank == 0:
            for name, of_name in rates.items():
                print(f"{'new κ' if new_kappa else 'same κ'}, {name}: {min(of_name):.1f} to {max(of_name):.1f}")


if __name__ == "__main__":
    main()
