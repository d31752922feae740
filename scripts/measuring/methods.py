"""All algorithms on all examples: work, accuracy, mass balance, contact set."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from rich.console import Console
from rich.table import Table

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.errors import NumericalFailure
from signorini_fenicsx.base.parallel import collector_off, on_root
from signorini_fenicsx.base.text import write_table
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.meshes.sampling import measure, sampled, squares_degree
from signorini_fenicsx.methods.registry import METHODS
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.solution import Solution

COMM = MPI.COMM_WORLD
MEANS = ("iterations", "seconds", "flux", "mass")
"""The columns with means over the examples."""


@dataclass(frozen=True)
class MethodRow:
    """One algorithm on one mesh.

    Attributes:
        case: Name of the case.
        h: Largest cell diameter.
        method: The algorithm.
        iterations: Number of its iterations; for qp those of the interior-point method.
        seconds: Wall time of assembly and solve, the longest over the ranks.
        flux: ‖σ_ref − σ_h‖ / ‖σ_ref‖.
        trace: ‖p_ref − p_h‖_Λ / ‖p_ref‖_Λ.
        mass: ‖∇·σ_h + f_h − c_h u_h‖ / ‖f_h‖, the local mass balance.
        contact: Measure of the facets in contact in only one of solution and reference, divided by |Γ_S|.
        distance: Largest difference of any degree of freedom of σ, u or p from Algorithm 1 on the same mesh.
    """

    case: str
    h: float
    method: str
    iterations: int
    seconds: float
    flux: float
    trace: float
    mass: float
    contact: float
    distance: float


def complain(method: str, failure: NumericalFailure) -> None:
    """Print which method failed and why."""
    if COMM.rank == 0:
        print(f"{method} failed: {failure}")


def show(rows: list[MethodRow]) -> None:
    """Print the rows of one example."""
    if COMM.rank == 0:
        columns = [field.name for field in fields(MethodRow)][1:]
        table = Table(*columns, title=rows[0].case)
        for row in rows:
            values = (getattr(row, name) for name in columns)
            table.add_row(*(f"{value:.2e}" if isinstance(value, float) else str(value) for value in values))
        Console(width=130).print(table)


def summarise(rows: dict[int, list[MethodRow]]) -> None:
    """Print means over the examples, and for each method its largest distance from Algorithm 1."""
    if COMM.rank == 0:
        title = "geometric means over the examples, h ≤ " + " / ".join(f"2^-{level}" for level in rows)
        table = Table("method", *MEANS, "distance", title=title)
        for method in METHODS:
            means = [" / ".join(f"{mean(some, method, column):.2g}" for some in rows.values()) for column in MEANS]
            distance = max(row.distance for some in rows.values() for row in some if row.method == method)
            table.add_row(method, *means, f"{distance:.1e}")
        Console(width=130).print(table)


def mean(rows: list[MethodRow], method: str, column: str) -> float:
    """Geometric mean of a column over the rows of one method."""
    values = [getattr(row, column) for row in rows if row.method == method]
    return float(np.exp(np.mean(np.log(np.maximum(values, 1e-17)))))


def methods(
    examples: str = "1,2,3,4,5,6",
    levels: str = "3:5",
    reference: int = 7,
    output: Path = Path("results/compare_methods"),
) -> None:
    """All algorithms on all examples and three mesh sizes: work, accuracy, mass balance, contact set.

    For h ≤ 2^-level it prints, and writes into methods.csv, one row per algorithm, then means over the examples; the
    columns are explained in `MethodRow`. The reference is Algorithm 1 with h ≤ 2^-reference, and ε is 1e-8 in all
    examples.
    """
    first, last = (int(level) for level in levels.split(":"))
    for method in METHODS:  # compiles the forms, so that no time contains this
        solve_case(load_case("example1").with_values({"solve.algorithm": method, "solve.h": 0.25}))
    rows: dict[int, list[MethodRow]] = {level: [] for level in range(first, last + 1)}
    for example in examples.split(","):
        case = load_case(f"example{example}")
        fine = solve_case(case.with_values({"solve.algorithm": "alg1", "solve.h": 2.0**-reference}))
        comparisons = {level: compare_methods(case, 2.0**-level, fine, on_failure=complain) for level in rows}
        for level, of_level in comparisons.items():
            rows[level] += of_level
        show([row for of_level in comparisons.values() for row in of_level])

    summarise(rows)

    def write() -> None:
        output.mkdir(parents=True, exist_ok=True)
        write_table(output / "methods.csv", MethodRow, itertools.chain(*rows.values()))

    on_root(COMM, write)


@collector_off()
def compare_methods(
    case: Case,
    h: float,
    fine: Solution,
    methods: tuple[str, ...] = tuple(METHODS),
    *,
    on_failure: Callable[[str, NumericalFailure], None] = lambda method, failure: None,
) -> list[MethodRow]:
    """Solve by each method, all from a cold start on one mesh, and compare with a fine solution (collective).

    Args:
        case: The problem.
        h: Wanted largest cell diameter.
        fine: The reference.
        methods: Algorithms; Algorithm 1 always runs.
        on_failure: Called on all ranks with each method that fails and its failure; it has no row.

    Raises:
        InputError: If there is no mesh with this h.
        NumericalFailure: If Algorithm 1 fails.
    """
    domain = mesh_case(case.with_values({"solve.h": h}), fine.spaces.mesh.comm)

    def solved(method: str) -> Solution:
        values = {"solve.algorithm": method, "solve.h": h, "solve.predict": False}
        return solve_case(case.with_values(values), domain=domain)

    exact = solved("alg1")
    solutions: dict[str, Solution] = {}
    for method in methods:
        try:
            solutions[method] = solved(method)
        except NumericalFailure as failure:
            on_failure(method, failure)
    return [
        MethodRow(
            case=case.name,
            h=domain.h,
            method=method,
            iterations=_iterations(method, solution),
            seconds=solution.timings["assembly"] + solution.timings["solve"],
            flux=flux,
            trace=trace,
            mass=mass_imbalance(solution),
            contact=contact,
            distance=distance(solution, exact),
        )
        for (method, solution), (flux, trace, contact) in zip(
            solutions.items(), _errors(list(solutions.values()), fine), strict=True
        )
    ]


def _iterations(method: str, solution: Solution) -> int:
    """The iterations of a method, those of PIQP for qp, which is one call of it."""
    history = solution.outcome.history
    return history[-1].linear_iterations if method == "qp" else len(history)


def mass_imbalance(solution: Solution) -> float:
    """‖∇·σ_h + f_h − c_h u_h‖ / ‖f_h‖ (collective)."""
    spaces, f_h, source = solution.spaces, solution.data.f_h, solution.data.source(solution.u)
    return float(
        np.sqrt(spaces.integrate(l2(ufl.div(solution.sigma) + source, ufl.dx)) / spaces.integrate(l2(f_h, ufl.dx)))
    )


def distance(one: Solution, two: Solution) -> float:
    """Largest difference of any degree of freedom of σ, u and p, of two solutions on one mesh (collective)."""
    pairs = [(one.sigma, two.sigma), (one.u, two.u), (one.p, two.p)]
    local = max(float(np.abs(a.x.array - b.x.array).max(initial=0.0)) for a, b in pairs)
    return one.spaces.mesh.comm.allreduce(local, MPI.MAX)


def _errors(solutions: list[Solution], fine: Solution) -> Iterator[tuple[float, float, float]]:
    """Flux, trace and contact errors of solutions on one mesh; its points are searched only once (collective)."""
    spaces, comm = fine.spaces, fine.spaces.mesh.comm
    mesh, gamma = spaces.mesh, spaces.Lambda.mesh
    source = solutions[0].spaces.domain
    inside, on_gamma = squares_degree(mesh), squares_degree(gamma)
    dx, ds = measure(mesh, inside), measure(gamma, on_gamma)

    def norm(difference: ufl.core.expr.Expr, where: ufl.Measure) -> float:
        return float(np.sqrt(comm.allreduce(fem.assemble_scalar(fenicsx.form(l2(difference, where))))))

    touching = fine.contact_set().inside
    sigma_norm, p_norm = norm(fine.sigma, dx), norm(fine.p, ds)
    gamma_measure = comm.allreduce(spaces.facet_measure.sum())
    sigmas = sampled([solution.sigma for solution in solutions], mesh, source, degree=inside)
    traces = sampled([solution.p for solution in solutions], gamma, source, degree=on_gamma)
    contacts = sampled([solution.contact_set().indicator() for solution in solutions], gamma, source, degree=0)
    for sigma, p, contact in zip(sigmas, traces, contacts, strict=True):
        wrong = np.abs(np.rint(contact.x.array[: len(touching)]) - touching)
        yield (
            norm(fine.sigma - sigma, dx) / sigma_norm,
            norm(fine.p - p, ds) / p_norm,
            float(comm.allreduce(spaces.facet_measure @ wrong) / gamma_measure),
        )
