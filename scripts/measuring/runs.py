"""Seconds of whole runs, of phases of the solver, of repeated solves, of steps in time, and of gradients."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import cProfile
import gc
import json
import os
import pstats
import resource
import subprocess
import sys
import tempfile
import time
import timeit
from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.api import (
    Contact,
    Coulomb,
    Diffusion,
    Dirichlet,
    Elasticity,
    Evolution,
    Neumann,
    Signorini,
    Solution,
    Solver,
    Wall,
    evolve,
    load_case,
    solve,
    solve_case,
)
from signorini_fenicsx.linear.earlier import EarlierSolutions
from signorini_fenicsx.meshes.domain import Boundary, Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.solve.hybrid import HybridBackend

COMM = MPI.COMM_WORLD
YARDSTICK = [sys.executable, str(Path(__file__).parents[1] / "measure.py"), "yardstick"]
PHASES = {
    "mesh": ("mesh",),
    "assembly": ("assembly",),
    "sets and solution": ("prediction", "solve"),
    "KKT": ("kkt",),
    "certificate": ("certificate",),
    "output": ("output",),
}
WARM = ("solve", "example1", "--h", "0.3", "-q")


def whole_runs(
    run: Annotated[list[str], typer.Option(help="CASE:H; may be repeated.")] = ["example1:2^-8", "cube:2^-4"],  # noqa: B006
    rounds: Annotated[int, typer.Option(min=1)] = 3,
) -> None:
    """Whole runs as multiples of the yardstick f₀, one linear solve with a known contact set (`yardstick.py`).

    A run counts from the start of the command to its end, with certificate and output, on a mesh that it makes itself.
    In each round a run on one rank, one on two ranks and the yardstick follow each other. Ratios are taken within a
    round, and their least and largest values are printed. The machine should be idle.
    """
    with tempfile.TemporaryDirectory() as folder:
        launch([*command(), *WARM, "--output", f"{folder}/warm"], 1)
        for each in run:
            case, h = each.split(":")
            in_rounds(case, h, rounds, Path(folder))


def in_rounds(case: str, h: str, rounds: int, folder: Path) -> None:
    """Alternate the three and print their ratios."""
    seconds: dict[str, list[float]] = {}
    ratios: dict[str, list[float]] = {}
    about = {}
    for number in range(rounds + 1):
        totals = {}
        for ranks in (1, 2):
            output = folder / f"{case}-{ranks}"
            totals[ranks] = launch([*command(), "solve", case, "--h", h, "-q", "--output", str(output)], ranks)[0]
            about[ranks] = json.loads((output / "summary.json").read_text(encoding="utf-8"))
        yardstick = json.loads(launch([*YARDSTICK, case, h], 1)[1])
        if number == 0:  # compiles, and fills the caches of the system
            continue
        f = yardstick["total"]
        timings = about[1]["timings"]
        parts = {name: sum(timings.get(key, 0.0) for key in keys) for name, keys in PHASES.items()}
        rest = totals[1] - sum(parts.values())
        for name, value in {"whole run": totals[1], **parts, "start and end": rest}.items():
            seconds.setdefault(name, []).append(value)
            ratios.setdefault(name, []).append(value / f)
        seconds.setdefault("f₀", []).append(f)
        ratios.setdefault("one rank / two ranks", []).append(totals[1] / totals[2])
        solving = [sum(about[n]["timings"].get(key, 0.0) for key in ("assembly", "prediction", "solve")) for n in about]
        ratios.setdefault("solver, one rank / two ranks", []).append(solving[0] / solving[1])
    facets = yardstick["unknowns"]
    print(f"{case}, h = {h}: {about[1]['cells']} cells, {facets} facets, {about[1]['mesh']}")
    for name in seconds:
        values = f"{min(seconds[name]):8.2f} to {max(seconds[name]):.2f} s"
        print(f"  {name:20}{values:22}" + (span(ratios[name]) + " f₀" if name in ratios else ""))
    for name in ("one rank / two ranks", "solver, one rank / two ranks"):
        print(f"  {name:30} {span(ratios[name])}")
    for ranks, summary in about.items():
        print(f"  memory on {ranks}: {summary['peak_memory'] / facets:.0f} bytes per facet over all ranks")


def span(values: list[float]) -> str:
    """The least and the largest."""
    return f"{min(values):.2f} to {max(values):.2f}"


def command() -> list[str]:
    """The program of this environment."""
    return [str(Path(sys.executable).with_name("signorini"))]


def launch(arguments: list[str], ranks: int) -> tuple[float, str]:
    """Seconds of a command, and the last line that it prints."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    began = time.perf_counter()
    done = subprocess.run(
        [*launcher, *arguments], check=True, capture_output=True, text=True, env=os.environ | {"OMP_NUM_THREADS": "1"}
    )
    return time.perf_counter() - began, (done.stdout.splitlines() or [""])[-1]


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
    "conditions": ("auxiliary_space.py:update", "kept_factors.py:impose"),
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


def phases(run: Annotated[list[str], typer.Argument(help="CASE:H, such as example1:2^-8.")]) -> None:
    """Where the seconds of the solver go: microseconds per facet, for one solve on one core.

    It solves a case twice in one process, so that nothing is compiled and no file is read for the first time, and
    prints the second solve, and what the memory can do. The machine should be idle.
    """
    PETSc.Log.begin()
    for each in run:
        name, h = each.split(":")
        twice(load_case(name).with_values({"solve.h": h}))
    print(f"memory: {bandwidth():.1f} GB/s")


def bandwidth() -> float:
    """GB/s that one core reads and writes, adding two vectors into a third."""
    a, b, c = np.zeros((3, 2 * 10**7))
    seconds = min(timeit.repeat(lambda: np.add(a, b, out=c), number=1, repeat=5))
    return 3 * a.nbytes / seconds / 1e9


def twice(case: Case) -> None:
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


def problems(number: int, boundary: Boundary, *, new_kappa: bool) -> list[Problem]:
    """Problems whose contact sets differ."""
    return [
        Problem(
            f=f"{15 + i % 7}*(x - 0.6) + {i % 3}*y",
            psi=f"-0.01*({i % 5} + x)",
            kappa=f"1 + {i % 9}/10*x" if new_kappa else 1.0,
            boundary=boundary,
        )
        for i in range(number)
    ]


def per_second(way: Callable[[Problem], Solution], todo: Sequence[Problem]) -> float:
    """Solves per second."""
    began = time.perf_counter()
    for problem in todo:
        way(problem)
    return len(todo) / (time.perf_counter() - began)


def repeated(
    unknowns: Annotated[int, typer.Option(help="Facets of the mesh, about.")] = 5000, solves: int = 20, rounds: int = 3
) -> None:
    """Solves per second on one mesh: separate calls of `solve` beside one `Solver`, which is set up once.

    In each round both ways solve the same problems: new f and ψ each time, then a new κ as well.
    """
    domain = build_domain(COMM, "square", (6 / unknowns) ** 0.5, mesh="unstructured")
    boundary = Boundary(signorini=["bottom", "left"])
    solver = Solver(domain, Problem(0, boundary=boundary))
    ways = {"separate": lambda problem: solve(domain, problem), "Solver": solver.solve}
    if COMM.rank == 0:
        print(f"{solver.spaces.crouzeix_raviart.dofmap.index_map.size_global} unknowns; solves per second, min to max")
    for new_kappa in (False, True):
        todo = problems(solves, boundary, new_kappa=new_kappa)
        rates: dict[str, list[float]] = {name: [] for name in ways}
        for way in ways.values():
            per_second(way, todo[:3])  # compiled forms, warm caches
        for _ in range(rounds):
            for name, way in ways.items():
                rates[name].append(per_second(way, todo))
        if COMM.rank == 0:
            for name, of_name in rates.items():
                print(f"{'new κ' if new_kappa else 'same κ'}, {name}: {min(of_name):.1f} to {max(of_name):.1f}")


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
    """One linear solve as `steps` says."""

    def __init__(self) -> None:
        self._backend: HybridBackend | None = None

    def __call__(self, solution: Solution) -> float:
        """The seconds of that of a solution (collective)."""
        spaces, data, conditions = solution.spaces, solution.data, solution.outcome.conditions
        if self._backend is None:
            self._backend = HybridBackend(spaces, data)
        backend = self._backend
        backend.solve(conditions)  # under new sets it sets up the preconditioner
        backend.x.set(0.0)
        backend._factors.earlier = EarlierSolutions()

        def solve() -> None:
            backend.renew(data)
            backend.solve(conditions)

        return seconds(solve)


def stands_still(before: Solution, solution: Solution) -> bool:
    """Whether a step has the sets of the one before, and took one linear problem (collective)."""
    outcome = solution.outcome
    same = not outcome.conditions.differ(before.outcome.conditions).any()
    return COMM.allreduce(same, MPI.LAND) and len(outcome.history) == 1


def steps(
    h: str = "1/64",
    steps: int = 20,
    moving: Annotated[bool, typer.Option("--moving", help="A load that moves.")] = False,
) -> None:
    """Seconds of time steps whose sets stand still, as multiples of one linear solve.

    The linear solve begins with the load of the step and ends with σ_h and u_h, under the sets with which the step ends
    and from zero. As in the steps, the matrix and its factorisation or multigrid are there already. With --moving no
    datum is a product of functions of x and of t, and solutions of earlier steps are further away.
    """
    solver = Solver(
        build_domain(COMM, "square", float(Fraction(h)), mesh="unstructured"),
        Problem(0, boundary=Boundary(["bottom", "left"])),
    )
    problem = MOVING if moving else PROBLEM
    evolution = Evolution(end=steps / 40, steps=steps, capacity="1/1000")
    solutions: list[Solution] = []
    instants = (
        instant.solution for instant in evolve(solver, replace(problem, boundary=Boundary(["bottom"])), evolution)
    )
    linear_solve, ratios = LinearSolve(), []
    for step in range(steps):
        spent = seconds(lambda: solutions.append(next(instants)))
        alone = linear_solve(solutions[-1])
        if step > 0 and stands_still(*solutions[-2:]):
            ratios.append((spent, alone, spent / alone))
    last = solutions[-1]
    if COMM.rank == 0:
        facets = solver.spaces.crouzeix_raviart.dofmap.index_map.size_global
        print(f"{facets} facets, {last.outcome.linear_solver}, {len(ratios)} of {steps} steps stand still")
        for name, values in zip(("step", "linear solve", "ratio"), np.transpose(ratios), strict=True):
            print(f"{name}: {values.min():.4g} to {values.max():.4g}, median {np.median(values):.4g}")


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


def gradients(what: str, h: list[float]) -> None:
    """Seconds and memory of gradients beside those of solves from known sets, for some h.

    WHAT is `diffusion`, by κ in each cell, or `coulomb`, by E in each cell and by μ, with Coulomb's friction.
    """
    gc.disable()
    for each in h:
        of_solves(each, {"diffusion": diffusion, "coulomb": coulomb}[what])


def of_solves(h: float, make: Any) -> None:
    """Print seconds of some solves and gradients."""
    domain = build_domain(COMM, "square", h, mesh="structured")
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
