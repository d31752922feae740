"""What commands print: words for people or one JSON object for programs; only rank 0's are seen."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mpi4py import MPI
from rich.console import Console

from signorini_fenicsx.base import progress
from signorini_fenicsx.base.text import json_text
from signorini_fenicsx.cli.live import Live


class Report:
    """What one command prints; those of the commands add the words.

    Attributes:
        console: Where.
        follows: Whether it shows what is under way.
    """

    follows = True

    def __init__(self, *, quiet: bool = False, as_json: bool = False):
        """Decide what is printed.

        Args:
            quiet: No words.
            as_json: The JSON object, and no words either.
        """
        self.console = Console(highlight=False, soft_wrap=True, emoji=False, quiet=quiet or as_json)
        self._as_json = as_json
        self._live = Live(self.console)
        if self.follows and not self.console.quiet and MPI.COMM_WORLD.rank == 0:
            progress.follow(self._live)

    def title(self, text: str) -> None:
        """Print what the output is about."""
        with self._live.above():
            self.console.print(text, style="bold", markup=False)

    def line(self, text: str) -> None:
        """Print a line."""
        with self._live.above():
            self.console.print(text, markup=False)

    def entry(self, name: str, text: str, *, width: int = 10) -> None:
        """Print a text behind its name, for which there is a column of this width."""
        self.line(f"{name:<{width}} {text}")

    def entries(self, texts: Mapping[str, str], *, width: int = 10) -> None:
        """Print texts behind their names."""
        for name, text in texts.items():
            self.entry(name, text, width=width)

    def results(self, folder: Path) -> None:
        """Say where the results are."""
        self.entry("results", str(folder))

    def json(self, values: Mapping[str, Any]) -> None:
        """Print the JSON object, where it is asked for."""
        if self._as_json:
            sys.stdout.write(json_text(values) + "\n")

    def summary(self, folder: Path) -> None:
        """Print the `summary.json` of a results folder as the JSON object, where it is asked for (rank 0)."""
        if self._as_json and MPI.COMM_WORLD.rank == 0:
            sys.stdout.write((folder / "summary.json").read_text(encoding="utf-8"))
