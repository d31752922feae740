"""Sets that cannot cycle: each lowers the energy, by Newton steps that are projected onto the laws.

On the sites the problem is to minimise E(p) = ½ (p, Sp) + (c, p) + Σ |e| φ(p), where the flux is Sp + c with a
symmetric S and −φ' is the law, which falls. A site on a slope of its law moves along it, and one on a vertical segment
stays, if its flux is within the segment. The solution under these conditions is the target of Newton's step. A site
that comes to the end of its segment on the way stops there. The step is halved until E falls by enough (Bertsekas, SIAM
J. Control Optim. 20, 1982). E along the way comes from p and the flux at its ends, because the flux is affine in p.

Some sets may hold the body in no way. So all sites are anchored by weak springs, see `Anchored`: E is strictly convex
then. The minimum with springs is a step of the proximal point method, and from where it ends the springs pull anew.
"""

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.contact.backend import Anchored, Pairs
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.contact.conditions import Condition, SiteConditions

ENOUGH = 1e-4
"""Share of the fall that the slope of E promises, with which a step is taken."""
HALVINGS = 20
"""So often a step is halved at most; then the fall is rounding."""


class Descent[I: Pairs]:
    """The way down from all sites in contact.

    Attributes:
        conditions: The next conditions.
    """

    def __init__(self, backend: Anchored[I], law: Chains):
        """Begin at the references of the laws, where weak springs then pull to (collective)."""
        self._backend, self._law = backend, law
        low, high, _, _ = law.extent()
        self._reach(np.clip(np.zeros(len(low)), low, high))
        backend.anchor()
        self._begins = True

    def _reach(self, p: Array, flux: Array | None = None) -> None:
        """Be at p, and find the flux there if it is not known (collective)."""
        law = self._law
        if flux is None:
            flux = self._backend.solve(SiteConditions(np.full(len(p), Condition.ZERO_TRACE, np.int8), value=p)).flux
        self._p, self._flux = p, flux
        left, right = ((each(law.p, p[:, None])).sum(axis=1) for each in (np.less, np.less_equal))
        corner = np.arange(law.corners)
        at = (corner >= left[:, None]) & (corner < right[:, None])
        self._segment: Indices = left + (at & (flux[:, None] < law.flux)).sum(axis=1)
        self.conditions = law.conditions(self._segment)

    def follow(self, iterate: I) -> SiteConditions:
        """Step towards the solution under the conditions, or as far as E falls; the next conditions (collective)."""
        if self._begins:
            self._begins = False
            return self.conditions
        segment, (p, flux), share = self._segment, (self._p, self._flux), 1.0
        low, high = (self._law.ends[0][np.arange(len(p)), segment + end] for end in (0, 1))
        at_start = self._slope(segment, p, flux)
        for _ in range(HALVINGS):
            wanted = p + share * (iterate.p - p)
            reached = np.clip(wanted, low, high)
            stopped = self._sum(reached != wanted) > 0
            self._reach(reached, None if stopped else flux + share * (iterate.flux - flux))
            moved = self._backend.measure * (reached - p)
            fall = self._sum((at_start + self._slope(segment, self._p, self._flux)) / 2 * moved)
            if not stopped or fall <= ENOUGH * self._sum(at_start * moved):
                break
            share /= 2
        return self.conditions

    def goes_on(self, iterate: I) -> bool:
        """Whether the springs still pull at the minimum; then they pull to it from now on (collective)."""
        pulled = self._backend.anchor()
        if pulled:
            low, high, _, _ = self._law.extent()
            self._reach(np.clip(iterate.p, low, high))
        self._begins = pulled
        return pulled

    def _slope(self, segment: Indices, p: Array, flux: Array) -> Array:
        """The derivative of E by each p, over |e|; 0 on vertical segments."""
        slope, value = (each[np.arange(len(p)), segment] for each in (self._law.slope, self._law.value))
        vertical = np.isinf(slope)
        return np.where(vertical, 0.0, flux - value + np.where(vertical, 0.0, slope) * p)

    def _sum(self, values: Array | Mask) -> float:
        return float(self._backend.comm.allreduce(float(values.sum())))
