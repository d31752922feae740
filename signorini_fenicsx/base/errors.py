"""Errors of a run, and their exit statuses."""

from typing import Any


class InputError(Exception):
    """The user asked for something impossible: one clear sentence, exit status 2, nothing is written."""


class NumericalFailure(Exception):
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
