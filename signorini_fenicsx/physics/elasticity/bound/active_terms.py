"""Nearly the minimum of `interior_point` in few solves, from forces near those of the minimum.

The forces of the stress tell well which foundations are touched and where friction holds. These terms become stiff
springs that pull with the forces known; at the others the force is at an end of its range. The next sets follow from
the solution, as in a primal-dual active set method, which needs a solve for each. What is found is admissible but for
rounding, so it serves a bound whatever is left to gain.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.physics.elasticity.bound.interior_point import TOUCHES, Terms

ROUNDS = 6
"""Solves at most."""
ENOUGH = 3e-4
"""The minimum is found if other sets would change it by about this share of itself at most: what each term that should
change stores in a spring of the unit. That is less than it gains by a factor of about ten."""
ACCURATE = 0.003
"""Share of the root of twice the minimum that a solve may leave in the energy norm."""
STIFF = 100.0
"""Springs of terms that hold, as shares of the unit."""


def nearly_minimal(terms: Terms, forces: Array, x: Array) -> Array | None:
    """An x near the minimum, inside all foundations; None if the sets go on changing it (collective).

    Args:
        terms: The function.
        forces: Values of τ near those of the minimum.
        x: Where to begin.

    Raises:
        LinearSolveFailure: If a solve fails.
    """
    comm, foundations = terms.comm, np.isinf(terms.high)
    largest = comm.allreduce(float(np.abs(forces[foundations]).max(initial=0.0)), MPI.MAX)
    margin = TOUCHES * np.where(foundations, largest, terms.high - terms.low)
    held = (forces > terms.low + margin) & (forces < terms.high - margin)
    force = np.where(held, forces, np.where(forces > terms.low + margin, terms.high, terms.low))
    best, changed = terms.pushed(x), True
    least = _value(terms, best)
    for _ in range(ROUNDS):
        springs = np.where(held, STIFF * terms.unit, 0.0)
        if changed:
            terms.factorise(springs)
        pull = force + springs * (terms.along(x) - terms.bound)
        allowed = ACCURATE * np.sqrt(2 * max(least, 0.0))
        x = x + terms.solve(terms.load - terms.times(x) - terms.spread(pull), allowed)
        off = terms.along(x) - terms.bound
        reached, inside = force + springs * off, terms.pushed(x)
        value = _value(terms, inside)
        if not np.isfinite(value):
            return None
        if value < least:
            least, best = value, inside
        beyond = reached - np.clip(reached, terms.low, terms.high)
        past = np.where(force <= terms.low, np.maximum(off, 0.0), np.minimum(off, 0.0))
        gain = np.where(held, beyond**2 / terms.unit, terms.unit * past**2)
        gained = comm.allreduce(float(gain.sum())) / 2 <= ENOUGH * least
        if gained and allowed <= 2 * ACCURATE * np.sqrt(2 * max(least, 0.0)):
            return best
        following = np.where(held, beyond == 0, past != 0)
        changed = comm.allreduce(bool((following != held).any()), MPI.LOR)
        force, held = np.where(following == held, force, np.clip(reached, terms.low, terms.high)), following
    return None


def _value(terms: Terms, x: Array) -> float:
    """The function, without foundations (collective)."""
    off, two = terms.along(x) - terms.bound, np.isfinite(terms.high)
    rubbed = np.maximum(terms.high[two] * off[two], terms.low[two] * off[two]).sum()
    return terms.constant + float(terms.comm.allreduce(float(x @ (terms.times(x) / 2 - terms.load) + rubbed)))
