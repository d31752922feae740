"""What the solver asks of a physics: systems, set up once on a mesh, and runs of their problems."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import Stopwatch
from signorini_fenicsx.contact.history import OnStep, Outcome
from signorini_fenicsx.contact.kept_backend import KeptBackend
from signorini_fenicsx.contact.residuals import Residuals
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


class Posed[S: Solved](Protocol):
    """A problem with conditions on parts, such as `Diffusion`, and what its solutions are."""

    @property
    def solution_type(self) -> type[S]:
        """The class of its solutions."""

    def on(self, domain: Domain) -> Any:
        """The problem sorted by the kinds of its boundary, of which it has the parts as `boundary` (collective)."""


class Run(Protocol):
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

    def prepared(self, problem: Any, wish: Wish) -> Run:
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
