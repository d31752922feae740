"""`signorini solve` for cases with [time]."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.results import ResultsFolder
from signorini_fenicsx.base.signals import end_if_told
from signorini_fenicsx.base.text import named
from signorini_fenicsx.cases.units import read_off, units_of
from signorini_fenicsx.cli.case_report import CaseReport
from signorini_fenicsx.cli.common import results_place
from signorini_fenicsx.cli.solution_report import interval, mesh

if TYPE_CHECKING:
    from signorini_fenicsx.cases.case import CaseFile
    from signorini_fenicsx.certificate.step_bounds import StepBounds
    from signorini_fenicsx.output.steps import StepFolder
    from signorini_fenicsx.quantities import Quantity
    from signorini_fenicsx.solving.evolving import Instant
    from signorini_fenicsx.solving.solved import Solved


MOST_BEFORE = 2
"""Steps before a step that its bound needs: after a restart these are done again."""
TRUST = ("guaranteed", "relies_on", "bound_is")
"""What `largest` has that is no number."""
OF_STEP = "to the exact solution of the step's own problem"
"""What the bounds of steps are of, if their physics says nothing else."""


class EvolutionReport(CaseReport):
    """What `signorini solve` prints of a problem in time."""

    def columns(self, case: CaseFile, *, certified: bool) -> None:
        """Print the problem of the run, and name the columns of the steps."""
        assert case.time is not None
        self.line(f"{case.fineness}, {case.time.steps} steps{case.scheme} to t = {case.time.end:g}")
        bound = f" {'bound':>11}" if certified else ""
        self._own = case.columns_of_step
        own = "".join(f" {title:>{width}}" for title, width, _ in self._own.values())
        self.table(
            f"{'step':>6} {'t':>11} {'contact':>9} {'measure':>11}{own} {'solves':>9} {'KKT':>9}{bound} {'seconds':>9}"
        )

    def step(self, row: Mapping[str, Any]) -> None:
        """Print a step."""
        bound = f" {row['bound']:11.4e}" if "bound" in row else ""
        own = "".join(f" {row[key]:{width}{form}}" for key, (_, width, form) in self._own.items())
        self.row(
            f"{row['step']:6d} {row['t']:11.5g} {row['contact_facets']:9d} {row['contact_measure']:11.5g}{own} "
            f"{row['iterations']:9d} {row['kkt']:9.1e}{bound} {row['seconds']:9.2f}"
        )

    def finished(
        self, last: Solved, summary: Mapping[str, Any], quantities: Mapping[str, Quantity], *, certified: bool
    ) -> None:
        """Print the summary of all steps, and what there is to say of the last one."""
        about = summary["time"]
        lines = {
            "steps": f"{about['steps']} to t = {about['end']:g}, {summary['iterations']} linear problems",
            "mesh": mesh(last, summary),
            "at most": named({name: each for name, each in about["largest"].items() if name not in TRUST}, ".3e"),
            **{name: f"at the end {words}" for name, words in last.lines(summary).items()},
        }
        lines |= {name: f"at the end {words}" for name, words in read_off(summary, units_of(last)).items()}
        if "errors" in summary:
            lines["errors"] = f"at the end {named(summary['errors'], '.4e')}"
        if certified:
            lines["certified"] = (
                f"each bound is that of the distance {about['largest']['bound_is'] or OF_STEP}{last.after}"
                + _reservation(about["largest"])
            )
        lines |= {name: f"at the end {interval(quantity)}" for name, quantity in quantities.items()}
        self.entries(lines)
        self.notes(last.notes())


def _reservation(about: Mapping[str, Any]) -> str:
    """Why not all bounds are guaranteed, for the problem that they are of, if they are not."""
    if about["bound"] is None:
        return "; some steps have none"
    return f"; not all are guaranteed: {about['relies_on']} not enclosed or not resolved" if about["relies_on"] else ""


def solve_in_time(
    case: CaseFile,
    comm: MPI.Comm,
    report: EvolutionReport,
    output: Path | None,
    start_from: Path | None = None,
    *,
    restart: bool,
    certify_steps: bool,
    plot: bool,
) -> None:
    """Solve a case in time and write its results (collective).

    Raises:
        InputError: If it cannot be discretised as asked, or there is nothing to go on with.
        NumericalFailure: If a step cannot be solved.
    """
    from signorini_fenicsx.certificate.step_bounds import StepBounds
    from signorini_fenicsx.output.checkpoint import load_solution
    from signorini_fenicsx.output.evolution import write_evolution
    from signorini_fenicsx.output.steps import StepFolder

    with ResultsFolder(comm, results_place(output, case.name)) as folder:
        start = None if start_from is None else load_solution(start_from, comm)
        steps = StepFolder(comm, folder.target)
        done = steps.begin(case, start_from, restart=restart)
        report.heading(case, comm)
        report.columns(case, certified=certify_steps)
        bounds = StepBounds() if certify_steps else None
        last, quantities = _go_on(case, folder, start, steps, done, bounds, report)
        failures = len(folder.failures)
        write_evolution(folder, steps, last, quantities, plot=plot)
        if len(folder.failures) == failures:
            steps.remove()
        else:
            folder.failures["steps"] = f"`--restart` writes again what is made of the steps in {steps.path}"
        summary = on_root(comm, lambda: json.loads((folder.target / "summary.json").read_text(encoding="utf-8")))
        report.finished(last.solution, summary, quantities, certified=certify_steps)
        report.published(folder.target)


def _go_on(
    case: CaseFile,
    folder: ResultsFolder,
    start: Solved | None,
    steps: StepFolder,
    done: int,
    bounds: StepBounds | None,
    report: EvolutionReport,
) -> tuple[Instant, Mapping[str, Quantity]]:
    """Do all steps after those that are done; the last one again if all are (collective).

    A bound or quantities that cannot be found are in the failures of the folder; the steps go on.

    Returns:
        The last step, and the intervals for its quantities.
    """
    from signorini_fenicsx.cases.solving import evolve_case, quantities_of, shared_domain
    from signorini_fenicsx.output.evolution import UNBOUNDED, row_of
    from signorini_fenicsx.quantities.bracket import NOT_FOUND, Quantity

    assert case.time is not None
    comm = folder.comm
    done = min(done, case.time.steps - 1)
    told = done if bounds is None else max(0, done - MOST_BEFORE)
    past = None if told == 0 else (lambda own: steps.past(own, told))
    domain = shared_domain(start, case)
    last, quantities = None, dict[str, "Quantity"]()
    before = steps.rows()[done - 1] if done else {}
    near = {each.name: Quantity.in_row(each.name, before) for each in case.quantity}
    began = time.perf_counter()
    try:
        for instant in evolve_case(
            case, comm, domain=domain, start=start, past=past, on_step=lambda step: end_if_told(comm)
        ):
            certificate = None
            if bounds is not None:
                certificate = folder.attempt("error bounds", partial(bounds.certify, instant))
            if instant.step <= done:
                continue
            found = folder.attempt("quantities", partial(quantities_of, instant.solution, near))
            quantities = dict.fromkeys((each.name for each in case.quantity), NOT_FOUND) if found is None else found
            near |= quantities
            now = time.perf_counter()
            row = row_of(instant, certificate, quantities, now - began)
            row |= UNBOUNDED if certificate is None and bounds is not None else {}
            steps.save(instant, row)
            report.step(row)
            last, began, done = instant, now, instant.step
    except (NumericalFailure, InputError) as error:
        t = case.time.evolution().time(done + 1)
        ways = ""
        if done == 0:
            steps.remove()
        else:
            shorter = f"--set time.steps={done} --set time.end={case.time.evolution().time(done)!r}"
            ways = f"; `--restart` goes on after the {done} steps in {steps.path}; with `{shorter}` it ends with them"
        error.args = (f"case {case.name}, step {done + 1}, t = {t:.5g}: {error}{ways}",)
        raise
    assert last is not None
    return last, quantities
