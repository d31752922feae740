"""One timed run of this program, or of the same discrete problem by another solver; prints JSON.

[mpirun -n N] python fenicsx_worker.py METHOD CASE H MESH AGAIN
"""

import json
import sys
from dataclasses import replace

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.base.parallel import Stopwatch, abort_all_on_exception, peak_memory
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import options_of, solve_case
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.conditions import SiteConditions
from signorini_fenicsx.meshes.domain import Domain, distribute
from signorini_fenicsx.meshes.meshing import label_parts
from signorini_fenicsx.meshes.shapes import SHAPES
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.discrete.data import Data, project_data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces, build_spaces
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.solve.facets import FacetBackend
from signorini_fenicsx.physics.diffusion.solve.hybrid import HybridBackend
from signorini_fenicsx.physics.diffusion.solve.mixed import MixedBackend
from signorini_fenicsx.solving.solver import solve

COMM = MPI.COMM_WORLD
PHASES = "assembly", "prediction", "solve"
"""What a solver does."""

SETTINGS: dict[str, dict[str, object]] = {
    "ours": {},
    "ours, this mesh alone": {},
    "saddle point, fresh": {"solve.backend": "mixed", "solve.predict": False},
    "saddle point, symbolic reuse": {"solve.backend": "mixed", "solve.predict": False},
    "SNESVI + GAMG": {"solve.algorithm": "vi", "solve.max_iterations": 200},
    "contact set known": {},
}


class FreshMixed(FacetBackend):
    """The saddle point, assembled and factorised anew in each step, as in the paper."""

    name = "mixed"

    def __init__(self, spaces: Spaces, data: Data):
        super().__init__(spaces, data)
        self.dofs = spaces.V.dofmap.index_map.size_global + spaces.Q.dofmap.index_map.size_global

    def solver(self) -> str:
        """Name of the linear solver."""
        return "preonly+lu+mumps"

    def solve(self, conditions: SiteConditions) -> Iterate:
        """Assemble, factor and solve (collective)."""
        return MixedBackend(self.spaces, self.data).solve(conditions)


def read_mesh(path: str, shape: str) -> Domain:
    """Read points and cells on rank 0 and distribute them (collective)."""
    dim = SHAPES[shape].dim
    if COMM.rank == 0:
        with np.load(path) as file:
            points, cells = file["points"], file["cells"]
    else:
        points, cells = np.empty((0, dim)), np.empty((0, dim + 1), dtype=np.int64)
    return label_parts(distribute(COMM, points, cells, dim), shape)


def solve_known(case: Case, solution: Solution) -> dict[str, float]:
    """Seconds of one linear solve under the final conditions of a solution, from assembly to recovery (collective)."""
    watch = Stopwatch()
    with watch.phase("assembly"):
        spaces = build_spaces(solution.spaces.domain, case.boundary.signorini, case.boundary.neumann)
        system = HybridBackend(spaces, project_data(spaces, case.posed(spaces.mesh.geometry.dim)))
    with watch.phase("solve"):
        system.solve(solution.outcome.conditions)
    return watch.longest(COMM)


def logged(event: str) -> float:
    """Seconds that PETSc has spent in one of its events so far, the longest over the ranks (collective).

    The program names a stage of PETSc's log after each of its phases, and an event has a time in each stage.
    """
    stages = [PETSc.Log.Stage(phase).id for phase in PHASES]
    return float(COMM.allreduce(sum(PETSc.Log.Event(event).getPerfInfo(stage)["time"] for stage in stages), MPI.MAX))


def run(method: str, case: Case, domain: Domain, tuning: Tuning) -> dict[str, object]:
    """Solve once and report (collective)."""
    case = case.with_values(SETTINGS[method])
    own_mesh = method == "ours"
    solution = solve_case(case, COMM, domain=domain, tuning=tuning) if method == "contact set known" else None
    before = {event: logged(event) for event in ("PCSetUp", "KSPSolve")}
    if solution is not None:
        timings = solve_known(case, solution)
    elif method == "saddle point, fresh":
        options = replace(options_of(case, tuning), backend=FreshMixed)
        dim = domain.mesh.geometry.dim
        solution = solve(domain, case.posed(dim), options)
        timings = solution.timings
    else:
        solution = solve_case(case, COMM, domain=None if own_mesh else domain, tuning=tuning)
        timings = solution.timings
    setup, solving = (logged(event) - seconds for event, seconds in before.items())
    seconds = sum(timings.get(phase, 0.0) for phase in PHASES)
    errors = solution.errors()
    return {
        "cells": solution.spaces.mesh.topology.index_map(solution.spaces.mesh.topology.dim).size_global,
        "unknowns": solution.outcome.dofs,
        "solver": solution.outcome.linear_solver,
        "steps": 1 if method == "contact set known" else len(solution.outcome.history) + 1,
        "linear_iterations": max(step.linear_iterations for step in solution.outcome.history),
        "seconds": seconds,
        "assembly": timings["assembly"],
        "setup": setup,
        "solve": solving,
        "recovery and rest": seconds - timings["assembly"] - setup - solving,
        "kkt": max(vars(solution.kkt).values()),
        "flux_error": errors["sigma_L2"] if errors else None,
        "contact_measure": solution.contact[1],
        "sigma_L2": solution.norms()["sigma_L2"],
        "peak_memory": peak_memory(COMM),
    }


def main() -> None:
    """Solve a small problem with the same code first, so that no compilation is timed."""
    abort_all_on_exception(COMM)
    method, name, h, mesh, again = sys.argv[1:]
    case = load_case(name).with_values({"geometry.mesh": "structured", "solve.h": h})
    PETSc.Log.begin()
    small = case.with_values({"solve.h": 0.2})
    run(method, small, mesh_case(small, COMM), Tuning(direct_up_to=0, predict_from=0))
    results = [run(method, case, read_mesh(mesh, case.geometry.shape), Tuning()) for _ in range(int(again))]
    result = min(results, key=lambda each: each["seconds"])
    if COMM.rank == 0:
        print(json.dumps(result))


if __name__ == "__main__":
    main()
