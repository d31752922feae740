"""Residuals that judge a solution: numbers free of units, the same for every physics."""

from signorini_fenicsx.base.tolerances import KKT


class Residuals:
    """Residuals of a discrete problem, free of scale: the fields of a dataclass."""

    def violation(self) -> str | None:
        """Those above the tolerance in words, or None."""
        bad = [f"{name} {value:.1e}" for name, value in vars(self).items() if not value <= KKT]
        return f"KKT residuals above {KKT:g}: {', '.join(bad)}" if bad else None
