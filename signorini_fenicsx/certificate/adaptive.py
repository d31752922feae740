"""Adaptive refinement: solve, certify, mark, refine, until the certified error is small or there are too many cells."""

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, LaterFailure, check_kind, in_words
from signorini_fenicsx.base.owned import cells_behind, owned_values
from signorini_fenicsx.base.parallel import collect_garbage, collector_off, end_all, first_words
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.refinement import dorfler, refine
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.physics import PHYSICS
from signorini_fenicsx.solving.solved import Solved
from signorini_fenicsx.solving.solver import refining, solve, sorted_on

type SolveOn[S: Solved] = Callable[[Domain, S | None], S]

FIRST_MESH = 8.0
"""By default h of the first mesh is at most the diameter of the domain divided by this."""
ROUNDING = 1e-10
"""A bound below this share of ‖σ_h‖, or of the largest bound of the run, is rounding."""
LONGER = 1.5
"""A slope needs meshes whose unknowns differ by this factor."""
DEFAULT_THETA = 0.5
MARGIN, LEAST = 1.3, 0.05
"""Near the target so many times the share of Σ η_T² is refined that is above it, and no less than the second."""
DEFAULT_MAX_CELLS = 10**6
ALONE = "quantity"
"""The name in rows of a quantity that is measured alone."""


@dataclass(frozen=True)
class AdaptRow:
    """One mesh of an adaptive run.

    Attributes:
        refinement: "adaptive", or "uniform" if all cells are refined each time.
        mesh: Number of the mesh, from 0.
        cells: Number of cells.
        unknowns: Unknowns of the linear system.
        h: Largest cell diameter.
        contact_facets: Number of facets in contact; in elasticity, of their vertices; with laws in Ω, of cells.
        contact_measure: Their measure.
        iterations: Iterations of the algorithm, which starts from the sets of the mesh before.
        bound: Bound of the energy error.
        gap: The gap in the bound.
        oscillation: The data oscillation in the bound.
        relative: bound/‖σ_h‖.
        seconds: Wall time since the start, all meshes included.
        quantities: Quantities that are found on each mesh, with their intervals, by name.
    """

    refinement: str
    mesh: int
    cells: int
    unknowns: int
    h: float
    contact_facets: int
    contact_measure: float
    iterations: int
    bound: float
    gap: float
    oscillation: float
    relative: float
    seconds: float
    quantities: Mapping[str, Any] = field(default_factory=dict, kw_only=True)

    def columns(self) -> dict[str, Any]:
        """All of it for a row of a table."""
        of_quantities = [quantity.columns(name) for name, quantity in self.quantities.items()]
        own = {key: value for key, value in vars(self).items() if key != "quantities"}
        return own | {key: value for columns in of_quantities for key, value in columns.items()}


class Measured(Protocol):
    """A quantity with its interval, see `quantities.Quantity`."""

    @property
    def width(self) -> float:
        """The length of the interval."""

    @property
    def shares(self) -> Array | None:
        """What each owned cell adds to this length; None if that is not known."""

    def columns(self, name: str) -> dict[str, Any]:
        """All of it for a row of a table, under a name."""


@collector_off()
def adapt[S: Solved](
    domain: Domain,
    problem: SolveOn[S] | Any,
    *,
    target: float | None = None,
    max_cells: int = DEFAULT_MAX_CELLS,
    theta: float = DEFAULT_THETA,
    on_row: Callable[[AdaptRow], None] = lambda row: None,
    measure: Callable[[S], Measured | Mapping[str, Measured]] | None = None,
    by: str | None = None,
    width: float | None = None,
) -> tuple[S, Certificate]:
    """Refine a mesh where the certificate of its solution finds the error (collective).

    If the algorithm works on sets, each later mesh starts from the contact set of the mesh before.

    Args:
        domain: The first mesh.
        problem: A `Diffusion`, `Elasticity` or `Stokes`; or a function that solves the problem on a mesh of the domain,
            starting from the solution on the mesh before or from None (collective).
        target: Relative bound at which to stop; with None only the number of cells ends the refinement.
        max_cells: Meshes with more cells are not used.
        theta: The refined cells have this share of Σ η_T²; 1 refines uniformly.
        on_row: Called on all ranks after each mesh.
        measure: Gives a quantity of a solution with its interval, such as `lambda solution: solution.quantity(Mean())`;
            then the mesh is refined where this is long (collective). Or some by name, which are in the rows.
        by: The name of that among these for which the mesh is refined; None for the bound of the energy error.
        width: Length of its interval at which to stop.

    Returns:
        The last solution and its certificate, whether the target is reached or not.

    Raises:
        InputError: If the first mesh has too many cells.
        LaterFailure: If the bound or the quantity cannot be found, the mesh not be refined, or the problem not be
            solved on a mesh after the first; it has the last `solution`, its `certificate` and the failed `state`.
        NumericalFailure: If the problem on the first mesh cannot be solved.
    """
    check_kind("domain", domain, Domain)
    check_kind("max_cells", max_cells, int)
    if not 0 < theta <= 1:
        raise InputError(f"theta: must be greater than 0 and at most 1, not {theta}")
    began, comm = time.perf_counter(), domain.mesh.comm
    if domain.cells > max_cells:
        cells = f"{domain.cells} cells, more than the {max_cells} allowed"
        raise InputError(f"the first mesh, h = {domain.h:.3g}, has {cells}")
    solve_on = problem if callable(problem) else _solving(domain, problem)
    solution, start, mesh = solve_on(domain, None), None, 0
    while True:
        check_kind("what `problem` returns", solution, Solved)
        if PHYSICS[solution.physics].bound is None:
            raise InputError(f"adapt: no error bound is known for {solution.physics}, by which a mesh could be refined")
        start = solution if solution.method.starts_from_sets else None
        with _after(solution):
            certificate = certify(solution)
            measured = {} if measure is None else measure(solution)
            found = measured if isinstance(measured, Mapping) else {ALONE: measured}
            interval = found.get(ALONE if found is not measured else by or "")
        largest = comm.allreduce(float(owned_values(certificate.indicator).max(initial=0.0)), MPI.MAX)
        if theta < 1 and interval is None and certificate.if_none and largest == 0:
            raise InputError(f"adapt: there is no error bound by which to refine the mesh: {certificate.if_none}")
        seconds = comm.allreduce(time.perf_counter() - began, MPI.MAX)
        row = _row("uniform" if theta >= 1 else "adaptive", mesh, solution, certificate, seconds)
        on_row(replace(row, quantities=found))
        narrow = interval is not None and width is not None and interval.width <= width
        if narrow or (target is not None and certificate.relative <= target):
            return solution, certificate
        shares = None if interval is None else interval.shares
        with doing("refining the mesh"), _after(solution, certificate, "cannot refine further: "):
            part = theta if target is None or interval is not None else _enough(theta, certificate.relative / target)
            marked = dorfler(owned_values(certificate.indicator) if shares is None else np.sqrt(shares), part, comm)
            marked = np.union1d(marked, np.flatnonzero(certificate.coarse)).astype(marked.dtype)
            domain = refine(domain, with_opposite(solution.spaces, marked))
        if domain.cells > max_cells:
            return solution, certificate
        mesh += 1
        collect_garbage(comm)
        with _after(solution, certificate, f"on the next mesh, with {domain.cells} cells: "):
            solution = solve_on(domain, start)


def _solving(domain: Domain, problem: Any) -> SolveOn[Any]:
    """What solves a problem on a mesh, with the element of order two where it is there (collective)."""
    options, _ = refining(sorted_on(domain, problem), Options())
    return lambda mesh, start: solve(mesh, problem, options, start=start)


def with_opposite(spaces: Any, cells: NDArray[np.int32]) -> NDArray[np.int32]:
    """Owned cells to refine, with those behind masters that would be coarse for slaves opposite to them (collective).

    On them u is linear on facets, and a slave that is finer answers with pressures that go up and down.
    """
    masters = [pair.coarse_masters(spaces.mesh, cells) for pair in getattr(spaces, "pairs", ())]
    return np.unique(np.concatenate([cells, *(cells_behind(spaces.mesh, facets) for facets in masters)]))


def _enough(theta: float, above: float) -> float:
    """The share of Σ η_T² to refine if the bound is so many times the target: near it less is enough."""
    return theta if theta >= 1 else min(theta, max(LEAST, MARGIN * (1 - above**-2)))


@contextlib.contextmanager
def _after(solution: Solved, certificate: Certificate | None = None, where: str = "") -> Iterator[None]:
    """Do something for whose failure, on any rank, a solution and its bound may not be lost (collective).

    Raises:
        LaterFailure: On all ranks, if it fails on one.
    """
    comm, error, words = solution.spaces.mesh.comm, None, ""
    try:
        yield
    except Exception as failure:
        error, words = failure, in_words(failure) or type(failure).__name__
    if words := first_words(comm, words, lambda words: end_all(comm, f"failed: {where}{words}\n")):
        raise LaterFailure(where + words, solution, certificate, getattr(error, "solution", None)) from error


def _row(refinement: str, mesh: int, solution: Solved, certificate: Certificate, seconds: float) -> AdaptRow:
    sites, measure = solution.sites_in_contact()
    return AdaptRow(
        refinement=refinement,
        mesh=mesh,
        cells=solution.spaces.domain.cells,
        unknowns=solution.outcome.dofs,
        h=solution.spaces.domain.h,
        contact_facets=sites,
        contact_measure=measure,
        iterations=len(solution.outcome.history),
        bound=certificate.bound,
        gap=certificate.gap,
        oscillation=certificate.oscillation,
        relative=certificate.relative,
        seconds=seconds,
    )


def rate(rows: Sequence[AdaptRow]) -> float | None:
    """Least-squares slope of the bound against the unknowns on logarithmic axes, from the finer half of the meshes.

    None if these are too few or of nearly one size; bounds that are rounding do not count.
    """
    least = ROUNDING * max((row.bound for row in rows if row.bound < np.inf), default=0.0)
    fine = [row for row in rows[len(rows) // 2 :] if row.relative > ROUNDING and least < row.bound < np.inf]
    if len(fine) < 2 or fine[-1].unknowns < LONGER * fine[0].unknowns:
        return None
    unknowns, bound = np.log([row.unknowns for row in fine]), np.log([row.bound for row in fine])
    return float(np.polyfit(unknowns, bound, 1)[0])
