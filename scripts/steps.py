"""Seconds of time steps whose sets stand still, as multiples of one linear solve.

Usage: [mpirun -n N] python scripts/steps.py [--h 1/64] [--steps 20] [--moving]

The linear solve begins with the load of the step and ends with σ_h and u_h, under the sets with which the step ends and
from zero. As in the steps, the matrix and its factorisation or multigrid are there already. With `--moving` the load
moves, so that no datum is a product of functions of x and of t, and solutions of earlier steps are further away.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.api import evolve
from signorini_fenicsx.contact.laws import Wall
from signorini_fenicsx.linear.earlier import EarlierSolutions
from signorini_fenicsx.meshes.domain import Boundary
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.solve.hybrid import HybridBackend
from signorini_fenicsx.solving.evolution import Evolution
from signorini_fenicsx.solving.solver import Solver

COMM = MPI.COMM_WORLD
GROWS = "(1 + sin(t)/5)"
PROBLEM = Problem(
    f=f"10*(x - 0.6)*{GROWS}",
    kappa="1/4",
    u_D=f"x*(1 - x)*{GROWS}/9",
    laws=[Wall(["left"], beta=4, level=f"y*{GROWS}")],
)
"""With all data in proportion to one function of time, and a small capacity, the sets stand still."""
MOVING = replace(PROBLEM, f=f"{PROBLEM.f} + 3*exp(-40*((x - 1/2 - t/5)^2 + (y - 3/4 + t/9)^2))")


def seconds(do: Callable[[], object]) -> float:
    """The seconds of the slowest rank (collective)."""
    COMM.Barrier()
    began = time.perf_counter()
    do()
    return COMM.allreduce(time.perf_counter() - began, MPI.MAX)


class LinearSolve:
    """One linear solve as the module says."""

    def __init__(self) -> None:
        self._backend: HybridBackend | None = None

    def __call__(self, solution: Solution) -> float:
        """The seconds of that of a solution (collective)."""
        spaces, data, conditions = solution.spaces, solution.data, solution.outcome.conditions
        if self._backend is None:
            self._backend = HybridBackend(spaces, data)
        backend = self._backend
        backend.solve(conditions)  # under new sets it sets up the preconditioner
        backend._system.x.set(0.0)
        backend._earlier = EarlierSolutions()

        def solve() -> None:
            backend.renew(data)
            backend.solve(conditions)

        return seconds(solve)


def stands_still(before: Solution, solution: Solution) -> bool:
    """Whether a step has the sets of the one before, and took one linear problem (collective)."""
    outcome = solution.outcome
    same = not outcome.conditions.differ(before.outcome.conditions).any()
    return COMM.allreduce(same, MPI.LAND) and len(outcome.history) == 1


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--h", type=Fraction, default=Fraction(1, 64))
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--moving", action="store_true", help="a load that moves")
    options = parser.parse_args()
    solver = Solver(
        build_domain(COMM, "square", float(options.h), mesh="unstructured"),
        Problem(0, boundary=Boundary(["bottom", "left"])),
    )
    problem = MOVING if options.moving else PROBLEM
    evolution = Evolution(end=options.steps / 40, steps=options.steps, capacity="1/1000")
    solutions: list[Solution] = []
    steps = (instant.solution for instant in evolve(solver, replace(problem, boundary=Boundary(["bottom"])), evolution))
    linear_solve, ratios = LinearSolve(), []
    for step in range(options.steps):
        spent = seconds(lambda: solutions.append(next(steps)))
        alone = linear_solve(solutions[-1])
        if step > 0 and stands_still(*solutions[-2:]):
            ratios.append((spent, alone, spent / alone))
    last = solutions[-1]
    if COMM.rank == 0:
        facets = solver.spaces.crouzeix_raviart.dofmap.index_map.size_global
        print(f"{facets} facets, {last.outcome.linear_solver}, {len(ratios)} of {options.steps} steps stand still")
        for name, values in zip(("step", "linear solve", "ratio"), np.transpose(ratios), strict=True):
            print(f"{name}: {values.min():.4g} to {values.max():.4g}, median {np.median(values):.4g}")


if __name__ == "__main__":
    main()
