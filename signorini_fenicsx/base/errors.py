"""Errors of a run, and their exit statuses."""

import contextlib
from collections.abc import Iterator
from typing import Any


class InOneSentence(Exception):
    """An error whose message says all: a notebook shows it without a traceback."""

    def _render_traceback_(self) -> list[str]:
        """What IPython shows in the place of a traceback."""
        return [f"{type(self).__name__}: {self}"]


class InputError(InOneSentence):
    """The user asked for something impossible: one clear sentence, exit status 2, nothing is written."""


class NumericalFailure(InOneSentence):
    """The computation ended without a solution that satisfies the Signorini conditions: exit status 1.

    Attributes:
        solution: The last state as a `solving.solution.Solution`, for inspection; None if there is none.
    """

    def __init__(self, reason: str, solution: Any = None):
        super().__init__(reason)
        self.solution = solution


class WriteFailure(Exception):
    """A library could not write on this rank, and the other ranks may wait for it forever: exit status 1."""


class LinearSolveFailure(NumericalFailure):
    """A Krylov or direct solver of PETSc gave up."""


@contextlib.contextmanager
def holding(solution: Any) -> Iterator[None]:
    """A numerical failure in this context holds the solution, so that a run whose bound alone fails does not lose it.

    Args:
        solution: What is known, see `NumericalFailure.solution`.

    Raises:
        NumericalFailure: The failure.
    """
    try:
        yield
    except NumericalFailure as failure:
        failure.solution = solution
        raise
