"""The minimum of a convex quadratic function with terms at nodes, foundations and friction, by an interior point.

It minimises ½x·Kx − b·x + Σ max τ(a·x − g) over low ≤ τ ≤ high, with a small vector a and a number g for each term. A
foundation, a·x ≤ g, has the forces 0 ≤ τ < ∞; friction w|a·x − g| has −w ≤ τ ≤ w; a law whose pressure jumps by w has 0
≤ τ ≤ w. At the minimum Kx + Σ τa = b. With a·x − g = s⁺ − s⁻ and s⁺, s⁻ ≥ 0, the products s⁻(τ − low) and s⁺(high − τ)
are 0 there. The method keeps all of these factors positive and lets the products tend to 0 together (Mehrotra 1992).
Its x is inside of all foundations, and neither directions that are nearly the same, nor more of them than dimensions,
nor bodies that only foundations hold make it slower. Each step solves with K + Σ aaᵀ/compliance.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import LinearSolveFailure

MOST = 60
"""Steps at most. From forces near those of the minimum 5 to 15 are enough."""
ENOUGH = 1e-5
"""The products of all terms add up to at most this share of the minimum at the end,"""
LEAST = 1e-16
"""or to this share of the scale of the minimum, which is rounding."""
HUGE = 1e140
"""Numbers from which a step has failed: their squares are hardly floats."""
BACK = 0.995
"""Share of the way to the nearest bound that a step goes."""
INSIDE = 0.05
"""At the start a force is at least this share of its range off the ends of it."""
TOUCHES = 1e-3
"""At the start a term is taken for touching if its force is more than this share of the largest."""
LOOSE, RUBS = 1e-6, 1e-4
"""Springs at the start, as shares of the unit: of terms that do not touch, and of those with friction."""


class Terms(Protocol):
    """The function, distributed: x is that of the owned unknowns, terms are those of this rank.

    Attributes:
        comm: Communicator.
        load: b.
        constant: What is added to the function, so that its minimum is near 0 where all is well.
        scale: The size of what the function is a difference of.
        bound: g of each term.
        low: The least τ.
        high: The largest τ, ∞ for a foundation.
        unit: A stiffness for each term, of the size of K there.
    """

    comm: MPI.Comm
    load: Array
    constant: float
    scale: float
    bound: Array
    low: Array
    high: Array
    unit: Array

    def times(self, x: Array) -> Array:
        """Kx (collective)."""

    def along(self, x: Array) -> Array:
        """a·x of each term (collective)."""

    def spread(self, forces: Array) -> Array:
        """Σ τa (collective)."""

    def factorise(self, stiffness: Array) -> None:
        """Get ready to solve with K + Σ d aaᵀ, for a d of each term (collective)."""

    def solve(self, load: Array, left: float = 0.0) -> Array:
        """Solve with the matrix that was factorised last; in the energy norm so much may be left (collective)."""

    def pushed(self, x: Array) -> Array:
        """The x inside all foundations that is near this one (collective)."""


def minimise(terms: Terms, forces: Array) -> Array:
    """The x of the minimum (collective).

    Args:
        terms: The function.
        forces: Values of τ near those of the minimum.

    Raises:
        LinearSolveFailure: If the first factorisation fails; where a later one does, the last point is near enough.
    """
    path = _Path(terms, forces)
    for number in range(MOST):
        if path.is_at_end():
            break
        before = path.x
        try:
            path.step()
        except LinearSolveFailure:
            if number == 0:
                raise
            return before
        if not path.is_finite():
            return before
    return path.x


class _Path:
    """The present point: x, τ, s⁻ and s⁺."""

    def __init__(self, terms: Terms, forces: Array):
        """Start with springs in the place of the foundations, a bit off all bounds (collective)."""
        self._terms, self._two = terms, np.isfinite(terms.high)
        one = ~self._two
        touching = one & (forces > TOUCHES * self._largest(forces[one]))
        springs = terms.unit * np.where(self._two, RUBS, np.where(touching, 1.0, LOOSE))
        room = np.where(self._two, terms.high - terms.low, 0.0)
        inner = terms.low + INSIDE * room, terms.low + (1 - INSIDE) * room
        start = np.where(self._two, np.clip(forces, *inner), 0.0)
        pulled = terms.spread(np.where(touching, springs * terms.bound, 0.0) - start)
        terms.factorise(springs)
        self.x = terms.solve(terms.load + pulled)
        off = terms.along(self.x) - terms.bound
        far = self._mean(np.abs(off), touching) or self._largest(np.abs(off)) or self._largest(np.abs(self.x)) or 1.0
        force = self._mean(forces, touching) or self._mean(terms.unit, one) * far
        self._below = np.maximum(-off, 0.0) + far
        self._above = np.where(self._two, np.maximum(off, 0.0) + far, 0.0)
        self._force = np.where(self._two, start, np.maximum(forces, 0.0) + force)
        self._pairs = terms.comm.allreduce(int(len(off) + np.count_nonzero(self._two)))

    def _largest(self, values: Array) -> float:
        return float(self._terms.comm.allreduce(float(np.abs(values).max(initial=0.0)), MPI.MAX))

    def _mean(self, values: Array, where: Mask) -> float:
        total, number = self._terms.comm.allreduce(np.array([values[where].sum(), np.count_nonzero(where)])).tolist()
        return total / number if number > 0 else 0.0

    @property
    def _over(self) -> Array:
        """High − τ; 1 where there is none."""
        return np.where(self._two, self._terms.high - self._force, 1.0)

    @property
    def _under(self) -> Array:
        """τ − low."""
        return self._force - self._terms.low

    def is_at_end(self) -> bool:
        """Whether the products are small, and compute what is left of the equations (collective)."""
        terms = self._terms
        image = terms.times(self.x)
        self._left = image - terms.load + terms.spread(self._force)
        self._off = terms.along(self.x) - terms.bound - self._above + self._below
        sums = [
            (self._over * self._above + self._under * self._below).sum(),
            self.x @ (image / 2 - terms.load),
            (terms.high[self._two] * self._above[self._two] - (terms.low * self._below)[self._two]).sum(),
        ]
        self._products, value, rubbing = terms.comm.allreduce(np.array(sums)).tolist()
        apart = self._largest(self._off) <= LEAST**0.5 * self._largest(self.x)
        lowest = max(ENOUGH * (terms.constant + value + rubbing), LEAST * terms.scale)
        return self._pairs == 0 or not np.isfinite(self._products) or (apart and self._products <= lowest)

    def is_finite(self) -> bool:
        """Whether the squares of all numbers are floats, too (collective)."""
        return self._largest(self.x) < HUGE and self._largest(self._force) < HUGE

    @np.errstate(divide="ignore", invalid="ignore")  # a factor that rounding makes 0 ends the path, see `minimise`
    def step(self) -> None:
        """Predict where the products vanish, then go towards where they all have a smaller value (collective)."""
        over, under = self._over, self._under
        compliance = self._above / over + self._below / under
        self._terms.factorise(1 / compliance)
        wanted = -over * self._above, -under * self._below
        moves = self._moves(compliance, *wanted)
        length = self._longest(*moves)
        mean = self._products / self._pairs
        after = (over - length * moves[1]) * (self._above + length * moves[2])
        after = after + (under + length * moves[1]) * (self._below + length * moves[3])
        ahead = self._terms.comm.allreduce(float(after.sum())) / self._pairs
        aim = (ahead / mean) ** 3 * mean
        moves = self._moves(
            compliance,
            np.where(self._two, wanted[0] + aim + moves[1] * moves[2], 0.0),
            wanted[1] + aim - moves[1] * moves[3],
        )
        length = min(1.0, BACK * self._longest(*moves))
        x, force, above, below = moves
        self.x, self._force = self.x + length * x, self._force + length * force
        self._above, self._below = self._above + length * above, self._below + length * below

    def _moves(self, compliance: Array, above: Array, below: Array) -> tuple[Array, Array, Array, Array]:
        """Newton's changes of x, τ, s⁺ and s⁻ that change the products by so much (collective)."""
        terms, over, under = self._terms, self._over, self._under
        off = self._off - above / over + below / under
        x = terms.solve(-self._left - terms.spread(off / compliance))
        force = (terms.along(x) + off) / compliance
        return x, force, (above + self._above * force) / over, (below - self._below * force) / under

    def _longest(self, _x: Array, force: Array, above: Array, below: Array) -> float:
        """The longest step, up to 1, that leaves all factors ≥ 0 (collective)."""
        longest = 1.0
        pairs = [
            (self._over[self._two], -force[self._two]),
            (self._under, force),
            (self._above[self._two], above[self._two]),
            (self._below, below),
        ]
        for value, change in pairs:
            falls = change < 0
            longest = min(longest, float((value[falls] / -change[falls]).min(initial=1.0)))
        return float(self._terms.comm.allreduce(longest, MPI.MIN))
