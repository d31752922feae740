"""The backend of a system for traces, with a condition per site: a facet, or a vertex of one.

Small systems are factorised, larger ones solved by CG with multigrid.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.tolerances import TIE
from signorini_fenicsx.contact.backend import DataBackend, Iterate
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.contact.sites import SiteKind
from signorini_fenicsx.discrete.hybrid_system import HybridSystem, TraceSystem
from signorini_fenicsx.discrete.posed import Posed, State
from signorini_fenicsx.discrete.sizes import Sizes
from signorini_fenicsx.discrete.vertex_laws import VertexLaws
from signorini_fenicsx.linear.constrained_matrix import ConstrainedMatrix, Imposed
from signorini_fenicsx.linear.corrections import corrected, stepped
from signorini_fenicsx.linear.facet_solver import FacetSolver
from signorini_fenicsx.linear.kept_factors import KeptFactors
from signorini_fenicsx.linear.patch import Patch


class TraceBackend(DataBackend):
    """The backend with one condition per site, for the p and the flux of the kinds of sites in `site_kinds`.

    The laws of the first kind of sites are `VertexLaws`. Subclasses say what the fields are (`iterate`), and what else
    acts at the sites.

    It has the problem of the last solve, and a state that says what x is to it:

        any ──solve, solve_until─────────> ROUGH or SOLVED    x is its solution, up to a share or to the end
        ROUGH ──the same again───────────> goes on from x
        SOLVED ──the same again──────────> nothing is done
        any ──solve_homogeneous, other───> POSED              x is only a start, the solver is set up
        ROUGH, SOLVED ──anchor, follow_bounds──> POSED
        any ──turn, release, renew, a failure──> START        x is only a start, and the laws are others

    Attributes:
        stiffness: The diagonal entry of each site that has an unknown, over its measure.
        measure: |e| of each site, over its vertices.
        sizes: The sizes of the last solution.
        conductance: With what β is compared, see `SiteConditions.clean`.
        exact_to: The jumps of fluxes beside the largest flux at which corrections end.
        corrected_to: The share of them that one correction by an iteration may leave.
        corrects: Whether σ is corrected at all.
    """

    noun = ("vertex", "vertices")
    conductance = np.inf
    exact_to = TIE
    corrected_to = 0.0
    corrects = True
    spaces: Any
    system: TraceSystem
    data: Any
    sizes: Sizes

    def __init__(
        self,
        system: TraceSystem,
        spaces: Any,
        fixed: npt.NDArray[np.int32],
        near: tuple[Indices, Indices],
        choose: Callable[[ConstrainedMatrix], FacetSolver[Any]],
    ):
        """Choose the solver (collective).

        Args:
            system: The system.
            spaces: Its spaces.
            fixed: Owned unknowns that are given under all conditions.
            near: What springs and shares couple, see `KeptFactors`.
            choose: Makes the linear solver.

        Raises:
            InputError: If PETSc refuses an option.
        """
        self.system, self.spaces, self.comm, sites = system, spaces, spaces.mesh.comm, spaces.site_kinds
        self._first, *_ = sites
        self.sites, self._unknowns, self.measure = len(sites), sites.unknown, sites.measure
        self._traces = slice(0, len(sites.unknown))  # sites in cells have no unknown
        self._trace_measures, self._signs = sites.measure[self._traces], sites.sign[self._traces]
        self._operator = operator = ConstrainedMatrix(system.matrix, PETSc.Mat.Option.SPD)
        self.dofs: int = operator.matrix.getSize()[0]
        self._solver, self._near, self._pressing = choose(operator), *near
        dim = spaces.mesh.topology.dim
        self._factors = KeptFactors(self._solver, operator, fixed, self._unknowns, dim, *near)
        self._x, self._held = operator.matrix.createVecs()
        self._x.set(0.0)
        self._last: Posed | None = None
        self._state, self._iterations = State.START, 0
        self.stiffness = system.matrix.getDiagonal().array_r[self._unknowns] / self._trace_measures

    @abstractmethod
    def _take(self, data: Any) -> None:
        """Take data with this matrix (collective)."""

    def renew(self, data: Any) -> bool:
        """Go on with other data, see `Renewable`; False if the matrix is another one (collective)."""
        if not self.system.renew(data):
            return False
        self.before_solve()
        self._take(data)
        if self.iterates and self.by_sets:
            self._factors.earlier.add(self._x)
        self._factors.serve_more()
        return True

    @property
    def cheap(self) -> bool:
        """Whether traces cost little beside a solve, see `Inexact.cheap`."""
        return False

    @property
    def by_traces(self) -> bool:
        """Whether all sites are where traces are, so that these are enough for the next sets."""
        return True

    @property
    def by_sets(self) -> bool:
        """Whether the conditions say all about the laws at the sites."""
        return True

    @abstractmethod
    def iterate(self, conditions: SiteConditions, sigma: Array, u: Array) -> Iterate:
        """The iterate from σ and u as the system recovers them (collective)."""

    def cleaned(self, conditions: SiteConditions, p: Array, flux: Array) -> tuple[Array, Array]:
        """`SitePairs.p` and `SitePairs.flux` from the means and the flux at the sites."""
        p = p.copy()
        for kind, laws in self.with_laws:
            if laws.chains.plain:  # there p' is p
                continue
            segment = laws.chains.segments(kind.of(conditions))
            kind.of(p)[:] = laws.openings(segment, kind.of(p), kind.of(flux))
        return conditions.clean(p, flux, self.conductance)

    @property
    def on_facets(self) -> list[tuple[SiteKind, VertexLaws]]:
        """The kinds of sites on facets that have `VertexLaws`, with these."""
        return [(self._first, self.laws)]

    @property
    def with_laws(self) -> list[tuple[SiteKind, VertexLaws]]:
        """All kinds of sites that have `VertexLaws`, with these."""
        return self.on_facets

    def posed(self, conditions: SiteConditions, *, held: bool = False) -> Posed:
        """The problem under these conditions; `held` if weak springs are to be left out (collective)."""
        conditions = conditions[self._traces]
        some, stiffness = conditions.counts(self.comm)[Condition.ROBIN] > 0, np.zeros(self._near.shape)
        springs = [(kind, laws.springs(kind.of(conditions))) for kind, laws in self.on_facets] if some else []
        for kind, each in springs:
            size = each.stiffness.shape[2]
            kind.of(stiffness)[:, :size] = each.stiffness.reshape(-1, size) * kind.measure[:, None]
        held_sites = conditions.kind == Condition.ZERO_TRACE
        return Posed(conditions, springs, Imposed(held_sites, stiffness, np.zeros(self._pressing.shape)))

    def given_forces(self, posed: Posed, p: Array | float = 0.0) -> Array:
        """The forces of the laws at the sites that are not held, springs with these means of p."""
        flux = np.where(posed.conditions.kind == Condition.NO_FLUX, posed.conditions.value, 0.0)
        for kind, springs in posed.springs:
            kind.of(flux)[:] += springs.pressure(kind.of(np.broadcast_to(p, flux.shape)))
        return np.asarray(self._signs * self._trace_measures * flux)

    def means(self, x: PETSc.Vec) -> Array:
        """The means of p at the sites."""
        return np.asarray(self._signs * x.array_r[self._unknowns])

    def site_forces(self, posed: Posed, load: Array) -> Array:
        """What is added to this right side at the sites for the solution from p = 0."""
        return self.given_forces(posed)

    def left_at_sites(self, posed: Posed, x: PETSc.Vec, left: Array) -> None:
        """Add what acts at the sites in this solution to what forces of σ leave, in place."""
        left[self._unknowns] += self.given_forces(posed, self.means(x))

    def after_solve(self, posed: Posed, *, ended: bool) -> bool:
        """What is done with x after each solve, which may have ended; whether it has then (collective)."""
        return ended

    @property
    def laws(self) -> VertexLaws:
        """The laws of the first kind of sites."""
        laws: VertexLaws = self.data.laws
        return laws

    @property
    def iterates(self) -> bool:
        """Whether the linear solver iterates and may stop early."""
        return self._solver.iterates

    @property
    def to_the_end(self) -> bool:
        """Whether the last solve went to its end, and x is its solution."""
        return self._state is State.SOLVED

    def solve(self, conditions: SiteConditions) -> Iterate:
        """Solve as `Backend.solve` says, starting from the last solution (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        self._solve(conditions)
        return self.recovered(conditions, refine=self.corrects and (self.to_the_end or not self.iterates))

    def leave(self, share: float) -> None:
        """Iterative solves leave this share of what there was at their start from now on; with 0 they go to the end."""
        self._solver.share = share

    def solve_until(self, conditions: SiteConditions, enough: Callable[[Array, Array], bool]) -> tuple[Array, Array]:
        """Solve as `Inexact.solve_until` says (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        if self.by_traces and not (self.to_the_end and self._is_last(conditions)):
            posed = self.posed(conditions)
            load, given = self._loads(posed)
            if (traces := self._factors.at_sites(load, posed.imposed)) is not None:
                p, forces = traces[0] + self._held.array_r[self._unknowns], traces[1] - load[self._unknowns] + given
                return self.cleaned(conditions, self._signs * p, self._signs * forces / self._trace_measures)

        def is_enough(x: PETSc.Vec) -> bool:
            if not conditions.has_values:
                return enough(*self._site_pairs(x, conditions))
            whole = x + self._held
            pairs = self._site_pairs(whole, conditions)
            whole.destroy()  # on several ranks it would wait for the next `PETSc.garbage_cleanup`
            return enough(*pairs)

        with self._solver.stopping(is_enough):
            self._solve(conditions)
        return self._site_pairs(self._x, conditions)

    def reached(self, conditions: SiteConditions) -> Iterate | None:
        """The iterate of the last solve, see `Inexact.reached`; no refinement, as other sets follow (collective)."""
        return self.recovered(conditions, refine=False) if self.iterates else None

    def solve_near(
        self, sites: Mask, layers: int, share: float
    ) -> Callable[[SiteConditions], tuple[Array, Array]] | None:
        """Solves as `Inexact.solve_near` says; None by a factorisation, or with laws in cells (collective)."""
        if not self.iterates or (around := self.around(sites)) is None:
            return None
        patch = Patch(self._operator.matrix, around, layers)

        def solve_on_patch(conditions: SiteConditions) -> tuple[Array, Array]:
            posed, self._state = self.posed(conditions), State.START
            load, _ = self._loads(posed)
            self._x.axpy(-1.0, self._held)
            self._factors.solve_on(patch, load, self._x, posed.imposed)
            self._x.axpy(1.0, self._held)
            return self._site_pairs(self._x, conditions)

        return None if patch.size > share * self.dofs else solve_on_patch

    def around(self, sites: Mask) -> npt.NDArray[np.int32] | None:
        """The owned unknowns of these sites; None where sites are in cells."""
        return self._unknowns[sites].astype(np.int32) if self.by_traces else None

    def _site_pairs(self, x: PETSc.Vec, conditions: SiteConditions) -> tuple[Array, Array]:
        """`SitePairs.p` and `SitePairs.flux`, the latter as what is left of the rows of the sites (collective)."""
        return self.cleaned(conditions, self.means(x), self.flux(x, self.system.load))

    def flux(self, x: PETSc.Vec, load: Array) -> Array:
        """The flux at the sites, as what is left of their rows with this right side (collective)."""
        return np.asarray(self._signs * (self._factors.forces(x) - load[self._unknowns]) / self._trace_measures)

    def _solve(self, conditions: SiteConditions) -> None:
        """Solve, unless the last solve under the same conditions converged (collective)."""
        if self.to_the_end and self._is_last(conditions):
            return
        self.before_solve()
        posed, self._state = self.posed(conditions), State.START
        load, _ = self._loads(posed)
        self._iterations, ended = self._factors.solve_by_any(load, self._x, posed.imposed)
        self._last, self._state = posed, State.POSED
        self._x.axpy(1.0, self._held)
        self._state = State.SOLVED if self.after_solve(posed, ended=ended) else State.ROUGH

    def before_solve(self) -> None:
        """What is done with x, the start of iterations, before each solve."""

    def _is_last(self, conditions: SiteConditions) -> bool:
        """Whether the last problem is that under these conditions, with the present laws (collective)."""
        last = None if self._state is State.START or self._last is None else self._last.conditions
        return conditions[self._traces].same(last, self.comm)

    def _loads(self, posed: Posed) -> tuple[Array, Array]:
        """The right side for the rest of a solution of which `_held` is given, and its part by laws (collective)."""
        conditions, load = posed.conditions, self.system.load.copy()
        self._held.set(0.0)
        if conditions.has_values:
            contact = conditions.kind == Condition.ZERO_TRACE
            self._held.array_w[self._unknowns] = np.where(contact, self._signs * conditions.value, 0.0)
            load -= self._operator.image(self._held)
        given = self.site_forces(posed, load)
        load[self._unknowns] += given
        if posed.loose or (self._last is not None and self._last.loose):
            self._x.set(0.0)  # a body on springs is so far away that it is no start for the next solve
            self._factors.forget()
        return load, given

    def solve_homogeneous(self, conditions: SiteConditions, load: Array, lift: Array | float = 0.0) -> PETSc.Vec:
        """Solve with any right side of the owned unknowns, and values where û is given, by default 0 (collective).

        The last solution stays. Springs pull with their stiffness alone.

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        if not self._is_last(conditions):
            self._last, self._state = self.posed(conditions, held=True), State.POSED
        assert self._last is not None
        return self._at_rest(self._last, load, lift)

    def _at_rest(self, posed: Posed, load: Array, lift: Array | float, start: Array | None = None) -> PETSc.Vec:
        """`solve_homogeneous` under some conditions; iterations begin at the start (collective)."""
        x, given = self._x.duplicate(), self._x.duplicate()
        given.array_w[:] = lift
        x.array_w[:], load = 0.0 if start is None else start - given.array_r, load - self._operator.image(given)
        load[self._unknowns] += self.pulls(posed, load)
        self._factors.solve_by_any(load, x, posed.imposed)
        x.axpy(1.0, given)
        given.destroy()
        return x

    def pulls(self, posed: Posed, load: Array) -> Array:
        """What shares of other sites' forces take from this right side, see `Imposed.shares`."""
        return np.asarray((posed.imposed.shares * load[self._unknowns[self._pressing]]).sum(axis=1))

    def response(self, conditions: SiteConditions, load: Array) -> Array:
        """What a load changes of the flux at the sites, as `solve_homogeneous` solves (collective).

        Raises:
            LinearSolveFailure: If the linear solver fails.
        """
        posed = self._last if self._is_last(conditions) else self.posed(conditions, held=True)
        assert posed is not None
        if (traces := self._factors.at_sites(load, posed.imposed)) is not None:
            return np.asarray(self._signs * traces[1] / self._trace_measures)
        return self.flux(self.solve_homogeneous(conditions, load), np.zeros_like(load))

    def recovered(self, conditions: SiteConditions, *, refine: bool) -> Iterate:
        """The iterate of x, with corrections if these are asked for (collective)."""
        fields = self.system.recover(self.system.with_lift(self._x))
        return self.iterate(conditions, *(self._refined(*fields) if refine else fields))

    def _refined(self, sigma: Array, u: Array) -> tuple[Array, Array]:
        """Correct σ while the jumps of its fluxes might decide about sets and become smaller (collective).

        The σ that x stands for is as exact as x times the stiffness: towards ν = ½ and in flat cells that is much less
        than rounding. Corrections are small, so that their own errors are. The largest force of one cell is the scale;
        those of both cells of a facet cancel, and on the boundary there may be none. Where weak springs hold a body,
        forces are those without them: a correction is a step of the proximal point method, after which they pull no
        more.
        """
        assert self._last is not None
        assert isinstance(self.system, HybridSystem)
        system, posed, change, through = self.system, self._last, self._x.duplicate(), sigma

        def left_by(fields: list[Array]) -> Array:
            nonlocal through
            self._x.array_w[:], through = fields[0], system.through(fields[1])
            left = system.tractions - system.spaces.forces(through)
            self.left_at_sites(posed, self._x, left)
            left[self._factors.essential(posed.conditions.kind == Condition.ZERO_TRACE)] = 0.0
            return left

        def correction(left: Array) -> list[Array]:
            change.set(0.0)
            before, self._solver.share = self._solver.share, self.corrected_to
            self._factors.solve_by_any(left, change, posed.imposed)
            self._solver.share = before
            return [change.array_r.copy(), *system.recover(system.everywhere(change.array_r), with_f=False)]

        def enough(left: Array) -> bool:
            size, scale = self.sizes.extent(np.abs(left), np.abs(through) / system.spaces.dim)
            return size <= self.exact_to * scale

        fields = [self._x.array_r.copy(), sigma, u]
        by = stepped if posed.loose else corrected
        _, sigma, u = by(self.comm, fields, left_by, correction, enough)
        return sigma, u

    def scales(self, _iterate: Any) -> tuple[Array, Array]:
        """The largest |u| and the largest |σ|, see `Backend.scales`."""
        u, sigma = self.sizes.largest
        return np.full(self.sites, u), np.full(self.sites, sigma)
