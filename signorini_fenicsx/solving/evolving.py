"""Problems in time: one solution after another, by one solver that is set up once."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from signorini_fenicsx.base.errors import NumericalFailure, check_kind
from signorini_fenicsx.base.parallel import collect_garbage, collector_off_in_steps
from signorini_fenicsx.contact.history import OnStep, Step
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.solving.evolution import Evolution, Past, Steps
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import Solver, sorted_on, with_sides

MOST = 500
"""Most linear problems of a step whose laws are curves."""
COLLECT = 50
"""Python's garbage is collected after so many steps; a step makes some hundred kilobytes."""
HALVINGS = 10
"""So often a step is halved that fails."""


@dataclass(frozen=True)
class Instant:
    """The solution after a step.

    Attributes:
        step: Number of the step, from 1.
        t: The time.
        solution: The fields then, as the solution of the step's own problem.
        steps: The problem in time on its mesh.
        numbers: What the table of steps has of it besides what the solution knows, see `Steps.of_step`.
    """

    step: int
    t: float
    solution: Any
    steps: Steps
    numbers: Mapping[str, float] = field(default_factory=dict)


@dataclass
class _Stepper:
    """The solver of steps, and of those that fail in halves of halves.

    Attributes:
        solve: Solves a problem, from segments, with what it takes from the steps before.
        past: What the next step, or part of a step, needs; its `step` is that of the present one.
        from_sets: Whether the method starts from segments.
        numbers: What the table has of the parts of this step.
    """

    solve: Callable[..., Any]
    past: Past
    from_sets: bool = True
    numbers: dict[str, float] = field(default_factory=dict)

    def go(self, steps: Steps, step: int, halvings: int = HALVINGS) -> Any:
        """Do a step, and give the solution after it (collective).

        Raises:
            NumericalFailure: If also its shortest parts fail.
        """
        left = self.past.left
        try:
            solution = self._done(steps, step)
        except NumericalFailure as failure:
            finer = steps.halved(failure)
            if finer is None:
                raise
            if halvings == 0:
                shortest = f"; so it is also in a part of 1/{2**HALVINGS} of the step"
                raise NumericalFailure(f"{failure}{shortest}", failure.solution) from None
            self.go(finer, 2 * step - 1, halvings - 1)
            return self.go(finer, 2 * step, halvings - 1)
        self.numbers = steps.of_step(solution, self.numbers)
        self.past = replace(self.past, left=[steps.left_by(solution), *left[:1]], segments=solution.segments())
        return solution

    def _done(self, steps: Steps, step: int) -> Any:
        """The solution after a step, also for laws whose graph depends on it (collective).

        Raises:
            NumericalFailure: If a problem of it is not solved.
        """
        left, segments, history = self.past.left, self.past.segments, list[Step]()
        posed, memory = steps.problem(step, left), steps.memory(step, left)
        while posed is not None:
            solved = self.solve(posed, start=segments if self.from_sets else None, memory=memory)
            history += solved.outcome.history
            posed, segments = steps.touching(posed, solved), solved.segments()
            if posed is not None and len(history) > MOST:
                raise NumericalFailure(
                    f"the laws with memory are not on their curves after {MOST} linear problems", solved
                )
        return replace(solved, step=self.past.step, outcome=replace(solved.outcome, history=history))


@collector_off_in_steps
def evolve(
    place: Domain | Solver,
    problem: Any,
    evolution: Evolution,
    options: Options | None = None,
    *,
    start: Any = None,
    past: Callable[[Steps], Past] | None = None,
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
        problem: A `Diffusion`, `Elasticity` or `Stokes`. Its data are numbers and texts in x, y, z and t, or functions
            that are the same at all times. An elastic body is at rest in each step, and friction is against the last
            one.
        evolution: Times; for diffusion also initial values, capacity and scheme.
        options: Algorithm, backend and their parameters; None for the defaults.
        start: Solution on any mesh of the domain; its sets are the first ones, and for diffusion its u takes the
            place of u_0.
        past: Gives what is known of the step after which to go on; None for the beginning.
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
    domain = place.spaces.domain if isinstance(place, Solver) else with_sides(place, problem)
    problem = sorted_on(domain, problem)
    solver: Solver = place if isinstance(place, Solver) else Solver(domain, problem)
    comm = solver.spaces.mesh.comm
    steps: Steps = solver.steps(problem, evolution, start, options)
    before = Past(0, [], start) if past is None else past(steps)
    about: dict[str, Any] = {"options": options, "name": name, "title": title, "source": source, "on_step": on_step}
    past_of_first = replace(before, left=[*before.left, steps.start()][:2])
    stepper = _Stepper(partial(solver.solve, **about), past_of_first, from_sets=options.method.starts_from_sets)
    for number in range(before.step + 1, evolution.steps + 1):
        stepper.past, stepper.numbers = replace(stepper.past, step=number), {}
        solution = stepper.go(steps, number)
        yield Instant(number, evolution.time(number), solution, steps, stepper.numbers)
        if number % COLLECT == 0:
            collect_garbage(comm)  # UFL makes cycles when it estimates the degree of a new datum
    del solver, stepper
    collect_garbage(comm)  # of the solver; when the mesh is freed, it is too late
