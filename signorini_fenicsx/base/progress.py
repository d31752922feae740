"""What the program is doing right now, for whoever shows it; without MPI and without a thread.

Whatever may take seconds is done inside `doing`, which nests, and says by `detail` how far it has come.
"""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

COMPILING = "compiling"
"""Of forms, in the middle of anything."""


@dataclass
class Activity:
    """A part of the work that is under way.

    Attributes:
        name: What.
        details: How far it has come.
    """

    name: str
    details: dict[str, int] = field(default_factory=dict)


class Follower(Protocol):
    """What shows what is going on."""

    def moved(self, under_way: list[Activity], *, only_detail: bool) -> None:
        """Take note of what is under way now, the innermost last; maybe only a detail of that has changed."""

    def ended(self, name: str, seconds: float) -> None:
        """Take note that something took this long, without what was done inside it."""


class _State:
    follower: Follower | None = None
    under_way: list[Activity]
    inside = 0.0


def follow(follower: Follower | None) -> None:
    """Tell a listener what is done in this process from now on; None ends this."""
    _State.follower, _State.under_way, _State.inside = follower, [], 0.0


@contextlib.contextmanager
def doing(name: str) -> Iterator[None]:
    """Tell that something is under way while the context lasts."""
    follower = _State.follower
    if follower is None:
        yield
        return
    began, before = time.perf_counter(), _State.inside
    _State.inside = 0.0
    _State.under_way.append(Activity(name))
    follower.moved(_State.under_way, only_detail=False)
    try:
        yield
    finally:
        seconds = time.perf_counter() - began
        _State.under_way.pop()
        follower.moved(_State.under_way, only_detail=False)
        follower.ended(name, seconds - _State.inside)
        _State.inside = before + seconds


def detail(name: str, value: int) -> None:
    """Tell how far the innermost activity has come."""
    if _State.follower is not None and _State.under_way:
        _State.under_way[-1].details[name] = value
        _State.follower.moved(_State.under_way, only_detail=True)
