"""Errors of a run, and their exit statuses.

*Arguments from Python that are of the wrong kind*: they are refused in one sentence.
"""

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from numbers import Real
from types import NoneType
from typing import Any

EXIT_FAILED, EXIT_BAD_INPUT, EXIT_LATER = 1, 2, 3


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
        solution: The last state as a `solution.Solution`, for inspection; None if there is none.
    """

    def __init__(self, reason: str, solution: Any = None):
        super().__init__(reason)
        self.solution = solution


class LaterFailure(NumericalFailure):
    """The problem is solved and its solution is kept; something that came after it failed: exit status 3.

    Attributes:
        solution: The solution.
        certificate: Its error bound; None if that is not known.
        state: The last state of what failed, such as the solve on the next mesh of `adapt`; None if it left none.
    """

    def __init__(self, reason: str, solution: Any = None, certificate: Any = None, state: Any = None):
        super().__init__(reason, solution)
        self.certificate, self.state = certificate, state


@contextlib.contextmanager
def telling(place: object) -> Iterator[None]:
    """Begin with a place what is refused in this context."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{place}: {error}") from None


@contextlib.contextmanager
def reading(place: object) -> Iterator[None]:
    """Refuse files that cannot be read in this context, or what is in them, in a sentence that begins with a place."""
    try:
        with telling(place):
            yield
    except OSError as error:
        raise InputError(f"{place}: {error.strerror or error}") from None


class WriteFailure(Exception):
    """A library could not write on this rank, and the other ranks may wait for it forever."""


def in_words(error: BaseException) -> str:
    """An error in one sentence; with its type, where its words were not written for users."""
    if isinstance(error, OSError):
        return f"{error.filename or 'file system'}: {error.strerror or error}"
    return str(error) if isinstance(error, InOneSentence | WriteFailure) else f"{type(error).__name__}: {error}"


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


WORDS = {str: "string", Real: "number", int: "whole number", Mapping: "dict", NoneType: "None"}
"""What classes are called; others have their own name, or that in their `WORD`."""


def check_kind(name: str, value: object, *kinds: type, hint: str = "") -> None:
    """Refuse a value of another class.

    Args:
        name: Name of the argument.
        value: What was given.
        kinds: The classes that are right.
        hint: What the user may have meant.

    Raises:
        InputError: If the value is of none of them.
    """
    if not isinstance(value, kinds):
        right = " or ".join(_word(kind) for kind in kinds)
        article = "an" if right[0] in "AEIOUaeiou" else "a"
        raise InputError(f"{name}: must be {article} {right}, not {_word(type(value))}{hint}")


def check_names(name: str, value: object) -> None:
    """Refuse what is no list of names.

    Raises:
        InputError: If it is a string or no list.
    """
    if isinstance(value, str):
        raise InputError(f"{name}: must be a list of names, such as ['{value}']")
    if not isinstance(value, Iterable):
        raise InputError(f"{name}: must be a list of names, such as ['bottom'], not {_word(type(value))}")


def names_of(name: str, value: object) -> tuple[str, ...]:
    """Names that were given as one or as a list.

    Raises:
        InputError: If they are neither.
    """
    if isinstance(value, str):
        return (value,)
    check_names(name, value)
    assert isinstance(value, Iterable)
    return tuple(value)


def _word(kind: type) -> str:
    return WORDS.get(kind) or str(vars(kind).get("WORD", kind.__name__))
