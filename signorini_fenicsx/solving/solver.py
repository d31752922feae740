"""One solver for all physics: spaces, data, method, residuals."""

from dataclasses import replace
from typing import Any, cast
from weakref import ref

from petsc4py import PETSc

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.parallel import Stopwatch, collector_off, peak_memory
from signorini_fenicsx.contact.history import OnStep
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.solving.evolution import Evolution, Steps
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solved import Solved
from signorini_fenicsx.solving.system import Posed, Remesh, Wish, check_start, sorted_on, system_on, with_sides


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
    def __init__(self, domain: Domain, problem: Posed[S] | Any):
        """Set up the spaces (collective).

        Args:
            domain: The mesh with its parts.
            problem: A `Diffusion` or `Elasticity`. Those that are solved later have conditions of the same kinds on the
                same parts.

        Raises:
            InputError: If a part is unknown, empty or not on the boundary.
        """
        check_kind("domain", domain, Domain)
        domain = with_sides(domain, problem)
        self._system = system_on(domain, sorted_on(domain, problem))

    @classmethod
    def of(cls, solution: Solved, problem: Any) -> "Solver[Any]":
        """What has solved a solution if it is alive and the parts of a sorted problem are the same, else a new one.

        Collective.
        """
        system = None if solution.system is None else solution.system()
        if system is None or problem.boundary != system.boundary:
            return Solver(solution.spaces.domain, problem)
        solver: Solver[Any] = cls.__new__(cls)
        solver._system = system
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
        problem: Posed[S] | Any,
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
            data = sorted_on(self.spaces.domain, problem)
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
    problem: Posed[S] | Any,
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
        problem: A `Diffusion` or `Elasticity`.
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
