"""A third physics, a bed of springs: k u = f in each cell, but u ≥ 0 in the cells behind Γ.

In time springs settle: each step adds f at its time to what bears on them.
"""
# ruff: noqa: D102 - `Physics` says what its attributes are

from functools import cached_property
from typing import Any

from signorini_fenicsx.solving.physics import Physics


class Springs(Physics):
    """A bed of springs; there is no bound of its errors, and no proof."""

    @cached_property
    def problem(self) -> Any:
        from springs.solving import Bed

        return Bed

    @cached_property
    def system(self) -> Any:
        from springs.solving import System

        return System

    @cached_property
    def keeping(self) -> Any:
        from springs.kept import KEEPING

        return KEEPING

    @cached_property
    def case(self) -> Any:
        from springs.case import BedCase

        return BedCase

    @cached_property
    def quantities(self) -> Any:
        from springs.quantities import QUANTITIES

        return QUANTITIES

    @cached_property
    def pictures(self) -> Any:
        from springs.pictures import PICTURES

        return PICTURES
