"""The report of `signorini study`: the plan, a live view, and the end. Only rank 0 prints."""

import time
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

from mpi4py import MPI
from rich.live import Live

from signorini_fenicsx.cli.report import Report
from signorini_fenicsx.studies.folder import Status, StudyFolder
from signorini_fenicsx.studies.study import Run, Study


class StudyReport(Report):
    """What `signorini study` prints."""

    follows = False  # there is a live view of all runs

    def heading(self, study: Study, runs: Sequence[Run], comm: MPI.Comm) -> None:
        """Print the number of runs and the groups of ranks."""
        size = min(study.ranks_per_run, comm.size)
        groups, idle = divmod(comm.size, size)
        self.title(study.title or study.name)
        shape = f"{groups} group{'s' * (groups > 1)} of {size} rank{'s' * (size > 1)}"
        remark = f", {idle} idle" if idle else ""
        if size < study.ranks_per_run:
            remark += f" (ranks_per_run = {study.ranks_per_run} wants more)"
        self.line(f"{len(runs)} runs, {shape}{remark}")

    def plan(self, runs: Sequence[Run], folder: StudyFolder) -> None:
        """List the runs with the values in which they differ, their estimated sizes and their status."""
        parameters = [run.parameters for run in runs]
        varied = [key for key in parameters[0] if len({str(values[key]) for values in parameters}) > 1]
        for run, values in zip(runs, parameters, strict=True):
            differences = "  ".join(f"{key.removeprefix('solve.')} = {values[key]}" for key in varied)
            status = folder.status(run).value
            self.line(f"{status:<7} {run.name}  ≈ {run.cells:8.2g} cells  {differences}")
        self.line(f"≈ {sum(run.cells for run in runs):.2g} cells in all")


def listing(study: Study, runs: Sequence[Run], folder: StudyFolder) -> dict[str, Any]:
    """The runs of a study for the JSON object: status, parameters, and how they ended (rank 0).

    Raises:
        InputError: If the record of a finished run is damaged.
    """
    rows = []
    for run in runs:
        status = folder.status(run)
        row = {"run": run.name, "status": status.value, "cells": run.cells, "parameters": run.parameters}
        if status in (Status.DONE, Status.FAILED):
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
        """Print the runs that have finished since the last call."""
        for run in self._finished() if self._speaks else []:
            if run.name not in self._said:
                self._said.add(run.name)
                record = self._folder.record(run)
                self._report.line(f"{record.status.value:<7} {run.name}  {record.seconds:.1f} s  {record.reason}")

    def _finished(self) -> list[Run]:
        return [run for run in self._runs if self._folder.status(run) in (Status.DONE, Status.FAILED)]

    def _view(self) -> str:
        states = [self._folder.status(run) for run in self._runs]
        counts = "  ".join(f"{states.count(state)} {state.value}" for state in Status)
        work = {
            state: sum(run.cells for run, s in zip(self._runs, states, strict=True) if s is state) for state in Status
        }
        new = sum(run.cells for run in self._finished() if run.name not in self._earlier)
        left = work[Status.TODO] + work[Status.RUNNING]
        elapsed = time.perf_counter() - self._began
        remaining = f"about {elapsed * left / new:.0f} s left" if new else "time left unknown yet"
        running = [run.name for run, state in zip(self._runs, states, strict=True) if state is Status.RUNNING]
        return "\n".join([f"{counts}  {elapsed:.0f} s, {remaining}", *(f"  {name}" for name in running)])
