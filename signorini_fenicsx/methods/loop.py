"""The loop that all active/inactive-set algorithms share: rule, solve, until the facet sets repeat.

*Ties.* Where p and σ·n are both rounding (biactive facets, symmetry, no load), a facet keeps its condition; the start,
which is no decision, counts as p = σ·n = 0 there. What rounding is, `ties` defines.

*Cycles.* Each set determines the next one, so a set that comes back comes back for ever. Every rule is principal
pivoting for a linear complementarity problem, p ≥ 0, Sp − g ≥ 0, one of them 0 on each facet, with the Schur complement
S on Γ_S; for the penalties in the shifted quantities of `Penalty.shift`, with (S⁻¹ + ε/|e|)⁻¹ or S + ε|e|. These
matrices are symmetric and positive definite. Then changing one facet at a time, the last in a fixed order of those that
want to change, ends after finitely many steps (Murty); and so does changing all of them whenever they have become fewer
than ever, and one at a time else (Júdice and Pires, Computers & Operations Research 21, 1994). That is what the loop
does from the first repetition on.
"""

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from mpi4py import MPI

from signorini_fenicsx.backends.contract import Backend, Iterate, LinearSolveFailure
from signorini_fenicsx.base.signals import LoopInterruption
from signorini_fenicsx.discrete.conditions import Condition, FacetConditions
from signorini_fenicsx.discrete.data import Data
from signorini_fenicsx.discrete.spaces import Spaces
from signorini_fenicsx.forms.mixed import flux_product
from signorini_fenicsx.forms.norms import l2, v_norm
from signorini_fenicsx.methods.registry import Algorithm

TIE = 1e-11
"""Values below this share of their scale are rounding: ten times what linear solvers leave (1e-12), and a wrong sign of
that size stays far below what the KKT residuals allow (1e-8)."""


@dataclass(frozen=True)
class Step:
    """One row of the history: iteration n of the algorithm, the start solve being n = 0 and not listed.

    Attributes:
        iteration: n, from 1.
        no_flux: Γ_S facets with σ·n = 0.
        zero_trace: Γ_S facets with p = 0.
        robin: Γ_S facets with σ·n + βp = 0.
        changed: Facets whose condition differs from iteration n − 1.
        clipped: Facets whose negative σ·n Algorithm 3 set to 0 (36).
        sigma_change: ‖σ^(n) − σ^(n−1)‖_V.
        u_change: ‖u^(n) − u^(n−1)‖_Q.
        linear_iterations: Iterations of the linear solver under these conditions; a set that repeats shows those of
            its only solve.
        seconds: Wall time of the iteration.
    """

    iteration: int
    no_flux: int
    zero_trace: int
    robin: int
    changed: int
    clipped: int
    sigma_change: float
    u_change: float
    linear_iterations: int
    seconds: float


@dataclass(frozen=True)
class Outcome:
    """How a solve ended.

    Attributes:
        iterate: Last solution.
        conditions: Facet conditions it was solved with.
        history: One step per iteration.
        reason: Why it ended, in words.
        converged: Whether the sets settled.
        backend: Name of the discrete system it was solved with.
        dofs: Unknowns of the linear systems.
        linear_solver: Name of their solver.
        own_residual: Largest residual of the discrete problem that the method solves, scale-free, where that is neither
            (9) nor a penalty of it: what is judged then instead of the KKT residuals.
        details: Numbers of its own that the method chose or found, such as ρ.
        rough_steps: Solves that went before to predict the sets and were stopped early.
    """

    iterate: Iterate
    conditions: FacetConditions
    history: list[Step]
    reason: str
    converged: bool
    backend: str
    dofs: int
    linear_solver: str
    own_residual: float | None = None
    details: dict[str, float] = field(default_factory=dict)
    rough_steps: int = 0


class History:
    """Builds the history: one step per iteration, its conditions compared with those before."""

    def __init__(self, spaces: Spaces, conditions: FacetConditions, on_step: Callable[[Step], None]):
        """Begin with the start, which is not a step itself.

        Args:
            spaces: The discrete spaces.
            conditions: Facet conditions of the start.
            on_step: Called on all ranks with each step.
        """
        self.steps: list[Step] = []
        self._comm = spaces.mesh.comm
        self._last_conditions, self._on_step = conditions, on_step
        self._began = time.perf_counter()

    def append(
        self,
        conditions: FacetConditions,
        sigma_change: float,
        u_change: float,
        *,
        linear_iterations: int = 1,
        clipped: int = 0,
    ) -> None:
        """Record an iteration by its conditions and the norms of what it changed (collective)."""
        counts = conditions.counts(self._comm)
        now = time.perf_counter()
        step = Step(
            iteration=len(self.steps) + 1,
            no_flux=counts[Condition.NO_FLUX],
            zero_trace=counts[Condition.ZERO_TRACE],
            robin=counts[Condition.ROBIN],
            changed=int(conditions.changes([self._last_conditions], self._comm)[0]),
            clipped=clipped,
            sigma_change=sigma_change,
            u_change=u_change,
            linear_iterations=linear_iterations,
            seconds=now - self._began,
        )
        self.steps.append(step)
        self._last_conditions, self._began = conditions, now
        self._on_step(step)


class Recorder(History):
    """A history of iterates in V_h × Q_h, each compared with the one before."""

    def __init__(self, spaces: Spaces, iterate: Iterate, conditions: FacetConditions, on_step: Callable[[Step], None]):
        """Begin with the start, which is not a step itself (collective).

        Args:
            spaces: The discrete spaces.
            iterate: The start.
            conditions: Its facet conditions.
            on_step: Called on all ranks with each step.
        """
        self._last = iterate
        self._sigma, self._u = fem.Function(spaces.V), fem.Function(spaces.Q)
        self._norms = [fem.form(v_norm(self._sigma, ufl.dx)), fem.form(l2(self._u, ufl.dx))]
        super().__init__(spaces, conditions, on_step)

    def add(self, iterate: Iterate, conditions: FacetConditions, *, clipped: int = 0) -> None:
        """Record an iteration (collective)."""
        sigma_change = u_change = 0.0
        if iterate is not self._last:
            self._sigma.x.array[:] = iterate.sigma.x.array - self._last.sigma.x.array
            self._u.x.array[:] = iterate.u.x.array - self._last.u.x.array
            local = np.array([fem.assemble_scalar(form) for form in self._norms])
            sigma_change, u_change = np.sqrt(self._comm.allreduce(local)).tolist()
        self._last = iterate
        with reached(lambda: iterate, conditions, self.steps):
            self.append(
                conditions, sigma_change, u_change, linear_iterations=iterate.linear_iterations, clipped=clipped
            )


@contextlib.contextmanager
def reached(iterate: Callable[[], Iterate], conditions: FacetConditions, history: list[Step]) -> Iterator[None]:
    """Tell an interruption that comes with a step what the loop has reached (collective)."""
    try:
        yield
    except LoopInterruption as interruption:
        interruption.state = (iterate(), conditions, history)
        raise


class FluxClip:
    """Step 3 of Algorithm 3: σ·n ≥ q_S on the ROBIN facets (36), and the trace that belongs to it (37)."""

    def __init__(self, spaces: Spaces, data: Data):
        self._spaces = spaces
        self._change = fem.Function(spaces.V)
        self._form = fem.form(flux_product(self._change, ufl.TestFunction(spaces.V), ufl.dx, data.kappa_h))

    def __call__(self, iterate: Iterate, conditions: FacetConditions) -> tuple[Iterate, int]:
        """Clip an iterate (collective).

        A clipped flux moves p on every Γ_S facet of its cell, by (κ_h⁻¹δσ, τ_h) of that facet's basis function τ_h.

        Returns:
            The clipped iterate and the number of clipped facets over all ranks.
        """
        spaces = self._spaces
        negative = (conditions.kind == Condition.ROBIN) & (iterate.flux < 0)
        clipped = spaces.mesh.comm.allreduce(int(np.count_nonzero(negative)))
        if clipped == 0:
            return iterate, 0
        self._change.x.array[:] = 0.0
        change = -iterate.flux * spaces.facet_measure / spaces.basis_flux
        self._change.x.array[spaces.flux_dofs[negative]] = change[negative]
        sigma = iterate.sigma.copy()
        sigma.x.array[:] += self._change.x.array
        moved = fem.assemble_vector(self._form)
        moved.scatter_reverse(la.InsertMode.add)
        p = iterate.p + moved.array[spaces.flux_dofs] / spaces.basis_flux
        return replace(iterate, sigma=sigma, p=p, flux=np.where(negative, 0.0, iterate.flux)), clipped


def ties(spaces: Spaces, data: Data, iterate: Iterate) -> npt.NDArray[np.bool_]:
    """The Γ_S facets of this rank whose p and σ·n are both rounding (collective).

    The scale of p is the largest |u| in Ω or |p| on Γ_S, that of σ·n the largest flux, per |e|, through any facet of a
    cell behind Γ_S: the terms whose sums p and σ·n are. Where κ jumps, rounding is the same in the energy, so that the
    scale of p is also at most the largest √κ|u| or √κ|p| over √κ of the facet's cell, that of σ·n the largest flux/√κ
    times that. On a ROBIN facet, where one of the two may be small and still meaningful, the other one decides.
    """
    roots = np.sqrt(data.conductivities(spaces))
    root = roots[spaces.cells]
    through = np.abs(iterate.sigma.x.array[spaces.V.dofmap.list[spaces.cells]]).max(axis=1, initial=0.0)
    flux = through * np.abs(spaces.basis_flux) / spaces.facet_measure
    u, p = np.abs(iterate.u.x.array), np.abs(iterate.p)
    terms = (np.append(u, p), np.append(roots * u, root * p), flux, flux / root)
    scales = np.array([values.max(initial=0.0) for values in terms])
    spaces.mesh.comm.Allreduce(MPI.IN_PLACE, scales, MPI.MAX)
    trace_scale, flux_scale = np.minimum(scales[0], scales[1] / root), np.minimum(scales[2], scales[3] * root)
    return (p <= TIE * trace_scale) & (np.abs(iterate.flux) <= TIE * flux_scale)


class SingleChange:
    """Of the facets that want to change, lets the last one by midpoint do so: an order that no partition affects."""

    def __init__(self, spaces: Spaces):
        gamma, dofmap = spaces.Lambda.mesh, spaces.Lambda.dofmap.list[:, 0]
        self._comm = gamma.comm
        corners = np.empty((len(dofmap), gamma.geometry.dofmaps[0].shape[1], 3))
        corners[dofmap] = gamma.geometry.x[gamma.geometry.dofmaps[0]]
        self._places = np.sort(corners, axis=1).sum(axis=1)[: len(spaces.facets)]  # sorted: the same bits on any rank

    def __call__(self, conditions: FacetConditions, wanted: FacetConditions) -> FacetConditions:
        """The conditions with one facet as wanted (collective)."""
        places = [(*self._places[i], i) for i in np.flatnonzero(conditions.kind != wanted.kind)]
        *place, index = max(places, default=(-1,))
        last = max(self._comm.allgather(place))
        kind = conditions.kind.copy()
        if place and place == last:
            kind[index] = wanted.kind[index]
        return replace(wanted, kind=kind)


def iterate_sets(
    backend: Backend,
    algorithm: Algorithm,
    *,
    rho: float,
    eps: float,
    max_iterations: int,
    predicted: FacetConditions | None = None,
    on_step: Callable[[Step], None] = lambda step: None,
) -> Outcome:
    """Run an algorithm until the facet sets repeat (collective).

    A set that equals its predecessor ends the loop without another solve: the same set has the same solution. A set
    seen earlier means that the algorithm cycles. If it is the clip of Algorithm 3 that cycles, the loop goes on without
    it, as full-step semismooth Newton for (25); otherwise, and if that cycles too, it goes on with safeguarded changes,
    see above. Either is told in the reason.

    Args:
        backend: Solves under given facet conditions.
        algorithm: Start and rule.
        rho: ρ > 0 of the rule.
        eps: ε > 0 of the penalty.
        max_iterations: Solves allowed after the start.
        predicted: Conditions to start from, instead of the algorithm's own start.
        on_step: Called on all ranks after each iteration.

    Raises:
        LinearSolveFailure: If the start cannot be solved. Later failures end the loop and are told in the outcome.
    """
    spaces = backend.spaces
    comm = spaces.mesh.comm
    clip = FluxClip(spaces, backend.data) if algorithm.clips else None
    single: SingleChange | None = None

    def end(reason: str, *, converged: bool) -> Outcome:
        return Outcome(
            iterate, solved_with, recorder.steps, reason, converged, backend.name, backend.dofs, backend.solver()
        )

    def wanted(*, start: bool = False) -> FacetConditions:
        tied = ties(spaces, backend.data, iterate)
        p, flux = (np.where(tied, 0.0, values) for values in (iterate.p, iterate.flux))
        if start and algorithm.forgets_start:
            p, flux = np.zeros_like(p), np.zeros_like(flux)
        following = algorithm.next_conditions(p, flux, rho, eps)
        return following if start else replace(following, kind=np.where(tied, solved_with.kind, following.kind))

    solved_with = predicted or algorithm.cold_start(len(spaces.facets), eps)
    iterate = backend.solve(solved_with)
    recorder = Recorder(spaces, iterate, solved_with, on_step)
    conditions = wanted(start=predicted is None)
    seen: list[FacetConditions] = []
    remark, fewest = "", 0

    while True:
        clipped = 0
        if conditions.changes([solved_with], comm)[0] > 0:
            try:
                iterate = backend.solve(conditions)
            except LinearSolveFailure as failure:
                return end(str(failure), converged=False)
            if clip is not None:
                iterate, clipped = clip(iterate, conditions)
        solved_with = conditions
        recorder.add(iterate, conditions, clipped=clipped)

        seen.append(conditions)
        conditions = wanted()
        *earlier, last = conditions.changes(seen, comm).tolist()
        if last == 0:
            return end("the facet sets repeat" + remark, converged=True)
        iterations = len(recorder.steps)
        if 0 in earlier and single is None:
            cycle = f"from iteration {iterations + 1} on: the sets cycle with period {len(seen) - earlier.index(0)}"
            if clip is None:
                remark += f", by changing single facets {cycle}"
                single, fewest = SingleChange(spaces), last
            else:
                remark = f", without the clip (36) {cycle}"
                clip, seen = None, []
        if iterations == max_iterations:
            return end(f"{last} facets still change after {max_iterations} iterations{remark}", converged=False)
        if single is not None:
            if last >= fewest:
                conditions = single(solved_with, conditions)
            fewest = min(fewest, last)
