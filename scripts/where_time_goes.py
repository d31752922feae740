"""Where the seconds of the solver go: microseconds per facet, for one solve on one core.

Solves a case twice in one process, so that nothing is compiled and no file is read for the first time, and prints the
second solve, and what the memory can do. The machine should be idle.

    uv run python scripts/where_time_goes.py example1:2^-8 cube:2^-4
"""

import cProfile
import pstats
import timeit
from pathlib import Path
from typing import Annotated

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import numpy as np
import typer
from petsc4py import PETSc

from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.physics.diffusion.case import Case

SOLVER = ("assembly", "prediction", "solve")
"""Its phases."""
FUNCTIONS = {
    "spaces": ("mesh.py:create_submesh", "function.py:functionspace"),
    "data": ("data.py:project_data",),
    "patterns of matrices": ("petsc.py:create_matrix",),
    "recovery": ("facet_system.py:recover",),
    "linear solves": ("petsc.py:solve",),
    "test of the sets in each iteration": ("facet_solver.py:__call__",),
    "solves on patches": ("prediction.py:_settled_nearby",),
    "conditions": ("auxiliary_space.py:update", "facet_system.py:apply"),
}
"""Functions of the program and of DOLFINx, by file and name; some contain others."""
EVENTS = {
    "sweeps": ("MatSOR",),
    "products with matrices": ("MatMult", "MatResidual"),
    "between levels": ("MatMultAdd", "MatMultTranspose"),
    "Galerkin products": ("MatPtAPNumeric", "MatPtAPSymbolic"),
    "vectors": ("VecTDot", "VecNorm", "VecAXPY", "VecAYPX", "VecAXPBYCZ", "VecCopy", "VecPointwiseMult", "VecSet"),
}
"""PETSc's events, mostly within the linear solves; a residual contains a product."""


def main(run: Annotated[list[str], typer.Argument(help="CASE:H, such as example1:2^-8.")]) -> None:
    """Measure and print one block per run."""
    PETSc.Log.begin()
    for each in run:
        name, h = each.split(":")
        measure(load_case(name).with_values({"solve.h": h}))
    print(f"memory: {bandwidth():.1f} GB/s")


def bandwidth() -> float:
    """GB/s that one core reads and writes, adding two vectors into a third."""
    a, b, c = np.zeros((3, 2 * 10**7))
    seconds = min(timeit.repeat(lambda: np.add(a, b, out=c), number=1, repeat=5))
    return 3 * a.nbytes / seconds / 1e9


def measure(case: Case) -> None:
    """Solve twice and print the second solve."""
    solve_case(case)
    profile, before = cProfile.Profile(), seconds_of_events()
    solution = profile.runcall(solve_case, case)
    events = {name: seconds - before[name] for name, seconds in seconds_of_events().items()}
    facets, timings = solution.outcome.dofs, solution.timings
    solving = sum(timings.get(phase, 0.0) for phase in SOLVER)
    iterations = max(step.linear_iterations for step in solution.outcome.history)
    print(f"{case.name}, h = {case.solve.h:g}: {facets} facets, the last solve took {iterations} iterations")
    rows = {"solver": solving, **{key: timings[key] for key in SOLVER if key in timings}}
    for name, seconds in {**rows, **seconds_of_functions(profile), **events}.items():
        print(f"  {name:36}{1e6 * seconds / facets:8.2f}")
    print(f"  {facets / solving / 1000:.0f}k facets per second")


def seconds_of_functions(profile: cProfile.Profile) -> dict[str, float]:
    """Seconds in each row of `FUNCTIONS`, with what they call."""
    seconds = dict.fromkeys(FUNCTIONS, 0.0)
    for (file, _, function), (*_, total, _) in pstats.Stats(profile).stats.items():  # type: ignore[attr-defined]
        for row, names in FUNCTIONS.items():
            if f"{Path(file).name}:{function}" in names:
                seconds[row] += total
    return seconds


def seconds_of_events() -> dict[str, float]:
    """Seconds so far in each row of `EVENTS`, in the stages of the solver, which the program names after its phases."""
    stages = [PETSc.Log.Stage(name).id for name in SOLVER]
    return {
        row: sum(PETSc.Log.Event(name).getPerfInfo(stage)["time"] for name in names for stage in stages)
        for row, names in EVENTS.items()
    }


if __name__ == "__main__":
    typer.run(main)
