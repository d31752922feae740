"""All algorithms on all examples: work, accuracy, mass balance, contact set."""

import signorini_fenicsx  # isort: skip  # noqa: F401  first: it loads the wheel's libraries

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import ufl
from mpi4py import MPI

from measuring import COMM, say, show
from signorini_fenicsx.base.errors import NumericalFailure
from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.cases.case import load_case
from signorini_fenicsx.cases.domains import mesh_case
from signorini_fenicsx.cases.solving import solve_case
from signorini_fenicsx.comparing.comparison import compare
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.meshes.sampling import measure, sampled, squares_degree
from signorini_fenicsx.methods.registry import METHODS
from signorini_fenicsx.physics.diffusion.case import Case
from signorini_fenicsx.physics.diffusion.solution import Solution

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
