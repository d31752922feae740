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
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.linear.kept_factors import Imposed, KeptFactors
from signorini_fenicsx.physics.elasticity.data import ElasticData
from signorini_fenicsx.physics.elasticity.friction import FrictionBounds, law_of_sites
from signorini_fenicsx.physics.elasticity.multigrid import DEFAULTS, DIRECT_UP_TO, STIFF, of_facets
from signorini_fenicsx.physics.elasticity.normal_laws import Springs
from signorini_fenicsx.physics.elasticity.on_facets import neighbours
from signorini_fenicsx.physics.elasticity.rigid_motions import is_free
from signorini_fenicsx.physics.elasticity.sizes import Sizes
from signorini_fenicsx.physics.elasticity.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.system import ElasticSystem
from signorini_fenicsx.physics.elasticity.tools import Moving
from signorini_fenicsx.physics.elasticity.weak_springs import SPRING, WeakSprings

MOST_ITERATIONS = 400
"""If CG needs more, it gives way to a factorisation."""
ROUGH = 1e-2
"""What a rough solve with tools leaves, as a share of what there was at its start."""
REFINEMENTS = 40
"""Corrections of a stress at most."""


class ElasticBackend(PlainBackend):
    """Solves under one condition per facet vertex of Γ_C: p = g − u_n there, and the flux is the pressure −σ_nn.

    ZERO_TRACE is contact, NO_FLUX a free vertex. Under other laws both are measured from a point of the graph, p is as
    `NormalLaws.own` has it, and ROBIN is a spring. After these sites come those with friction, where p = u_t and the
    flux is σ_t: ZERO_TRACE sticks, NO_FLUX with the bound of the shear for its value slips. In space a vertex with
    friction has two of them, for the components of both, and `FrictionBounds.stiffness` is added where it slips.

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
        motions: Array | None = None,
        *,
        direct: bool = False,
    ):
        """Assemble and choose the solver (collective).

        Args:
            spaces: The spaces.
            data: The data.
            tuning: Has the size from which CG with multigrid is the default.
            motions: Means of r_n at the sites for each rigid motion that only contact prevents; None for none.
            direct: Whether to factorise in any case, without the user's options for the facet system.

        Raises:
            InputError: If PETSc refuses an option.
        """
        self.spaces, self.data, self.comm = spaces, data, spaces.mesh.comm
        self._unknowns, self.measure = spaces.site_kinds.unknown, spaces.site_kinds.measure
        self.sites = len(self._unknowns)
        self.friction, self._turns = data.friction, data.friction.slipping is not None  # in space σ_t turns
        self.system = ElasticSystem(spaces, data)
        self._operator = ConstrainedMatrix(self.system.matrix, PETSc.Mat.Option.SPD)
        self.dofs = (matrix := self._operator.matrix).getSize()[0]
        large = not direct and (tuning or Tuning()).is_large(self.dofs, DIRECT_UP_TO[spaces.dim])
        make = partial(of_facets, spaces, self._operator, data.stiffness_of_volume(spaces) >= STIFF) if large else None
        prefix, defaults = "certificate_" if direct else "facet_", DEFAULTS[spaces.dim]
        self._solver = FacetSolver(matrix, prefix, defaults, make, MOST_ITERATIONS)
        self._near, self._pressing = neighbours(spaces)
        self._factors = KeptFactors(
            self._solver, self._operator, data.fixed, self._unknowns, spaces.dim, self._near, self._pressing
        )
        self._x, self._held = matrix.createVecs()
        self._x.set(0.0)
        self.tools = Moving(spaces, data.tools)
        self._moved: Array | float = 0.0  # the part of the last solution by the motion of tools
        self._springs: Springs | None = None
        self._motions = np.zeros((self.sites, 0)) if motions is None else motions
        self._iterations, self.to_the_end = 0, False  # of the last solve; did the iteration go to its end?
        self._applied: SiteConditions | None = None
        self._imposed: SiteConditions | None = None  # of the last solve, with `_law`
        self._sprung = False
        diagonal = self.system.matrix.getDiagonal().array_r[self._unknowns]
        self._weak, self.stiffness = WeakSprings(SPRING * diagonal), diagonal / self.measure
        self.sizes = Sizes(self.comm, data.lift, self.stiffness, loaded=self.system.loaded or bool(self.tools))

    @property
    def chains(self) -> Chains:
        """The law of each site, of friction by its present bounds."""
        return law_of_sites(self.spaces, self.data.laws.chains, self.friction)

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
        return self if not self._turns and (rough or not self.tools) else None

    @property
    def anchored(self) -> Anchored[Iterate] | None:
        """The backend itself, but in space with friction, whose law turns."""
        return None if self._turns else self

    def anchor(self) -> bool:
        """Let weak springs pull as `Anchored.anchor` says (collective)."""
        assert self._imposed is not None
        p, weak = self._beside_tools(self._x), self._weak
        pull = np.abs(weak.pull(self._imposed, p) / self.measure)
        self._weak, self._applied = WeakSprings(weak.stiffness, p), None
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
        if not self._has_solved(conditions):
            load, given, _ = self._posed(conditions)
            if (traces := self._factors.at_sites(load, self._at_sites(conditions))) is not None:
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
        laws, normal = self.data.laws, len(self.spaces.sites)
        segment = laws.chains.segments(conditions.take(slice(normal)))
        p = np.append(laws.own(segment, p[:normal], flux[:normal]), p[normal:])
        p, flux = conditions.clean(p, flux, np.inf)
        flux[normal:] += self.friction.pressed(self.spaces.pressure_of(flux)) - self.friction.resisted(p[normal:])
        return p, flux + self._weak.on_held(conditions, p) / self.measure

    def _solve(self, conditions: SiteConditions) -> None:
        """Solve, unless the last solve under the same conditions converged (collective)."""
        if self._has_solved(conditions):
            return
        self._applied = None
        self._x.array_w[:], self._moved = self._x.array_r - self._moved, 0.0
        load, _, loose = self._posed(conditions)
        springs = np.where(sprung := self._weak.under(conditions, loose=loose), self._weak.stiffness, 0.0)
        self._law = self._at_sites(conditions, springs)
        if self._factors.solve(load, self._x, self._law):
            self._iterations, self.to_the_end = 1, True
        else:
            self._iterations, self.to_the_end = self._factors.solve_anew(load, self._x, self._law)
        self._imposed = conditions
        self._x.axpy(1.0, self._held)
        self._sprung = loose
        if self.tools:
            self._respond(conditions, sprung)
            self.to_the_end &= self._solver.share == 0.0
            forces = self._factors.forces(self._x) - self.system.load[self._unknowns]
            self.tools.rho, self._moved = self.tools.follow(forces, loaded=True)
            self._x.array_w[:] = self._x.array_r + self._moved
        self._applied = conditions

    def _has_solved(self, conditions: SiteConditions) -> bool:
        """Whether the last solve was under these conditions, and converged (collective)."""
        return conditions.same(self._applied, self.comm) and self.to_the_end

    def _posed(self, conditions: SiteConditions) -> tuple[Array, Array, bool]:
        """The problem under these conditions, of which `_held` is the part of the solution that is given (collective).

        Returns:
            The right side for the rest, its part by laws at the sites, and whether a motion of the body is free.
        """
        contact, free = (conditions.kind == kind for kind in (Condition.ZERO_TRACE, Condition.NO_FLUX))
        self._take_springs(conditions)
        load, given = self.system.load.copy(), self._given_forces(conditions)
        self._held.set(0.0)
        if conditions.has_values:
            self._held.array_w[self._unknowns] = np.where(contact, self._signs * conditions.value, 0.0)
            load -= self._operator.image(self._held)
        given += self._pulls(load) + self._signs * self._weak.pull(conditions, 0.0)
        load[self._unknowns] += given
        means = np.where(free[:, None], 0.0, self._motions)
        means[len(self.spaces.sites) :] += self.friction.held_across(self._motions[len(self.spaces.sites) :])
        loose = self._weak.anchor is None and is_free(self.comm, means)
        if loose or self._sprung:
            self._x.set(0.0)  # a body on springs is so far away that it is no start for the next solve
            self._factors.forget()
        return load, given, loose

    def _respond(self, conditions: SiteConditions, sprung: Mask) -> None:
        """Find how the body follows the tools under the conditions of the present matrix (collective)."""
        contact, at_rest = conditions.kind == Condition.ZERO_TRACE, self._given_forces(conditions)
        weak = self._weak.stiffness * sprung

        def response(move: Array, last: Array | None) -> PETSc.Vec:
            load, lift = np.zeros((2, len(self.system.load)))
            pulled = self._given_forces(conditions, -self._signs * move) - at_rest + weak * move
            load[self._unknowns], lift[self._unknowns] = np.where(contact, 0.0, pulled), np.where(contact, move, 0.0)
            return self._at_rest(conditions, load, lift, last)

        self.tools.respond(response, self._factors.forces)

    def _take_springs(self, conditions: SiteConditions) -> None:
        """Take the springs under these conditions (collective)."""
        some, normal = conditions.counts(self.comm)[Condition.ROBIN] > 0, slice(len(self.spaces.sites))
        self._springs = self.data.laws.springs(conditions.take(normal)) if some else None

    def _given_forces(self, conditions: SiteConditions, p: Array | float = 0.0) -> Array:
        """The forces of the laws at the sites that are not held, springs with these means of the opening."""
        free, normal = conditions.kind == Condition.NO_FLUX, len(self.spaces.sites)
        flux = np.where(free, conditions.value, 0.0)
        if self._springs is not None:
            flux[:normal] += self._springs.pressure(np.broadcast_to(p, self.sites)[:normal])
        flux[normal:] -= self.friction.resisted(np.broadcast_to(p, self.sites)[normal:])
        return np.asarray(self._signs * self.measure * flux)

    def solve_homogeneous(self, conditions: SiteConditions, load: Array, lift: Array | float = 0.0) -> PETSc.Vec:
        """Solve with any right side of the owned unknowns, and values where û is given, by default 0 (collective).

        The last solution stays. Springs pull with their stiffness alone, and nothing acts on tools but the body.

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        new = not conditions.same(self._imposed, self.comm)
        x = self._at_rest(conditions, load, lift)
        if self.tools:
            if new:
                self._respond(conditions, np.zeros(self.sites, dtype=bool))
            x.array_w[:] += self.tools.follow(self._factors.forces(x), loaded=False)[1]
        return x

    def _at_rest(
        self, conditions: SiteConditions, load: Array, lift: Array | float, start: Array | None = None
    ) -> PETSc.Vec:
        """`solve_homogeneous` with tools at rest; iterations begin at the start (collective)."""
        x, given = self._x.duplicate(), self._x.duplicate()
        given.array_w[:] = lift
        x.array_w[:], load = 0.0 if start is None else start - given.array_r, load - self._operator.image(given)
        if not conditions.same(self._imposed, self.comm):
            self._applied = None
            self._take_springs(conditions)
            self._law = self._at_sites(conditions)
        load[self._unknowns] += self._pulls(load)
        if not self._factors.solve(load, x, self._law):
            self._factors.solve_anew(load, x, self._law)
        self._imposed = conditions
        x.axpy(1.0, given)
        given.destroy()
        return x

    def response(self, conditions: SiteConditions, load: Array) -> Array:
        """What a load changes of the flux at the sites, as `solve_homogeneous` solves (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        if not self.tools:
            if not conditions.same(self._imposed, self.comm):
                self._take_springs(conditions)
            if (traces := self._factors.at_sites(load, self._at_sites(conditions))) is not None:
                return np.asarray(self._signs * traces[1] / self.measure)
        return self.flux(self.solve_homogeneous(conditions, load), np.zeros_like(load))

    def follow_bounds(self, conditions: SiteConditions, forces: Array, slope: Array, share: float) -> Array:
        """Move the solution by the response to forces per area at the sites with friction (collective).

        σ_t also grows with the pressure of its vertex, with a slope. It is for the time after a solve by CG under the
        same conditions, and leaves a share. The result is the change of the flux at all sites.
        """
        load, x = np.zeros(len(self.system.load)), self._x.duplicate()
        load[self.spaces.slip_sites] = self.spaces.slip_measure * forces
        x.set(0.0)
        shares = np.append(np.zeros(len(self.spaces.sites)), slope)
        self._factors.coupled(load, x, replace(self._at_sites(conditions), shares=shares), share)
        self._x.axpy(1.0, x)
        self._applied = None
        return self.flux(x, np.zeros_like(load))

    def turn(self, friction: FrictionBounds) -> None:
        """Take another linear law of friction in space."""
        self.friction = friction
        self._applied = self._imposed = None

    @property
    def is_contact(self) -> bool:
        """Whether there is no other law in the normal direction than contact."""
        return not self.data.laws.of_parts

    @property
    def _signs(self) -> Array:
        """−1 for normal sites, where p and the flux are those of −u_n and −σ_nn, and 1 for those with friction."""
        return np.where(np.arange(self.sites) < len(self.spaces.sites), -1.0, 1.0)

    def _pulls(self, load: Array) -> Array:
        """What the linear law in space takes from this right side, of which the pressure is what is left."""
        return np.asarray(self._shares * load[self._unknowns[self._pressing]])

    @property
    def _shares(self) -> Array:
        """How much of the pressure of its vertex the shear of a site follows; 0 for normal sites."""
        return np.append(np.zeros(len(self.spaces.sites)), self.friction.slopes)

    def _at_sites(self, conditions: SiteConditions, weak: Array | float = 0.0) -> Imposed:
        """What is imposed at the sites: also springs of laws, weak ones, and those of friction in space."""
        number, (sites, width) = len(self.spaces.sites), self._near.shape
        springs = np.where(self._near == np.arange(sites)[:, None], np.reshape(weak, (-1, 1)), 0.0)
        measure = self.measure[:, None]
        if self._springs is not None:
            springs[:number] += self._springs.stiffness.reshape(-1, width) * measure[:number]
        if self._turns:
            springs[number:, :2] += self.friction.stiffness.reshape(-1, 2) * measure[number:]
        return Imposed(conditions.kind == Condition.ZERO_TRACE, springs, self._shares)

    def _recovered(self, conditions: SiteConditions, *, refine: bool = True) -> Iterate:
        spaces = self.spaces
        stresses, displacements = self.system.recover(self.system.everywhere(self._x.array_r) + self.data.lift)
        if refine:
            stresses, displacements = self._refined(conditions, stresses, displacements)
        p, flux = self._cleaned(conditions, self._beside_tools(self._x), self.data.reactions(spaces, stresses))
        self.sizes.take(displacements, stresses)
        return Iterate(p, flux, self._iterations, spaces.split.stress(stresses), spaces.displacement(displacements))

    def _refined(self, conditions: SiteConditions, stresses: Array, displacements: Array) -> tuple[Array, Array]:
        """Correct the stress while the jumps of its tractions might decide about sets and become smaller (collective).

        The stress that x stands for is as exact as x times the stiffness: towards ν = ½ and in flat cells that is much
        less than rounding. Corrections are small, so that their own errors are. Where weak springs hold it, forces
        are those without them: a correction is a step of the proximal point method, after which they pull no more.
        """
        contact, spaces = conditions.kind == Condition.ZERO_TRACE, self.spaces
        correction, before = self._x.duplicate(), np.inf
        for _ in range(REFINEMENTS):
            forces = self.system.forces(stresses)
            left = self.system.tractions - self.system.of_supports(self._x.array_r) - forces
            p = self._beside_tools(self._x)
            left[self._unknowns] += self._given_forces(conditions, p) + self._signs * self._weak.pull(conditions, p)
            pressure = spaces.pressure_of(self.flux(self._x, self.system.load))
            left[spaces.slip_sites] += spaces.slip_measure * self.friction.pressed(pressure)
            left[self._factors.essential(contact)] = 0.0
            size, scale = self.sizes.extent(np.abs(left), np.abs(forces))
            if size <= TIE * scale or not size < before:
                break
            correction.set(0.0)
            if not self._factors.solve(left, correction, self._law):
                self._factors.solve_anew(left, correction, self._law)
            before = size
            more, moved = self.system.recover(self.system.everywhere(correction.array_r), with_f=False)
            stresses, displacements = stresses + more, displacements + moved
            self._x.axpy(1.0, correction)
        return stresses, displacements

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
