"""What `signorini solve` does and says for a case of elastic contact."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.results import ResultsFolder
from signorini_fenicsx.base.signals import end_if_told
from signorini_fenicsx.cases.elastic_case import ElasticCase, solve_elastic_case
from signorini_fenicsx.certificate.certify import Certificate
from signorini_fenicsx.certificate.certify_elastic import certify_elastic
from signorini_fenicsx.cli.common import failure_kept, results_place
from signorini_fenicsx.cli.report import Report, named
from signorini_fenicsx.cli.solution_report import bounds_in_words
from signorini_fenicsx.methods.history import Step
from signorini_fenicsx.output.elastic import write_elastic
from signorini_fenicsx.solving.elastic_solution import ElasticSolution


class ElasticReport(Report):
    """What is printed of a case of elastic contact."""

    def heading(self, case: ElasticCase, comm: MPI.Comm) -> None:
        """Say what the run is about, and name the columns of the iterations."""
        self.title(case.title or case.name)
        self.line(f"elastic contact, {case.solve.algorithm}, {comm.size} rank{'s' * (comm.size > 1)}, {case.fineness}")
        counts = "".join(f"{name:>9}" for name in ("open", "contact", "changed"))
        self.line(f"{'n':>4}{counts} {'‖δσ‖_V':>10} {'‖δu‖_Q':>10} {'seconds':>9}")

    def step(self, row: Step) -> None:
        """Show an iteration as soon as it is done."""
        counts = "".join(f"{n:9d}" for n in (row.no_flux, row.zero_trace, row.changed))
        self.line(f"{row.iteration:4d}{counts} {row.sigma_change:10.2e} {row.u_change:10.2e} {row.seconds:9.2f}")

    def solution(self, solution: ElasticSolution, certificate: Certificate) -> None:
        """Show the summary of a finished run (collective)."""
        summary = solution.summary()
        total = summary["resultants"].pop("sum")
        forces = (f"{name} ({_row(values[: solution.spaces.dim])})" for name, values in summary["resultants"].items())
        lines = {
            "converged": f"{summary['reason']} after {summary['iterations']} iterations",
            "mesh": f"h = {summary['h']:.5g}, {summary['cells']} cells, {summary['contact_facets']} Γ_C facets",
            "system": f"{summary['backend']}, {summary['dofs']} unknowns, {summary['linear_solver']}",
            "contact": f"{summary['touching_vertices']} facet vertices, measure {summary['contact_measure']:.6g}",
            "norms": named(summary["norms"], ".6g"),
            "forces": f"{'  '.join(forces)}; all together {np.abs(total).max():.1e}",
            "KKT": named(summary["kkt"], ".1e"),
        }
        if "errors" in summary:
            lines["errors"] = named(summary["errors"], ".4e")
        lines["certified"] = bound(certificate)
        lines["seconds"] = named(summary["timings"], ".2f")
        self.entries(lines)


def bound(certificate: Certificate) -> str:
    """The error bound in words, and why it is not guaranteed if it is not."""
    if not np.isfinite(certificate.bound):
        return "no error bound: what is given of u passes the foundation"
    names = ", ".join(certificate.by_quadrature)
    why = f"; not guaranteed: {names} not in the discrete spaces" if names else ""
    return f"energy error {bounds_in_words(certificate)}{why}"


def _row(values: list[float]) -> str:
    return ", ".join(f"{value:.5g}" for value in values)


def solve_elastic_run(
    case: ElasticCase,
    comm: MPI.Comm,
    output: Path | None,
    refused: Mapping[str, object],
    *,
    plot: bool,
    quiet: bool,
    as_json: bool,
) -> None:
    """Solve a case, bound its error and write its results (collective).

    Args:
        case: The case.
        comm: Communicator.
        output: The results folder.
        refused: Options that only scalar problems have, and what is given for them.
        plot: Whether to draw pictures.
        quiet: Whether to print nothing.
        as_json: Whether to print the summary as JSON.

    Raises:
        InputError: If such an option is given, or the case cannot be discretised as asked.
        NumericalFailure: If there is no solution to write; the last state is kept.
    """
    for name, value in refused.items():
        if value:
            raise InputError(f"{name}: elastic contact has no such option")
    report = ElasticReport(quiet=quiet, as_json=as_json)

    def on_step(row: Step) -> None:
        report.step(row)
        end_if_told(comm)

    with ResultsFolder(comm, results_place(output, case.name)) as folder:
        report.heading(case, comm)
        with failure_kept(folder, lambda solution: write_elastic(solution, folder.path, plot=plot)):
            solution = solve_elastic_case(case, comm, on_step=on_step)
        certificate = certify_elastic(solution)
        write_elastic(solution, folder.path, certificate=certificate, plot=plot)
        folder.publish()
        report.solution(solution, certificate)
        report.results(folder.target)
        report.summary(folder.target)
