"""Residuals that judge a solution: numbers free of units, the same for every physics."""

from collections.abc import Sequence

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.tolerances import KKT
from signorini_fenicsx.contact.chains import Chains


class Residuals:
    """Residuals of a discrete problem, free of scale: the fields of a dataclass."""

    def violation(self) -> str | None:
        """The residuals above the tolerance in words, or None."""
        bad = [f"{name} {value:.1e}" for name, value in vars(self).items() if not value <= KKT]
        return f"KKT residuals above {KKT:g}: {', '.join(bad)}" if bad else None


def squares_off(law: Chains, pair: Sequence[Array], unit: Array, measure: Array, *scales: Array | float) -> Array:
    """Sums over sites of the squares of what `Chains.distances` says, as fluxes, shape (3, scales).

    Args:
        law: The law of each site.
        pair: p and σ·n.
        unit: One unit of p is so many of σ·n.
        measure: The weight of each site.
        scales: What the fluxes are divided by, once by each.
    """
    off, *others = law.distances(pair[0], pair[1], unit)
    return np.array([[measure @ (flux / scale) ** 2 for scale in scales] for flux in (unit * off, *others)])


def relative(sizes: Array, scales: Array) -> float:
    """The largest of some sizes, each as a share of its scale: 0 if it is 0, and ∞ if only its scale is."""
    return float(np.where(sizes == 0, 0.0, sizes / scales).max())
