"""Makers of random problems for `random_runs.py`, each with what judges its solution."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Found:
    """What came of a problem.

    Attributes:
        words: A line about it.
        counts: What it is counted as.
        numbers: Numbers of which the least, the median and the largest count, by name.
        wrong: Whether something is wrong.
        shown: Whether its line is shown.
    """

    words: str
    counts: Sequence[str] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    wrong: bool = False
    shown: bool = True
