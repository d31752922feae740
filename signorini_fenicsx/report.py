"""What the command line shows; only rank 0 writes."""

from pathlib import Path

from mpi4py import MPI
from rich.console import Console
from rich.table import Table

from signorini_fenicsx.active_set import Step
from signorini_fenicsx.algorithms import ALGORITHMS
from signorini_fenicsx.case import Case
from signorini_fenicsx.convergence import ErrorRow
from signorini_fenicsx.solver import Solution

console = Console(highlight=False, soft_wrap=True)


def heading(case: Case, comm: MPI.Comm) -> None:
    """Say what is about to be solved."""
    console.print(f"[bold]{case.title or case.name}[/]")
    ranks = f"{comm.size} rank" + "s" * (comm.size > 1)
    console.print(f"{ALGORITHMS[case.solve.algorithm].title}, {case.solve.backend} backend, {ranks}")


def iteration_heading() -> None:
    """Name the columns of the iterations."""
    console.print(f"{'n':>4} {'σ·n = 0':>9} {'p = 0':>9} {'changed':>9} {'‖δσ‖_V':>10} {'‖δu‖_Q':>10} {'seconds':>9}")


def step(row: Step) -> None:
    """Show an iteration as soon as it is done."""
    console.print(
        f"{row.iteration:4d} {row.no_flux:9d} {row.zero_trace:9d} {row.changed:9d} "
        f"{row.sigma_change:10.2e} {row.u_change:10.2e} {row.seconds:9.2f}"
    )


def solution(result: Solution, folder: Path) -> None:
    """Show the summary of a finished run (collective)."""
    summary = result.summary()
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_row("converged", f"{summary['reason']} after {summary['iterations']} iterations")
    table.add_row("mesh", f"h = {summary['h']:.5g}, {summary['cells']} cells, {summary['signorini_facets']} Γ_S facets")
    table.add_row("system", f"{summary['dofs']} unknowns, {summary['linear_solver']}")
    table.add_row("contact", f"{summary['contact_facets']} facets, measure {summary['contact_measure']:.6g}")
    table.add_row("norms", "  ".join(f"{name} {value:.6g}" for name, value in summary["norms"].items()))
    table.add_row("KKT", "  ".join(f"{name} {value:.1e}" for name, value in summary["kkt"].items()))
    table.add_row("seconds", "  ".join(f"{name} {value:.2f}" for name, value in summary["timings"].items()))
    table.add_row("results", str(folder))
    console.print(table)


def level(number: int) -> None:
    """Say which mesh is being solved, until its row replaces the line."""
    if console.is_terminal:
        console.print(f"solving h = 2^-{number} …", end="\r")


def convergence_heading() -> None:
    """Name the columns of a convergence study."""
    errors = "".join(f" {name:>10} {'order':>6}" for name in ("‖δσ‖_V", "‖δu‖_Q", "‖δp‖_Λ"))
    console.print(f"{'level':>5} {'h':>8} {'cells':>8} {'n':>3}{errors} {'slides σ':>9} {'slides u':>9}")


def convergence_row(row: ErrorRow) -> None:
    """Show the errors of one level."""

    def cell(value: float | None, width: int, form: str) -> str:
        return f"{'-' if value is None else format(value, form):>{width}}"

    errors = "".join(
        f" {cell(error, 10, '.3g')} {cell(order, 6, '.2f')}"
        for error, order in (
            (row.sigma_V, row.sigma_order),
            (row.u_Q, row.u_order),
            (row.p_Lambda, row.p_order),
        )
    )
    slides = f" {cell(row.slides_sigma_V, 9, '.3g')} {cell(row.slides_u_Q, 9, '.3g')}"
    console.print(f"{row.level:5d} {row.h:8.5f} {row.cells:8d} {row.iterations:3d}{errors}{slides}")
