"""One solver for all physics: spaces, data, method, residuals.

*What the solver asks of a physics*: systems, set up once on a mesh, and runs of their problems.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, cast
from weakref import ref

from petsc4py import PETSc

from signorini_fenicsx.base.errors import InputError, NumericalFailure, check_kind
from signorini_fenicsx.base.parallel import Stopwatch, collector_off, peak_memory
from signorini_fenicsx.contact.history import OnStep, Outcome
from signorini_fenicsx.contact.kept_backend import KeptBackend
from signorini_fenicsx.contact.residuals import Residuals
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.discrete.mesh_spaces import MeshSpaces
from signorini_fenicsx.discrete.unjoined import check_joined
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.named_sides import oriented
from signorini_fenicsx.meshes.sampling import curve_gap
from signorini_fenicsx.solving.evolution import Evolution, Steps
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.physics import PHYSICS
from signorini_fenicsx.solving.solved import Solved

type Remesh = Callable[[float], Domain]
"""Maps a factor > 1 to a mesh of the domain that is coarser by this factor (collective). Raises InputError if there is
no such mesh."""


@dataclass(frozen=True)
class Wish:
    """How a problem is to be solved.

    Attributes:
        options: Algorithm, backend and their parameters.
        start: Segments to start from, or None.
        remesh: Makes coarser meshes; None if there are none.
        memory: What the step of a problem in time takes from those before, see `Steps.memory`.
        watch: Measures the phases.
        on_step: Called on all ranks after each iteration.
    """

    options: Options
    start: Any = None
    remesh: Remesh | None = None
    memory: Any = None
    watch: Stopwatch = field(default_factory=Stopwatch)
    on_step: OnStep = lambda step: None


class PosedProblem[S: Solved](Protocol):
    """A problem with conditions on parts, such as `Diffusion`, and what its solutions are."""

    @property
    def solution_type(self) -> type[S]:
        """The class of its solutions."""

    def on(self, domain: Domain) -> Any:
        """The problem sorted by the kinds of its boundary, of which it has the parts as `boundary` (collective)."""


class SolverRun(Protocol):
    """A problem on its mesh, ready to be solved."""

    def remarks(self) -> Sequence[str]:
        """What `signorini check` tells of the data besides, in sentences (collective)."""

    def outcome(self) -> Outcome:
        """Run the method; if it is interrupted, return its last state (collective)."""

    def judged(self, outcome: Outcome) -> tuple[Outcome, Residuals]:
        """The outcome, which has converged only if its residuals are small, and these (collective)."""

    def solution(self, outcome: Outcome, **about: Any) -> Solved:
        """The solution, with the fields of `Solved` that are the same for all physics (collective)."""


class System(Protocol):
    """The spaces of a physics on a mesh, and what it keeps from problem to problem.

    Attributes:
        spaces: The discrete spaces.
        boundary: The parts of each kind of boundary.
        kept: Keeps the backend of the last solve, if it did not fail.
    """

    spaces: MeshSpaces
    boundary: Any
    kept: KeptBackend

    def __init__(self, domain: Domain, problem: Any):
        """Set up the spaces for such a problem (collective).

        Raises:
            InputError: If a part is unknown, empty or not on the boundary.
        """

    def prepared(self, problem: Any, wish: Wish) -> SolverRun:
        """Read the data of a problem with this boundary, and check them (collective).

        Raises:
            InputError: If the problem cannot be discretised as asked.
        """

    def check(self, problem: Any) -> list[str]:
        """Read the data of a problem with this boundary, and check what can be known before it is solved (collective).

        Returns:
            Data that jump and should not, in words.

        Raises:
            InputError: If the problem cannot be discretised.
        """

    def steps(self, problem: Any, evolution: Evolution, start: Any, options: Options) -> Steps:
        """The steps of a problem in time (collective).

        Args:
            problem: The problem with t in its data.
            evolution: Times, and what else there is.
            start: A solution to begin with, or None.
            options: Algorithm, backend and their parameters.

        Raises:
            InputError: If a datum is not what it has to be, or the start is on another domain.
        """


def system_on(domain: Domain, problem: Any) -> System:
    """The system of the physics of a sorted problem on a mesh (collective).

    Raises:
        InputError: If the boundary does not suit the mesh, or bodies in it are not joined.
    """
    system: System = PHYSICS[problem.boundary.physics].system(domain, problem)
    pairs = getattr(system.boundary, "pairs", ())
    check_joined(system.spaces, system.boundary.named, [(pair.slave, pair.master) for pair in pairs])
    return system


def refining(problem: Any, options: Options) -> tuple[Options, str]:
    """The options with which a sorted problem is refined adaptively, and why not with an element of order two.

    Options that name an element stay as they are.
    """
    choose = PHYSICS[problem.boundary.physics].refining
    if choose is None or options.element is not None:
        return options, ""
    chosen: tuple[Options, str] = choose(problem, options)
    return chosen


def with_sides(domain: Domain, problem: Any) -> Domain:
    """The domain with the sides of parts inside it that the conditions of a problem name (collective).

    Raises:
        InputError: If a part is not inside the domain, or a side is not clear.
    """
    conditions = getattr(problem, "conditions", ())
    named = oriented(domain, {part: each.side for each in conditions if each.side is not None for part in each.parts})
    for part in sorted(named.unsided.intersection(part for each in conditions for part in getattr(each, "parts", ()))):
        raise InputError(
            f"side: facets of '{part}' are along the last coordinate axis, so a larger coordinate names no side of it; "
            "give its condition a side, a region or a direction"
        )
    return named


def _problems() -> str:
    """What the problems of all physics are called."""
    names = [physics.problem.__name__ for physics in PHYSICS.values()]
    *others, last = [f"{'an' if name[0] in 'AEIOU' else 'a'} {name}" for name in names]
    return f"{', '.join(others)} or {last}"


def sorted_on(domain: Domain, problem: Any) -> Any:
    """A problem sorted by the kinds of its boundary, if it is not yet (collective).

    Raises:
        InputError: If it is of no physics.
    """
    sorted_problem = problem.on(domain) if hasattr(problem, "on") else problem
    if getattr(getattr(sorted_problem, "boundary", None), "physics", None) not in PHYSICS:
        raise InputError(f"problem: must be {_problems()}, not {type(problem).__name__}")
    return sorted_problem


def check_start(system: System, start: Any, *kinds: type) -> None:
    """Refuse a start that is none of these, of another physics, or on another domain (collective).

    Raises:
        InputError: If it is.
    """
    if start is None:
        return
    domain = system.spaces.domain
    if isinstance(start, Solved) and start.physics != system.boundary.physics:
        raise InputError(f"start: {start.name} is of another physics")
    check_kind("start", start, *kinds)
    if not same_domain(domain, start.spaces.domain):
        raise InputError(f"the start was solved on '{start.spaces.domain.name}', not on '{domain.name}'")


def same_domain(domain: Domain, other: Domain) -> bool:
    """Whether two meshes are of one domain: shapes have the same name, files the same bounding box (collective)."""
    if domain is other:
        return True
    if domain.is_shape and other.is_shape:
        return domain.name == other.name
    if domain.mesh.topology.dim != other.mesh.topology.dim:
        return False
    distance = abs(domain.box() - other.box()).max()
    return bool(distance <= curve_gap(domain) + curve_gap(other))


class Solver[S: Solved]:
    """A domain with the boundary of a problem, set up once and solved on for one problem after another.

    Spaces, forms, matrices and, as long as κ stays, factorisations are kept. The results are those of `solve`.

    >>> from mpi4py import MPI
    >>> from signorini_fenicsx import Diffusion, Signorini
    >>> from signorini_fenicsx.meshes.meshing import build_domain
    >>> square = build_domain(MPI.COMM_WORLD, "square", 0.1, mesh="structured")
    >>> under = [Diffusion(f=load, conditions=[Signorini("bottom", psi=-0.1)]) for load in (-1, -2, -3)]
    >>> solver = Solver(square, under[0])
    >>> [solver.solve(problem).contact.facets for problem in under]
    [3, 9, 11]
    """

    @collector_off()
    def __init__(self, domain: Domain, problem: PosedProblem[S] | Any):
        """Set up the spaces (collective).

        Args:
            domain: The mesh with its parts.
            problem: A `Diffusion`, `Elasticity` or `Stokes`. Those that are solved later have conditions of the same
                kinds on the same parts.

        Raises:
            InputError: If a part is unknown, empty or not on the boundary.
        """
        check_kind("domain", domain, Domain)
        domain = with_sides(domain, problem)
        self._sorted = problem, sorted_on(domain, problem)
        self._system = system_on(domain, self._sorted[1])

    @classmethod
    def of(cls, solution: Solved, problem: Any) -> "Solver[Any]":
        """What has solved a solution if it is alive and the parts of a sorted problem are the same, else a new one.

        Collective.
        """
        system = None if solution.system is None else solution.system()
        if system is None or problem.boundary != system.boundary:
            return Solver(solution.spaces.domain, problem)
        solver: Solver[Any] = cls.__new__(cls)
        solver._system, solver._sorted = system, (problem, problem)
        return solver

    @property
    def spaces(self) -> Any:
        """The discrete spaces; `spaces.mesh` is the mesh, which must not move."""
        return self._system.spaces

    @collector_off()
    def steps(self, problem: Any, evolution: Evolution, start: Any, options: Options) -> Steps:
        """The steps of a problem in time that is sorted, see `System.steps` (collective)."""
        check_start(self._system, start, Solved)
        return self._system.steps(problem, evolution, start, options)

    @collector_off()
    def solve(
        self,
        problem: PosedProblem[S] | Any,
        options: Options | None = None,
        *,
        start: Any = None,
        remesh: Remesh | None = None,
        name: str = "problem",
        title: str = "",
        source: object = None,
        watch: Stopwatch | None = None,
        on_step: OnStep = lambda step: None,
        memory: Any = None,
    ) -> S:
        """Solve a problem with conditions of these kinds on these parts, see `solve` (collective).

        `start` may also be segments alone. One is added: `memory`, what the step of a problem in time takes from those
        before, see `Steps.memory`.

        Raises:
            InputError: If the problem cannot be discretised as asked, or has other parts.
            NumericalFailure: If the sets do not settle or a residual is too large; its `solution` is the last state.
        """
        options, watch = Options.of(options), watch or Stopwatch()
        system, comm = self._system, self.spaces.mesh.comm
        with watch.phase("assembly"):
            data = self._sorted[1] if problem is self._sorted[0] else sorted_on(self.spaces.domain, problem)
            if with_sides(self.spaces.domain, problem) is not self.spaces.domain:
                raise InputError("side: the named side of a part is not the one that the solver was set up for")
            if data.boundary.physics != system.boundary.physics:
                raise InputError("problem: is of another physics than that which the solver was set up for")
            check_start(system, start, Solved, Segments)
            segments = start if isinstance(start, Segments | None) else start.segments()
            run = system.prepared(data, Wish(options, segments, remesh, memory, watch, on_step))
        outcome = run.outcome()
        with watch.phase("kkt"):
            outcome, kkt = run.judged(outcome)
            PETSc.garbage_cleanup(comm)  # in parallel PETSc frees objects only here
        timings = watch.longest(comm)
        about = {"name": name, "title": title, "source": source, "timings": timings, "peak_memory": peak_memory(comm)}
        given = {"problem": replace(data, boundary=system.boundary), "options": options, "system": ref(system)}
        solution: Any = run.solution(outcome, kkt=kkt, **given, **about)
        if not solution.converged:
            system.kept.forget()
            raise NumericalFailure(solution.outcome.reason, solution)
        return cast("S", solution)


@collector_off()
def solve[S: Solved](
    domain: Domain,
    problem: PosedProblem[S] | Any,
    options: Options | None = None,
    *,
    start: Any = None,
    remesh: Remesh | None = None,
    name: str = "problem",
    title: str = "",
    source: object = None,
    watch: Stopwatch | None = None,
    on_step: OnStep = lambda step: None,
) -> S:
    """Solve a contact problem (collective).

    Args:
        domain: The mesh with its parts.
        problem: A `Diffusion`, `Elasticity` or `Stokes`.
        options: Algorithm, backend and their parameters; None for the defaults.
        start: Solution on any mesh of the domain; its sets are the first ones, of a body with the bounds of friction.
        remesh: Makes coarser meshes, from which the sets of a large problem are predicted.
        name: Name of the results.
        title: A longer name in words.
        source: The case from which the problem was read, see `Solved`.
        watch: A stopwatch that has measured the earlier phases; None for a new one.
        on_step: Called on all ranks after each iteration.

    Raises:
        InputError: If the problem cannot be discretised as asked.
        NumericalFailure: If the sets do not settle or a residual is too large; its `solution` is the last state.
    """
    watch = watch or Stopwatch()
    with watch.phase("assembly"):
        check_kind("domain", domain, Domain)
        domain = with_sides(domain, problem)
        problem = sorted_on(domain, problem)
        solver: Solver[S] = Solver(domain, problem)
    solution = solver.solve(
        problem,
        options,
        start=start,
        remesh=remesh,
        name=name,
        title=title,
        source=source,
        watch=watch,
        on_step=on_step,
    )
    del solver
    PETSc.garbage_cleanup(domain.mesh.comm)  # of the solver; when the mesh is freed, it is too late
    return solution
