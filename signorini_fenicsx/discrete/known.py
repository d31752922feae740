"""Keeps what was made of data that do not change from one problem to the next."""

from collections.abc import Callable
from typing import Any

from signorini_fenicsx.discrete.given import is_fixed


class Known:
    """The last result for each name, and the data of which it was made.

    Data that are functions or UFL may change their values and stay equal, so nothing made of them is kept.
    """

    def __init__(self) -> None:
        self._found: dict[str, tuple[Any, Any]] = {}

    def get[T](self, name: str, given: Any, make: Callable[[], T]) -> T:
        """What `make` gives for these data, or what it gave if they are the same; collective if `make` is."""
        if name in self._found and is_fixed(given):
            before, result = self._found[name]
            if is_fixed(before) and before == given:
                return result
        result = make()
        self._found[name] = given, result
        return result
