"""What a proof gives."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dolfinx import fem


@dataclass(frozen=True)
class Proven:
    """Upper bounds, with the names of `Certificate`.

    Attributes:
        bound: Bound of ‖σ − σ_h‖ and of |∇(v − u)|, in elasticity |v − u|.
        sigma_bound: Bound of ‖σ − σ_h‖.
        gap: Bound of the gap.
        oscillation: Bound of the effect of f, g_N and q_S minus their means.
        remainder: Bound of ‖y − σ_h‖.
    """

    bound: float
    sigma_bound: float
    gap: float
    oscillation: float
    remainder: float


@dataclass(frozen=True)
class Proofs:
    """The proofs of a physics.

    Attributes:
        most: Largest number of cells, of which enclosures take 4 to 5 GB in space, 1 GB in the plane.
        prepared: Gives the proof for a solution and the v of its certificate, to be run on rank 0 (collective). Raises
            InputError if there is no theorem for the problem.
    """

    most: int
    prepared: Callable[[Any, fem.Function], Callable[[], Proven | None]]
