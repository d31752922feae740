"""Speed beside P1 and P2 of general libraries at equal errors.

Each program solves on structured meshes of growing size, in a process for each round; rounds follow one another. Its
seconds at an error are found between its sizes by a power law. Ratios are taken within a round, and the least and the
largest are printed: ours divided by those of the other program. In the first line of a mesh both have the same error of
the flux; in the second line ours has found its bound too, and this bound is the error that the other one really has.
Where the flux is not known (`example1`), its error is taken from energies, and of ours the bound for σ_h.
"""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from measuring import say, show
from measuring.problem import PROBLEMS, Problem
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.meshes.grids import Share
from signorini_fenicsx.meshes.shapes import SHAPES

MEASURE = str(Path(__file__).parents[1] / "measure.py")
OTHERS = {f"{library} P{degree}": (library, degree) for degree in (1, 2) for library in ("scikit-fem", "NGSolve")}
SIZES = {  # of all, from which those are taken that a program needs for 10³ to 10⁶ unknowns
    2: [f"2^-{exponent}" for exponent in (2, 3, 4, 5, 6, 7, 8, 9)],
    3: ["0.5", "0.28", "0.2", "0.14", "0.1", "0.072", "0.055", "0.039"],
}
CHOSEN = {  # first and last of these sizes, in the plane and in space
    **{"RT0": ((2, 8), (1, 8)), "RT1": ((1, 7), (0, 6))},
    **{"scikit-fem P1": ((2, 8), (1, 8)), "NGSolve P1": ((2, 8), (1, 7))},
    **{"scikit-fem P2": ((0, 7), (0, 7)), "NGSolve P2": ((0, 7), (0, 4))},
}
QUICK = 3
"""With --quick so many of the larger sizes are left out."""
AGAIN = 3
"""Most solves of a mesh in one process, the fastest of which counts."""


@dataclass(frozen=True)
class Run:
    """One solve.

    Attributes:
        program: The element of ours, or the other program.
        round: Number of the round.
        h: The size.
        unknowns: Number of unknowns.
        steps: Set updates.
        seconds: From the mesh to the fields.
        error: Of the flux.
        seconds_of_bound: Those of the bound besides; of ours alone.
        bound: The bound; of ours alone.
        energy: ½a(u, u) − b(u); of the others alone.
        processor: Seconds of the processor; of the others alone.
    """

    program: str
    round: int
    h: str
    unknowns: int
    steps: int
    seconds: float
    error: float
    seconds_of_bound: float = 0.0
    bound: float = float("nan")
    energy: float = float("nan")
    processor: float = float("nan")


def benchmark(
    problems: Annotated[list[str] | None, typer.Argument(help=f"Some of {', '.join(PROBLEMS)}; or all.")] = None,
    element: Annotated[list[str], typer.Option(help="RT0 or RT1; may be given twice.")] = ["RT0", "RT1"],  # noqa: B006
    rounds: Annotated[int, typer.Option(min=1, help="How often all is run.")] = 3,
    quick: Annotated[bool, typer.Option(help="Without the larger sizes.")] = False,
) -> None:
    """Run all programs on all problems and print our seconds over those of the others; ~ is an extrapolation."""
    for name in problems or PROBLEMS:
        runs: list[Run] = []
        with tempfile.TemporaryDirectory() as folder:
            for number in range(rounds):
                for program in (*element, *OTHERS):
                    first, last = CHOSEN[program][PROBLEMS[name].dim - 2]
                    last = max(last - QUICK, first + 2) if quick else last  # a power law needs two
                    runs += launch(name, program, number, SIZES[PROBLEMS[name].dim][first:last], Path(folder))
        say(name)
        show(["element", "unknowns", "equal", "", "seconds", *OTHERS, "fastest P2"], rows(element, runs))


def launch(name: str, program: str, number: int, sizes: Sequence[str], folder: Path) -> list[Run]:
    """Solve with each size in one process."""
    if program in OTHERS:
        lines = by_other(program, name, [mesh_of(PROBLEMS[name], h, folder) for h in sizes])
    else:
        lines = apart("ours", program, name, str(AGAIN), *sizes)
    return [Run(program, number, h, **line) for h, line in zip(sizes, lines, strict=True)]


def by_other(program: str, name: str, meshes: Sequence[Path]) -> list[dict[str, Any]]:
    """What another program finds on each mesh."""
    library, degree = OTHERS[program]
    return apart("conforming", library, str(degree), name, str(AGAIN), *map(str, meshes))


def apart(*command: str) -> list[dict[str, Any]]:
    """What `measure.py` prints in a process of its own, line by line.

    Raises:
        RuntimeError: If it fails.
    """
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "NGS_NUM_THREADS": "1"}
    words = [sys.executable, MEASURE, *command]
    done = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr[-2000:]}")
    return [json.loads(line) for line in done.stdout.splitlines()]


def mesh_of(problem: Problem, h: str, folder: Path) -> Path:
    """The file of points and cells of a structured mesh, written once."""
    path = folder / f"{h}.npz"
    if not path.exists():
        settings = load_case(problem.case).with_values({"geometry.mesh": "structured", "solve.h": h})
        grid = SHAPES[settings.geometry.shape].grid
        assert grid is not None
        points, cells = grid(settings.solve.h, "right", Share())
        np.savez(path, points=points, cells=cells)
    return path


def seconds_at(runs: Sequence[Run], error: float) -> tuple[float, bool]:
    """Seconds of a program at an error, and whether they are extrapolated."""
    errors, seconds = (np.log([getattr(run, key) for run in runs]) for key in ("error", "seconds"))
    wanted = np.log(error)
    i = int(np.clip(np.searchsorted(-errors, -wanted) - 1, 0, len(runs) - 2))
    slope = (seconds[i + 1] - seconds[i]) / (errors[i + 1] - errors[i])
    outside = not errors[-1] <= wanted <= errors[0]
    return float(np.exp(seconds[i] + slope * (wanted - errors[i]))), outside


def rows(elements: Sequence[str], runs: Sequence[Run]) -> Iterator[list[object]]:
    """Two lines for each mesh of ours: at equal error, and at equal certified error with the bound."""
    for element in elements:
        of_element = [run for run in runs if run.program == element]
        for h in dict.fromkeys(run.h for run in of_element):
            ours = [run for run in of_element if run.h == h]
            for what in ("error", "bound"):
                errors = [getattr(run, what) for run in ours]
                seconds = [run.seconds + (what == "bound") * run.seconds_of_bound for run in ours]
                columns = zip(*quotients(runs, ours, errors, seconds), strict=True)
                shown = between([(each, False) for each in seconds]), *map(between, columns)
                yield [element, ours[0].unknowns, what, errors[0], *shown]


def quotients(
    runs: Sequence[Run], ours: Sequence[Run], errors: Sequence[float], seconds: Sequence[float]
) -> Iterator[list[tuple[float, bool]]]:
    """For each round our seconds as multiples of those of the other programs at an error, then of the faster P2."""
    for run, error, mine in zip(ours, errors, seconds, strict=True):
        at = {other: seconds_at(of(runs, other, run.round), error) for other in OTHERS}
        faster = min(at[other] for other, (_, degree) in OTHERS.items() if degree == 2)
        yield [(mine / theirs, guessed) for theirs, guessed in (*at.values(), faster)]


def of(runs: Sequence[Run], program: str, number: int) -> list[Run]:
    """The runs of a program in a round, from the largest error on."""
    return sorted((run for run in runs if (run.program, run.round) == (program, number)), key=lambda run: -run.error)


def between(values: Sequence[tuple[float, bool]]) -> str:
    """The least and the largest of some values, marked if one is extrapolated."""
    low, high = min(value for value, _ in values), max(value for value, _ in values)
    return "~" * any(guessed for _, guessed in values) + (f"{low:.2g}" if len(values) == 1 else f"{low:.2g}–{high:.2g}")


PHASES = "assembly", "prediction", "solve"
"""What a solver does."""
ENOUGH = 5.0
"""Seconds after which a problem is not solved again."""
WARM = {2: "0.2", 3: "0.5"}
"""Sizes of problems that are solved before, so that no compilation is timed."""


def ours(element: str, name: str, again: int, sizes: list[str]) -> None:
    """Solve with each size and print a line of JSON, with the fastest of several solves with one size."""
    problem = PROBLEMS[name]
    values = {"geometry.mesh": "structured", "solve.element": element, **problem.values}
    case = load_case(problem.case).with_values(values)
    for number, h in enumerate((WARM[problem.dim], *sizes)):
        runs: list[tuple[float, float]] = []
        while len(runs) < again and sum(map(sum, runs)) < ENOUGH:
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
