"""The two ways a run can end badly, and the exit statuses they map to."""

from typing import Any


class InputError(Exception):
    """The user asked for something that cannot be: one clear sentence, exit status 2, nothing written."""


class NumericalFailure(Exception):
    """The computation ended without a solution that satisfies the Signorini conditions: exit status 1.

    Attributes:
        solution: The last state reached, a `solving.solution.Solution` for inspection, or None if there is none.
    """

    def __init__(self, reason: str, solution: Any = None):
        super().__init__(reason)
        self.solution = solution


class WriteFailure(Exception):
    """A library could not write on this rank; the others may never stop waiting for it: exit status 1."""
