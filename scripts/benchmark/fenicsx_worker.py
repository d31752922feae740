"""One timed run of this program, or of the same discrete problem solved in a more usual way; prints JSON.

[mpirun -n N] python fenicsx_worker.py METHOD CASE H MESH
"""

import json
import sys

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.backends import contract as backend
from signorini_fenicsx.backends import facet_system, hybrid, mixed
from signorini_fenicsx.backends.contract import Iterate
from signorini_fenicsx.backends.hybrid import HybridBackend
from signorini_fenicsx.backends.mixed import MixedBackend
from signorini_fenicsx.base.parallel import Stopwatch, abort_all_on_exception, peak_memory
from signorini_fenicsx.cases import discretisation
from signorini_fenicsx.cases.case import Case, load_case
from signorini_fenicsx.cases.domains import discrete_data
from signorini_fenicsx.discrete.conditions import FacetConditions
from signorini_fenicsx.discrete.data import Data
from signorini_fenicsx.discrete.spaces import Spaces, build_spaces
from signorini_fenicsx.meshes.domain import Domain, distribute
from signorini_fenicsx.meshes.meshing import label_parts
from signorini_fenicsx.meshes.shapes import SHAPES
from signorini_fenicsx.solving import prediction, solver
from signorini_fenicsx.solving.solution import Solution

COMM = MPI.COMM_WORLD

SETTINGS: dict[str, dict[str, object]] = {
    "ours": {},
    "ours, this mesh alone": {},
    "saddle point, fresh": {"solve.backend": "mixed", "solve.predict": False},
    "saddle point, symbolic reuse": {"solve.backend": "mixed", "solve.predict": False},
    "SNESVI + GAMG": {"solve.algorithm": "vi", "solve.max_iterations": 200},
    "contact set known": {},
}


class FreshMixed:
    """The paper's way: the saddle point is assembled and factored anew in each step."""

    name = "mixed"

    def __init__(self, spaces: Spaces, data: Data):
        self.spaces, self._data = spaces, data
        self.dofs = spaces.V.dofmap.index_map.size_global + spaces.Q.dofmap.index_map.size_global

    def solver(self) -> str:
        """Name of the linear solver."""
        return "preonly+lu+mumps"

    def solve(self, conditions: FacetConditions) -> Iterate:
        """Assemble, factor and solve (collective)."""
        return MixedBackend(self.spaces, self._data).solve(conditions)


def read_mesh(path: str, shape: str) -> Domain:
    """Read points and cells on rank 0 and distribute them (collective)."""
    dim = SHAPES[shape].dim
    if COMM.rank == 0:
        with np.load(path) as file:
            points, cells = file["points"], file["cells"]
    else:
        points, cells = np.empty((0, dim)), np.empty((0, dim + 1), dtype=np.int64)
    return label_parts(distribute(COMM, points, cells, dim), SHAPES[shape])


def solve_known(case: Case, found: Solution) -> dict[str, float]:
    """Seconds of one linear solve under the final conditions of a solution, from assembly to recovery (collective)."""
    watch = Stopwatch()
    with watch.phase("assembly"):
        spaces = build_spaces(found.spaces.domain, case.boundary.signorini, case.boundary.neumann)
        system = HybridBackend(spaces, discrete_data(case, spaces))
    with watch.phase("solve"):
        system.solve(found.conditions)
    return watch.longest(COMM)


class Phases:
    """Seconds of set-up and of iterations or substitutions, over all linear solves of the backends."""

    def __init__(self) -> None:
        self.setup = self.solve = 0.0

    def solve_linear(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """What the backends call, with a clock (collective)."""
        watch = Stopwatch()
        with watch.phase("setup"):
            ksp.setUp()
            ksp.getPC().setUp()  # which KSP leaves to its solve where only values have changed
        with watch.phase("solve"):
            backend.solve_linear(ksp, b, x)
        seconds = watch.longest(COMM)
        self.setup += seconds["setup"]
        self.solve += seconds["solve"]


def run(method: str, case: Case, domain: Domain) -> dict[str, object]:
    """Solve once and report (collective)."""
    case = case.with_values(SETTINGS[method])
    found = solver.solve(case, COMM, domain=domain) if method == "contact set known" else None
    phases = Phases()
    hybrid.solve_linear = mixed.solve_linear = phases.solve_linear
    if found is None:
        found = solver.solve(case, COMM, domain=None if method == "ours" else domain)
        timings = found.timings
    else:
        timings = solve_known(case, found)
    seconds = sum(timings.get(phase, 0.0) for phase in ("assembly", "prediction", "solve"))
    errors = found.errors()
    return {
        "cells": found.spaces.mesh.topology.index_map(found.spaces.mesh.topology.dim).size_global,
        "unknowns": found.dofs,
        "solver": found.linear_solver,
        "steps": 1 if method == "contact set known" else found.rough_steps + len(found.history),
        "linear_iterations": max(step.linear_iterations for step in found.history),
        "seconds": seconds,
        "assembly": timings["assembly"],
        "setup": phases.setup,
        "solve": phases.solve,
        "recovery and rest": seconds - timings["assembly"] - phases.setup - phases.solve,
        "kkt": max(vars(found.kkt).values()),
        "flux_error": errors["sigma_L2"] if errors else None,
        "contact_measure": found.contact()[1],
        "sigma_L2": found.norms()["sigma_L2"],
        "peak_memory": peak_memory(COMM),
    }


def main() -> None:
    """Solve a small problem with the same code first, so that no compilation is timed."""
    abort_all_on_exception(COMM)
    method, name, h, mesh = sys.argv[1:]
    case = load_case(name).with_values({"geometry.mesh": "structured", "solve.h": h})
    if method == "saddle point, fresh":
        solver.BACKENDS["mixed"] = FreshMixed
    small = case.with_values({"solve.h": 0.2})
    limits = facet_system.DIRECT_UP_TO, prediction.PREDICT_FROM
    facet_system.DIRECT_UP_TO, prediction.PREDICT_FROM = 0, 0
    run(method, small, discretisation.mesh_case(small, COMM))
    facet_system.DIRECT_UP_TO, prediction.PREDICT_FROM = limits
    result = run(method, case, read_mesh(mesh, case.geometry.shape))
    if COMM.rank == 0:
        print(json.dumps(result))


if __name__ == "__main__":
    main()
