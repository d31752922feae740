"""The elastic backend: a hybrid system with a contact condition per facet vertex of Γ_C.

Where only contact holds the body, a set on the way may be too small for that. Then weak springs hold the free sites;
under the load they give way so far that the next set is larger. No result has springs: its residuals would be large.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial

import numpy as np
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import LinearSolveFailure
from signorini_fenicsx.base.tolerances import KKT, LINEAR, STEP
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.backend import Anchored, Inexact, Iterate
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.contact.sites import SiteKind
from signorini_fenicsx.discrete.field_change import FieldChange
from signorini_fenicsx.discrete.posed import Posed, State
from signorini_fenicsx.discrete.sizes import Sizes
from signorini_fenicsx.discrete.trace_backend import TraceBackend
from signorini_fenicsx.discrete.trace_multigrid import STIFF, facet_solver
from signorini_fenicsx.discrete.vertex_laws import VertexLaws
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.friction import FrictionBounds
from signorini_fenicsx.physics.elasticity.discrete.on_facets import neighbours
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.discrete.tools import Moving
from signorini_fenicsx.physics.elasticity.solve.mean_pressure import BETTER, ENOUGH, FALLS, LEAVES, MOST, STALLS
from signorini_fenicsx.physics.elasticity.solve.rigid_motions import check_rigid_motions, is_free
from signorini_fenicsx.physics.elasticity.solve.system import ElasticSystem
from signorini_fenicsx.physics.elasticity.solve.weak_springs import SPRING, WeakSprings

ROUGH = 1e-2
"""What a rough solve with tools leaves, as a share of what there was at its start."""


class ElasticBackend(TraceBackend):
    """The backend with one condition per facet vertex of Γ_C: p = g − u_n there, and the flux is the pressure −σ_nn.

    ZERO_TRACE is contact, NO_FLUX a free vertex. Under other laws both are measured from a point of the graph, p is
    that of `VertexLaws.openings`, and ROBIN is a spring. After these sites come those with friction, where p = u_t and
    the flux is σ_t: ZERO_TRACE sticks, NO_FLUX with the bound of the shear for its value slips. In space a vertex with
    friction has two of them, for the components of both, and `FrictionBounds.stiffness` is added where it slips.
    """

    name = "elastic"
    pulled: Array | float = 0.0
    lost = 0.0
    spaces: ElasticSpaces
    system: ElasticSystem
    data: ElasticData

    def __init__(
        self,
        spaces: ElasticSpaces,
        data: ElasticData,
        tuning: Tuning | None = None,
        *,
        direct: bool = False,
    ):
        """Assemble and choose the solver (collective).

        Args:
            spaces: The spaces.
            data: The data.
            tuning: Has the size from which CG with multigrid is the default.
            direct: Whether to factorise in any case, without the user's options for the facet system.

        Raises:
            InputError: If PETSc refuses an option.
        """

        def stiff() -> bool:
            return data.stiffness_of_volume(spaces) >= STIFF

        self._slip = spaces.site_kinds["slip"]
        super().__init__(
            ElasticSystem(spaces, data),
            spaces,
            data.fixed,
            neighbours(spaces),
            partial(facet_solver, spaces, tuning, direct=direct, with_normals=stiff),
        )
        self._take(data)

    def _take(self, data: ElasticData) -> None:
        """Take data with this matrix (collective)."""
        spaces, self.data = self.spaces, data
        self._motions = check_rigid_motions(spaces, data) if data.motions is None else data.motions
        self.tools, self._weak = Moving(spaces, data.tools), WeakSprings(SPRING * self.stiffness * self.measure)
        self._state, self._iterations = State.START, 0
        self.corrected_to = 0.0 if self.system.mean is None else LEAVES
        self.sizes = Sizes(self.comm, data.lift, self.stiffness, loaded=self.system.loaded or bool(self.tools))

    @property
    def by_sets(self) -> bool:
        """Whether the law of friction is not that of space, which turns."""
        return not self.friction.in_space

    @property
    def on_facets(self) -> list[tuple[SiteKind, VertexLaws]]:
        """The kinds of sites that have `VertexLaws`: that of friction in the plane where joints have springs."""
        by_springs = self.friction.springs is not None and not self.friction.in_space
        return super().on_facets + ([(self._slip, self.friction.laws)] if by_springs else [])

    @property
    def friction(self) -> FrictionBounds:
        """The present bounds of friction."""
        return self.data.friction

    @friction.setter
    def friction(self, friction: FrictionBounds) -> None:
        self.data = replace(self.data, friction=friction)

    def data_found(self) -> ElasticData:
        """The data with the last bounds of friction, and with the tools where they have moved to (collective)."""
        return self.data.after(self.spaces, self.tools.rho)

    @property
    def inexact(self) -> Inexact | None:
        """The backend itself, as traces cost less than fields; with tools by rough solves, never where laws turn."""
        rough = self.iterates and not self.friction.by_pressure
        return self if self.by_sets and (rough or not self.tools) else None

    @property
    def anchored(self) -> Anchored[Iterate] | None:
        """The backend itself, but in space with friction, whose law turns."""
        return self if self.by_sets else None

    def anchor(self) -> bool:
        """Let weak springs pull as `Anchored.anchor` says (collective)."""
        assert self._last is not None
        p, weak = self.means(self._x), self._weak
        pull = np.abs(weak.pull(self._last.conditions, p) / self.measure)
        self._weak, self._state = WeakSprings(weak.stiffness, p), State.POSED
        return weak.anchor is None or self.sizes.extent(pull, pull)[0] > STEP * self.sizes.largest[1]

    def release(self) -> None:
        """Take the springs away that pull under all conditions."""
        self._weak = WeakSprings(self._weak.stiffness)
        self.turn(self.friction)

    def solve_until(self, conditions: SiteConditions, enough: Callable[[Array, Array], bool]) -> tuple[Array, Array]:
        """Solve as `Inexact.solve_until` says (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        if self.tools:
            self.leave(ROUGH)
            self._solve(conditions)
            self.leave(0.0)
            return self._site_pairs(self._x, conditions)
        return super().solve_until(conditions, enough)

    def solve_near(self, _sites: Mask, _layers: int, _share: float) -> None:
        """There are no solves on patches of bodies: None."""

    def means(self, x: PETSc.Vec) -> Array:
        """The means of −(û_n − r_n) and û_t − r_t at the sites, r the motions of tools."""
        return np.asarray(self._signs * (x.array_r[self._unknowns] - self.tools.at_sites))

    def cleaned(self, conditions: SiteConditions, p: Array, flux: Array) -> tuple[Array, Array]:
        """`SitePairs.p` and `SitePairs.flux` from the means and the flux at the sites."""
        p, flux = super().cleaned(conditions, p, flux)
        slip = self._slip
        slip.of(flux)[:] += self.friction.pressed(flux[slip.pressing]) - self.friction.resisted(slip.of(p))
        return p, flux + self._weak.on_held(conditions, p) / self.measure

    def before_solve(self) -> None:
        """Take the last motions of tools from x, so that iterations start near the body."""
        self._x.array_w[:] = self._x.array_r - self.tools.forget()
        if self._grows:
            self._solver.share = self.corrected_to

    def after_solve(self, posed: Posed, *, ended: bool) -> bool:
        """Let the tools move, and the body with them; keep the volume of an incompressible one (collective)."""
        if self.system.mean is not None and (ended or self._grows):
            ended = self._grow(posed)
        if not self.tools:
            return ended
        self._respond(posed)
        forces = self._factors.forces(self._x) - self.system.load[self._unknowns]
        self._x.array_w[:] = self._x.array_r + self.tools.take(forces)
        return ended and self._solver.share == 0.0

    @property
    def _grows(self) -> bool:
        """Whether the solution of an iterative solve and its mean pressures grow together."""
        return self.system.mean is not None and self.iterates and not self._solver.is_asked

    def _grow(self, posed: Posed) -> bool:
        """Keep the volume of cells; whether solves have come to their end (collective)."""
        left: Array | float = 0.0
        if self._grows:
            load = self._loads(posed)[0]
            self._x.axpy(-1.0, self._held)
            left = self._factors.left(load, self._x, posed.imposed)
            self._x.axpy(1.0, self._held)
            size = LINEAR * np.sqrt(self.comm.allreduce(float(load @ load)))
        assert self.system.mean is not None
        means, pulls, self.lost, left = self._keep_volume(
            self._x, posed, self.system.mean.grown, self.data.lift, left, size if self._grows else 0.0
        )
        self.system.take_means(means, pulls)
        self._solver.share = 0.0
        return not self._grows or self._norm(left) <= size

    def _norm(self, values: Array | float) -> float:
        """The Euclidean norm over all ranks (collective)."""
        return float(np.sqrt(self.comm.allreduce(float(np.vdot(values, values)))))

    def _keep_volume(
        self,
        x: PETSc.Vec,
        posed: Posed,
        wanted: Array,
        lift: Array | float = 0.0,
        left: Array | float = 0.0,
        enough: float = 0.0,
    ) -> tuple[Array, Array, float, Array | float]:
        """Move x by the mean pressures from solve to solve until no cell loses volume, see `mean_pressure`.

        These, their pulls, what is still lost as a share, and what x leaves of the right side; `left` is that at first,
        which has to be `enough` in the end. By an iteration each solve leaves a share, which the next one has as well
        (collective).
        """
        assert self.system.mean is not None
        change, before, stalled = x.duplicate(), (np.inf, np.inf), 0
        sums, pulls, search = (
            np.zeros(len(self.spaces.order)),
            np.zeros(len(self.system.load)),
            self.system.mean.search(),
        )
        to_the_end, self._solver.share = self._solver.share, self.corrected_to if self.iterates else 0.0
        means, share = self.system.means(self.system.everywhere(x.array_r) + lift, wanted)
        for _ in range(MOST):
            over = share / ENOUGH, self._norm(left) / enough if enough > 0 else 0.0
            falls = any(now < last / FALLS for now, last in zip(over, before, strict=True))
            stalled = 0 if falls else stalled + 1
            if max(over) <= 1 or stalled == STALLS:
                break
            way = search.direction(means, again=stalled > 0)
            pull = self.system.pulls_of_means(way)
            change.set(0.0)
            load = left - pull
            self._iterations += self._factors.solve_by_any(load, change, posed.imposed)[0]
            after = self._factors.left(load, change, posed.imposed) if self.iterates else 0.0
            x.axpy(1.0, change)
            last, (means, share) = share, self.system.means(self.system.everywhere(x.array_r) + lift, wanted)
            if (length := search.length(means) if share >= last / FALLS else 1.0) != 1.0:
                x.axpy(length - 1.0, change)
                tried = self.system.means(self.system.everywhere(x.array_r) + lift, wanted)
                if tried[1] < BETTER * share:
                    means, share = tried
                else:
                    x.axpy(1.0 - length, change)
                    length = 1.0
            left = (1.0 - length) * left + length * after
            sums, pulls, before = sums + length * way, pulls + length * pull, over
        change.destroy()
        self._solver.share = to_the_end
        return sums, pulls, share, left

    def _at_rest(self, posed: Posed, load: Array, lift: Array | float, start: Array | None = None) -> PETSc.Vec:
        """`TraceBackend._at_rest` with the volume of cells kept; `pulled` has what mean pressures do (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails, or no such x exists.
        """
        x = super()._at_rest(posed, load, lift, start)
        if self.system.mean is not None:
            self.system.mean.of_response, self.pulled, lost, _ = self._keep_volume(x, posed, self.system.mean.wanted)
            if lost > KKT:
                raise LinearSolveFailure("a pressure that is known up to a constant only has no derivative")
        return x

    def posed(self, conditions: SiteConditions, *, held: bool = False) -> Posed:
        """The problem under these conditions; weak springs are left out if the body is held (collective)."""
        loose = False
        if not held and self._weak.anchor is None:
            means = np.where((conditions.kind == Condition.NO_FLUX)[:, None], 0.0, self._motions)
            self._slip.of(means)[:] += self.friction.held_across(self._slip.of(self._motions))
            loose = is_free(self.comm, means)
        weak = np.where(not held and self._weak.under(conditions, loose=loose), self._weak.stiffness, 0.0)
        posed = super().posed(conditions)
        stiffness, shares = posed.imposed.springs, posed.imposed.shares
        self._slip.of(shares)[:] = self.friction.slopes
        stiffness += np.where(self._near == np.arange(self.sites)[:, None], weak[:, None], 0.0)
        turning = self.friction.stiffness
        self._slip.of(stiffness)[:, : turning.shape[2]] += (
            turning.reshape(-1, turning.shape[2]) * self._slip.measure[:, None]
        )
        imposed = replace(posed.imposed, springs=stiffness, shares=shares)
        return replace(posed, imposed=imposed, weak=weak, loose=loose)

    def site_forces(self, posed: Posed, load: Array) -> Array:
        """What is added to this right side at the sites: forces of laws, shares, and the pull to an anchor."""
        pull = self._signs * self._weak.pull(posed.conditions, 0.0)
        return self.given_forces(posed) + self.pulls(posed, load) + pull

    def _respond(self, posed: Posed) -> None:
        """Find how the body follows the tools under the conditions of the present matrix (collective)."""
        contact, at_rest = posed.conditions.kind == Condition.ZERO_TRACE, self.given_forces(posed)

        def response(move: Array, last: Array | None) -> PETSc.Vec:
            load, lift = np.zeros((2, len(self.system.load)))
            pulled = self.given_forces(posed, -self._signs * move) - at_rest + posed.weak * move
            load[self._unknowns], lift[self._unknowns] = np.where(contact, 0.0, pulled), np.where(contact, move, 0.0)
            return self._at_rest(posed, load, lift, last)

        self.tools.respond(response, self._factors.forces)

    def given_forces(self, posed: Posed, p: Array | float = 0.0) -> Array:
        """The forces of the laws at the sites, see `TraceBackend.given_forces`, those of friction in space as well."""
        forces, slip = super().given_forces(posed, p), self._slip
        slip.of(forces)[:] -= slip.measure * self.friction.resisted(slip.of(np.broadcast_to(p, self.sites)))
        return forces

    def solve_homogeneous(self, conditions: SiteConditions, load: Array, lift: Array | float = 0.0) -> PETSc.Vec:
        """Solve as `TraceBackend.solve_homogeneous`; nothing acts on tools but the body (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        new, x = not self._is_last(conditions), super().solve_homogeneous(conditions, load, lift)
        if self.tools:
            assert self._last is not None
            if new:
                self._respond(self._last)
            x.array_w[:] += self.tools.follow(self._factors.forces(x), loaded=False)[1]
        return x

    def response(self, conditions: SiteConditions, load: Array) -> Array:
        """What a load changes of the flux at the sites, see `TraceBackend.response` (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        if self.tools:
            return self.flux(self.solve_homogeneous(conditions, load), np.zeros_like(load))
        return super().response(conditions, load)

    def follow_bounds(self, forces: Array, slope: Array, share: float) -> Array:
        """Move the solution by the response to forces per area at the sites with friction (collective).

        σ_t also grows with the pressure of its vertex, with a slope. It is for the time after a solve by CG, and leaves
        a share. The result is the change of the flux at all sites.
        """
        assert self._last is not None
        load, x, shares = np.zeros(len(self.system.load)), self._x.duplicate(), np.zeros(self._pressing.shape)
        load[self._slip.unknown], dim = self._slip.measure * forces, self.spaces.dim
        self._slip.of(shares)[:] = slope[:, None] * np.tile(
            np.repeat(np.eye(dim), dim - 1, axis=0), (len(slope) // (dim * (dim - 1)), 1)
        )
        x.set(0.0)
        self._factors.coupled(load, x, replace(self._last.imposed, shares=shares), share)
        self._x.axpy(1.0, x)
        self._state = State.POSED
        return self.flux(x, np.zeros_like(load))

    def turn(self, friction: FrictionBounds) -> None:
        """Take another law of friction."""
        self.friction, self._state = friction, State.START

    def iterate(self, conditions: SiteConditions, sigma: Array, u: Array) -> Iterate:
        """The iterate from the values of σ and u (collective)."""
        spaces = self.spaces
        self.sizes.take(u, sigma)
        means = self.means(self._x)
        p, flux = self.cleaned(conditions, means, self.data.reactions(spaces, sigma, self._slip.of(means)))
        return Iterate(p, flux, self._iterations, spaces.split.stress(sigma), spaces.displacement(u))

    def left_at_sites(self, posed: Posed, x: PETSc.Vec, left: Array) -> None:
        """Add what supports, laws, weak springs and pressure do, see `TraceBackend.left_at_sites`."""
        left -= self.system.of_supports(x.array_r)
        super().left_at_sites(posed, x, left)
        left[self._unknowns] += self._signs * self._weak.pull(posed.conditions, self.means(x))
        pressure = self.flux(x, self.system.load)[self._slip.pressing]
        left[self._slip.unknown] += self._slip.measure * self.friction.pressed(pressure)

    @cached_property
    def change(self) -> FieldChange:
        """Norms of what changed, see `Backend.change`."""
        return FieldChange(self.spaces.split.stresses, self.spaces.displacements)
