"""All algorithms on all examples, what adaptive refinement gains, and how intervals of quantities shrink with h."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import pairwise
from typing import Annotated

import numpy as np
import typer
import ufl
from mpi4py import MPI

from measuring import COMM, say, show
from signorini_fenicsx import Diffusion, Neumann, Signorini, adapt_case, load_case, solve, solve_case
from signorini_fenicsx.base.errors import NumericalFailure
from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.certificate.adaptive import ALONE, FIRST_MESH, AdaptRow
from signorini_fenicsx.comparing.comparison import compare
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.meshes.meshing import build_domain
from signorini_fenicsx.meshes.sampling import measure, sampled, squares_degree
from signorini_fenicsx.meshes.shapes import shape_of
from signorini_fenicsx.methods.registry import METHODS
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.quantities import Energy, Flux, Integral, Kind, Mean, Quantity
from signorini_fenicsx.solving.solved import Solved

MEANS = ("iterations", "seconds", "flux", "mass", "contact")
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


def mean(rows: Sequence[MethodRow], method: str, column: str) -> float:
    """Geometric mean of a column over the rows of one method."""
    values = [getattr(row, column) for row in rows if row.method == method]
    return float(np.exp(np.mean(np.log(np.maximum(values, 1e-17)))))


def methods(examples: str = "1,2,3,4,5,6", levels: str = "3:5", reference: int = 7) -> None:
    """All algorithms on all examples and three mesh sizes: work, accuracy, mass balance, contact set.

    For h ≤ 2^-level it prints one row per algorithm, then means over the examples; the columns are explained in
    `MethodRow`. The reference is Algorithm 1 with h ≤ 2^-reference, and ε is 1e-8 in all examples.
    """
    first, last = (int(level) for level in levels.split(":"))
    for method in METHODS:  # compiles the forms, so that no time contains this
        solve_case(load_case("example1").with_values({"solve.algorithm": method, "solve.h": 0.25}))
    rows: dict[int, list[MethodRow]] = {level: [] for level in range(first, last + 1)}
    columns = [field.name for field in fields(MethodRow)]
    for example in examples.split(","):
        case = load_case(f"example{example}")
        fine = solve_case(case.with_values({"solve.algorithm": "alg1", "solve.h": 2.0**-reference}))
        for level, some in rows.items():
            new = compare_methods(case, 2.0**-level, fine)
            some += new
            show(columns, [[getattr(row, name) for name in columns] for row in new])
    lines = []
    for method in METHODS:
        means = [" / ".join(f"{mean(some, method, column):.2g}" for some in rows.values()) for column in MEANS]
        lines.append(
            [method, *means, max(row.distance for some in rows.values() for row in some if row.method == method)]
        )
    say(f"geometric means over the examples, h ≤ 2^-({levels})")
    show(["method", *MEANS, "distance"], lines)


@collector_off()
def compare_methods(case: Case, h: float, fine: Solution, methods: Sequence[str] = tuple(METHODS)) -> list[MethodRow]:
    """Solve by each method, all from a cold start on one mesh, and compare with a fine solution (collective).

    Args:
        case: The problem.
        h: Wanted largest cell diameter.
        fine: The reference.
        methods: Algorithms; Algorithm 1 always runs, and what fails has no row.

    Raises:
        InputError: If there is no mesh with this h.
        NumericalFailure: If Algorithm 1 fails.
    """
    domain, rows = mesh_case(case.with_values({"solve.h": h}), fine.spaces.mesh.comm), []

    def solved(method: str) -> Solution:
        values = {"solve.algorithm": method, "solve.h": h, "solve.predict": False}
        return solve_case(case.with_values(values), domain=domain)

    exact = solved("alg1")
    for method in methods:
        try:
            solution = solved(method)
        except NumericalFailure as failure:
            say(f"{method} failed: {failure}")
            continue
        history, timings = solution.outcome.history, solution.timings
        iterations = history[-1].linear_iterations if method == "qp" else len(history)
        numbers = *errors(solution, fine), mass_imbalance(solution), wrong_contact(solution, fine)
        seconds = timings["assembly"] + timings["solve"]
        rows.append(MethodRow(case.name, domain.h, method, iterations, seconds, *numbers, distance(solution, exact)))
    return rows


def errors(solution: Solution, fine: Solution) -> tuple[float, float]:
    """‖σ_ref − σ_h‖ / ‖σ_ref‖ and ‖p_ref − p_h‖_Λ / ‖p_ref‖_Λ (collective)."""
    spaces, source, norms = fine.spaces, solution.spaces.domain, fine.norms()
    (sigma,) = sampled([solution.sigma], spaces.mesh, source, degree=(inside := squares_degree(spaces.mesh)))
    gamma = spaces.Lambda.mesh
    (p,) = sampled([solution.p], gamma, source, degree=(along := squares_degree(gamma)))
    off = spaces.integrate(l2(fine.sigma - sigma, measure(spaces.mesh, inside))) ** 0.5
    off_p = spaces.integrate(l2(fine.p - p, measure(gamma, along))) ** 0.5
    return off / norms["sigma_L2"], off_p / norms["p_L2"]


def wrong_contact(solution: Solution, fine: Solution) -> float:
    """Measure of the facets in contact in only one of two solutions, divided by |Γ_S| (collective)."""
    found = compare(solution, fine)
    both = sum(found.contact) * found.jaccard / (1 + found.jaccard)
    return (sum(found.contact) - 2 * both) / COMM.allreduce(fine.spaces.facet_measure.sum())


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


QUANTITIES: dict[str, Kind] = {
    "mean": Mean(),
    "far corner": Integral(weight="1 if x > 0.5 and y < 0.25 else 0"),
    "on bottom": Mean(parts="bottom"),
}
"""Quantities of example 5."""


def measured(solution: Solved, kind: Kind, *, of_energy: bool) -> Quantity:
    """A quantity; for the bound of the energy error without the shares of cells (collective)."""
    interval = solution.quantity(kind)
    return replace(interval, shares=None) if of_energy else interval


def coarse(name: str) -> Case:
    """A case with RT0 on the mesh from which adaptive runs start."""
    case = load_case(name)
    return case.with_values({"solve.h": shape_of(case.geometry.shape).diameter / FIRST_MESH, "solve.element": "RT0"})


def reached(rows: list[AdaptRow], size: Callable[[AdaptRow], float], most: float, number: str) -> list[object]:
    """Cells or unknowns of the first mesh on which something is at most so large, and the seconds of all up to it."""
    row = next((row for row in rows if size(row) <= most), None)
    return ["–", "–"] if row is None else [getattr(row, number), row.seconds]


def width(row: AdaptRow) -> float:
    """The length of the interval of the quantity."""
    return row.quantities[ALONE].width


def quantities(max_cells: Annotated[int, typer.Argument()] = 20_000) -> None:
    """Refinement for the interval of a quantity beside that for the energy error, and uniform one, in example 5.

    The table has cells of the first mesh whose interval is that short, and the seconds of all meshes up to it, each
    with its interval. Each length is what the last mesh for the energy bound reaches, times 1, 2 and 4.
    """
    ways = {"interval": (False, 0.5), "energy": (True, 0.5), "uniform": (True, 1.0)}
    table = []
    for name, kind in QUANTITIES.items():
        rows: dict[str, list[AdaptRow]] = {way: [] for way in ways}
        for way, (of_energy, theta) in ways.items():
            measure = partial(measured, kind=kind, of_energy=of_energy)
            adapt_case(coarse("example5"), max_cells=max_cells, theta=theta, measure=measure, on_row=rows[way].append)
        for factor in (4, 2, 1):
            most = factor * width(rows["energy"][-1])
            found = [cell for some in rows.values() for cell in reached(some, width, most, "cells")]
            table.append([name, most, *found])
    show(["quantity", "length", *(f"{way}: {what}" for way in ways for what in ("cells", "s"))], table)


def adaptive(
    max_cells: Annotated[int, typer.Argument()] = 200_000,
    cases: Annotated[list[str], typer.Argument()] = ["example2", "example5"],  # noqa: B006
) -> None:
    """Unknowns and seconds that adaptive refinement with RT0 needs for the certified error of uniform meshes.

    For each case uniform refinement runs up to MAX_CELLS. For each uniform mesh the table gives its certified relative
    error, its unknowns, the seconds of all meshes up to it, and those of this mesh alone; then unknowns of the first
    adaptive mesh with at most this error, and the seconds of all up to it. Each mesh starts from the contact set of the
    mesh before. A first run on small meshes compiles the forms and does not count.
    """
    table = []
    for name in cases:
        case, uniform, refined = coarse(name), list[AdaptRow](), list[AdaptRow]()
        adapt_case(case, max_cells=10_000)
        _, finest = adapt_case(case, max_cells=max_cells, theta=1.0, on_row=uniform.append)
        adapt_case(case, target=finest.relative, on_row=refined.append)
        for before, row in pairwise(uniform):
            of_row = [row.unknowns, row.seconds, row.seconds - before.seconds]
            most = row.relative
            others = reached(refined, lambda row: row.relative, most, "unknowns")
            table.append([name, most, *of_row, *others])
    show(["case", "error", "uniform", "seconds", "alone", "adaptive", "seconds"], table)


def orders() -> None:
    """How half the length of some intervals shrinks with h (collective)."""
    problem = Diffusion(f="-10 if x < 0.5 else 10", conditions=[Signorini("bottom"), Neumann("right")])
    kinds = [Integral(weight="1 if x < 0.5 else 0"), Mean(), Flux(["left", "bottom", "top"]), Energy()]
    for n in (16, 32, 64, 128):
        solution = solve(build_domain(COMM, "square", 1.001 * 2**0.5 / n, mesh="structured"), problem)
        intervals = [solution.quantity(kind) for kind in kinds]
        say(f"{n:4d} " + "  ".join(f"{each.middle:.6f} ± {each.width / 2:.2e}" for each in intervals))
