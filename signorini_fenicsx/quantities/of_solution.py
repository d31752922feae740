"""Quantities of a solution of any physics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.quantities import diffusion
from signorini_fenicsx.quantities.bracket import Quantity
from signorini_fenicsx.quantities.kinds import Kind
from signorini_fenicsx.solving.solved import Solved

QUANTITIES: dict[str, Callable[[Any, Any], Quantity]] = {"diffusion": diffusion.quantity}
"""The quantities of the physics that have some."""


def quantity(solution: Solved, kind: Kind) -> Quantity:
    """The interval for a quantity, see `Solved.quantity` (collective).

    Raises:
        InputError: If it is not one of this problem.
    """
    check_kind("solution", solution, Solved)
    check_kind("kind", kind, Kind)
    if solution.physics not in QUANTITIES:
        raise InputError(f"{solution.physics}: no quantities are known")
    return QUANTITIES[solution.physics](solution, kind)
