"""Friction in space: one Newton method for contact, slip and Coulomb's bound together.

At a vertex with friction u_t and σ_t have two components, σ_t = −g u_t/|u_t| where u_t ≠ 0, |σ_t| ≤ g elsewhere, and g
is given or μ times the pressure λ. With c, the stiffness of the vertex alone, this is |w|σ_t = −g w for w = c u_t − σ_t
where |w| > g, and u_t = 0 elsewhere: so decide Hüeber, Stadler and Wohlmuth (SIAM J. Sci. Comput. 30, 2008) which
vertices slip. Linear in u_t, σ_t and λ it is the law of `Slipping` with s = w/|w|, a = (|w| − g)/c. Far from the
solution σ_t is not −g s; then θ, what σ_t has along −s as a share of g, makes the law softer. It is 1 at the solution.

Each step is one linear solve, whose solution also decides about contact, by the rule of the loop. What makes these
steps many in other methods is that contact, slip and bound are found one inside the other.

With Tresca's law these steps converge in all problems seen, with Coulomb's not if μ is large. Let T(g) be μ times the
pressure of Tresca's problem with the bound g. For large μ, or where Newton's steps come no nearer, a step is Newton's
for an implicit Euler step g' − g = Δt(T(g') − g') instead: g' has the share 1/(1 + Δt) of g, the rest is μ times the
pressure. With Δt = 0 it is Tresca's problem, with Δt = ∞ Coulomb's. Δt grows and shrinks as the residual falls and
rises (switched evolution relaxation, see Kelley and Keyes, SIAM J. Numer. Anal. 35, 1998).

What differs from the plane is that σ_t turns; there three states are enough, and the loop alone finds them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.contact.backend import SitePairs
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.physics.elasticity.discrete.friction import STICKS, FrictionBounds, Slipping
from signorini_fenicsx.physics.elasticity.solve.backend import ElasticBackend
from signorini_fenicsx.physics.elasticity.solve.coulomb import CHANGE, pressure

EXACT = 1e-11
"""Newton's method ends when no σ_t is off its law by more than this share of the largest g that is reached, or by
`coulomb.CHANGE` if that becomes smaller no more."""
TINY = 1e-300
"""In the place of 0 where something is divided by it."""
PATIENCE = 12
"""After so many steps without a residual below all before, Newton's steps become delayed ones, or these Newton's."""
FALLS = 0.9
"""What is not below this share of a residual is not below it."""
ALONE = 2.0
"""Above this μ the first steps are delayed."""
DELAYED, SHORTEST = 1.0, 0.2
"""The first and the shortest Δt of a delay."""
SLOWER, FASTER = 0.3, 1.5
"""By how much Δt changes at most in a step."""
ROUGH = 0.1
"""CG leaves at most this share of what there was, and at most the share by which the last law is off."""
STILL = "Coulomb's bound still changes after {}"
OFF = "; σ_t is still off Coulomb's law by {:.1e} of the largest bound"


def slipped(
    backend: ElasticBackend, contact: Callable[[Callable[[SitePairs], bool]], Outcome], changes: list[float], most: int
) -> Outcome:
    """Find contact, where the vertices slip and along which directions, and Coulomb's bounds (collective).

    CG solves the first problems roughly, and later ones as exactly as the law is known, the last one to the end.

    Args:
        backend: The backend; its friction ends with the linear law of the solution, or if there is none with the
            bounds at the begin.
        contact: Runs the loop from the last sets, and calls with each solution what it is given.
        changes: Gets, for each solve, how far σ_t is off Coulomb's law, as a share of the largest bound.
        most: After so many solves it is given up where sets repeat and the bound does not.

    Returns:
        The outcome of the last loop.
    """
    share, last, known, base = ROUGH if backend.iterates else 0.0, np.inf, False, backend.friction
    delay = _Delay(DELAYED) if is_large(backend.comm, base) else _Delay()
    backend.leave(share)

    @np.errstate(over="ignore", invalid="ignore")  # where nothing holds a tool; the next matrix is singular then
    def follow(iterate: SitePairs) -> bool:
        nonlocal share, last, known, base
        friction = backend.friction
        slip, shear = map(backend.spaces.site_kinds["slip"].rows_of, (iterate.p, iterate.flux))
        pressed = friction.following(pressure(backend, iterate))
        after = _following(backend, pressed, slip, shear)
        size, largest = _off(backend, after, iterate)
        off = 0.0 if size[0] <= backend.sizes.rounding else size[0] / largest if largest > 0 else np.inf
        changes.extend([off] if friction.by_pressure else [])
        known = off <= EXACT or last / 2 <= off <= CHANGE
        if known and (share == 0 or backend.to_the_end):
            return False
        share, last = (0.0 if known else min(share, off)), off
        backend.leave(share)
        base = base.towards(pressed, delay.share)
        if friction.by_pressure and largest > 0 and delay.after(max(size)) < 1:
            after = _following(backend, base.towards(pressed, delay.share), slip, shear, pressed, delay.share)
        backend.turn(after)
        return friction.by_pressure

    try:
        if backend.comm.allreduce(bool((backend.friction.bound >= STICKS).any()), MPI.LOR):
            follow(contact(lambda iterate: False).iterate)
        begin = backend.friction
        while True:
            exactly = share == 0  # a law that is known at once may leave the sets of a rough solve as they are
            outcome = contact(follow)
            still = outcome.converged and not known and backend.friction.by_pressure
            if still and len(changes) < most:
                continue  # a delayed bound may leave the sets as they are
            outcome = outcome.ended(STILL.format(counted(most, "iteration"))) if still else outcome
            if still or exactly or (outcome.converged and backend.to_the_end):
                break
            share = 0.0
            backend.leave(share)
    finally:
        backend.leave(0.0)
    if not outcome.converged:
        backend.turn(begin)
        off = OFF.format(changes[-1]) if changes and np.isfinite(changes[-1]) else ""
        return outcome.ended(f"{outcome.reason}{off}")
    pairs = map(backend.spaces.site_kinds["slip"].rows_of, (outcome.iterate.p, outcome.iterate.flux))
    backend.turn(backend.friction.following(pressure(backend, outcome.iterate)).turned(backend.friction.left(*pairs)))
    law = backend.chains
    return replace(outcome, conditions=law.conditions(law.segments(outcome.conditions)))


def is_large(comm: MPI.Comm, friction: FrictionBounds) -> bool:
    """Whether μ in space is so large that Coulomb's bound is delayed at once (collective)."""
    return bool(comm.allreduce(friction.mu.max(initial=0.0), MPI.MAX) > ALONE)


def _following(
    backend: ElasticBackend,
    friction: FrictionBounds,
    slip: Array,
    shear: Array,
    pressed: FrictionBounds | None = None,
    share: float = 1.0,
) -> FrictionBounds:
    """The linear law at u_t and σ_t with these bounds, of which a share is that by the pressure; by default all."""
    stiffness = _stiffness(backend)
    wanted = stiffness[:, :, None] * friction.left(slip, shear) - shear
    pull, pulled = (np.linalg.norm(each, axis=2) for each in (wanted, shear))
    slips = (pull > friction.bound) & (pull > 0)
    direction = np.where(slips[:, :, None], wanted / np.where(slips, pull, 1.0)[:, :, None], 0.0)
    along = -np.einsum("nak,nak->na", direction, shear) / np.maximum(np.maximum(friction.bound, pulled), TINY)
    size = np.where(slips, (pull - friction.bound) / stiffness, 1.0)
    follows = np.where(slips & friction.coulomb[:, None], share, 0.0)
    slope, part = follows * friction.mu, follows * ((pressed or friction).bound - friction.given)
    return replace(friction, slipping=Slipping(direction, size, np.maximum(along, 0.0), slope, part))


def _stiffness(backend: ElasticBackend) -> Array:
    """The stiffness of the vertices with friction alone, the mean over both components, shape (facets, 3)."""
    return np.asarray(backend.spaces.site_kinds["slip"].rows_of(backend.stiffness).mean(axis=2))


def _off(backend: ElasticBackend, friction: FrictionBounds, iterate: SitePairs) -> tuple[list[float], float]:
    """How far u_t and σ_t are off the law with these bounds, opening and pressure off theirs; the largest g.

    Collective.
    """
    normal, along = backend.spaces.site_kinds
    slip, shear = map(along.rows_of, (iterate.p, iterate.flux))
    unit, law = map(normal.of, (backend.stiffness, backend.chains))
    outside, beyond, beside = law.distances(normal.of(iterate.p), normal.of(iterate.flux), unit)
    contact = np.concatenate([unit * np.abs(outside), np.abs(beyond), beside])
    _, off = friction.residuals(slip, shear, _stiffness(backend))
    reached = np.where(friction.sticks, 0.0, friction.bound)
    largest = np.array([each.max(initial=0.0) for each in (off, contact, reached)])
    backend.comm.Allreduce(MPI.IN_PLACE, largest, MPI.MAX)
    *most, bound = largest.tolist()
    return most, bound


@dataclass
class _Delay:
    """How Coulomb's bound follows the pressure, see the module.

    Attributes:
        time: Δt.
    """

    time: float = np.inf
    _last: float = np.inf
    _least: float = np.inf
    _waited: int = 0

    @property
    def share(self) -> float:
        """Δt/(1 + Δt)."""
        return 1 / (1 + 1 / self.time)

    def after(self, off: float) -> float:
        """Take Δt for the next step by the residual of the last one; return its share."""
        self._waited = 0 if off < FALLS * self._least else self._waited + 1
        self._least = min(off, self._least)
        if self._waited == PATIENCE:
            self.time = DELAYED if np.isinf(self.time) else np.inf
            self._least, self._waited = np.inf, 0
        elif np.isfinite(self.time):
            change = min(max(self._last / max(off, TINY), SLOWER), FASTER)
            self.time = max(self.time * change, SHORTEST)
        self._last = off
        return self.share
