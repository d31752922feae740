"""Seconds and memory of runs over ranks, and of gradients."""

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
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
import ufl
from dolfinx import fem

from measuring import COMM, say, show
from signorini_fenicsx.api import (
    Contact,
    Coulomb,
    Diffusion,
    Dirichlet,
    Elasticity,
    Neumann,
    Signorini,
    Solver,
)
from signorini_fenicsx.meshes.meshing import build_domain

REPEATS = 4


def diffusion(values: fem.Function, number: fem.Constant) -> Diffusion:
    """A problem with κ in each cell and a load."""
    x = ufl.SpatialCoordinate(values.function_space.mesh)
    conditions = [Signorini("bottom", psi=-0.05), Neumann("right")]
    return Diffusion(f=40 * number * (x[0] - 0.6), kappa=values, conditions=conditions)


def coulomb(values: fem.Function, number: fem.Constant) -> Elasticity:
    """A block that is pressed and pushed, with E in each cell and μ."""
    pushed = Dirichlet("top", ["0.05", "-0.1"])
    conditions = [Contact("bottom", friction=Coulomb(0.3 * number)), pushed, Neumann(["left", "right"])]
    return Elasticity(young=values, poisson=0.3, conditions=conditions)


def gradients(what: str, h: list[float]) -> None:
    """Seconds and memory of gradients beside those of solves from known sets, for some h.

    WHAT is `diffusion`, by κ in each cell, or `coulomb`, by E in each cell and by μ, with Coulomb's friction.
    """
    gc.disable()
    for size in h:
        of_gradients({"diffusion": diffusion, "coulomb": coulomb}[what], size)


def of_gradients(make: Callable[[fem.Function, fem.Constant], Any], h: float) -> None:
    """Print seconds of some solves and gradients."""
    domain = build_domain(COMM, "square", h, mesh="structured")
    values, number = fem.Function(fem.functionspace(domain.mesh, ("DG", 0))), fem.Constant(domain.mesh, 1.0)
    values.x.array[:] = 1.0
    problem = make(values, number)
    solver = Solver(domain, problem)
    solution = solver.solve(problem)
    for _ in range(REPEATS):
        values.x.array[:] *= 1.01
        began = time.perf_counter()
        solution = solver.solve(problem, start=solution)
        solved, before = time.perf_counter(), peak()
        u = solution.u if make is diffusion else solution.u[0]
        solution.gradient(u**2 * ufl.dx, [values, number])
        of_solve, of_gradient = solved - began, time.perf_counter() - solved
        words = f"solve {of_solve:.2f} s, gradient {of_gradient:.2f} s, {of_gradient / of_solve:.2f} of it"
        say(f"{domain.cells} cells: {words}; {before:.0f} MB before, {peak():.0f} MB after")


def peak() -> float:
    """The most memory that the process has held, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


DIM = {"example1": 2, "cube": 3}
SIZES = {"example1": 2.0**-8, "cube": 2.0**-4}
QUICK = {"example1": 2.0**-7, "cube": 2.0**-3}
PHASES = ("mesh", "assembly", "prediction", "solve", "kkt", "certificate", "output")
SOLVER = ("assembly", "prediction", "solve")
REDUCTIONS = ("VecTDot", "VecDot", "VecNorm", "VecMDot", "VecDotNorm2")
"""Operations on vectors that need one reduction each; PETSc does not count these."""
RANKS = (1, 2, 4, 8, 16)
OF_RANKS = ["case", "ranks", "facets", "bytes per facet", "memory / that of one rank", "iterations", "solves"]
OF_RANKS += ["messages per rank", "kB per message", "reductions"]


def scaling(
    quick: Annotated[bool, typer.Option(help="Small meshes, up to 4 ranks.")] = False,
    rounds: Annotated[
        int, typer.Option(min=1, help="Repeats of the runs whose seconds count; the fastest is kept.")
    ] = 3,
) -> None:
    """How a whole run scales with ranks: seconds by phase, memory, and how often ranks talk to each other.

    Three experiments, each for a case in the plane and one in space:

    strong: the same mesh on one and on two ranks;
    weak: as many cells per rank on two ranks as on one;
    memory: the same mesh on 1, 2, 4, 8 and 16 ranks, more than there are cores, so the seconds mean nothing there. What
    an empty process has (a run on a few cells with as many ranks) is taken off. Messages and reductions are those that
    PETSc counts while it assembles and solves, and the products and norms of vectors, each of which is a reduction.

    The machine should be idle; `--quick` is a trial on small meshes.
    """
    sizes, ranks = (QUICK, RANKS[:3]) if quick else (SIZES, RANKS)
    times: dict[str, list[list[object]]] = {"strong": [], "weak": []}
    counts: list[list[object]] = []
    for case, h in sizes.items():
        empty = [run(case, 1.0, n)["memory"] for n in ranks]  # also fills the caches
        whole, half = h, h * 0.5 ** (1 / DIM[case])
        one, strong, weak = (
            min((run(case, size, n) for _ in range(rounds)), key=lambda found: found["seconds"])
            for size, n in ((whole, 1), (whole, 2), (half, 2))
        )
        for name, two in (("strong", strong), ("weak", weak)):
            ratios = [one[key] / max(two[key], 1e-9) * two["cells"] / one["cells"] for key in ("seconds", *PHASES)]
            times[name] += [in_time(one), in_time(two)]
            times[name].append(["cells per second, two / one", "", "", *ratios, ""])
        found = [run(case, h, n, log=True) for n in ranks]
        bytes_per_facet = [(each["memory"] - none) / each["dofs"] for each, none in zip(found, empty, strict=True)]
        for each, per_facet in zip(found, bytes_per_facet, strict=True):
            memory = round(per_facet), per_facet / bytes_per_facet[0]
            counts.append([case, each["ranks"], each["dofs"], *memory, *each["counts"]])
    for name, rows in times.items():
        show([name, "ranks", "cells", "whole run", *PHASES, "start and end"], rows)
    show(OF_RANKS, counts)


def in_time(found: dict[str, Any]) -> list[object]:
    """A row of seconds by phase."""
    phases = [found[phase] for phase in PHASES]
    return [*(found[key] for key in ("case", "ranks", "cells", "seconds")), *phases, found["seconds"] - sum(phases)]


def run(case: str, h: float, ranks: int, *, log: bool = False) -> dict[str, Any]:
    """Run the program and read what it has written; `log` lets PETSc count, which takes some time."""
    with tempfile.TemporaryDirectory() as folder:
        place, counts = Path(folder, "run"), Path(folder, "log.py")
        program = str(Path(sys.executable).with_name("signorini"))
        command = ["mpirun", "-n", str(ranks), program, "solve", case, "--h", str(h), "-q", "--output", str(place)]
        command += ["--", "-log_view", f":{counts}:ascii_info_detail"] if log else []
        began = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
        found = {"case": case, "ranks": ranks, "seconds": time.perf_counter() - began} | dict.fromkeys(PHASES, 0.0)
        summary = json.loads((place / "summary.json").read_text(encoding="utf-8"))
        found |= summary["timings"] | {"cells": summary["cells"], "dofs": summary["dofs"]}
        counted_too = {"counts": counted(counts.read_text(encoding="utf-8"), ranks)} if log else {}
        return found | {"memory": summary["peak_memory"]} | counted_too


def counted(text: str, ranks: int) -> list[object]:
    """What PETSc has counted in assembly and solver, from its log, whose lines are assignments in Python."""
    line = re.compile(r'^Stages\["([^"]+)"\]\["([^"]+)"\]\[(\d+)\] = (\{.*\})$', re.MULTILINE)

    def total(event: str, key: str, *, of_all: bool = False) -> float:
        found = [(rank, of) for stage, name, rank, of in line.findall(text) if stage in SOLVER and name == event]
        return sum(ast.literal_eval(of)[key] for rank, of in found if of_all or rank == "0")

    messages, length = (total("summary", key, of_all=True) / ranks for key in ("numMessages", "messageLength"))
    reductions = total("summary", "numReductions") + sum(total(event, "count") for event in REDUCTIONS)
    linear = [round(total(event, "count")) for event in ("PCApply", "KSPSolve")]
    return [*linear, round(messages), length / max(messages, 1) / 1000, round(reductions)]
