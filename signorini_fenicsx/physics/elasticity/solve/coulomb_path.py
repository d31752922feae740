"""Coulomb's friction for any μ: a path of solutions from no friction to all of it.

Let the bound of the shear be k = max(μ λ − z d, 0) with the pressure λ, a number z ≥ 0 and given d > 0. For large z
there is no friction, and one solution. In all z the solutions stay bounded, as those of Tresca's problem do. So the
path of solutions that begins there comes to z = 0, where the law is Coulomb's, perhaps after z has grown for a while:
it cannot end before, and not come back to a large z, where there is one solution only.

The discrete path is piecewise linear: under given states of all sites the solution is linear in z. It is followed on
the sites alone, with the dense matrix of what moving one site does to the forces on all. At the end of each piece one
site changes its state, and what decides about the new state tells whether z falls or grows on the next piece. The d of
different sites differ, so that no two change at once.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from signorini_fenicsx.base.arrays import Array, Indices

MOST = 20
"""Changes of states at most, for each site."""


class State(IntEnum):
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
    State.OPEN: (State.PRESSED,),
    State.PRESSED: (State.OPEN,),
    State.FREE: (None,),
    State.STICK: (State.MINUS, State.PLUS),
    State.PLUS: (State.STICK, State.FREE),
    State.MINUS: (State.STICK, State.FREE),
}
"""Which state follows when each of the margins of a state, see `Sites._margins`, has become 0; `FREE` ends in the
direction in which the site moves."""


@dataclass(frozen=True)
class Sites:
    """The sites of all ranks: the flux at them is `stiffness @ p + force`, for any p at them.

    Attributes:
        stiffness: Shape (sites, sites).
        force: The flux with p = 0 everywhere.
        share: d of each site.
        normal: For a tangential site the normal one of the same vertex; −1 for normal sites.
        mu: μ at tangential sites of Coulomb's law, 0 elsewhere.
        given: The bound of the shear at other tangential sites, 0 elsewhere.
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
        z = 2 * float((self.mu * pressure[self.normal]).max(initial=0.0))
        sign, last = -1.0, None
        for _ in range(MOST * len(state)):
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
                return state, p, np.where((state == State.OPEN) | (state == State.FREE), 0.0, flux)
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
        signs = np.where(state == State.PLUS, 1.0, np.where(state == State.MINUS, -1.0, 0.0))
        free = np.flatnonzero((state != State.PRESSED) & (state != State.STICK))
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
            [state == each for each in State],
            [p, flux, -bound, bound - flux, p, -p],
        )
        limited = self.mu > 0
        second = np.select(
            [state == State.STICK, limited & ((state == State.PLUS) | (state == State.MINUS))],
            [bound + flux, bound],
            np.inf if constant else 0.0,
        )
        return np.column_stack([first, second])

    def _change(self, state: Indices, site: int, which: int, p: Array) -> tuple[int, int]:
        """Change the state of a site whose margin has become 0; returns which margin of the new state is 0."""
        before = State(state[site])
        following = NEXT[before][which]
        if following is None:
            following = State.PLUS if p[site] > 0 else State.MINUS
        state[site] = following
        if before == State.FREE:
            return site, 1
        return site, 1 if (before, following) == (State.PLUS, State.STICK) else 0
