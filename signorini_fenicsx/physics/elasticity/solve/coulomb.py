"""Coulomb's friction as an equation for the bound of the shear, solved by Newton's method.

Let T(g) be μ times the pressure of Tresca's problem with the bound g, plus what adhesion holds. Coulomb's law is
g = T(g). The sequence g, T(g), T(T(g)), … tends to a solution if μ is small, with a rate that grows with μ, and to none
if μ is large. Newton's method needs few steps in both cases: under the sets of the last problem its solution is linear
in g, so the product of T' and a vector is one linear solve with these sets, and GMRES finds (I − T')⁻¹ of what is left
of the equation. A step that leaves more than there was is halved. The first g is T(∞), where nothing slips.

For large μ there may be several solutions, and no theorem known to us tells where there is one only.

*Coulomb's friction for any μ*: a path of solutions from no friction to all of it.

Let the bound of the shear be k = max(μ λ + g − z d, 0) with the pressure λ, the g of adhesion, a number z ≥ 0 and given
d > 0. For large z there is no friction, and one solution. In all z the solutions stay bounded, as those of Tresca's
problem do. So the path of solutions that begins there comes to z = 0, where the law is Coulomb's, perhaps after z has
grown for a while: it cannot end before, and not come back to a large z, where there is one solution only.

The discrete path is piecewise linear: under given states of all sites the solution is linear in z. It is followed on
the sites alone, with the dense matrix of what moving one site does to the forces on all. At the end of each piece one
site changes its state, and what decides about the new state tells whether z falls or grows on the next piece. The d of
different sites differ, so that no two change at once.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.parallel import on_root
from signorini_fenicsx.base.rows import in_digits
from signorini_fenicsx.contact.backend import SitePairs
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.contact.history import FoundSets, Outcome
from signorini_fenicsx.linear.gmres import EXACT, gmres
from signorini_fenicsx.physics.elasticity.discrete.friction import STICKS
from signorini_fenicsx.physics.elasticity.solve.backend import ElasticBackend

MOST_CHANGES = 20
"""Changes of states at most, for each site."""


class PathState(IntEnum):
    """The state of a site: of a normal one `OPEN` or `PRESSED`, of a tangential one the others."""

    OPEN = 0
    PRESSED = 1
    FREE = 2
    """Without a bound of the shear, k = 0."""
    STICK = 3
    PLUS = 4
    """Slips with u_t > 0, so that σ_t = −k."""
    MINUS = 5
    """Slips with u_t < 0, so that σ_t = k."""


NEXT = {
    PathState.OPEN: (PathState.PRESSED,),
    PathState.PRESSED: (PathState.OPEN,),
    PathState.FREE: (None,),
    PathState.STICK: (PathState.MINUS, PathState.PLUS),
    PathState.PLUS: (PathState.STICK, PathState.FREE),
    PathState.MINUS: (PathState.STICK, PathState.FREE),
}
"""Which state follows when each of the margins of a state, see `PathSites._margins`, has become 0; `FREE` ends in the
direction in which the site moves."""


@dataclass(frozen=True)
class PathSites:
    """The sites of all ranks: the flux at them is `stiffness @ p + force`, for any p at them.

    Attributes:
        stiffness: Shape (sites, sites).
        force: The flux with p = 0 everywhere.
        share: d of each site.
        normal: For a tangential site the normal one of the same vertex; −1 for normal sites.
        mu: μ at tangential sites of Coulomb's law, 0 elsewhere.
        given: What of the bound of the shear does not follow the pressure; 0 at normal sites.
    """

    stiffness: Array
    force: Array
    share: Array
    normal: Indices
    mu: Array
    given: Array

    def follow(self, state: Indices, pressure: Array) -> tuple[Indices, Array, Array] | None:
        """Follow the path to z = 0.

        Args:
            state: The states without friction of Coulomb's law, whose sites are `FREE`.
            pressure: The flux at all sites then.

        Returns:
            The states, p and the flux of all sites at the end; None if the path cannot be followed.
        """
        state, coulomb = state.copy(), self.mu > 0
        shift = np.where(coulomb, self.share, 0.0)
        z = 2 * float(np.where(coulomb, self.mu * pressure[self.normal] + self.given, 0.0).max(initial=0.0))
        sign, last = -1.0, None
        for _ in range(MOST_CHANGES * len(state)):
            try:
                (p, p_z), (flux, flux_z) = self._piece(state, shift)
            except np.linalg.LinAlgError:
                return None
            margins = self._margins(state, p + z * p_z, flux + z * flux_z, z, shift)
            slopes = self._margins(state, p_z, flux_z, 1.0, shift, constant=False)
            if last is not None:
                sign = float(np.sign(slopes[last])) or sign
            with np.errstate(divide="ignore", invalid="ignore"):
                length = np.where(sign * slopes < 0, np.maximum(margins, 0.0) / np.abs(slopes), np.inf)
            if last is not None:
                length[last] = np.inf
            site, which = divmod(int(np.argmin(length)), length.shape[1])
            if sign < 0 and z <= length[site, which]:
                return state, p, np.where((state == PathState.OPEN) | (state == PathState.FREE), 0.0, flux)
            if not np.isfinite(length[site, which]):
                return None
            z += sign * float(length[site, which])
            last = self._change(state, site, which, p + z * p_z)
        return None

    def _piece(self, state: Indices, shift: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """The solution under given states: p and the flux of all sites at z = 0, and how they grow with z.

        Raises:
            numpy.linalg.LinAlgError: If there is not one solution.
        """
        signs = np.where(state == PathState.PLUS, 1.0, np.where(state == PathState.MINUS, -1.0, 0.0))
        free = np.flatnonzero((state != PathState.PRESSED) & (state != PathState.STICK))
        rubbing = (signs * self.mu)[free]
        matrix = self.stiffness[free] + rubbing[:, None] * self.stiffness[self.normal[free]]
        right = np.column_stack(
            [
                -(signs * self.given)[free] - self.force[free] - rubbing * self.force[self.normal[free]],
                (signs * shift)[free],
            ]
        )
        p = np.zeros((len(state), 2))
        p[free] = np.linalg.solve(matrix[:, free], right)
        flux = self.stiffness @ p
        flux[:, 0] += self.force
        return (p[:, 0], p[:, 1]), (flux[:, 0], flux[:, 1])

    def _margins(
        self, state: Indices, p: Array, flux: Array, z: float, shift: Array, *, constant: bool = True
    ) -> Array:
        """Margins that are ≥ 0 as long as the states are right, shape (sites, 2); ∞ where there is no second one.

        Without the constants these are the slopes, of the slopes of p and the flux and with z = 1.
        """
        bound = self.mu * flux[self.normal] - z * shift + constant * self.given
        first = np.select(
            [state == each for each in PathState],
            [p, flux, -bound, bound - flux, p, -p],
        )
        limited = self.mu > 0
        second = np.select(
            [state == PathState.STICK, limited & ((state == PathState.PLUS) | (state == PathState.MINUS))],
            [bound + flux, bound],
            np.inf if constant else 0.0,
        )
        return np.column_stack([first, second])

    def _change(self, state: Indices, site: int, which: int, p: Array) -> tuple[int, int]:
        """Change the state of a site whose margin has become 0; returns which margin of the new state is 0."""
        before = PathState(state[site])
        following = NEXT[before][which]
        if following is None:
            following = PathState.PLUS if p[site] > 0 else PathState.MINUS
        state[site] = following
        if before == PathState.FREE:
            return site, 1
        return site, 1 if (before, following) == (PathState.PLUS, PathState.STICK) else 0


CHANGE = 1e-9
"""The bound is found when it differs from μ times the pressure by this share of itself."""
MOST = 20
"""Problems of Tresca at most, before a path is followed."""
MOST_SITES = 2000
"""No path is followed with more sites: its matrix would be too large."""
ROUGH = 1e-2
"""Share of what is left at which GMRES stops at most, where Newton's method may be rough."""
SHORTEST = 1 / 64
"""Share of Newton's step below which a step is taken as it is."""
GOLDEN = (np.sqrt(5) - 1) / 2


def balanced[S: FoundSets](
    backend: ElasticBackend, tresca: Callable[[], S], changes: list[float], *, roughly: bool = False
) -> S:
    """Find the bound of the shear that is μ times the pressure, by Newton's method (collective).

    Args:
        backend: The backend; its friction ends with this bound.
        tresca: Solves Tresca's problem with the present bound of the backend, from the sets of the last time.
        changes: Gets, for each problem, how much the bound still differs from μ times the pressure, relative to that.
        roughly: Whether Newton's steps need not be more exact than their squares.

    Returns:
        The last problem; after `MOST` of them the bound is not found.
    """
    spaces, accepted, step, share, least = backend.spaces, backend.friction, np.empty(0), 1.0, np.inf
    while True:
        outcome, present = tresca(), backend.friction
        if not present.by_pressure or not outcome.converged:
            return outcome
        following = present.following(pressure(backend, outcome.iterate))
        changes.append(present.change(following, spaces))
        if changes[-1] <= CHANGE or len(changes) == MOST:
            return outcome
        left = present.distance(following, spaces)
        if backend.comm.allreduce(bool((present.bound >= STICKS).any()), MPI.LOR):
            accepted = backend.friction = following  # nothing slipped before
            step = np.zeros_like(following.bound)
        elif left < least or share <= SHORTEST:
            accepted, least, share = present, left, 1.0
            slip, (p, flux) = spaces.site_kinds["slip"], (outcome.iterate.p, outcome.iterate.flux)
            segments = present.chains.segments(slip.of(outcome.conditions), (slip.of(p), slip.of(flux)))
            law = present.directions(segments), present.slope(spaces.pressure_of(outcome.iterate.flux))
            enough = EXACT
            if roughly:
                enough = max(EXACT, min(changes[-1] ** 2, ROUGH), CHANGE / (100 * changes[-1]))
            step = _step(backend, outcome.conditions, law, following.bound - present.bound, enough)
            backend.friction = accepted.moved(step)
        else:
            share /= 2
            backend.friction = accepted.moved(share * step)


def pressure(backend: ElasticBackend, pairs: SitePairs) -> Array:
    """The pressure at the vertices with friction, shape (facets, d), 0 where it is rounding."""
    return backend.spaces.pressure_of(np.where(np.abs(pairs.flux) > backend.sizes.rounding, pairs.flux, 0.0))


def by_path(backend: ElasticBackend, tresca: Callable[[Indices | None], Outcome], changes: list[float]) -> Outcome:
    """Find the bound where Newton's method did not, along the path from no friction (collective).

    Args:
        backend: As for `balanced`.
        tresca: The same from given segments; None for the sets of the last time.
        changes: As for `balanced`.

    Returns:
        The outcome of the problem at the end of the path, or of that at its begin.
    """
    friction, comm, spaces = backend.friction, backend.comm, backend.spaces
    backend.friction = friction.with_bounds(np.zeros_like(friction.bound))
    outcome = tresca(None)
    goes = not (backend.iterates or backend.data.laws.of_parts or spaces.dim == 3 or backend.tools)
    if not outcome.converged or not goes or comm.allreduce(backend.sites) > MOST_SITES:
        return outcome.ended(
            f"the bound of the friction still changes by {min(changes):.1e} after {len(changes)} steps"
        )
    normal, slip = spaces.site_kinds
    coulomb = np.repeat(friction.coulomb, 2)
    segments = backend.friction.chains.segments(slip.of(outcome.conditions))
    slips = np.array([PathState.MINUS, PathState.STICK, PathState.PLUS])[segments]
    touches = normal.of(outcome.conditions.kind) == Condition.ZERO_TRACE
    state = np.append(np.where(touches, PathState.PRESSED, PathState.OPEN), np.where(coulomb, PathState.FREE, slips))
    first = comm.exscan(backend.sites) or 0
    zeros = np.zeros(len(normal))
    of_rank = (
        *_reactions(backend),
        _shares(backend),
        np.concatenate([np.full(len(normal), -1), first + slip.pressing.ravel()]),
        np.append(zeros, friction.mu),
        np.append(zeros, friction.given),
        state,
        outcome.iterate.flux,
    )
    of_ranks = comm.gather(of_rank)

    def along_path() -> tuple[Indices, Array, Array] | None:
        *parts, state, flux = (np.concatenate(each) for each in zip(*of_ranks or [], strict=True))
        return PathSites(*parts).follow(state, flux)

    end = on_root(comm, along_path)  # whose turns are decisions, which one rank makes for all
    if end is None:
        return outcome.ended("no solution with this friction was found, neither by Newton's method nor along a path")
    own_sites = slice(first, first + backend.sites)
    state, p, flux = end[0][own_sites], end[1][own_sites], end[2][own_sites]
    backend.friction = friction.following(backend.spaces.pressure_of(flux))
    segments = np.select([state == PathState.OPEN, state == PathState.STICK, state == PathState.PLUS], [1, 1, 2], 0)
    slip.of(segments)[slip.of((state == PathState.FREE) & (p > 0))] = 2
    outcome = tresca(segments)
    changes.append(backend.friction.change(backend.friction.following(pressure(backend, outcome.iterate)), spaces))
    if changes[-1] > CHANGE:
        return outcome.ended(f"the bound of the friction still changes by {changes[-1]:.1e} at the end of a path")
    return outcome


def _reactions(backend: ElasticBackend) -> tuple[Array, Array]:
    """The flux at the sites of this rank as `matrix @ p + force`, for any p at the sites of all (collective).

    The matrix has the sites of all ranks one rank after another. Costs a linear solve for each.
    """
    sites, none = backend.spaces.site_kinds, np.zeros_like(backend.system.load)
    held = SiteConditions.everywhere(Condition.ZERO_TRACE, backend.sites)
    force = backend.flux(backend.solve_homogeneous(held, backend.system.load), backend.system.load)
    columns = [np.empty((backend.sites, 0))]
    for rank, count in enumerate(backend.comm.allgather(backend.sites)):
        for site in range(count):
            lift = none.copy()
            if rank == backend.comm.rank:
                lift[sites.unknown[site]] = sites.sign[site]
            columns.append(backend.flux(backend.solve_homogeneous(held, none, lift), none)[:, None])
    return np.concatenate(columns, axis=1), force


def _shares(backend: ElasticBackend) -> Array:
    """A number from 1 to 2 for each site, not the same for two, on any number of ranks (collective)."""
    comm, places = backend.comm, backend.places()
    order = np.lexsort(in_digits(np.concatenate(comm.allgather(places))).T)
    shares = np.empty(len(order))
    shares[order] = 1 + (GOLDEN * np.arange(1, len(order) + 1)) % 1
    first = comm.exscan(backend.sites) or 0
    return shares[first : first + backend.sites]


def _step(
    backend: ElasticBackend, conditions: SiteConditions, law: tuple[Array, Array], left: Array, share: float
) -> Array:
    """The step of `newton`; one GMRES finds it where CG solves for contact, and the solution follows."""
    friction, (directions, slope) = backend.friction, law
    if not backend.iterates or backend.data.laws.of_parts or backend.tools:
        return newton(backend, conditions, law, left, share)
    left = np.where(friction.coulomb[:, None], left, 0.0)
    forces, slopes = (directions * np.repeat(each, backend.spaces.dim - 1) for each in (left, slope))
    flux = backend.follow_bounds(forces, slopes, share)
    return left + slope * backend.spaces.pressure_of(flux)


def newton(
    backend: ElasticBackend,
    conditions: SiteConditions,
    law: tuple[Array, Array],
    left: Array,
    share: float = EXACT,
) -> Array:
    """(I − T')⁻¹ of what is left, shape (facets, d), under these sets (collective).

    Args:
        backend: The backend.
        conditions: The sets.
        law: The derivatives of σ_t by the bounds at the sites, and of the bounds by the pressure, shape (facets, d).
        left: What is left.
        share: GMRES stops at this share of it.
    """
    friction, spaces, none = backend.friction, backend.spaces, np.zeros(len(backend.system.load))
    (directions, slope), slip = law, spaces.site_kinds["slip"]

    def without_response(values: Array) -> Array:
        load = none.copy()
        load[slip.unknown] = directions * slip.measure * np.repeat(values, spaces.dim - 1)
        pressure = spaces.pressure_of(backend.response(conditions, load))
        return values - (slope * pressure.reshape(slope.shape)).ravel()

    right = np.where(friction.coulomb[:, None], left, 0.0).ravel()
    return gmres(backend.comm, without_response, right, share=share)[0].reshape(left.shape)
