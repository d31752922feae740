"""What shows what is under way: a line that changes on a terminal, elsewhere a line for what took long."""

import contextlib
import time
from collections.abc import Iterator

from rich.console import Console

from signorini_fenicsx.base.parallel import is_launched
from signorini_fenicsx.base.progress import COMPILING, Activity

LONG = 2.0
"""Seconds from which on a log mentions something."""
PAUSE = 0.1
"""Seconds between two details on a terminal."""
WORDS = {
    COMPILING: "compiling forms (kept for later runs)",
    "mesh": "making the mesh",
    "assembly": "assembling the equations",
    "prediction": "predicting the contact set",
    "solve": "solving",
    "kkt": "checking the solution",
    "certificate": "bounding the error",
    "proof": "proving the bound",
    "output": "writing the results",
}
"""Of the phases; other activities are called what they are."""


class Live:
    """A `progress.Follower` on rank 0's console.

    Attributes:
        alive: Whether it shows a line that changes.
        verbose: Whether it mentions everything.
    """

    def __init__(self, console: Console, *, verbose: bool = False):
        """Show it there."""
        self._console, self.verbose = console, verbose
        # Not in a log with colours. Ranks of Open MPI see a terminal even if mpirun writes into a log.
        self.alive = console.is_interactive and console.file.isatty() and not is_launched()
        self._text, self._drawn = "", 0.0
        self._took: dict[str, float] = {}
        self._in_table = False

    def moved(self, under_way: list[Activity], *, only_detail: bool) -> None:
        """Show it on a terminal."""
        if not self.alive:
            return
        self._text = " · ".join(map(_described, under_way)) + " …" * bool(under_way)
        if not only_detail or time.monotonic() - self._drawn >= PAUSE:
            self._draw(self._text)

    def ended(self, name: str, seconds: float) -> None:
        """Mention in a log what took long; what was compiled meanwhile before it, and nothing inside a table."""
        if self.alive and not self.verbose:
            return
        self._took[name] = self._took.get(name, 0.0) + seconds
        if name != COMPILING and not self._in_table:  # what is compiled takes many short times
            self._mention()

    def table(self, *, goes_on: bool) -> None:
        """Take note that the next line is one of a table, or that it is not."""
        if self._in_table and not goes_on:
            self._mention()
        self._in_table = goes_on

    def _mention(self) -> None:
        for name in sorted(self._took, key=COMPILING.__ne__):
            if (seconds := self._took[name]) > LONG or self.verbose:
                with self.above():
                    self._console.print(f"{WORDS.get(name, name)} took {seconds:.{1 + self.verbose}f} s", markup=False)
        self._took = {}

    @contextlib.contextmanager
    def above(self) -> Iterator[None]:
        """Make room for a line that stays."""
        if self._text:
            self._draw("")
        yield
        if self._text:
            self._draw(self._text)

    def _draw(self, text: str) -> None:
        """Replace the line, and go back to where it begins: whatever is printed next covers it."""
        self._console.file.write(f"\r\x1b[2K{text[: self._console.width - 1]}\r")
        self._console.file.flush()
        self._drawn = time.monotonic()


def _described(activity: Activity) -> str:
    details = ", ".join(f"{name} {value}" for name, value in activity.details.items())
    words = WORDS.get(activity.name, activity.name)
    return f"{words}: {details}" if details else words
