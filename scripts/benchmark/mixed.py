"""This program on the problems of the benchmark: prints a line of JSON for each size.

python mixed.py ELEMENT PROBLEM AGAIN H…

Seconds are those of the solver, from the mesh to the fields, and those of the error bound. Of several solves with one
size the fastest counts.
"""

import json
import sys
import time

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

from problem import PROBLEMS

from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case

PHASES = "assembly", "prediction", "solve"
"""What a solver does."""
ENOUGH = 5.0
"""Seconds after which a problem is not solved again."""
WARM = {2: "0.2", 3: "0.5"}
"""Sizes of problems that are solved before, so that no compilation is timed."""


def main() -> None:
    """Solve with each size and report."""
    element, name, again, *sizes = sys.argv[1:]
    problem = PROBLEMS[name]
    values = {"geometry.mesh": "structured", "solve.element": element, **problem.values}
    case = load_case(problem.case).with_values(values)
    for number, h in enumerate((WARM[problem.dim], *sizes)):
        runs: list[tuple[float, float]] = []
        while len(runs) < int(again) and sum(map(sum, runs)) < ENOUGH:
            solution = solve_case(case.with_values({"solve.h": h}))
            began = time.perf_counter()
            certificate = solution.certify()
            bounded = time.perf_counter() - began
            seconds = sum(solution.timings.get(phase, 0.0) for phase in PHASES)
            runs.append((seconds, bounded))
        seconds, bounded = (min(each) for each in zip(*runs, strict=True))
        errors = solution.errors()
        about = {
            "unknowns": solution.outcome.dofs,
            "steps": len(solution.outcome.history),
            "seconds": seconds,
            "error": certificate.sigma_bound if errors is None else errors["energy"],
            "seconds_of_bound": bounded,
            "bound": certificate.bound,
        }
        if number > 0:
            print(json.dumps(about), flush=True)


if __name__ == "__main__":
    main()
