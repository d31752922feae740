"""The folder of a study: one folder per finished run, tables of all runs, and a lock for one launch at a time."""

import contextlib
import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError, in_words
from signorini_fenicsx.base.exchange import PARTIAL, clear, complete, failed_place
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.reading import text_of
from signorini_fenicsx.base.signals import Interruption
from signorini_fenicsx.base.text import write_rows
from signorini_fenicsx.base.versions import versions
from signorini_fenicsx.output.latex import write_columns
from signorini_fenicsx.studies.study import Run, flattened
from signorini_fenicsx.studies.varied import varied_keys

LOCK = ".lock"
"""A folder with this file belongs to a study."""
CLAIMS = ".claims"

RECORD = "run.json"
HOW_IT_ENDED = ("status", "reason")
NOT_RESULTS = (
    *("case", "title", "algorithm", "converged", "reason", "rows"),
    *("versions", "command", "ranks", "timings", "peak_memory"),
)
"""Keys of a summary that are elsewhere in the tables, or in none because they differ from launch to launch."""

type Row = dict[str, Any]


class Status(Enum):
    """The status of a run."""

    TODO = "to do"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True)
class Record:
    """The record of a finished run.

    Attributes:
        status: DONE or FAILED.
        summary: Its `summary.json`.
        reason: Why the run ended, in words; empty if it measured errors. If it is not complete, what failed.
        seconds: Wall time of the run.
        ranks: Number of its ranks.
        complete: Whether it has a solution, and nothing that came after that failed.
    """

    status: Status
    summary: dict[str, Any]
    reason: str
    seconds: float
    ranks: int
    complete: bool


class StudyFolder:
    """The folder of a study: a context manager that all ranks enter together, and only one launch at a time.

    When a run is finished, its complete folder appears under `runs`; for a failed run its name ends in `.failed`.
    """

    def __init__(self, comm: MPI.Comm, path: Path | str):
        """Keep the path; nothing on disk changes before the context is entered."""
        self._comm = comm
        self.path = Path(path).absolute()
        self.claims = self.path / CLAIMS
        self._lock: int | None = None

    def __enter__(self) -> Self:
        """Create the folder, lock it and remove what a killed launch has left (collective).

        Raises:
            InputError: If it cannot be written, is not the folder of a study, or another launch is using it.
        """
        on_root(self._comm, self._open)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, Interruption):
            error.args = (f"{error}; finished runs are kept, and the same command does the others",)
        if self._lock is not None:
            shutil.rmtree(self.claims, ignore_errors=True)
            os.close(self._lock)
            self._lock = None

    def place(self, run: Run) -> Path:
        """Folder of a run that has succeeded."""
        return self.path / "runs" / run.name

    def is_busy(self) -> bool:
        """Whether a launch is under way here (rank 0)."""
        try:
            with (self.path / LOCK).open() as lock:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
        return False

    def status(self, run: Run) -> Status:
        """The status of a run, from the files alone; after a kill RUNNING is what was running."""
        if (self.place(run) / RECORD).is_file():
            return Status.DONE
        if (failed_place(self.place(run)) / RECORD).is_file():
            return Status.FAILED
        return Status.RUNNING if (self.claims / run.name).exists() else Status.TODO

    def record(self, run: Run) -> Record:
        """Read the record of a finished run.

        Raises:
            InputError: If it is damaged.
        """
        status = self.status(run)
        folder = self._ended(run, status)
        try:
            summary = dict(json.loads(text_of(folder / "summary.json")))
            own = json.loads(text_of(folder / RECORD))
            reason = own.get("reason", summary.get("reason", ""))
            return Record(status, summary, str(reason), float(own["seconds"]), int(own["ranks"]), "reason" not in own)
        except (OSError, ValueError, TypeError, LookupError, RecursionError):
            raise InputError(f"{folder}: is damaged; delete it, and the run will be done again") from None

    def _ended(self, run: Run, status: Status) -> Path:
        """The folder of a run that has ended with this status."""
        return self.place(run) if status is Status.DONE else failed_place(self.place(run))

    def forget_failures(self, runs: Sequence[Run]) -> None:
        """Let runs that failed, or are not complete, be tried again (rank 0)."""
        for run in runs:
            if (status := self.status(run)) is Status.FAILED or (
                status is Status.DONE and not self.record(run).complete
            ):
                clear(self.place(run).parent, self._ended(run, status))

    def write_tables(self, runs: Sequence[Run], title: str) -> str:
        """Write `table.csv`, `.parquet`, `.tex` and `timings.csv` of finished runs, then a picture (rank 0).

        The table has one row per run, or per level of a run that measures errors: first what varies, then the results,
        then what is the same in all runs. What depends on how the study was launched is only in the timings.

        Returns:
            Why the picture cannot be drawn; empty if it can.
        """
        import pyarrow.parquet  # takes a second to import

        from signorini_fenicsx.studies.picture import draw_study, told_of  # likewise

        records, varied = [(run, self.record(run)) for run in runs], varied_keys(runs)
        rows = [row for run, record in records for row in _rows(run, record)]
        constant = [key for run in runs for key in run.parameters if key not in varied]
        table = _rectangular(rows, [*varied, *HOW_IT_ENDED], ["run", *constant])
        timings = [
            {"run": run.name, "ranks": record.ranks, "seconds": record.seconds} | record.summary.get("timings", {})
            for run, record in records
        ]
        for name, rows in (("table.csv", table), ("timings.csv", _rectangular(timings, ["run"], []))):
            with self._written(name) as path:
                write_rows(path, rows[0], rows)
        with self._written("table.parquet") as path:
            pyarrow.parquet.write_table(pyarrow.Table.from_pylist(table), path)
        with self._written("table.tex") as path:
            write_columns(path, *told_of(table, varied))
        with self._written("versions.json") as path:
            path.write_text(json.dumps(versions(), indent=2) + "\n", encoding="utf-8")
        try:
            with self._written("study.png") as path:
                draw_study(path, table, varied, title)
        except Exception as error:
            return f"study.png: {in_words(error)}; the tables are in {self.path}"
        return ""

    @contextlib.contextmanager
    def _written(self, name: str) -> Iterator[Path]:
        """The path of a new file, which then takes the place of the one with this name; no link is written through."""
        new = (self.path / name).with_stem(f"{Path(name).stem}.part")
        new.unlink(missing_ok=True)
        yield new
        if new.exists():
            new.rename(self.path / name)

    def _open(self) -> None:
        try:
            if self.path.exists() and not self.path.is_dir():
                raise InputError(f"output {self.path}: is a file, not a folder")
            if self.path.is_dir() and any(self.path.iterdir()) and not (self.path / LOCK).is_file():
                raise InputError(f"output {self.path}: is not empty and not the folder of a study; choose another")
            for folder in (self.path / "runs", self.claims):
                if folder.exists() and not folder.is_dir():
                    raise InputError(f"output {folder}: is in the way, as it is not a folder; move it elsewhere")
            (self.path / "runs").mkdir(parents=True, exist_ok=True)
            lock = os.open(self.path / LOCK, os.O_CREAT | os.O_RDWR, 0o666)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # the system releases it when the process dies
            except BlockingIOError:
                os.close(lock)
                raise InputError(f"output {self.path}: another launch of a study is writing into it") from None
            self._lock = lock
            shutil.rmtree(self.claims, ignore_errors=True)
            self.claims.mkdir()
            for left in self.path.glob(f"runs/.*{PARTIAL}"):
                complete(left.with_name(left.name[1 : -len(PARTIAL)]))
        except OSError as error:
            raise InputError(f"output {self.path}: cannot be written ({error.strerror})") from None


def _rows(run: Run, record: Record) -> list[Row]:
    """The rows of a run: its parameters, then its results."""
    summary = record.summary
    first = {"run": run.name, "status": record.status.value, "reason": record.reason, **_plain(run.parameters)}
    results = flattened({key: value for key, value in summary.items() if key not in NOT_RESULTS})
    return [first | _plain(results) | row for row in summary.get("rows", [{}])]


def _plain(values: Row) -> Row:
    """Turn lists into JSON text, so that each cell of a table is one value."""
    return {key: json.dumps(value) if isinstance(value, list) else value for key, value in values.items()}


def _rectangular(rows: list[Row], first: Sequence[str], last: Sequence[str]) -> list[Row]:
    """Give all rows the same columns, with None where a row has no value.

    Args:
        rows: The rows.
        first: The columns that come first.
        last: Those that come last; others are between them, in order of first appearance.
    """
    keys = dict.fromkeys(key for row in rows for key in row)
    between = [key for key in keys if key not in first and key not in last]
    columns = dict.fromkeys([*first, *between, *last])
    return [{key: row.get(key) for key in columns} for row in rows]
