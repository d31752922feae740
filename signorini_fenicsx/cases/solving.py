"""Solving the problem of a case file."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import overload

from mpi4py import MPI

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import Stopwatch, collector_off
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import Case, CaseFile
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.elastic_case import AnyCase, ElasticCase
from signorini_fenicsx.certificate.adaptive import DEFAULT_MAX_CELLS, DEFAULT_THETA, AdaptRow, adapt
from signorini_fenicsx.certificate.certify import Certificate
from signorini_fenicsx.contact.history import OnStep
from signorini_fenicsx.meshes.domain import Boundary, Domain
from signorini_fenicsx.meshes.meshing import coarser_domains
from signorini_fenicsx.solving.elastic import solve_elastic
from signorini_fenicsx.solving.elastic_solution import ElasticSolution
from signorini_fenicsx.solving.evolving import Instant, Past, evolve
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solution import Solution
from signorini_fenicsx.solving.solver import Solver

type AnySolution = Solution | ElasticSolution


@overload
def solve_case(
    case: Case,
    comm: MPI.Comm = ...,
    *,
    domain: Domain | Solver | None = ...,
    start: Solution | None = ...,
    tuning: Tuning | None = ...,
    on_step: OnStep = ...,
) -> Solution: ...


@overload
def solve_case(
    case: AnyCase,
    comm: MPI.Comm = ...,
    *,
    domain: Domain | Solver | None = ...,
    start: AnySolution | None = ...,
    tuning: Tuning | None = ...,
    on_step: OnStep = ...,
) -> AnySolution: ...


@collector_off()
def solve_case(
    case: AnyCase,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    domain: Domain | Solver | None = None,
    start: AnySolution | None = None,
    tuning: Tuning | None = None,
    on_step: OnStep = lambda step: None,
) -> AnySolution:
    """Solve a case of any physics (collective).

    Args:
        case: The problem, its discretisation and algorithm.
        comm: Communicator, used if there is no mesh yet.
        domain: Mesh to solve on, or a solver set up on it with the boundary of this case; None for the mesh of the
            case. With a mesh given, no coarser mesh predicts the sets.
        start: Solution of the same physics whose contact set is the first one.
        tuning: Sizes from which the program works differently; None for the defaults.
        on_step: Called on all ranks after each iteration.

    Raises:
        InputError: If the case cannot be discretised as asked.
        NumericalFailure: If the sets do not settle or a KKT residual is too large; its `solution` is the last state.
    """
    check_kind("case", case, Case, ElasticCase, hint="; load_any_case reads one")
    refuse_time(case)
    watch = Stopwatch()
    with watch.phase("mesh"):
        place = domain or mesh_case(case, comm)
    mesh = place.spaces.domain if isinstance(place, Solver) else place
    remesh = None if domain is not None else coarser_domains(mesh, partial(_remade, case, mesh.mesh.comm))
    options = options_of(case, tuning)
    if isinstance(case, ElasticCase):
        return solve_elastic(
            mesh,
            case.boundary.read(),
            case.data(),
            options,
            start=_of_kind(ElasticSolution, start),
            remesh=remesh,
            name=case.name,
            title=case.title,
            source=case,
            watch=watch,
            on_step=on_step,
        )
    with watch.phase("assembly"):
        solver = place if isinstance(place, Solver) else Solver(place, boundary_of(case))
    return solver.solve(
        case.data(mesh.mesh.geometry.dim),
        options,
        start=_of_kind(Solution, start),
        remesh=remesh,
        name=case.name,
        title=case.title,
        source=case,
        watch=watch,
        on_step=on_step,
    )


def _remade(case: AnyCase, comm: MPI.Comm, factor: float) -> Domain:
    """A mesh of a case whose h is larger by a factor (collective)."""
    return mesh_case(case.with_values({"solve.h": factor * case.solve.h}), comm)


@collector_off()
def evolve_case(
    case: Case,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    domain: Domain | None = None,
    start: AnySolution | None = None,
    past: Callable[[Solver], Past] | None = None,
    tuning: Tuning | None = None,
    on_step: OnStep = lambda step: None,
) -> Iterator[Instant]:
    """Solve a case with [time] step by step, see `evolve` (collective).

    Raises:
        InputError: If the case has no [time] or cannot be discretised as asked.
        NumericalFailure: If a step cannot be solved; its `solution` is the last state.
    """
    if case.time is None:
        raise InputError(f"{case.name}: has no [time]")
    place = domain or mesh_case(case, comm)
    return evolve(
        place,
        boundary_of(case),
        case.data(place.mesh.geometry.dim),
        case.time.evolution(),
        options_of(case, tuning),
        start=_of_kind(Solution, start),
        past=past,
        name=case.name,
        title=case.title,
        source=case,
        on_step=on_step,
    )


def refuse_time(case: AnyCase) -> None:
    """Refuse a case in time.

    Raises:
        InputError: If it is one.
    """
    if isinstance(case, Case) and case.time is not None:
        raise InputError(
            f"{case.name}: is a problem in time, by its section [time]; only `signorini solve` takes those"
        )


def _of_kind[S: (Solution, ElasticSolution)](kind: type[S], start: AnySolution | None) -> S | None:
    """The start, if it is of this kind.

    Raises:
        InputError: If it is of another physics.
    """
    if start is None or isinstance(start, kind):
        return start
    raise InputError(f"the start, {start.name}, is of another physics; take one of the same")


@overload
def adapt_case(
    case: Case,
    comm: MPI.Comm = ...,
    *,
    target: float | None = ...,
    max_cells: int = ...,
    theta: float = ...,
    on_row: Callable[[AdaptRow], None] = ...,
    on_step: OnStep = ...,
) -> tuple[Solution, Certificate]: ...


@overload
def adapt_case(
    case: AnyCase,
    comm: MPI.Comm = ...,
    *,
    target: float | None = ...,
    max_cells: int = ...,
    theta: float = ...,
    on_row: Callable[[AdaptRow], None] = ...,
    on_step: OnStep = ...,
) -> tuple[AnySolution, Certificate]: ...


@collector_off()
def adapt_case(
    case: AnyCase,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    target: float | None = None,
    max_cells: int = DEFAULT_MAX_CELLS,
    theta: float = DEFAULT_THETA,
    on_row: Callable[[AdaptRow], None] = lambda row: None,
    on_step: OnStep = lambda step: None,
) -> tuple[AnySolution, Certificate]:
    """Solve a case on meshes refined where the error is, see `certificate.adaptive.adapt` (collective).

    Raises:
        InputError: If the first mesh cannot be made or has too many cells.
        NumericalFailure: If the problem on a mesh cannot be solved, or the mesh not be refined.
    """

    def solve_on(domain: Domain, start: AnySolution | None) -> AnySolution:
        return solve_case(case, domain=domain, start=start, on_step=on_step)

    return adapt(mesh_case(case, comm), solve_on, target=target, max_cells=max_cells, theta=theta, on_row=on_row)


def boundary_of(case: Case) -> Boundary:
    """Γ_S and Γ_N of a case, and its inner parts."""
    parts = case.boundary
    return Boundary([*parts.signorini, *case.law_parts], parts.neumann, parts.inner)


def options_of(case: CaseFile, tuning: Tuning | None = None) -> Options:
    """The section `[solve]`, without h."""
    values = {key: value for key, value in case.solve.model_dump().items() if key != "h"}
    return Options(**values, tuning=tuning or Tuning())


def case_of(solution: Solution) -> Case:
    """The case of a solution.

    Raises:
        InputError: If the problem was given in Python.
    """
    if not isinstance(solution.source, Case):
        raise InputError(f"{solution.name} was given in Python, not by a case file")
    return solution.source


def shared_domain(start: AnySolution, case: AnyCase) -> Domain | None:
    """The mesh of an earlier solution, if the case has the same; None for files, which may have changed since."""
    if not isinstance(start.source, CaseFile):
        return None
    earlier = start.source
    same = (earlier.geometry, earlier.solve.h) == (case.geometry, case.solve.h) and case.geometry.file is None
    return start.spaces.domain if same else None
