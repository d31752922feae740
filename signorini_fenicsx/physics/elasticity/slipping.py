"""Friction in space: one Newton method for contact, slip and Coulomb's bound together.

At a vertex with friction u_t and σ_t have two components, σ_t = −g u_t/|u_t| where u_t ≠ 0, |σ_t| ≤ g elsewhere, and g
is given or μ times the pressure λ. With c, the stiffness of the vertex alone, this is |w|σ_t = −g w for w = c u_t − σ_t
where |w| > g, and u_t = 0 elsewhere: so decide Hüeber, Stadler and Wohlmuth (SIAM J. Sci. Comput. 30, 2008) which
vertices slip. Linear in u_t, σ_t and λ it is the law of `Slipping` with s = w/|w|, a = (|w| − g)/c. Far from the
solution σ_t is not −g s; then θ, what σ_t has along −s as a share of g, makes the law softer. It is 1 at the solution.

Each step is one linear solve, whose solution also decides about contact, by the rule of the loop. What makes these
steps many in other methods is that contact, slip and bound are found one inside the other.

What differs from the plane is that σ_t turns; there three states are enough, and the loop alone finds them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.contact.backend import Pairs
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.physics.elasticity.backend import ElasticBackend
from signorini_fenicsx.physics.elasticity.coulomb import CHANGE
from signorini_fenicsx.physics.elasticity.friction import STICKS, FrictionBounds, Slipping

EXACT = 1e-11
"""Newton's method ends when no σ_t is off its law by more than this share of the largest g that is reached, or by
`coulomb.CHANGE` if that becomes smaller no more."""
TINY = 1e-300
"""In the place of 0 where something is divided by it."""
ROUGH = 0.1
"""CG leaves at most this share of what there was, and at most the share by which the last law is off."""


def slipped(
    backend: ElasticBackend, contact: Callable[[Callable[[Pairs], None]], Outcome], changes: list[float]
) -> Outcome:
    """Find contact, where the vertices slip and along which directions, and Coulomb's bounds (collective).

    CG solves the first problems roughly, and later ones as exactly as the law is known, the last one to the end.

    Args:
        backend: The backend; its friction ends with the linear law of the solution, or if there is none with the
            bounds at the begin.
        contact: Runs the loop from the last sets, and calls with each solution what it is given.
        changes: Gets, for each solve, how far σ_t is off Coulomb's law, as a share of the largest bound.

    Returns:
        The outcome of the last loop.
    """
    share, last = ROUGH if backend.iterates else 0.0, np.inf
    backend.leave(share)

    def follow(iterate: Pairs) -> None:
        nonlocal share, last
        friction, normal = backend.friction, len(backend.spaces.sites)
        slip, shear = (each[normal:].reshape(-1, 3, 2) for each in (iterate.p, iterate.flux))
        pressure = backend.spaces.pressure_of(iterate.flux)
        after = _following(backend, friction.following(pressure), slip, shear)
        off = _off(backend, after, slip, shear)
        if friction.by_pressure:
            changes.append(off)
        known = off <= EXACT or last / 2 <= off <= CHANGE
        if known and (share == 0 or backend.to_the_end):
            return
        share, last = (0.0 if known else min(share, off)), off
        backend.leave(share)
        backend.turn(after)

    try:
        if backend.comm.allreduce(bool((backend.friction.bound >= STICKS).any()), MPI.LOR):
            follow(contact(lambda iterate: None).iterate)
        begin = backend.friction
        while True:
            outcome = contact(follow)
            if share == 0 or (outcome.converged and backend.to_the_end):
                break
            share = 0.0
            backend.leave(share)
    finally:
        backend.leave(0.0)
    if not outcome.converged:
        backend.turn(begin)
        return outcome
    slip = outcome.iterate.p[len(backend.spaces.sites) :].reshape(-1, 3, 2)
    backend.turn(backend.friction.following(backend.spaces.pressure_of(outcome.iterate.flux)).turned(slip))
    law = backend.chains
    return replace(outcome, conditions=law.conditions(law.segments(outcome.conditions)))


def _following(backend: ElasticBackend, friction: FrictionBounds, slip: Array, shear: Array) -> FrictionBounds:
    """The linear law at u_t and σ_t with these bounds."""
    wanted = _stiffness(backend)[:, :, None] * slip - shear
    pull, pulled = (np.linalg.norm(each, axis=2) for each in (wanted, shear))
    slips = (pull > friction.bound) & (pull > 0)
    direction = np.where(slips[:, :, None], wanted / np.where(slips, pull, 1.0)[:, :, None], 0.0)
    along = -np.einsum("nak,nak->na", direction, shear) / np.maximum(np.maximum(friction.bound, pulled), TINY)
    size = np.where(slips, (pull - friction.bound) / _stiffness(backend), 1.0)
    follows = np.where(slips & friction.coulomb[:, None], friction.mu, 0.0)
    return replace(friction, slipping=Slipping(direction, size, np.maximum(along, 0.0), follows))


def _stiffness(backend: ElasticBackend) -> Array:
    """The diagonal entries of the vertices with friction over their measure, shape (facets, 3)."""
    spaces = backend.spaces
    diagonal = backend.system.matrix.getDiagonal().array_r[spaces.slip_sites] / spaces.slip_measure
    return np.asarray(diagonal.reshape(-1, 3, 2).mean(axis=2))


def _off(backend: ElasticBackend, friction: FrictionBounds, slip: Array, shear: Array) -> float:
    """How far u_t and σ_t are off the law with these bounds, as a share of the largest g (collective)."""
    _, off = friction.residuals(slip, shear, _stiffness(backend))
    reached = np.where(friction.sticks, 0.0, friction.bound)
    largest = np.array([off.max(initial=0.0), reached.max(initial=0.0)])
    backend.comm.Allreduce(MPI.IN_PLACE, largest, MPI.MAX)
    most, bound = largest.tolist()
    return 0.0 if most == 0 else most / bound if bound > 0 else np.inf
