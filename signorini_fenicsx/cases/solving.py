"""Solving the problem of a case file."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError, check_kind, telling
from signorini_fenicsx.base.parallel import Stopwatch, collector_off
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.cases.case import CaseFile
from signorini_fenicsx.cases.complaints import naming
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.readings import check_places
from signorini_fenicsx.certificate.adaptive import DEFAULT_MAX_CELLS, DEFAULT_THETA, AdaptRow, adapt
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.contact.history import OnStep
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.meshing import coarser_domains
from signorini_fenicsx.quantities import Quantity
from signorini_fenicsx.quantities.of_solution import check_quantities
from signorini_fenicsx.solution import Solution
from signorini_fenicsx.solving.evolution import Past, Steps
from signorini_fenicsx.solving.evolving import Instant, evolve
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solved import Solved
from signorini_fenicsx.solving.solver import Solver, refining, solve


@collector_off()
def solve_case(
    case: CaseFile,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    domain: Domain | Solver | None = None,
    start: Solved | None = None,
    tuning: Tuning | None = None,
    on_step: OnStep = lambda step: None,
    mesh: Callable[[CaseFile, MPI.Comm], Domain] = mesh_case,
) -> Any:
    """Solve a case of any physics (collective).

    Args:
        case: The problem, its discretisation and algorithm.
        comm: Communicator, used if there is no mesh yet.
        domain: Mesh to solve on, or a solver set up on it with the boundary of this case; None for the mesh of the
            case. With a mesh given, no coarser mesh predicts the sets.
        start: Solution of the same physics whose contact set is the first one.
        tuning: Sizes from which the program works differently; None for the defaults.
        on_step: Called on all ranks after each iteration.
        mesh: Makes the mesh of the case.

    Raises:
        InputError: If the case cannot be discretised as asked.
        NumericalFailure: If the sets do not settle or a KKT residual is too large; its `solution` is the last state.
    """
    check_kind("case", case, CaseFile, hint="; load_case reads one")
    refuse_time(case)
    watch = Stopwatch()
    with watch.phase("mesh"), naming(case.name):
        place = domain or mesh(case, comm)
    present = place.spaces.domain if isinstance(place, Solver) else place
    remesh = None if domain is not None else coarser_domains(present, partial(_remade, case, present))
    with watch.phase("assembly"), naming(case.name):
        posed = posed_on(case, present)
    solved = place.solve if isinstance(place, Solver) else partial(solve, place)
    about: dict[str, Any] = {"name": case.name, "title": case.title, "source": case}
    with naming(case.name):
        return solved(
            posed, options_of(case, tuning), start=start, remesh=remesh, **about, watch=watch, on_step=on_step
        )


def _remade(case: CaseFile, present: Domain, factor: float) -> Domain:
    """A mesh of a case whose h is larger by a factor (collective).

    Raises:
        InputError: If the case has a mesh that cannot be made with another h.
    """
    asked = case.solve.h if case.geometry.shape is not None else case.file_h
    h = present.h if asked is None else asked  # a geometry that is meshed with its own sizes
    return mesh_case(case.with_values({"solve.h": factor * h}), present.mesh.comm)


def posed_on(case: CaseFile, domain: Domain) -> Any:
    """The problem of a case, in time with t in it, and what is to be measured in it is refused where it cannot be.

    Collective.

    Raises:
        InputError: If an expression cannot be read, something is no quantity, or a probe is outside the domain.
    """
    dim = domain.mesh.geometry.dim
    posed = case.posed(dim)
    first = case.at_step(posed, 1, dim)
    check_places(domain, case.probe, case.section)
    for each in case.quantity:
        with telling(f"[[quantity]] {each.name}"):
            check_quantities(domain, first, [each.made()])
    return posed


def check_named(case: CaseFile, name: str | None) -> None:
    """Refuse a name that no quantity of a case has.

    Raises:
        InputError: If it has none of that name.
    """
    names = [each.name for each in case.quantity]
    if name not in (None, *names):
        raise InputError(f"--quantity {name}: {case.name} has {', '.join(names) or 'no [[quantity]]'}")


@collector_off()
def quantities_of(solution: Solution, near: Mapping[str, Quantity | None] | None = None) -> dict[str, Quantity]:
    """The intervals for the quantities of the case of a solution, by their names (collective).

    Args:
        solution: The solution.
        near: Those of the step or on the mesh before, as far as they are known.
    """
    found, before = {}, near or {}
    for each in solution.source.quantity if isinstance(solution.source, CaseFile) else []:
        with telling(f"[[quantity]] {each.name}"):
            interval = solution.quantity(each.made(), before.get(each.name))
            found[each.name] = replace(interval, symbol=each.symbol, unit=each.unit)
    return found


@collector_off()
def evolve_case(
    case: CaseFile,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    domain: Domain | None = None,
    start: Any = None,
    past: Callable[[Steps], Past] | None = None,
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
    with naming(case.name):
        place = domain or mesh_case(case, comm)
        posed = posed_on(case, place)
    return evolve(
        place,
        posed,
        case.time.evolution(),
        options_of(case, tuning),
        start=start,
        past=past,
        name=case.name,
        title=case.title,
        source=case,
        on_step=on_step,
    )


def refuse_time(case: CaseFile) -> None:
    """Refuse a case in time.

    Raises:
        InputError: If it is one.
    """
    if case.last_time is not None:
        raise InputError(
            f"{case.name}: is a problem in time, by its section [time]; only `signorini solve` takes those, in Python "
            "`evolve_case`"
        )


@collector_off()
def adapt_case(
    case: CaseFile,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    target: float | None = None,
    max_cells: int = DEFAULT_MAX_CELLS,
    theta: float = DEFAULT_THETA,
    on_row: Callable[[AdaptRow], None] = lambda row: None,
    on_step: OnStep = lambda step: None,
    measure: Callable[[Any], Quantity] | None = None,
    by: str | None = None,
    width: float | None = None,
    on_note: Callable[[str], None] = lambda note: None,
) -> tuple[Any, Certificate]:
    """Solve a case on meshes refined where the error is, see `certificate.adaptive.adapt` (collective).

    Without `measure` the quantities of the case are found on each mesh; `by` is the name of one. The first mesh is that
    of the case; `signorini adapt` begins with an h of an eighth of the diameter.

    Raises:
        InputError: If there is no such quantity, or if the first mesh cannot be made or has too many cells.
        LaterFailure: If something fails after the problem has been solved on a mesh, see there.
        NumericalFailure: If the problem on the first mesh cannot be solved.
    """
    near: dict[str, Quantity | None] = {}

    def solve_on(domain: Domain, start: Solved | None) -> Any:
        return solve_case(case, domain=domain, start=start, on_step=on_step)

    def of_case(solution: Any) -> dict[str, Quantity]:
        near.update(found := quantities_of(solution, near))
        return found

    check_named(case, by)
    with naming(case.name):
        first = mesh_case(case, comm)
    options, lacking = refining(case.posed(first.mesh.geometry.dim), options_of(case))
    if lacking:
        on_note(f"element {options.element}: {lacking}")
    if options.element is not None:
        case = case.with_values({"solve.element": options.element})
    return adapt(
        first,
        solve_on,
        target=target,
        max_cells=max_cells,
        theta=theta,
        on_row=on_row,
        measure=measure or of_case,
        by=by,
        width=width,
    )


def options_of(case: CaseFile, tuning: Tuning | None = None) -> Options:
    """The section `[solve]`, without h."""
    values = {key: value for key, value in case.solve.model_dump().items() if key != "h"}
    return Options(**values, tuning=tuning or Tuning())


def shared_domain(start: Solved | None, case: CaseFile) -> Domain | None:
    """The mesh of an earlier solution, if the case has the same; None for files, which may have changed since."""
    if start is None or not isinstance(start.source, CaseFile):
        return None
    earlier = start.source
    same = (earlier.geometry, earlier.solve.h) == (case.geometry, case.solve.h) and not case.geometry.files
    return start.spaces.domain if same else None
