"""Adaptive refinement: solve, certify, mark, refine, until the certified error or the number of cells says stop."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import collect_garbage, collector_off
from signorini_fenicsx.base.progress import doing
from signorini_fenicsx.certificate.certify import Certificate, certify
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.meshes.refinement import dorfler, refine
from signorini_fenicsx.solving.solution import Solution

type SolveOn = Callable[[Domain, Solution | None], Solution]

FIRST_MESH = 8.0
"""The first mesh has h at most the diameter of the domain over this, unless the user says otherwise."""
DEFAULT_THETA = 0.5
DEFAULT_MAX_CELLS = 10**6


@dataclass(frozen=True)
class AdaptRow:
    """One mesh of an adaptive run.

    Attributes:
        refinement: "adaptive", or "uniform" if all cells are refined each time.
        mesh: Its number, from 0.
        cells: Cells.
        unknowns: Unknowns of the linear system.
        h: Largest cell diameter.
        contact_facets: Facets in contact.
        contact_measure: Their measure.
        iterations: Iterations of the algorithm, from the sets of the mesh before.
        bound: Certified energy error.
        gap: The gap in it.
        oscillation: The data oscillation in it.
        relative: bound/‖σ_h‖.
        seconds: Wall time since the start, all meshes included.
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


@collector_off()
def adapt(
    domain: Domain,
    solve_on: SolveOn,
    *,
    target: float | None = None,
    max_cells: int = DEFAULT_MAX_CELLS,
    theta: float = DEFAULT_THETA,
    on_row: Callable[[AdaptRow], None] = lambda row: None,
) -> tuple[Solution, Certificate]:
    """Refine a mesh where the certificate of its solution says that the error is (collective).

    Each mesh but the first starts from the contact set of the one before, if the algorithm works on sets.

    Args:
        domain: The first mesh.
        solve_on: Solves the problem on a mesh of the domain, from a solution on the mesh before or from none
            (collective).
        target: Relative certified error to stop at; without one only the number of cells stops it.
        max_cells: A mesh with more cells is not solved on.
        theta: Part of Σ η_T² whose cells are refined; 1 refines uniformly.
        on_row: Called on all ranks after each mesh.

    Returns:
        The last solution and its certificate, whether the target is reached or not.

    Raises:
        InputError: If the first mesh has too many cells.
        NumericalFailure: If a mesh cannot be solved on or refined.
    """
    began, comm = time.perf_counter(), domain.mesh.comm
    cells = _cells(domain)
    if cells > max_cells:
        raise InputError(f"the first mesh, h = {domain.h:.3g}, has {cells} cells, more than the {max_cells} allowed")
    start: Solution | None = None
    mesh = 0
    while True:
        solution = solve_on(domain, start)
        start = solution if solution.method.starts_from_sets else None
        certificate = certify(solution)
        seconds = comm.allreduce(time.perf_counter() - began, MPI.MAX)
        on_row(_row("uniform" if theta >= 1 else "adaptive", mesh, solution, certificate, seconds))
        if target is not None and certificate.relative <= target:
            return solution, certificate
        with doing("refining the mesh"):
            marked = dorfler(certificate.indicator.x.array, theta, comm)
            domain = refine(domain, np.union1d(marked, np.flatnonzero(certificate.coarse)).astype(marked.dtype))
        if _cells(domain) > max_cells:
            return solution, certificate
        mesh += 1
        collect_garbage(comm)


def _cells(domain: Domain) -> int:
    return domain.mesh.topology.index_map(domain.mesh.topology.dim).size_global


def _row(refinement: str, mesh: int, solution: Solution, certificate: Certificate, seconds: float) -> AdaptRow:
    facets, measure = solution.contact()
    return AdaptRow(
        refinement=refinement,
        mesh=mesh,
        cells=_cells(solution.spaces.domain),
        unknowns=solution.outcome.dofs,
        h=solution.spaces.domain.h,
        contact_facets=facets,
        contact_measure=measure,
        iterations=len(solution.outcome.history),
        bound=certificate.bound,
        gap=certificate.gap,
        oscillation=certificate.oscillation,
        relative=certificate.relative,
        seconds=seconds,
    )


def rate(rows: Sequence[AdaptRow]) -> float | None:
    """Least-squares slope of the bound over the unknowns on logarithmic axes, over the finer half of the meshes."""
    fine = [row for row in rows[len(rows) // 2 :] if 0 < row.bound < np.inf]
    if len(fine) < 2:
        return None
    unknowns, bound = np.log([row.unknowns for row in fine]), np.log([row.bound for row in fine])
    return float(np.polyfit(unknowns, bound, 1)[0])
