"""What the command line shows; only rank 0 writes."""

import math
import sys
from collections.abc import Mapping
from decimal import ROUND_CEILING, Context, Decimal
from pathlib import Path
from typing import Any

from mpi4py import MPI
from rich.console import Console

from signorini_fenicsx.cases.case import Case
from signorini_fenicsx.cases.inspection import Expected, is_typical
from signorini_fenicsx.certificate.adaptive import AdaptRow, rate
from signorini_fenicsx.certificate.certify import Certificate
from signorini_fenicsx.comparing.comparison import Comparison
from signorini_fenicsx.comparing.convergence import ERRORS, ErrorRow, Vary
from signorini_fenicsx.methods.loop import Step
from signorini_fenicsx.methods.registry import ALGORITHMS, Algorithm
from signorini_fenicsx.output.writing import json_text
from signorini_fenicsx.rigorous.proof import Proof
from signorini_fenicsx.rigorous.theorem import Proven
from signorini_fenicsx.solving.solution import Solution

console = Console(highlight=False, soft_wrap=True, emoji=False)

VIOLATIONS = {"trace": "‖[p]_-‖", "flux": "‖[σ·n]_-‖", "mass_balance": "‖∇·σ + f_h‖"}
DETAILS = {"rho": "ρ", "rho_limit": "converges for ρ <", "omega": "ω", "colours": "colours"}


def heading(case: Case, comm: MPI.Comm) -> None:
    """Say what is about to be solved."""
    console.print(case.title or case.name, style="bold", markup=False)
    ranks = f"{comm.size} rank" + "s" * (comm.size > 1)
    console.print(f"{ALGORITHMS[case.solve.algorithm].title}, {ranks}")


def iteration_heading(case: Case) -> None:
    """Say what the run is about and name the columns of the iterations."""
    penalty = f", ε = {case.solve.eps:g}" if ALGORITHMS[case.solve.algorithm].has_eps else ""
    console.print(f"{case.fineness}{penalty}", markup=False)
    counts = "".join(f"{name:>9}" for name in ("σ·n = 0", "p = 0", "Robin", "changed", "clipped"))
    console.print(f"{'n':>4}{counts} {'‖δσ‖_V':>10} {'‖δu‖_Q':>10} {'seconds':>9}")


def step(row: Step) -> None:
    """Show an iteration as soon as it is done; of more than 20 only those with a number such as 30 or 400."""
    if row.iteration > 20 and row.iteration % 10 ** (len(str(row.iteration)) - 1) != 0:
        return
    counts = "".join(f"{n:9d}" for n in (row.no_flux, row.zero_trace, row.robin, row.changed, row.clipped))
    changes = f"{row.sigma_change:10.2e} {row.u_change:10.2e} {row.seconds:9.2f}"
    console.print(f"{row.iteration:4d}{counts} {changes}")


def solution(result: Solution, folder: Path, certificate: Certificate, proof: Proof | None = None) -> None:
    """Show the summary of a finished run (collective)."""
    summary = result.summary()
    rough = f", {summary['rough_steps']} rough set updates before" if summary["rough_steps"] else ""
    lines = {
        "converged": f"{summary['reason']} after {summary['iterations']} iterations{rough}",
        "mesh": f"h = {summary['h']:.5g}, {summary['cells']} cells, {summary['signorini_facets']} Γ_S facets",
        "system": f"{summary['backend']}, {summary['dofs']} unknowns, {summary['linear_solver']}",
        "contact": f"{summary['contact_facets']} facets, measure {summary['contact_measure']:.6g}",
        "norms": "  ".join(f"{name} {value:.6g}" for name, value in summary["norms"].items()),
        "KKT": "  ".join(f"{name} {value:.1e}" for name, value in summary["kkt"].items()),
    }
    if "errors" in summary:
        lines["errors"] = "  ".join(f"{name} {value:.4e}" for name, value in summary["errors"].items())
    if "violation" in summary:
        left = "  ".join(f"{VIOLATIONS[name]} {value:.3e}" for name, value in summary["violation"].items())
        lines["ε"] = f"{summary['eps']:g} leaves {left}"
    if "own_residual" in summary:
        lines["own"] = f"residual of its own discrete problem {summary['own_residual']:.1e}"
    if summary["details"]:
        lines["chosen"] = "  ".join(f"{DETAILS[name]} {value:.6g}" for name, value in summary["details"].items())
    lines["certified"] = bound(certificate)
    if proof is not None and proof.proven is not None:
        lines["proved"] = proved(proof.proven, proof.seconds)
    lines["seconds"] = "  ".join(f"{name} {value:.2f}" for name, value in summary["timings"].items())
    memory = summary["peak_memory"]
    lines["memory"] = f"{memory / 2**20:.0f} MiB at most, {memory / summary['dofs']:.0f} bytes per unknown"
    for name, text in lines.items():
        console.print(f"{name:<10} {text}", markup=False)
    results(folder)


def methods() -> None:
    """List the algorithms, one line each."""
    names, titles = max(map(len, ALGORITHMS)), max(len(algorithm.title) for algorithm in ALGORITHMS.values())
    for name, algorithm in ALGORITHMS.items():
        console.print(f"{name:<{names}}  {algorithm.title:<{titles}}  {algorithm.reference}", markup=False)


def bound(certificate: Certificate) -> str:
    """The error bound in words, and why it is not guaranteed if it is not."""
    if not math.isfinite(certificate.bound):
        reasons = "u_D < psi where Γ_D meets Γ_S, data are not bounded, or a linear solve for it failed"
        return f"no error bound: {reasons}{_reservation(certificate)}"
    parts = "gap {gap:.3e}, oscillation {oscillation:.1e}, remainder {remainder:.1e}".format(**certificate.summary())
    return (
        f"energy error ≤ {certificate.bound:.4e}, {100 * certificate.relative:.3g} % of ‖σ_h‖; "
        f"‖σ − σ_h‖ ≤ {certificate.sigma_bound:.4e} ({parts}){_reservation(certificate)}"
    )


def _reservation(certificate: Certificate) -> str:
    if certificate.unresolved:
        name, place = certificate.unresolved[0]
        where = ", ".join(f"{x:.4g}" for x in place)
        return f"; not guaranteed: {name} is not resolved near ({where})"
    if certificate.by_quadrature:
        return f"; not guaranteed: {', '.join(certificate.by_quadrature)} by quadrature"
    return ""


def proved(bounds: Proven, seconds: float) -> str:
    """The proven error bound in words, all numbers rounded up."""
    parts = ", ".join(f"{name} {above(getattr(bounds, name), 2)}" for name in ("gap", "oscillation", "remainder"))
    return (
        f"energy error ≤ {above(bounds.bound, 5)}; ‖σ − σ_h‖ ≤ {above(bounds.sigma_bound, 5)} "
        f"({parts}; {seconds:.1f} s)"
    )


def above(value: float, digits: int) -> str:
    """A number of so many digits that is not less than the float."""
    rounded = Context(prec=digits, rounding=ROUND_CEILING).create_decimal(Decimal(value))
    return f"{float(rounded):.{digits - 1}e}"


def expected(case: Case, estimate: Expected) -> None:
    """Show the sizes of a case and what a run should take."""
    about = "" if estimate.exact else "≈ "
    mesh = case.fineness.removeprefix("mesh ")
    console.print(
        f"{'mesh':<10} {mesh}, {about}{estimate.cells} cells, {about}{estimate.facets} unknowns", markup=False
    )
    for name, part in estimate.parts.items():
        size = f", {part['facets']} facets, measure {part['measure']:.6g}" if "facets" in part else ""
        console.print(f"{'part':<10} {name}: {part['condition']}{size}", markup=False)
    for name, cells in estimate.regions.items():
        console.print(f"{'region':<10} {name}: {cells} cells", markup=False)
    usual = "" if is_typical(case) else "; these are rates of alg1 to alg4 with the hybrid backend, others take more"
    console.print(f"{'memory':<10} ≈ {estimate.memory / 2**20:.0f} MiB (an estimate{usual})")
    console.print(
        f"{'seconds':<10} ≈ {estimate.solver_seconds:.1f} to solve, {estimate.run_seconds:.0f} in all, without Gmsh's "
        f"(an estimate, for free cores{usual})"
    )


def checked(counts: Mapping[str, int]) -> None:
    """Say that a case can be solved, and how large it is."""
    kinds = ("signorini", "neumann", "dirichlet")
    facets = ", ".join(f"{counts[f'{kind}_facets']} on Γ_{kind[0].upper()}" for kind in kinds)
    console.print(f"{'ready':<10} {counts['cells']} cells; facets: {facets}")


def versions(found: Mapping[str, str]) -> None:
    """Show versions, one per line."""
    width = max(map(len, found))
    for name, text in found.items():
        console.print(f"{name:<{width}}  {text}", markup=False)


def summary(folder: Path) -> None:
    """Print the `summary.json` of a results folder to standard output, also when all else is quiet (rank 0)."""
    if MPI.COMM_WORLD.rank == 0:
        sys.stdout.write((folder / "summary.json").read_text(encoding="utf-8"))


def json_object(values: Mapping[str, Any]) -> None:
    """Print values as one JSON object to standard output, also when all else is quiet (rank 0)."""
    sys.stdout.write(json_text(values) + "\n")


def results(folder: Path) -> None:
    """Say where the results are."""
    console.print(f"{'results':<10} {folder}", markup=False)


def about_to_solve(case: Case) -> None:
    """Say which problem is being solved, until its row replaces the line."""
    if console.is_terminal:
        console.print(f"solving {case.fineness}, {case.solve.algorithm} …", end="\r", markup=False)


def convergence_heading() -> None:
    """Name the columns of a convergence study."""
    errors = "".join(f" {name:>11} {'order':>5}" for name in ERRORS.values())
    console.print(f"{'h':>8} {'ε':>8} {'cells':>8} {'n':>3}{errors} {'slides σ':>9} {'slides u':>9}")


def convergence_row(row: ErrorRow) -> None:
    """Show the errors of one run."""
    errors = "".join(
        f" {_cell(getattr(row, name), 11, '.3g')} {_cell(getattr(row, name + '_order'), 5, '.2f')}" for name in ERRORS
    )
    slides = f" {_cell(row.slides_sigma_V, 9, '.3g')} {_cell(row.slides_u_Q, 9, '.3g')}"
    console.print(f"{row.h:8.5f} {_cell(row.eps, 8, '.1e')} {row.cells:8d} {row.iterations:3d}{errors}{slides}")


def convergence_slopes(slopes: dict[str, float], vary: Vary, algorithm: Algorithm) -> None:
    """Show fitted slopes beside those of the theory."""
    theory = {
        Vary.H: "h (8)" if algorithm.penalty is None else "h (30), (32)",
        Vary.EPS: "ε" if algorithm.stabilised else "√ε in general, ε for a regular flux (21)-(24)",
    }.get(vary, "h + √ε (29), (31)")
    fitted = "  ".join(f"{ERRORS[name]} {slope:.2f}" for name, slope in slopes.items())
    console.print(f"fitted slopes  {fitted}   theory: {theory}")


def adapt_heading(target: float | None, max_cells: int) -> None:
    """Say when refinement ends and name the columns of the meshes."""
    wanted = "" if target is None else f"relative error ≤ {target:g} or "
    console.print(f"until {wanted}{max_cells} cells")
    sizes = "".join(f" {name:>9}" for name in ("cells", "unknowns", "contact"))
    console.print(f"{'mesh':>13}{sizes} {'n':>3} {'error ≤':>10} {'relative':>9} {'seconds':>9}")


def adapt_row(row: AdaptRow) -> None:
    """Show the certified error on one mesh."""
    console.print(
        f"{row.refinement:>9}{row.mesh:4d} {row.cells:9d} {row.unknowns:9d} {row.contact_measure:9.5g} "
        f"{row.iterations:3d} {row.bound:10.4e} {row.relative:9.3e} {row.seconds:9.2f}"
    )


def adapted(rows: list[AdaptRow], dim: int, certificate: Certificate, folder: Path) -> None:
    """Show the last certificate, and the fitted rates beside the best possible one."""
    rates = {
        name: rate([row for row in rows if row.refinement == name])
        for name in dict.fromkeys(r.refinement for r in rows)
    }
    fitted = "  ".join(f"{name} {value:.2f}" for name, value in rates.items() if value is not None)
    if fitted:
        console.print(f"{'slopes':<10} {fitted}, of the error over the unknowns; best possible {-1 / dim:.2f}")
    console.print(f"{'certified':<10} {bound(certificate)}", markup=False)
    results(folder)


def comparison(result: Comparison, first: Path, second: Path) -> None:
    """Show how far two runs are apart."""
    one, other = result.contact
    norms = "  ".join(f"{ERRORS.get(name, '‖δσ·n‖_Λ')} {value:.4e}" for name, value in vars(result.norms).items())
    lines = {
        "A": str(first),
        "B": str(second),
        "contact": f"measure {one:.6g} and {other:.6g}",
        "sets": f"Jaccard {result.jaccard:.6f}, Hausdorff distance {result.hausdorff:.4g}",
        "norms": norms,
        "relative": "  ".join(f"{ERRORS[name]} {value:.3e}" for name, value in result.relative.items()),
    }
    for name, text in lines.items():
        console.print(f"{name:<10} {text}", markup=False)


def _cell(value: float | None, width: int, form: str) -> str:
    return f"{'-' if value is None else format(value, form):>{width}}"
