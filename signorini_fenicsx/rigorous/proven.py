"""What a proof gives."""

from dataclasses import dataclass


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
