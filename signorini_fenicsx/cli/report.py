"""Output of commands: text for people or one JSON object for programs; only rank 0 prints."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mpi4py import MPI
from rich.console import Console

from signorini_fenicsx.base import progress
from signorini_fenicsx.base.text import json_text, printable_lines
from signorini_fenicsx.cli.live import Live


class Report:
    """The output of one command; subclasses add the texts of the commands.

    Attributes:
        console: Where it is printed.
        follows: Whether it shows what is being done.
    """

    follows = True

    def __init__(self, *, quiet: bool = False, verbose: bool = False, as_json: bool = False):
        """Decide what is printed.

        Args:
            quiet: Print no text.
            verbose: Print all rows of tables, and how long everything took.
            as_json: Print the JSON object and no text.
        """
        self.console = Console(highlight=False, soft_wrap=True, emoji=False, quiet=quiet or as_json)
        self._as_json = as_json
        self._live = Live(self.console, verbose=verbose)
        self._columns = ""
        if self.follows and not self.console.quiet and MPI.COMM_WORLD.rank == 0:
            progress.follow(self._live)

    def title(self, text: str) -> None:
        """Print a title."""
        with self._live.above():
            self.console.print(printable_lines(text), style="bold", markup=False)

    def line(self, text: str) -> None:
        """Print a line."""
        self._live.table(goes_on=False)
        self._print(text)

    def table(self, columns: str) -> None:
        """Name the columns of a table; they are printed with its first row, below what took long before it."""
        self._columns = columns

    def row(self, text: str) -> None:
        """Print a row of a table; what takes long meanwhile is mentioned below the table."""
        if self._columns:
            self.line(self._columns)
            self._columns = ""
        self._live.table(goes_on=True)
        self._print(text)

    def _print(self, text: str) -> None:
        with self._live.above():
            self.console.print(printable_lines(text), markup=False)

    def entry(self, name: str, text: str, *, width: int = 10) -> None:
        """Print a name, in a column of this width, and a text."""
        self.line(f"{name:<{width}} {text}")

    def entries(self, texts: Mapping[str, str], *, width: int = 10) -> None:
        """Print names and their texts."""
        for name, text in texts.items():
            self.entry(name, text, width=width)

    def results(self, folder: Path) -> None:
        """Print where the results are."""
        self.entry("results", str(folder))

    def json(self, values: Mapping[str, Any]) -> None:
        """Print the JSON object if `as_json` is set."""
        if self._as_json:
            sys.stdout.write(json_text(values) + "\n")

    def published(self, folder: Path) -> None:
        """Print where the results are, or their `summary.json` as the JSON object if `as_json` is set."""
        self.results(folder)
        if self._as_json and MPI.COMM_WORLD.rank == 0:
            sys.stdout.write((folder / "summary.json").read_text(encoding="utf-8"))
