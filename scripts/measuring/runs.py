"""Seconds and memory of runs: over ranks, of repeated solves, of steps in time, and of gradients."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import ast
import gc
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
import ufl
from dolfinx import fem
from mpi4py import MPI

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
    solve,
)
from signorini_fenicsx.linear.earlier import EarlierSolutions
from signorini_fenicsx.meshes.domain import Boundary, Domain
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.solve.hybrid import HybridBackend

COMM = MPI.COMM_WORLD


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


DIM = {"example1": 2, "cube": 3}
SIZES = {"example1": 2.0**-8, "cube": 2.0**-4}
QUICK = {"example1": 2.0**-7, "cube": 2.0**-3}
PHASES = ("mesh", "assembly", "prediction", "solve", "kkt", "certificate", "output")
SOLVER = ("assembly", "prediction", "solve")
REDUCTIONS = ("VecTDot", "VecDot", "VecNorm", "VecMDot", "VecDotNorm2")
"""Operations on vectors that need one reduction each; PETSc does not count these."""
RANKS = (1, 2, 4, 8, 16)


@dataclass(frozen=True)
class Run:
    """One run of the program.

    Attributes:
        case: The case.
        ranks: Number of ranks.
        h: Largest cell diameter asked for.
        cells: Cells of the mesh.
        unknowns: Facets, the unknowns of the hybrid backend.
        seconds: From the start of the command to its end.
        timings: Seconds per phase.
        memory: Peak memory in bytes, summed over ranks.
        empty: The same for a run on a few cells.
        iterations: Iterations of the linear solver, those of predictions included.
        solves: Calls of the linear solver.
        messages: Messages per rank in assembly and solver, the mean over ranks.
        sent: Bytes per rank in these messages.
        reductions: Reductions of all ranks in assembly and solver.
    """

    case: str
    ranks: int
    h: float
    cells: int
    unknowns: int
    seconds: float
    timings: dict[str, float]
    memory: int
    empty: int
    iterations: int
    solves: int
    messages: float
    sent: float
    reductions: int

    @property
    def per_facet(self) -> float:
        """Bytes per facet over all ranks, without empty processes."""
        return (self.memory - self.empty) / self.unknowns


def scaling(
    quick: Annotated[bool, typer.Option(help="Small meshes, up to 4 ranks.")] = False,
    rounds: Annotated[
        int, typer.Option(min=1, help="Repeats of the runs whose seconds count; the fastest is kept.")
    ] = 3,
    output: Annotated[Path, typer.Option(help="Where the results go.")] = Path("results/scaling"),
) -> None:
    """How a whole run scales with ranks: seconds by phase, memory, and how often ranks talk to each other.

    Three experiments, each for a case in the plane and one in space:

    strong: the same mesh on one and on two ranks;
    weak: as many cells per rank on two ranks as on one;
    memory: the same mesh on 1, 2, 4, 8 and 16 ranks, more than there are cores, so the seconds mean nothing there. What
    an empty process has (a run on a few cells with as many ranks) is taken off. Messages and reductions are those that
    PETSc counts while it assembles and solves, and the products and norms of vectors, each of which is a reduction.

    The results are `scaling.json` and `table.md`. The machine should be idle; `--quick` is a trial on small meshes.
    """
    sizes, ranks = (QUICK, RANKS[:3]) if quick else (SIZES, RANKS)
    output.mkdir(parents=True, exist_ok=True)
    runs: dict[str, list[Run]] = {"strong": [], "weak": [], "memory": []}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for case, h in sizes.items():
            empty = {n: measured(case, 1.0, n, folder, 0, log=False).memory for n in ranks}  # also fills the caches
            one, two = (best(case, h, n, folder, empty[n], rounds) for n in (1, 2))
            runs["strong"] += [one, two]
            runs["weak"] += [one, best(case, h * 0.5 ** (1 / DIM[case]), 2, folder, empty[2], rounds)]
            runs["memory"] += [measured(case, h, n, folder, empty[n]) for n in ranks]
    by_name = {name: [asdict(run) for run in each] for name, each in runs.items()}
    (output / "scaling.json").write_text(json.dumps(by_name, indent=2) + "\n", encoding="utf-8")
    tables = of_time("strong", runs["strong"]), of_time("weak", runs["weak"]), of_ranks(runs["memory"])
    text = "\n\n".join("\n".join(lines) for lines in tables)
    (output / "table.md").write_text(text + "\n", encoding="utf-8")
    print(text)


def best(case: str, h: float, ranks: int, folder: Path, empty: int, rounds: int) -> Run:
    """The fastest of several runs."""
    runs = [measured(case, h, ranks, folder, empty, log=False) for _ in range(rounds)]
    return min(runs, key=lambda run: run.seconds)


def measured(case: str, h: float, ranks: int, folder: Path, empty: int, *, log: bool = True) -> Run:
    """Run the program and read what it has written; `log` lets PETSc count, which takes some time."""
    place, counts = folder / "run", folder / "log.py"
    program = Path(sys.executable).with_name("signorini")
    command = ["mpirun", "-n", str(ranks), str(program), "solve", case, "--h", str(h), "-q", "--output", str(place)]
    command += ["--", "-log_view", f":{counts}:ascii_info_detail"] if log else []
    began = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
    seconds = time.perf_counter() - began
    summary = json.loads((place / "summary.json").read_text(encoding="utf-8"))
    return Run(
        case=case,
        ranks=ranks,
        h=h,
        cells=summary["cells"],
        unknowns=summary["dofs"],
        seconds=seconds,
        timings=summary["timings"],
        memory=summary["peak_memory"],
        empty=empty,
        **(counted(counts) if log else {"iterations": 0, "solves": 0, "messages": 0.0, "sent": 0.0, "reductions": 0}),
    )


def counted(path: Path) -> dict[str, Any]:
    """What PETSc has counted in assembly and solver, from its log, whose lines are assignments in Python."""
    line = re.compile(r'^Stages\["([^"]+)"\]\["([^"]+)"\]\[(\d+)\] = (\{.*\})$', re.MULTILINE)
    events: dict[str, list[dict[str, float]]] = {}
    ranks = 0
    for stage, event, rank, values in line.findall(path.read_text(encoding="utf-8")):
        ranks = max(ranks, int(rank) + 1)
        if stage in SOLVER and (rank == "0" or event == "summary"):
            events.setdefault(event, []).append(ast.literal_eval(values) | {"rank": int(rank)})

    def total(event: str, key: str, *, of_all: bool = False) -> float:
        return sum(values[key] for values in events.get(event, []) if of_all or values["rank"] == 0)

    counted = total("summary", "numReductions") + sum(total(event, "count") for event in REDUCTIONS)
    return {
        "iterations": round(total("PCApply", "count")),
        "solves": round(total("KSPSolve", "count")),
        "messages": total("summary", "numMessages", of_all=True) / ranks,
        "sent": total("summary", "messageLength", of_all=True) / ranks,
        "reductions": round(counted),
    }


def of_time(name: str, runs: list[Run]) -> list[str]:
    """A table of seconds by phase, in pairs of runs on one and on two ranks."""
    lines = [
        f"| {name} | ranks | cells | whole run | {' | '.join(PHASES)} | start and end |",
        "|---|" + "---:|" * (len(PHASES) + 4),
    ]
    for one, two in zip(runs[::2], runs[1::2], strict=True):
        for run in (one, two):
            phases = [run.timings.get(phase, 0.0) for phase in PHASES]
            cells = [*(f"{value:.2f}" for value in phases), f"{run.seconds - sum(phases):.2f}"]
            lines.append(f"| {run.case} | {run.ranks} | {run.cells} | {run.seconds:.2f} s | {' | '.join(cells)} |")
        ratios = [one.timings.get(phase, 0.0) / max(two.timings.get(phase, 0.0), 1e-9) for phase in PHASES]
        work = (two.cells / one.cells) if name == "weak" else 1.0
        shown = [f"{work * ratio:.2f}" for ratio in (one.seconds / two.seconds, *ratios)]
        lines.append(f"| cells per second, two / one | | | {' | '.join(shown)} | |")
    return lines


def of_ranks(runs: list[Run]) -> list[str]:
    """A table of memory and communication over ranks."""
    names = ["case", "ranks", "facets", "bytes per facet", "memory / that of one rank", "iterations", "solves"]
    names += ["messages per rank", "kB per message", "reductions"]
    lines = [f"| {' | '.join(names)} |", "|---|" + "---:|" * (len(names) - 1)]
    for run in runs:
        one = next(each for each in runs if each.case == run.case and each.ranks == 1)
        memory = f"{run.per_facet:.0f}", f"{run.per_facet / one.per_facet:.2f}"
        talk = f"{run.messages:.0f}", f"{run.sent / max(run.messages, 1) / 1000:.2f}"
        numbers = (run.ranks, run.unknowns, *memory, run.iterations, run.solves, *talk, run.reductions)
        lines.append(f"| {run.case} | {' | '.join(map(str, numbers))} |")
    return lines
