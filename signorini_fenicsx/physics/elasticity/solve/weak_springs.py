"""Weak springs at the sites, where the sets on the way to a solution are too small to hold the body."""

from dataclasses import dataclass

import numpy as np

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.contact.chains import Condition, SiteConditions

SPRING = 1e-6
"""Share of a site's diagonal entry that is its spring."""


@dataclass(frozen=True)
class WeakSprings:
    """Weak springs on free sites where a motion of the body is free, or on all sites for `contact.loop.Descent`.

    Attributes:
        stiffness: That of each site.
        anchor: p that they pull to, under all conditions; None for 0, if a motion is free.
    """

    stiffness: Array
    anchor: Array | None = None

    def under(self, conditions: SiteConditions, *, loose: bool) -> Mask:
        """The sites that they move; loose is whether a motion is free."""
        if self.anchor is not None:
            return conditions.kind != Condition.ZERO_TRACE
        return loose & (conditions.kind == Condition.NO_FLUX)

    def pull(self, conditions: SiteConditions, p: Array | float) -> Array:
        """The forces along p to the anchor at sites that are not held."""
        if self.anchor is None:
            return np.zeros(len(self.stiffness))
        return np.where(self.under(conditions, loose=True), self.stiffness * (self.anchor - p), 0.0)

    def on_held(self, conditions: SiteConditions, p: Array) -> Array:
        """What they take of the forces at sites that are held."""
        if self.anchor is None:
            return np.zeros(len(self.stiffness))
        return np.where(conditions.kind == Condition.ZERO_TRACE, self.stiffness * (p - self.anchor), 0.0)
