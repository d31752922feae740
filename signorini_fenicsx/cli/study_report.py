"""What `signorini study` does and prints: the plan, a live view, and the end. Only rank 0 prints."""

import time
from collections.abc import Collection, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mpi4py import MPI
from rich.live import Live
from rich.text import Text

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.text import counted, printable_lines
from signorini_fenicsx.cli.common import results_place
from signorini_fenicsx.cli.report import Report
from signorini_fenicsx.studies.folder import Record, Status, StudyFolder
from signorini_fenicsx.studies.runner import check_all_succeeded, run_study
from signorini_fenicsx.studies.study import Run, Study, load_study
from signorini_fenicsx.studies.varied import in_words, varied_keys

MANY = 1000
"""A study of so many runs has to be meant."""
ENDED = (Status.DONE, Status.FAILED)


class StudyReport(Report):
    """What `signorini study` prints."""

    follows = False  # there is a live view of all runs

    def heading(self, study: Study, runs: Sequence[Run], comm: MPI.Comm) -> None:
        """Print the number of runs and the groups of ranks."""
        size = min(study.ranks_per_run, comm.size)
        groups, idle = divmod(comm.size, size)
        self.title(study.title or study.name)
        shape = f"{counted(groups, 'group')} of {counted(size, 'rank')}"
        remark = f", {idle} idle" if idle else ""
        if size < study.ranks_per_run:
            remark += f" (ranks_per_run = {study.ranks_per_run} wants more)"
        self.line(f"{len(runs)} runs, {shape}{remark}")

    def plan(self, runs: Sequence[Run], folder: StudyFolder) -> None:
        """List the runs with the values in which they differ, their estimated sizes and their status."""
        keys = varied_keys(runs)
        for run in runs:
            self.line(f"{folder.status(run).value:<7} {in_words(run, keys)}  ≈ {run.cells:.2g} cells  {run.name}")
        self.line(f"≈ {sum(run.cells for run in runs):.2g} cells in all")

    def status(self, runs: Sequence[Run], folder: StudyFolder) -> None:
        """Print how far a study is, and how each of its runs ended (rank 0).

        Raises:
            InputError: If the record of a finished run is damaged.
        """
        keys, busy = varied_keys(runs), folder.is_busy()
        states = {run.name: folder.status(run) for run in runs}
        for run in runs:
            state = states[run.name]
            if state is Status.RUNNING and not busy:  # left by a launch that was killed
                state = states[run.name] = Status.TODO
            end = _end(folder.record(run)) if state in ENDED else ""
            self.line(f"{state.value:<7} {in_words(run, keys)}{end}")
        statuses = list(states.values())
        ended = sum(state in ENDED for state in statuses)
        counts = ", ".join(f"{statuses.count(state)} {state.value}" for state in Status if state in statuses)
        self.line(f"{ended}/{len(runs)}: {counts}; {'a launch is under way' if busy else 'no launch is under way'}")


def _end(record: Record) -> str:
    """How a run ended: its seconds, and why it failed."""
    return f"  {record.seconds:.1f} s" + ("" if record.complete else f"  {record.reason}")


def listing(study: Study, runs: Sequence[Run], folder: StudyFolder) -> dict[str, Any]:
    """The runs of a study for the JSON object: status, parameters, and how they ended (rank 0).

    Raises:
        InputError: If the record of a finished run is damaged.
    """
    rows = []
    for run in runs:
        status = folder.status(run)
        row = {"run": run.name, "status": status.value, "cells": run.cells, "parameters": run.parameters}
        if status in ENDED:
            record = folder.record(run)
            row |= {"reason": record.reason, "seconds": record.seconds, "ranks": record.ranks}
        rows.append(row)
    return {"study": study.name, "title": study.title, "folder": str(folder.path), "runs": rows}


class Progress:
    """A live view of a study, read from its folder; a context manager.

    On a terminal a thread keeps it up to date, because the rank that shows it computes as well. Otherwise a line is
    printed for each finished run, as soon as this rank knows of it.
    """

    def __init__(self, runs: Sequence[Run], folder: StudyFolder, comm: MPI.Comm, report: Report):
        """Look up the status of the runs (rank 0)."""
        self._report = report
        self._runs, self._folder, self._speaks = runs, folder, comm.rank == 0
        self._keys = varied_keys(runs)
        self._began = time.perf_counter()
        self._earlier = {run.name for run in self._finished()} if self._speaks else set()
        self._said = set(self._earlier)
        self._live = Live(console=report.console, get_renderable=self._view, refresh_per_second=2, transient=True)

    def __enter__(self) -> Self:
        if self._speaks and self._earlier:
            self._report.line(f"{len(self._earlier)} runs were finished before")
        if self._speaks and self._report.console.is_terminal:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()
        self.say()

    def say(self) -> None:
        """Print the runs that have finished since the last call, how many of all that are, and the time left."""
        for run in self._finished() if self._speaks else []:
            if run.name not in self._said:
                self._said.add(run.name)
                record = self._folder.record(run)
                count = f"{len(self._said):>{len(str(len(self._runs)))}}/{len(self._runs)}"
                values = in_words(run, self._keys)
                self._report.line(f"{count} {record.status.value:<6} {values}{_end(record)}{self._left(self._said)}")

    def _finished(self) -> list[Run]:
        return [run for run in self._runs if self._folder.status(run) in ENDED]

    def _left(self, finished: Collection[str]) -> str:
        """The time left, from the cells of the runs that have finished; nothing where it is not known, or all are."""
        new = sum(run.cells for run in self._runs if run.name in finished and run.name not in self._earlier)
        left = sum(run.cells for run in self._runs if run.name not in finished)
        if not new or not left:
            return ""
        return f"  about {(time.perf_counter() - self._began) * left / new:.0f} s left"

    def _view(self) -> Text:
        states = [self._folder.status(run) for run in self._runs]
        ended = [run.name for run, state in zip(self._runs, states, strict=True) if state in ENDED]
        running = [run for run, state in zip(self._runs, states, strict=True) if state is Status.RUNNING]
        failed = f", {states.count(Status.FAILED)} of them failed" if Status.FAILED in states else ""
        head = f"{len(ended)}/{len(self._runs)}{failed}{self._left(ended)}"
        return Text(printable_lines("\n".join([head, *(f"  running {in_words(run, self._keys)}" for run in running)])))


def do_study(
    path: str,
    output: Path | None,
    report: StudyReport,
    *,
    dry_run: bool,
    retry_failed: bool,
    status: bool,
    yes: bool,
    as_json: bool,
) -> None:
    """Do all unfinished runs of a study, or show how far it is (collective).

    Raises:
        InputError: If the study or its folder is not right, or it is large and nobody has said yes.
        NumericalFailure: If a run failed.
    """
    comm = MPI.COMM_WORLD
    study, runs = on_root(comm, lambda: load_study(path))
    folder = StudyFolder(comm, results_place(output, f"{study.name}-study"))
    report.heading(study, runs, comm)
    if status:
        on_root(comm, lambda: report.status(runs, folder))
    elif dry_run:
        report.plan(runs, folder)
    if dry_run or status:
        if as_json:
            report.json(on_root(comm, lambda: listing(study, runs, folder)))
        return
    if len(runs) >= MANY and not yes:
        raise InputError(f"study {study.name}: has {len(runs)} runs; look at them by --dry-run, and begin by --yes")
    title = study.title or study.name
    with folder:
        if retry_failed:
            on_root(comm, lambda: folder.forget_failures(runs))
        with Progress(runs, folder, comm, report) as progress:
            undrawn = run_study(runs, study.ranks_per_run, folder, comm, title=title, on_run=progress.say)
        report.results(folder.path)
        if as_json:
            report.json(on_root(comm, lambda: listing(study, runs, folder)))
        check_all_succeeded(runs, folder, comm, undrawn)
