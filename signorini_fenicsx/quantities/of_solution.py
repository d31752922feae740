"""Quantities of a solution of any physics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.quantities import diffusion, elasticity
from signorini_fenicsx.quantities.bracket import Quantity
from signorini_fenicsx.quantities.kinds import Kind
from signorini_fenicsx.solving.solved import Solved

QUANTITIES: dict[str, Any] = {"diffusion": diffusion, "elasticity": elasticity}
"""The quantities of the physics that have some: each module has `quantity`, and `check` for what may be asked."""


def quantity(solution: Solved, kind: Kind) -> Quantity:
    """The interval for a quantity, see `Solved.quantity` (collective).

    Raises:
        InputError: If it is not one of this problem.
    """
    check_kind("solution", solution, Solved)
    check_quantities(solution.spaces.domain, (solution.boundary, solution.problem), [kind])
    found: Quantity = QUANTITIES[solution.physics].quantity(solution, kind)
    return found


def check_quantities(domain: Domain, posed: tuple[Any, Any], kinds: Sequence[Kind]) -> None:
    """Refuse what are no quantities of a problem, before it is solved (collective).

    Args:
        domain: The mesh with its parts.
        posed: The parts of each kind of boundary, and the problem sorted by them.
        kinds: The quantities.

    Raises:
        InputError: If one is none of this problem.
    """
    for kind in kinds:
        check_kind("kind", kind, Kind)
        if posed[0].physics not in QUANTITIES:
            raise InputError(f"{posed[0].physics}: no quantities are known")
        QUANTITIES[posed[0].physics].check(domain, posed, kind)
