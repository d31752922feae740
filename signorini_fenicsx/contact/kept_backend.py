"""The backend of the last solve of a system, which serves derivatives and, where it can, the next solve."""

from collections.abc import Callable
from typing import Any
from weakref import ref

from signorini_fenicsx.contact.backend import Backend, Renewable
from signorini_fenicsx.contact.history import Outcome


class KeptBackend:
    """What makes the backend of each solve, or goes on with that of the last one.

    Attributes:
        present: The last backend; None before the first and after a solve that failed.
    """

    def __init__(self) -> None:
        self.present: Any = None
        self._made_for: object = None
        self._solved: tuple[ref[Outcome], object] | None = None

    def take(self, wanted: object, make: Callable[[Any, Any], Any], spaces: Any, data: Any) -> Backend[Any]:
        """The last backend with other data if it was made for the same wish and can take these, or a new one.

        Collective.

        Args:
            wanted: The wish: a backend that was made for another one is not taken.
            make: Makes a new one from the spaces and the data.
            spaces: The discrete spaces.
            data: The data on them.
        """
        kept, self.present = self.present, None
        if not (wanted == self._made_for and isinstance(kept, Renewable) and kept.renew(data)):
            kept = None  # its memory first
            kept = make(spaces, data)
        self.present, self._made_for = kept, wanted
        return self.present

    def solved(self, outcome: Outcome, data: object) -> None:
        """Remember what was solved last."""
        self._solved = ref(outcome), data

    def of[B](self, outcome: Outcome, kind: type[B]) -> B | None:
        """The backend that is set up for the problem with this outcome; None if there is none, or it is another."""
        last, data = self._solved or (None, None)
        if last is None or last() is not outcome or not isinstance(self.present, kind):
            return None
        return self.present if getattr(self.present, "data", None) is data else None

    def forget(self) -> None:
        """Drop the backend."""
        self.present = None
