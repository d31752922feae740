"""The elastic backend: the facet system with a contact condition per facet vertex of Γ_C.

Small systems are factorised, larger ones solved by CG with multigrid.

Where only contact holds the body, a set on the way may be too small for that. Then weak springs hold the free sites;
under the load they give way so far that the next set is larger. No result has springs: its residuals would be large.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial

import numpy as np
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.tolerances import STEP, TIE
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.backend import Anchored, Inexact, Iterate, Pairs, PlainBackend
from signorini_fenicsx.contact.chains import Chains
from signorini_fenicsx.contact.conditions import Condition, SiteConditions
from signorini_fenicsx.discrete.field_change import FieldChange
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix
from signorini_fenicsx.linear.corrections import corrected, stepped
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.linear.kept_factors import Imposed, KeptFactors
from signorini_fenicsx.physics.elasticity.discrete.data import ElasticData
from signorini_fenicsx.physics.elasticity.discrete.friction import FrictionBounds, law_of_sites
from signorini_fenicsx.physics.elasticity.discrete.normal_laws import Springs
from signorini_fenicsx.physics.elasticity.discrete.on_facets import neighbours
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.discrete.tools import Moving
from signorini_fenicsx.physics.elasticity.solve.multigrid import DEFAULTS, DIRECT_UP_TO, STIFF, of_facets
from signorini_fenicsx.physics.elasticity.solve.posed import Posed, State
from signorini_fenicsx.physics.elasticity.solve.rigid_motions import check_rigid_motions, is_free
from signorini_fenicsx.physics.elasticity.solve.sizes import Sizes
from signorini_fenicsx.physics.elasticity.solve.system import ElasticSystem
from signorini_fenicsx.physics.elasticity.solve.weak_springs import SPRING, WeakSprings

MOST_ITERATIONS = 400
"""If CG needs more, it gives way to a factorisation."""
ROUGH = 1e-2
"""What a rough solve with tools leaves, as a share of what there was at its start."""


class ElasticBackend(PlainBackend):
    """Solves under one condition per facet vertex of Γ_C: p = g − u_n there, and the flux is the pressure −σ_nn.

    ZERO_TRACE is contact, NO_FLUX a free vertex. Under other laws both are measured from a point of the graph, p is as
    `NormalLaws.own` has it, and ROBIN is a spring. After these sites come those with friction, where p = u_t and the
    flux is σ_t: ZERO_TRACE sticks, NO_FLUX with the bound of the shear for its value slips. In space a vertex with
    friction has two of them, for the components of both, and `FrictionBounds.stiffness` is added where it slips.

    It has the problem of the last solve, and a state that says what x is to it:

        any ──solve, solve_until─────────> ROUGH or SOLVED    x is its solution, up to a share or to the end
        ROUGH ──the same again───────────> goes on from x
        SOLVED ──the same again──────────> nothing is done
        any ──solve_homogeneous, other───> POSED              x is only a start, the solver is set up
        ROUGH, SOLVED ──anchor, follow_bounds──> POSED
        any ──turn, release, renew, a failure──> START        x is only a start, and the laws are others

    Attributes:
        stiffness: The diagonal entry of each site over its measure.
        measure: |e| of each site, over its vertices.
        sizes: The sizes of the last solution.
    """

    name = "elastic"
    noun = ("vertex", "vertices")
    cheap = False

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
        self.spaces, self.comm = spaces, spaces.mesh.comm
        self._normal, self._slip = sites = spaces.site_kinds
        self.sites, self._unknowns, self.measure, self._signs = len(sites), sites.unknown, sites.measure, sites.sign
        self.system = ElasticSystem(spaces, data)
        self._operator = ConstrainedMatrix(self.system.matrix, PETSc.Mat.Option.SPD)
        self.dofs = (matrix := self._operator.matrix).getSize()[0]
        large = not direct and (tuning or Tuning()).is_large(self.dofs, DIRECT_UP_TO[spaces.dim])
        make = partial(of_facets, spaces, self._operator, data.stiffness_of_volume(spaces) >= STIFF) if large else None
        prefix, defaults = "certificate_" if direct else "facet_", DEFAULTS[spaces.dim]
        self._solver = FacetSolver(matrix, prefix, defaults, make, MOST_ITERATIONS)
        near = self._near, self._pressing = neighbours(spaces)
        self._factors = KeptFactors(self._solver, self._operator, data.fixed, self._unknowns, spaces.dim, *near)
        self._x, self._held = matrix.createVecs()
        self._x.set(0.0)
        self._last: Posed | None = None
        self.stiffness = self.system.matrix.getDiagonal().array_r[self._unknowns] / self.measure
        self._take(data)

    def _take(self, data: ElasticData) -> None:
        """Take data with this matrix (collective)."""
        spaces, self.data, self.friction = self.spaces, data, data.friction
        self._motions = check_rigid_motions(spaces, data) if data.motions is None else data.motions
        self.tools, self._weak = Moving(spaces, data.tools), WeakSprings(SPRING * self.stiffness * self.measure)
        self._state, self._iterations = State.START, 0
        self.sizes = Sizes(self.comm, data.lift, self.stiffness, loaded=self.system.loaded or bool(self.tools))

    def renew(self, data: ElasticData) -> bool:
        """Go on with other data, see `Renewable`; False if the matrix is another one (collective)."""
        if not self.system.renew(data):
            return False
        self._x.array_w[:] = self._x.array_r - self.tools.forget()
        if self.iterates and data.friction.slipping is None:
            self._factors.earlier.add(self._x)
        self._factors.serve_more()
        self._take(data)
        return True

    @property
    def chains(self) -> Chains:
        """The law of each site, of friction by its present bounds."""
        return law_of_sites(self.data.laws.chains, self.friction)

    def data_found(self) -> ElasticData:
        """The data with the last bounds of friction, and with the tools where they have moved to (collective)."""
        return replace(self.data.after(self.spaces, self.tools.rho), friction=self.friction)

    @property
    def iterates(self) -> bool:
        """Whether the linear solver iterates and may stop early."""
        return self._solver.iterates

    @property
    def inexact(self) -> Inexact | None:
        """The backend itself, as traces cost less than fields; with tools by rough solves, never where laws turn."""
        rough = self.iterates and not self.friction.by_pressure
        return self if self.friction.slipping is None and (rough or not self.tools) else None

    @property
    def anchored(self) -> Anchored[Iterate] | None:
        """The backend itself, but in space with friction, whose law turns."""
        return self if self.friction.slipping is None else None

    @property
    def to_the_end(self) -> bool:
        """Whether the last solve went to its end, and x is its solution."""
        return self._state is State.SOLVED

    def anchor(self) -> bool:
        """Let weak springs pull as `Anchored.anchor` says (collective)."""
        assert self._last is not None
        p, weak = self._beside_tools(self._x), self._weak
        pull = np.abs(weak.pull(self._last.conditions, p) / self.measure)
        self._weak, self._state = WeakSprings(weak.stiffness, p), State.POSED
        return weak.anchor is None or self.sizes.extent(pull, pull)[0] > STEP * self.sizes.largest[1]

    def release(self) -> None:
        """Take the springs away that pull under all conditions."""
        self._weak = WeakSprings(self._weak.stiffness)
        self.turn(self.friction)

    def solver(self) -> str:
        """Name of the linear solver in use, after the user's PETSc options."""
        return self._solver.name()

    def solve(self, conditions: SiteConditions) -> Iterate:
        """Solve as `Backend.solve` says, starting from the last solution (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        self._solve(conditions)
        return self._recovered(conditions, refine=self.to_the_end or not self.iterates)

    def leave(self, share: float) -> None:
        """Iterative solves leave this share of what there was at their start from now on; with 0 they go to the end."""
        self._solver.share = share

    def solve_until(self, conditions: SiteConditions, enough: Callable[[Array, Array], bool]) -> tuple[Array, Array]:
        """Solve as `Inexact.solve_until` says (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        if self.tools:
            self.leave(ROUGH)
            self._solve(conditions)
            self.leave(0.0)
            return self._pairs(self._x, conditions)
        if not (self.to_the_end and self._is_last(conditions)):
            posed = self._pose(conditions)
            load, given = self._loads(posed)
            if (traces := self._factors.at_sites(load, posed.imposed)) is not None:
                p, forces = traces[0] + self._held.array_r[self._unknowns], traces[1] - load[self._unknowns] + given
                return self._cleaned(conditions, self._signs * p, self._signs * forces / self.measure)

        def is_enough(x: PETSc.Vec) -> bool:
            whole = x + self._held
            pairs = self._pairs(whole, conditions)
            whole.destroy()  # on several ranks it would wait for the next `PETSc.garbage_cleanup`
            return enough(*pairs)

        with self._solver.stopping(is_enough):
            self._solve(conditions)
        return self._pairs(self._x, conditions)

    def reached(self, conditions: SiteConditions) -> Iterate | None:
        """The iterate of the last solve, see `Inexact.reached`; no refinement, as other sets follow (collective)."""
        return self._recovered(conditions, refine=False) if self.iterates else None

    def solve_near(self, _sites: Mask, _layers: int, _share: float) -> None:
        """Elastic contact has no solves on patches: None."""

    def _pairs(self, x: PETSc.Vec, conditions: SiteConditions) -> tuple[Array, Array]:
        """`Pairs.p` and `Pairs.flux`, the latter as what is left of the rows of the sites (collective)."""
        return self._cleaned(conditions, self._beside_tools(x), self.flux(x, self.system.load))

    def _beside_tools(self, x: PETSc.Vec) -> Array:
        """The means of −(û_n − r_n) and û_t − r_t at the sites, r the motions of tools."""
        return np.asarray(self._signs * (x.array_r[self._unknowns] - self.tools.at_sites))

    def flux(self, x: PETSc.Vec, load: Array) -> Array:
        """The flux at the sites, as what is left of their rows with this right side (collective)."""
        return np.asarray(self._signs * (self._factors.forces(x) - load[self._unknowns]) / self.measure)

    def _cleaned(self, conditions: SiteConditions, p: Array, flux: Array) -> tuple[Array, Array]:
        """`Pairs.p` and `Pairs.flux` from the means and the flux at the sites."""
        laws, normal, slip = self.data.laws, self._normal, self._slip
        segment, p = laws.chains.segments(normal.of(conditions)), p.copy()
        normal.of(p)[:] = laws.own(segment, normal.of(p), normal.of(flux))
        p, flux = conditions.clean(p, flux, np.inf)
        slip.of(flux)[:] += self.friction.pressed(flux[slip.pressing]) - self.friction.resisted(slip.of(p))
        return p, flux + self._weak.on_held(conditions, p) / self.measure

    def _solve(self, conditions: SiteConditions) -> None:
        """Solve, unless the last solve under the same conditions converged (collective)."""
        if self.to_the_end and self._is_last(conditions):
            return
        self._x.array_w[:] = self._x.array_r - self.tools.forget()
        posed, self._state = self._pose(conditions), State.START
        load, _ = self._loads(posed)
        self._iterations, ended = self._factors.solve_by_any(load, self._x, posed.imposed)
        self._last, self._state = posed, State.POSED
        self._x.axpy(1.0, self._held)
        if self.tools:
            self._respond(posed)
            ended &= self._solver.share == 0.0
            forces = self._factors.forces(self._x) - self.system.load[self._unknowns]
            self._x.array_w[:] = self._x.array_r + self.tools.take(forces)
        self._state = State.SOLVED if ended else State.ROUGH

    def _is_last(self, conditions: SiteConditions) -> bool:
        """Whether the last problem is that under these conditions, with the present laws (collective)."""
        last = None if self._state is State.START or self._last is None else self._last.conditions
        return conditions.same(last, self.comm)

    def _pose(self, conditions: SiteConditions, *, held: bool = False) -> Posed:
        """The problem under these conditions; weak springs are left out if the body is held (collective)."""
        some, loose = conditions.counts(self.comm)[Condition.ROBIN] > 0, False
        if not held and self._weak.anchor is None:
            means = np.where((conditions.kind == Condition.NO_FLUX)[:, None], 0.0, self._motions)
            self._slip.of(means)[:] += self.friction.held_across(self._slip.of(self._motions))
            loose = is_free(self.comm, means)
        weak = np.where(not held and self._weak.under(conditions, loose=loose), self._weak.stiffness, 0.0)
        springs = self.data.laws.springs(self._normal.of(conditions)) if some else None
        return Posed(conditions, springs, weak, loose, self._at_sites(conditions, springs, weak))

    def _loads(self, posed: Posed) -> tuple[Array, Array]:
        """The right side for the rest of a solution of which `_held` is given, and its part by laws (collective)."""
        conditions, load, given = posed.conditions, self.system.load.copy(), self._given_forces(posed)
        self._held.set(0.0)
        if conditions.has_values:
            contact = conditions.kind == Condition.ZERO_TRACE
            self._held.array_w[self._unknowns] = np.where(contact, self._signs * conditions.value, 0.0)
            load -= self._operator.image(self._held)
        given += self._pulls(load) + self._signs * self._weak.pull(conditions, 0.0)
        load[self._unknowns] += given
        if posed.loose or (self._last is not None and self._last.loose):
            self._x.set(0.0)  # a body on springs is so far away that it is no start for the next solve
            self._factors.forget()
        return load, given

    def _respond(self, posed: Posed) -> None:
        """Find how the body follows the tools under the conditions of the present matrix (collective)."""
        contact, at_rest = posed.conditions.kind == Condition.ZERO_TRACE, self._given_forces(posed)

        def response(move: Array, last: Array | None) -> PETSc.Vec:
            load, lift = np.zeros((2, len(self.system.load)))
            pulled = self._given_forces(posed, -self._signs * move) - at_rest + posed.weak * move
            load[self._unknowns], lift[self._unknowns] = np.where(contact, 0.0, pulled), np.where(contact, move, 0.0)
            return self._at_rest(posed, load, lift, last)

        self.tools.respond(response, self._factors.forces)

    def _given_forces(self, posed: Posed, p: Array | float = 0.0) -> Array:
        """The forces of the laws at the sites that are not held, springs with these means of the opening."""
        flux = np.where(posed.conditions.kind == Condition.NO_FLUX, posed.conditions.value, 0.0)
        p = np.broadcast_to(p, self.sites)
        if posed.springs is not None:
            self._normal.of(flux)[:] += posed.springs.pressure(self._normal.of(p))
        self._slip.of(flux)[:] -= self.friction.resisted(self._slip.of(p))
        return np.asarray(self._signs * self.measure * flux)

    def solve_homogeneous(self, conditions: SiteConditions, load: Array, lift: Array | float = 0.0) -> PETSc.Vec:
        """Solve with any right side of the owned unknowns, and values where û is given, by default 0 (collective).

        The last solution stays. Springs pull with their stiffness alone, and nothing acts on tools but the body.

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        if new := not self._is_last(conditions):
            self._last, self._state = self._pose(conditions, held=True), State.POSED
        assert self._last is not None
        x = self._at_rest(self._last, load, lift)
        if self.tools:
            if new:
                self._respond(self._last)
            x.array_w[:] += self.tools.follow(self._factors.forces(x), loaded=False)[1]
        return x

    def _at_rest(self, posed: Posed, load: Array, lift: Array | float, start: Array | None = None) -> PETSc.Vec:
        """`solve_homogeneous` with tools at rest; iterations begin at the start (collective)."""
        x, given = self._x.duplicate(), self._x.duplicate()
        given.array_w[:] = lift
        x.array_w[:], load = 0.0 if start is None else start - given.array_r, load - self._operator.image(given)
        load[self._unknowns] += self._pulls(load)
        self._factors.solve_by_any(load, x, posed.imposed)
        x.axpy(1.0, given)
        given.destroy()
        return x

    def response(self, conditions: SiteConditions, load: Array) -> Array:
        """What a load changes of the flux at the sites, as `solve_homogeneous` solves (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        if not self.tools:
            posed = self._last if self._is_last(conditions) else self._pose(conditions, held=True)
            assert posed is not None
            if (traces := self._factors.at_sites(load, posed.imposed)) is not None:
                return np.asarray(self._signs * traces[1] / self.measure)
        return self.flux(self.solve_homogeneous(conditions, load), np.zeros_like(load))

    def follow_bounds(self, forces: Array, slope: Array, share: float) -> Array:
        """Move the solution by the response to forces per area at the sites with friction (collective).

        σ_t also grows with the pressure of its vertex, with a slope. It is for the time after a solve by CG, and leaves
        a share. The result is the change of the flux at all sites.
        """
        assert self._last is not None
        load, x, shares = np.zeros(len(self.system.load)), self._x.duplicate(), np.zeros(self.sites)
        load[self._slip.unknown], self._slip.of(shares)[:] = self._slip.measure * forces, slope
        x.set(0.0)
        self._factors.coupled(load, x, replace(self._last.imposed, shares=shares), share)
        self._x.axpy(1.0, x)
        self._state = State.POSED
        return self.flux(x, np.zeros_like(load))

    def turn(self, friction: FrictionBounds) -> None:
        """Take another law of friction."""
        self.friction, self._state = friction, State.START

    def _pulls(self, load: Array) -> Array:
        """What the linear law in space takes from this right side, of which the pressure is what is left."""
        return np.asarray(self._shares * load[self._unknowns[self._pressing]])

    @property
    def _shares(self) -> Array:
        """How much of the pressure of its vertex the shear of a site follows; 0 for normal sites."""
        return np.append(np.zeros(len(self._normal)), self.friction.slopes)

    def _at_sites(self, conditions: SiteConditions, springs: Springs | None, weak: Array) -> Imposed:
        """What is imposed at the sites: also springs of laws, weak ones, and those of friction in space."""
        sites, width = self._near.shape
        stiffness = np.where(self._near == np.arange(sites)[:, None], weak[:, None], 0.0)
        if springs is not None:
            self._normal.of(stiffness)[:] += springs.stiffness.reshape(-1, width) * self._normal.measure[:, None]
        if self.friction.slipping is not None:
            turning = self.friction.stiffness.reshape(-1, 2) * self._slip.measure[:, None]
            self._slip.of(stiffness)[:, :2] += turning
        return Imposed(conditions.kind == Condition.ZERO_TRACE, stiffness, self._shares)

    def _recovered(self, conditions: SiteConditions, *, refine: bool = True) -> Iterate:
        spaces = self.spaces
        stresses, displacements = self.system.recover(self.system.everywhere(self._x.array_r) + self.data.lift)
        if refine:
            stresses, displacements = self._refined(stresses, displacements)
        p, flux = self._cleaned(conditions, self._beside_tools(self._x), self.data.reactions(spaces, stresses))
        self.sizes.take(displacements, stresses)
        return Iterate(p, flux, self._iterations, spaces.split.stress(stresses), spaces.displacement(displacements))

    def _refined(self, stresses: Array, displacements: Array) -> tuple[Array, ...]:
        """Correct the stress while the jumps of its tractions might decide about sets and become smaller (collective).

        The stress that x stands for is as exact as x times the stiffness: towards ν = ½ and in flat cells that is much
        less than rounding. Corrections are small, so that their own errors are. Where weak springs hold it, forces
        are those without them: a correction is a step of the proximal point method, after which they pull no more.
        """
        assert self._last is not None
        posed, change, forces = self._last, self._x.duplicate(), stresses

        def left_by(fields: list[Array]) -> Array:
            nonlocal forces
            self._x.array_w[:], forces = fields[0], self.system.forces(fields[1])
            left = self.system.tractions - self.system.of_supports(fields[0]) - forces
            p = self._beside_tools(self._x)
            left[self._unknowns] += self._given_forces(posed, p) + self._signs * self._weak.pull(posed.conditions, p)
            pressure = self.flux(self._x, self.system.load)[self._slip.pressing]
            left[self._slip.unknown] += self._slip.measure * self.friction.pressed(pressure)
            left[self._factors.essential(posed.conditions.kind == Condition.ZERO_TRACE)] = 0.0
            return left

        def correction(left: Array) -> list[Array]:
            change.set(0.0)
            self._factors.solve_by_any(left, change, posed.imposed)
            return [change.array_r.copy(), *self.system.recover(self.system.everywhere(change.array_r), with_f=False)]

        def enough(left: Array) -> bool:
            size, scale = self.sizes.extent(np.abs(left), np.abs(forces))
            return size <= TIE * scale

        fields = [self._x.array_r.copy(), stresses, displacements]
        by = stepped if posed.loose else corrected
        return tuple(by(self.comm, fields, left_by, correction, enough)[1:])

    def scales(self, pairs: Pairs) -> tuple[Array, Array]:
        """The largest |u| and the largest |σ|, see `Backend.scales`."""
        u, sigma = self.sizes.largest
        return np.full(self.sites, u), np.full(self.sites, sigma)

    @cached_property
    def change(self) -> FieldChange:
        """Norms of what changed, see `Backend.change`."""
        return FieldChange(self.spaces.split.stresses, self.spaces.displacements)

    def places(self) -> Array:
        """The places of the sites, see `ElasticSpaces.places`."""
        return self.spaces.places
