"""Nearly the minimum of a convex quadratic function with terms at nodes, foundations and friction, in few solves.

The function is ½x·Kx − b·x + Σ max τ·(Ax − g) over forces τ that are no longer than w, and not negative where a term is
one-sided; a small matrix A and a vector g belong to each term. A foundation, a·x ≤ g, is one-sided with w = ∞; a law
whose pressure jumps by w is one-sided; friction w|Ax − g| is not, and has two components in space. A term may give way,
as friction on springs does: then it is max τ·(Ax − g) − ½c|τ|² with its compliance c.

The forces of the stress tell well which foundations are touched, and with the slip of the solution where friction
holds. These terms become stiff springs that pull with the forces known; at the others the force is at an end of its
range, in space along the slip d, with the derivative of w d/|d| across it. The next sets follow from the solution, as
in a primal-dual active set method (Hüeber, Stadler, Wohlmuth 2008), which needs a solve for each. What is found is
admissible but for rounding, so it serves a bound whatever is left to gain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import LinearSolveFailure
from signorini_fenicsx.physics.elasticity.discrete.friction import shortened

ROUNDS = 12
"""Solves at most; one to three are enough but for a few problems."""
ENOUGH = 5e-4
"""The minimum is found if other sets would change it by about this share of itself at most: what each term that should
change stores in a spring of the unit. That is less than it gains by a factor of about ten,"""
IDLE = 0.01
"""Sets of terms on pieces go on changing: two solves one after the other that gain less than this share are enough.
One more with the same springs and the forces that they have reached leaves less of what they give way."""
LEAST = 1e-16
"""or by this share of the scale of the minimum, which is rounding."""
ACCURATE = 0.003
"""Share of the root of twice the minimum that a solve may leave in the energy norm."""
STIFF = 1000.0
"""Springs of terms that hold, as shares of the unit; no spring is stiffer."""
TOUCHES = 1e-3
"""At the start a one-sided term is taken for active if its force is more than this share of the largest."""
AHEAD = 0.3
"""At the start friction slips where its force would be too large if it grew with the slip by this share of the unit."""
FARTHER = 10.0
"""What begins to slip goes about so much farther than what it has too much of a force would move the unit."""


class Terms(Protocol):
    """The function, distributed: x is that of the owned unknowns, terms are those of this rank.

    Attributes:
        comm: Communicator.
        load: b.
        constant: What is added to the function, so that its minimum is near 0 where all is well.
        scale: The size of what the function is a difference of.
        bound: g of each term, shape (terms, components).
        most: w, ∞ for a foundation.
        one_sided: Whether no component of a force is negative.
        unit: A stiffness for each term, of the size of K there, shared by those with friction at the same node.
        gives: c of each term, 0 where it does not give way.
        on_pieces: Which terms are on pieces of facets: they are more than can be active, so that a one-sided one is
            taken for active at the start only if its force is positive where it grows by the unit with what is passed.
        locks: By how much the volume makes K stiffer than shear does.
    """

    comm: MPI.Comm
    load: Array
    constant: float
    scale: float
    bound: Array
    most: Array
    one_sided: Mask
    unit: Array
    gives: Array
    on_pieces: Mask
    locks: float

    def times(self, x: Array) -> Array:
        """Kx (collective)."""

    def along(self, x: Array) -> Array:
        """Ax of each term (collective)."""

    def spread(self, forces: Array) -> Array:
        """Σ Aᵀτ (collective)."""

    def factorise(self, stiffness: Array) -> None:
        """Get ready to solve with K + Σ AᵀDA, for a matrix D of each term (collective)."""

    def solve(self, load: Array, left: float = 0.0) -> Array:
        """Solve with the matrix that was factorised last; in the energy norm so much may be left (collective)."""

    def pushed(self, x: Array) -> Array:
        """The x inside all foundations that is near this one (collective)."""


def nearly_minimal(terms: Terms, forces: Array, x: Array) -> Array:
    """An x near the minimum, inside all foundations; the best one seen if the sets go on changing it (collective).

    Args:
        terms: The function.
        forces: Values of τ near those of the minimum, shape (terms, components).
        x: Where to begin.

    Raises:
        LinearSolveFailure: If the first solve fails; where a later one does, the best x so far is near enough.
    """
    comm, off = terms.comm, terms.along(x) - terms.bound
    sets, changed, precise, best = _Taken.of(terms, forces, off), True, False, terms.pushed(x)
    least, idle, pieces = _value(terms, best), 0, comm.allreduce(bool(terms.on_pieces.any()), MPI.LOR)
    for number in range(ROUNDS):
        if changed:
            springs = sets.springs(terms)
            terms.factorise(springs)
        allowed = ACCURATE * np.sqrt(2 * max(least, 0.0))
        pull = sets.pull(terms, springs, off)
        try:
            x = x + terms.solve(terms.load - terms.times(x) - terms.spread(pull), allowed)
        except LinearSolveFailure:
            if number == 0:
                raise
            break
        off, inside = terms.along(x) - terms.bound, terms.pushed(x)
        value = _value(terms, inside)
        if not np.isfinite(value):
            break
        idle = idle + 1 if pieces and value > (1 - IDLE) * least else 0
        if value < least:
            least, best = value, inside
        reached = sets.pull(terms, springs, off)
        after, gain = sets.after(terms, reached, off)
        enough = max(ENOUGH * least, LEAST * terms.scale)
        if idle > 1 or precise or (gain <= enough and allowed <= 2 * ACCURATE * np.sqrt(2 * max(least, 0.0))):
            if precise or not pieces:
                break
            sets, changed, precise = replace(sets, force=reached), False, True  # springs leave less
            continue
        slips = off.shape[1] > 1 and bool((~after.held & ~terms.one_sided).any())
        changed = comm.allreduce(slips or bool((after.held != sets.held).any()), MPI.LOR)
        sets = after
    return best


@dataclass(frozen=True)
class _Taken:
    """What the terms are taken for in a solve.

    Attributes:
        force: τ at the springs' rest, shape (terms, components).
        held: Whether a term holds.
        length: |Ax − g| where friction slips.
    """

    force: Array
    held: Mask
    length: Array

    @classmethod
    def of(cls, terms: Terms, forces: Array, off: Array) -> _Taken:
        """The sets of these forces and this Ax − g (collective)."""
        most, rubs, foundations = terms.most, ~terms.one_sided, np.isinf(terms.most)
        passed = np.where(terms.on_pieces, terms.unit, 0.0) * off[:, 0]
        beyond = off - terms.gives[:, None] * forces
        largest = terms.comm.allreduce(float(np.abs(forces[foundations]).max(initial=0.0)), MPI.MAX)
        margin = TOUCHES * np.where(foundations, largest, most)
        ahead = (1 + TOUCHES) * forces + np.where(rubs, AHEAD * terms.unit, 0.0)[:, None] * beyond
        force = _nearest(terms, ahead)
        pressed = forces[:, 0] + passed > margin
        held = np.where(rubs, (force == ahead).all(axis=1), pressed & (forces[:, 0] < most - margin))
        force[terms.one_sided] = 0.0
        full = pressed & ~held & terms.one_sided
        force[full, 0] = most[full]
        return cls(np.where(held[:, None], forces, force), held, np.linalg.norm(off, axis=1))

    def pull(self, terms: Terms, springs: Array, off: Array) -> Array:
        """The forces at this Ax − g; what holds and gives way has less than the force at rest."""
        share = np.where(self.held, 1 / (1 + STIFF * terms.unit * terms.gives), 1.0)
        return np.asarray(share[:, None] * self.force + np.einsum("kij,kj->ki", springs, off))

    def springs(self, terms: Terms) -> Array:
        """The springs, shape (terms, components, components)."""
        one, most, unit = np.eye(self.force.shape[1]), terms.most, terms.unit
        stiff = STIFF * unit / (1 + STIFF * unit * terms.gives)
        springs: Array = np.where(self.held, stiff, 0.0)[:, None, None] * one
        slips = np.flatnonzero(~self.held & ~terms.one_sided)
        direction = self.force[slips] / most[slips, None]
        across = one - direction[:, :, None] * direction[:, None]
        length = np.maximum(self.length[slips], most[slips] / (STIFF * unit[slips]))
        springs[slips] = (most[slips] / length)[:, None, None] * across
        return springs

    def after(self, terms: Terms, reached: Array, off: Array) -> tuple[_Taken, float]:
        """The next sets, and about what they gain (collective).

        Args:
            terms: The function.
            reached: The forces that a solve has reached.
            off: Its Ax − g.
        """
        beyond = off - terms.gives[:, None] * reached
        ahead = reached + np.where(self.held, 0.0, terms.unit)[:, None] * beyond
        following = _nearest(terms, ahead)
        turned_back = ~self.held & ((beyond * self.force).sum(axis=1) < 0)
        held = (following == ahead).all(axis=1) | turned_back
        gains = ((following - reached) ** 2).sum(axis=1) / terms.unit
        length = FARTHER * np.linalg.norm(following - reached, axis=1) / terms.unit
        force = np.where(held[:, None], np.where(self.held[:, None], self.force, _nearest(terms, reached)), following)
        sets = _Taken(force, held, np.where(self.held, length, np.linalg.norm(off, axis=1)))
        return sets, terms.locks * terms.comm.allreduce(float(gains.sum())) / 2


def _nearest(terms: Terms, forces: Array) -> Array:
    """The allowed forces nearest to these."""
    return shortened(np.where(terms.one_sided[:, None], np.maximum(forces, 0.0), forces), terms.most)


def _value(terms: Terms, x: Array) -> float:
    """The function, without foundations (collective)."""
    off, finite = terms.along(x) - terms.bound, np.isfinite(terms.most)
    reach = np.where(terms.one_sided, np.maximum(off[:, 0], 0.0), np.linalg.norm(off, axis=1))
    reach, most, gives = reach[finite], terms.most[finite], terms.gives[finite]
    force = np.minimum(most, np.divide(reach, gives, out=np.full_like(reach, np.inf), where=gives > 0))
    rubbed = force @ (reach - gives * force / 2)
    return terms.constant + float(terms.comm.allreduce(float(x @ (terms.times(x) / 2 - terms.load) + rubbed)))
