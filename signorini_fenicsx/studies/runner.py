"""A study on its ranks: groups of ranks do the unfinished runs; each result is kept as soon as it is complete."""

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError, LaterFailure, NumericalFailure
from signorini_fenicsx.base.farm import hand_out
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.results import ResultsFolder
from signorini_fenicsx.cases.domains import LastMesh
from signorini_fenicsx.cases.solving import quantities_of, solve_case
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.comparing.convergence import convergence_study
from signorini_fenicsx.output.writing import Found, SolutionFiles, publish_convergence, write_summary
from signorini_fenicsx.solution import Solution
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
) -> str:
    """Do the runs that have not been done, the largest first, and write the tables of all (collective).

    Args:
        runs: The runs of the study.
        ranks_per_run: Number of ranks for one run.
        folder: The folder of the study, entered.
        comm: Communicator that is split into groups.
        title: The title of the study.
        on_run: Called on all ranks of a group after each of its runs.

    Returns:
        Why the picture could not be drawn; empty if it was.

    Raises:
        InputError: If results cannot be written; finished runs stay.
        OSError: Likewise, for example on a full disk.
    """
    todo = on_root(comm, lambda: [run for run in runs if folder.status(run) is Status.TODO])
    by_name = {run.name: run for run in sorted(todo, key=lambda run: -run.cells)}

    meshes = LastMesh()

    def work(name: str, group: MPI.Comm) -> None:
        _execute(by_name[name], folder.place(by_name[name]), group, meshes)
        on_run()

    hand_out(comm, list(by_name), ranks_per_run, folder.claims, work, meshes.forget)
    return on_root(comm, lambda: folder.write_tables(runs, title))


def check_all_succeeded(runs: Sequence[Run], folder: StudyFolder, comm: MPI.Comm, undrawn: str = "") -> None:
    """Raise if runs of a study failed, or something after their solution did (collective).

    Args:
        runs: The runs.
        folder: The folder of the study.
        comm: Communicator.
        undrawn: What `run_study` returned.

    Raises:
        NumericalFailure: If a run failed; the message names the first one.
        LaterFailure: If all are solved, but not all that came after was done; likewise.
    """

    def told() -> NumericalFailure | None:
        records = [(run, folder.record(run)) for run in runs]
        failed = [(run, record) for run, record in records if record.status is Status.FAILED]
        chosen = failed or [(run, record) for run, record in records if not record.complete]
        if not chosen:
            return LaterFailure(undrawn) if undrawn else None
        run, record = chosen[0]
        first = f"the first one with {in_words(run, varied_keys(runs))}: {record.reason}"
        what, kind = ("failed", NumericalFailure) if failed else ("are solved, but not complete", LaterFailure)
        return kind(f"{len(chosen)} of {len(runs)} runs {what}, {first}")

    if (failure := on_root(comm, told)) is not None:
        raise failure


def _execute(run: Run, place: Path, comm: MPI.Comm, meshes: LastMesh) -> None:
    """Do one run and publish its folder, or that of its failure (collective over its group)."""
    began = time.perf_counter()

    def record(reason: str) -> None:
        about = {"parameters": run.parameters, "seconds": time.perf_counter() - began, "ranks": comm.size}
        about |= {"reason": reason} if reason else {}
        (results.path / RECORD).write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")

    with ResultsFolder(comm, place) as results:
        reason = ""
        try:
            _compute(run, results, comm, meshes)
        except (InputError, NumericalFailure) as failure:
            reason, solution = str(failure), failure.solution if isinstance(failure, NumericalFailure) else None
            if solution is not None:
                _write(run, results, solution, failed=True)
            else:
                summary = {"converged": False, "reason": reason}
                on_root(comm, lambda: write_summary(results.path, summary))
                results.keep_failed()
        reason = "; ".join(filter(None, (reason, results.told())))
        results.failures.clear()  # they are in the record
        on_root(comm, lambda: record(reason))
        results.add()


def _compute(run: Run, results: ResultsFolder, comm: MPI.Comm, meshes: LastMesh) -> None:
    task = run.convergence
    if task is None:
        _write(run, results, solve_case(run.case, comm, mesh=meshes), failed=False)
    else:
        rows = convergence_study(run.case, task.vary, task.levels, task.reference, comm)
        publish_convergence(run.case, task.vary, task.reference, rows, results, comm)


def _write(run: Run, results: ResultsFolder, solution: Solution, *, failed: bool) -> None:
    """Publish the solution of a run, and what is to be known and seen of it."""
    files, found = SolutionFiles(solution).publish(results, failed=failed), Found()
    if not failed:
        certificate = results.attempt("error bound", lambda: certify(solution))
        found = Found(
            certificate=certificate, quantities=results.attempt("quantities", lambda: quantities_of(solution))
        )
    files.publish_others(results, found, fields=run.fields, plot=run.plot)
