"""Problems in time: one solution after another, by one solver that is set up once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import collect_garbage, collector_off_in_steps
from signorini_fenicsx.contact.history import OnStep
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.diffusion.evolution import Evolution, Steps
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.solving import check_start
from signorini_fenicsx.physics.diffusion.spaces import Spaces
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import Solver
from signorini_fenicsx.solving.system import sorted_on

COLLECT = 50
"""Python's garbage is collected after so many steps; a step makes some hundred kilobytes."""


@dataclass(frozen=True)
class Instant:
    """The solution after a step.

    Attributes:
        step: Number of the step, from 1.
        t: The time.
        solution: σ_h, u_h and p_h then, as the solution of the step's own problem.
        steps: The problem in time on its mesh.
    """

    step: int
    t: float
    solution: Solution
    steps: Steps


@dataclass(frozen=True)
class Past:
    """What the next step needs of the last one.

    Attributes:
        step: Its number.
        u: u_h, and that of the step before; without u_0.
        segments: The segments on which it ended.
    """

    step: int
    u: Sequence[fem.Function]
    segments: Segments | None


@collector_off_in_steps
def evolve(
    place: Domain | Solver,
    problem: Any,
    evolution: Evolution,
    options: Options | None = None,
    *,
    start: Solution | None = None,
    past: Callable[[Solver], Past] | None = None,
    name: str = "problem",
    title: str = "",
    source: object = None,
    on_step: OnStep = lambda step: None,
) -> Iterator[Instant]:
    """Solve a problem in time, step by step (collective, also each step of the iterator).

    Each step starts from the sets of the last one.

    >>> from mpi4py import MPI
    >>> from signorini_fenicsx import Diffusion, Signorini
    >>> from signorini_fenicsx.meshes.meshing import build_domain
    >>> square = build_domain(MPI.COMM_WORLD, "square", 0.1, mesh="structured")
    >>> falling = Diffusion(f="-20*t", conditions=[Signorini("bottom", psi=-0.1)])
    >>> for instant in evolve(square, falling, Evolution(end=0.3, steps=3)):
    ...     print(round(instant.t, 2), instant.solution.contact.facets)
    0.1 5
    0.2 11
    0.3 13

    Args:
        place: The mesh, or a solver that is set up on it with such a problem.
        problem: A `Diffusion`. Its data are numbers and texts in x, y, z and t, or functions that are the same at all
            times.
        evolution: Times, initial values, capacity and scheme.
        options: Algorithm, backend and their parameters; None for the defaults.
        start: Solution on any mesh of the domain; its contact set is the first one, and its u takes the place of u_0.
        past: Gives the step after which to go on; None for the beginning.
        name: Name of the results.
        title: A longer name in words.
        source: The case from which the problem was read, see `Solution`.
        on_step: Called on all ranks after each iteration.

    Yields:
        The solution after each step.

    Raises:
        InputError: If a problem cannot be discretised as asked.
        NumericalFailure: If the sets of a step do not settle or a KKT residual is too large; its `solution` is the last
            state.
    """
    options = Options.of(options)
    check_kind("evolution", evolution, Evolution)
    boundary, sorted_problem = sorted_on(place.spaces.domain if isinstance(place, Solver) else place, problem)
    check_kind("problem", sorted_problem, Problem)
    solver = place if isinstance(place, Solver) else Solver(place, (boundary, sorted_problem))
    spaces: Spaces = solver.spaces
    if start is not None:
        evolution = replace(evolution, initial=_carried(start, spaces))
    steps = Steps(spaces, sorted_problem, evolution)
    known = Past(0, [], None if start is None else start.segments()) if past is None else past(solver)
    u, segments = [*known.u, steps.start()][:2], known.segments
    for step in range(known.step + 1, evolution.steps + 1):
        found = solver.solve(
            (boundary, steps.problem(step)),
            options,
            start=segments if options.method.starts_from_sets else None,
            memory=steps.memory(step, u),
            name=name,
            title=title,
            source=source,
            on_step=on_step,
        )
        solution = replace(found, step=step)
        u, segments = [solution.u, *u[:1]], solution.segments()
        yield Instant(step, evolution.time(step), solution, steps)
        if step % COLLECT == 0:
            collect_garbage(spaces.mesh.comm)  # UFL makes cycles when it estimates the degree of a new datum


def _carried(solution: Solution, spaces: Spaces) -> fem.Function:
    """Another u_h in the centroids of these cells (collective).

    Raises:
        InputError: If it is on another domain, or a centroid is not in its mesh.
    """
    check_start(spaces, solution)
    centroids = corners(spaces.mesh).mean(axis=1)
    u = fem.Function(spaces.Q, name="u")
    u.x.array[:] = solution.at(centroids).u
    outside = spaces.mesh.comm.allreduce(int(np.count_nonzero(np.isnan(u.x.array))))
    if outside > 0:
        raise InputError(
            f"the start, {solution.name}, has no u in the centroids of {outside} cells, which are outside of its mesh; "
            "take one on the same mesh"
        )
    return u
