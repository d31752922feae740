"""Runs a study: unfinished runs are distributed to groups of ranks; each result is kept as soon as it is complete."""

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.farm import hand_out
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.results import ResultsFolder
from signorini_fenicsx.cases.solving import quantities_of, solve_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.comparing.convergence import convergence_study
from signorini_fenicsx.output.writing import write_convergence, write_solution, write_summary
from signorini_fenicsx.studies.folder import RECORD, Status, StudyFolder
from signorini_fenicsx.studies.study import Run
from signorini_fenicsx.studies.varied import in_words, varied_keys


def run_study(
    runs: Sequence[Run],
    ranks_per_run: int,
    folder: StudyFolder,
    comm: MPI.Comm,
    *,
    title: str,
    on_run: Callable[[], None],
) -> None:
    """Do the runs that have not been done, the largest first, and write the tables of all (collective).

    Args:
        runs: The runs of the study.
        ranks_per_run: Number of ranks for one run.
        folder: The folder of the study, entered.
        comm: Communicator that is split into groups.
        title: The title of the study.
        on_run: Called on all ranks of a group after each of its runs.

    Raises:
        InputError: If results cannot be written; finished runs stay.
        OSError: Likewise, for example on a full disk.
    """
    todo = on_root(comm, lambda: [run for run in runs if folder.status(run) is Status.TODO])
    by_name = {run.name: run for run in sorted(todo, key=lambda run: -run.cells)}

    def work(name: str, group: MPI.Comm) -> None:
        _execute(by_name[name], folder.place(by_name[name]), group)
        on_run()

    hand_out(comm, list(by_name), ranks_per_run, folder.claims, work)
    on_root(comm, lambda: folder.write_tables(runs, title))


def check_all_succeeded(runs: Sequence[Run], folder: StudyFolder, comm: MPI.Comm) -> None:
    """Raise if runs of a study failed (collective).

    Raises:
        NumericalFailure: If a run failed; the message names the first one.
    """
    failed = on_root(comm, lambda: [run for run in runs if folder.status(run) is Status.FAILED])
    if failed:
        reason = on_root(comm, lambda: folder.record(failed[0]).reason)
        first = in_words(failed[0], varied_keys(runs))
        raise NumericalFailure(f"{len(failed)} of {len(runs)} runs failed, the first one with {first}: {reason}")


def _execute(run: Run, place: Path, comm: MPI.Comm) -> None:
    """Do one run and publish its folder, or that of its failure (collective over its group)."""
    began = time.perf_counter()

    def record(**failure: str) -> None:
        about = {"parameters": run.parameters, "seconds": time.perf_counter() - began, "ranks": comm.size} | failure
        (results.path / RECORD).write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")

    with ResultsFolder(comm, place, saves_state=False) as results:
        try:
            _compute(run, results.path, comm)
        except (InputError, NumericalFailure) as failure:
            reason, solution = str(failure), failure.solution if isinstance(failure, NumericalFailure) else None
            if solution is not None:
                write_solution(solution, results.path, fields=run.fields, plot=run.plot)
            else:
                summary = {"converged": False, "reason": reason}
                on_root(comm, lambda: write_summary(results.path, summary))
            on_root(comm, lambda: record(reason=reason))
            results.keep_failed()
        else:
            on_root(comm, record)
            results.publish()


def _compute(run: Run, folder: Path, comm: MPI.Comm) -> None:
    task = run.convergence
    if task is None:
        solution = solve_case(run.case, comm)
        certificate, quantities = certify(solution), quantities_of(solution)
        write_solution(
            solution, folder, certificate=certificate, quantities=quantities, fields=run.fields, plot=run.plot
        )
    else:
        rows = convergence_study(run.case, task.vary, task.levels, task.reference, comm)
        write_convergence(run.case, task.vary, task.reference, rows, folder, comm)
