"""Residuals that judge a solution: numbers free of units, the same for every physics."""

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.tolerances import KKT


class Residuals:
    """Residuals of a discrete problem, free of scale: the fields of a dataclass."""

    def violation(self) -> str | None:
        """The residuals above the tolerance in words, or None."""
        bad = [f"{name} {value:.1e}" for name, value in vars(self).items() if not value <= KKT]
        return f"KKT residuals above {KKT:g}: {', '.join(bad)}" if bad else None


def relative(sizes: Array, scales: Array) -> float:
    """The largest of some sizes, each as a share of its scale: 0 if it is 0, and ∞ if only its scale is."""
    return float(np.where(sizes == 0, 0.0, sizes / scales).max())
