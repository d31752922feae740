"""A third physics, a bed of springs: k u = f in each cell, but u ≥ 0 in the cells behind Γ."""

from functools import cached_property
from typing import Any

from signorini_fenicsx.solving.physics import Physics


class Springs(Physics):
    """What the program asks of a bed of springs; there is no bound of its errors, and there are no case files."""

    @cached_property
    def problem(self) -> Any:
        """The problem."""
        from springs.solving import Bed

        return Bed

    @cached_property
    def system(self) -> Any:
        """The system."""
        from springs.solving import System

        return System

    @cached_property
    def keeping(self) -> Any:
        """How beds are kept in files."""
        from springs.kept import KEEPING

        return KEEPING
