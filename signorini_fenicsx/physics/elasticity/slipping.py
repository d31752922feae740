"""Tresca's friction in space: Newton's method on the energy, with a line search.

At a vertex with friction u_t and σ_t have two components, and minimising the energy with Σ m g|u_t| gives σ_t =
−g u_t/|u_t| where u_t ≠ 0, |σ_t| ≤ g elsewhere. Newton's step solves with the linear law of `Slipping` at the vertices
that slip and u_t = 0 at others; contact is found by the loop as ever. Which vertices slip is decided as by Hüeber,
Stadler and Wohlmuth (SIAM J. Sci. Comput. 30, 2008): those with |c u_t − σ_t| > g, where c is the stiffness of the
vertex alone, so that for those that stick u_t = 0 would be best if all others stayed. A step goes as far as the energy
falls, which is known along it exactly. Where it does not fall at all, because too many vertices were to stick, the step
is one with the law σ_t = −(g/a)u_t, a the present |u_t|: along that it always falls (Weiszfeld). Under Coulomb's law
the first steps are whole.

What differs from the plane is that σ_t turns; there three states are enough, and the loop alone finds them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.physics.elasticity.backend import ElasticBackend
from signorini_fenicsx.physics.elasticity.friction import FrictionBounds, Slipping

EXACT = 1e-11
"""Newton's method ends when no σ_t is off −g u_t/|u_t| by more than this share of the largest g that is reached."""
ROUGH = 0.1
"""CG leaves at most this share of what there was, and at most the share by which the last law is off."""
WHOLE = 6
"""Under Coulomb's law so many steps are whole: the last bound is near, and a step as far as the energy falls may end
where one vertex would turn around."""
MOST = 40
"""Steps at most."""
HALVINGS = 40
ROUNDING = 1e-10
"""A slope of the energy below this share of what it is a difference of is rounding."""


def slipped(backend: ElasticBackend, contact: Callable[[], Outcome], enough: float = 0.0) -> Outcome:
    """Find where the vertices slip, and along which directions (collective).

    CG solves the first problems roughly, and later ones as exactly as the law is known, the last one to the end.

    Args:
        backend: The backend; its friction ends with the linear law of the solution.
        contact: Solves the contact problem with this linear law.
        enough: By how much the last law may be off, as a share of the largest g; 0 for nothing but rounding.

    Returns:
        The outcome of the last problem.
    """
    share, step = ROUGH if backend.iterates else 0.0, 0
    whole = WHOLE if backend.friction.by_pressure else 0

    def solved() -> Outcome:
        nonlocal share
        with backend.loosely(share):
            outcome = contact()
        if outcome.converged or share == 0:
            return outcome
        share = 0.0
        return contact()

    outcome = solved()
    x = backend.state()
    slip, shear = _pairs(backend, outcome)
    while outcome.converged:
        before = backend.friction
        after = _following(backend, before, slip, shear)
        off = _off(backend, before, after, slip, shear)
        if off <= enough or (off <= EXACT and share == 0):
            return outcome
        if step >= MOST:
            return outcome.ended(f"the directions of slip still change after {MOST} steps")
        share = min(ROUGH, off) if share > 0 and off > EXACT else 0.0
        for law in (after, _cautious(after, slip)):
            backend.friction = law
            outcome, step = solved(), step + 1
            end, (there, pull) = backend.state(), _pairs(backend, outcome)
            length = 1.0
            if step > whole and outcome.converged and backend.is_contact:
                length = _length(backend, x, end - x, slip, there - slip)
            if length > 0:
                break
        length = length or 1.0
        x, slip, shear = (a + length * (b - a) for a, b in ((x, end), (slip, there), (shear, pull)))
    return outcome


def _cautious(friction: FrictionBounds, slip: Array) -> FrictionBounds:
    """The law along which the energy falls, at u_t."""
    assert friction.slipping is not None
    size, slipping = np.linalg.norm(slip, axis=2), friction.slipping
    moves = (size > 0)[:, :, None]
    direction = np.where(moves, slip / np.where(moves, size[:, :, None], 1.0), slipping.direction)
    return replace(friction, slipping=Slipping(direction, np.where(size > 0, size, slipping.size), cautious=True))


def _pairs(backend: ElasticBackend, outcome: Outcome) -> tuple[Array, Array]:
    """u_t and σ_t at the vertices with friction, shape (facets, 3, 2) each."""
    normal, iterate = len(backend.spaces.sites), outcome.iterate
    return iterate.p[normal:].reshape(-1, 3, 2), iterate.flux[normal:].reshape(-1, 3, 2)


def _following(backend: ElasticBackend, friction: FrictionBounds, slip: Array, shear: Array) -> FrictionBounds:
    """The linear law at u_t and σ_t."""
    stiffness, size = _stiffness(backend), np.linalg.norm(slip, axis=2)
    wanted = stiffness[:, :, None] * slip - shear
    pull = np.linalg.norm(wanted, axis=2)
    slips = (pull > friction.bound) & (pull > 0)
    still = size == 0
    direction = np.where(still[:, :, None], wanted, slip)
    direction = direction / np.maximum(np.linalg.norm(direction, axis=2), 1e-300)[:, :, None]
    size = np.where(still, (pull - np.minimum(friction.bound, pull)) / stiffness, size)
    slipping = Slipping(np.where(slips[:, :, None], direction, 0.0), np.where(slips, size, 1.0))
    return replace(friction, slipping=slipping)


def _stiffness(backend: ElasticBackend) -> Array:
    """The diagonal entries of the vertices with friction over their measure, shape (facets, 3)."""
    spaces = backend.spaces
    diagonal = backend.system.matrix.getDiagonal().array_r[spaces.slip_sites] / spaces.slip_measure
    return np.asarray(diagonal.reshape(-1, 3, 2).mean(axis=2))


def _off(backend: ElasticBackend, before: FrictionBounds, after: FrictionBounds, slip: Array, shear: Array) -> float:
    """How far the solution under the linear law before is off the law itself, as a share of the largest g (collective).

    Infinite if it is another law, or if other vertices slip.
    """
    assert after.slipping is not None
    assert before.slipping is not None
    if before.slipping.cautious:
        return math.inf
    slips = after.slipping.direction.any(axis=2)
    off = np.where(slips, np.linalg.norm(shear - after.forces, axis=2), 0.0)
    changed = slips != before.slipping.direction.any(axis=2)
    reached = np.where(slips, after.bound, 0.0)
    largest = np.array([off.max(initial=0.0), reached.max(initial=0.0), float((changed & (after.bound > 0)).any())])
    backend.comm.Allreduce(MPI.IN_PLACE, largest, MPI.MAX)
    if largest[2] > 0:
        return math.inf
    return float(largest[0] / largest[1]) if largest[0] > 0 else 0.0


def _length(backend: ElasticBackend, x: Array, step: Array, slip: Array, change: Array) -> float:
    """How far to go along a step, up to 1, for the least energy: 0 if it does not fall (collective)."""
    friction = backend.friction
    first, second = _energy_along(backend, x, step)
    weights = friction.bound * (backend.spaces.rough.measure / backend.spaces.dim)[:, None]

    def slope(length: float) -> float:
        at = slip + length * change
        size = np.linalg.norm(at, axis=2)
        along = np.einsum("nak,nak->na", at, change)
        rubbed = np.where(size > 0, along / np.where(size > 0, size, 1.0), np.linalg.norm(change, axis=2))
        return first + length * second + backend.comm.allreduce(float((weights * rubbed).sum()))

    begin = slope(0.0)
    if slope(1.0) <= 0 or abs(begin) <= ROUNDING * abs(first):
        return 1.0
    if begin > 0:
        return 0.0
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if slope(middle) < 0 else (low, middle)
    return low


def _energy_along(backend: ElasticBackend, x: Array, step: Array) -> tuple[float, float]:
    """The first and the second derivative of the energy without friction at x along a step (collective)."""
    size = len(backend.system.load)
    here, there = (backend.image(each[:size]) for each in (x, step))
    slopes = np.array([(here - backend.system.load) @ step[:size], there @ step[:size]])
    first, second = backend.comm.allreduce(slopes).tolist()
    return first - backend.tools.work(step[size:]), second
