"""The loop that all active/inactive-set algorithms share: rule, solve, until the sets repeat.

It works on sites with a pair (p, σ·n) each, whatever these are, see `chains`.

*Ties.* A site where p and σ·n are both rounding (biactive sites, symmetry, no load) keeps its condition. After the
algorithm's own start there is no condition to keep; there a tie counts as p = σ·n = 0. The backend's scales and
`tolerances.TIE` define what is rounding.

*Cycles.* Each set determines the next one, so if a set occurs a second time, the same sets repeat forever. (`follow`
may change the laws; then the conditions have other values, and are another set.) Every rule
is principal pivoting for a linear complementarity problem: p ≥ 0, Sp − g ≥ 0, one of them 0 on each site, with the
Schur complement S on Γ_S. For the penalties this holds in the shifted quantities of `Penalty.shift`, with
(S⁻¹ + ε/|e|)⁻¹ or S + ε|e| in place of S. These matrices are symmetric and positive definite. For them, changing one
site at a time ends after finitely many steps, if it is always the last, in a fixed order, of those that want to change
(Murty). It also ends if all sites change whenever fewer want to change than ever before, and one at a time otherwise
(Júdice and Pires, Computers & Operations Research 21, 1994). The loop does this from the first repetition on. Both
hold as well for laws with several corners, where a site moves by one segment at a time.

*Sets that cannot cycle*: each lowers the energy, by Newton steps that are projected onto the laws.

On the sites the problem is to minimise E(p) = ½ (p, Sp) + (c, p) + Σ |e| φ(p), where the flux is Sp + c with a
symmetric S and −φ' is the law, which falls. A site on a slope of its law moves along it, and one on a vertical segment
stays, if its flux is within the segment. The solution under these conditions is the target of Newton's step. A site
that comes to the end of its segment on the way stops there. The step is halved until E falls by enough (Bertsekas, SIAM
J. Control Optim. 20, 1982). E along the way comes from p and the flux at its ends, because the flux is affine in p.

Some sets may hold the body in no way. So all sites are anchored by weak springs, see `Anchored`: E is strictly convex
then. The minimum with springs is a step of the proximal point method, and from where it ends the springs pull anew.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import cast

import numpy as np
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array, Indices, Mask
from signorini_fenicsx.base.errors import LinearSolveFailure, NumericalFailure
from signorini_fenicsx.base.text import counted
from signorini_fenicsx.base.tolerances import TIE
from signorini_fenicsx.contact.backend import Anchored, Backend, SitePairs
from signorini_fenicsx.contact.chains import Chains, Condition, SiteConditions
from signorini_fenicsx.contact.floating import Floating
from signorini_fenicsx.contact.history import History, OnStep, Outcome
from signorini_fenicsx.contact.set_rules import ALGORITHM_1, Present, SetRule

FAR = 100.0
"""A site that the own start leaves so many times as far from ψ as it is beyond ψ elsewhere stays open at first: contact
there would make of a large distance the size of the next iterate. So do all sites if it is beyond ψ nowhere."""
LINEAR = "without a law the problem is linear, and solved"
"""Why the loop ends where there are no sites."""
MORE = "; solve.max_iterations allows more"
"""What helps where the sets still change."""


@dataclass(frozen=True)
class Parameters:
    """Parameters of an iteration.

    Attributes:
        rho: ρ > 0 of the rule.
        eps: ε > 0 of the penalty.
        max_iterations: Solves allowed after the start.
        tie: A value below this share of its scale is rounding.
        floating: The components that some site must hold; None if there are none.
    """

    rho: float = 1.0
    eps: float = 1.0
    max_iterations: int = 50
    tie: float = TIE
    floating: Floating | None = None


def iterate_sets[I: SitePairs](
    backend: Backend[I],
    rule: SetRule,
    parameters: Parameters,
    *,
    start: SiteConditions | None = None,
    before: I | None = None,
    history: History | None = None,
    on_step: OnStep = lambda step: None,
    follow: Callable[[I], bool] = lambda iterate: False,
) -> Outcome:
    """Run an algorithm until the sets repeat (collective).

    A set that equals its predecessor ends the loop without another solve, because it has the same solution. A set that
    equals an earlier one means that the algorithm cycles. Then a rule with a clip goes on without the clip; Algorithm 3
    becomes full-step semismooth Newton for (25). If there is no clip, or if that cycles too, the loop goes on with the
    safeguarded changes of the module. The reason tells both.

    Args:
        backend: Solves under given conditions.
        rule: The algorithm.
        parameters: Of the rule and the loop.
        start: Conditions to start from, instead of the algorithm's own start.
        before: The iterate before these conditions. Then their solve is the first step; otherwise it is the start, and
            none.
        history: The steps before, which goes on; None if there are none.
        on_step: Called on all ranks after each iteration, if there is no history.
        follow: Called on all ranks with each solution; it may change the chains of the backend. If it returns that it
            has, sets that repeat are no cycle.

    Raises:
        LinearSolveFailure: If the start cannot be solved. Later failures end the loop; the outcome's reason tells them.
    """
    site, sites = backend.noun
    law = rule.law(backend.chains, parameters.eps)
    conditions = solved_with = start or law.conditions(rule.first(law))
    iterate = backend.solve(solved_with)
    history = history or History(backend.comm, on_step)
    most, allowed = len(history.steps) + parameters.max_iterations, counted(parameters.max_iterations, "iteration")
    if before is None:
        history.start_from(solved_with)
        follow(iterate)
        before, conditions = iterate, _wanted(backend, rule, parameters, iterate, start)
    safeguard = _Safeguard(backend, lambda: rule.law(backend.chains, parameters.eps), clips=rule.clip is not None)

    def end(reason: str, *, converged: bool, advice: str = "") -> Outcome:
        safeguard.end()
        state, system = backend.in_mixed_spaces(iterate, solved_with), (backend.name, backend.dofs, backend.solver())
        return history.outcome(state, reason + safeguard.remark + advice, system, converged=converged)

    while True:
        clipped = 0
        if safeguard.moved or conditions.changes([solved_with], backend.comm)[0] > 0:
            try:
                iterate = backend.solve(conditions)
            except LinearSolveFailure as failure:
                return end(str(failure), converged=False)
            if rule.clip is not None and safeguard.clips:
                iterate, clipped = _clipped(backend, iterate, rule.clipped(conditions.kind, iterate.flux))
        solved_with = conditions
        change = (0.0, 0.0) if iterate is before else backend.change(iterate, before)
        before = iterate
        state, spent = partial(backend.in_mixed_spaces, iterate, solved_with), iterate.linear_iterations
        history.append(conditions, change, state, linear_iterations=spent, clipped=clipped)

        safeguard.begin(anew=follow(iterate))
        wanted = _wanted(backend, rule, parameters, iterate, solved_with)
        changing = safeguard.look(conditions, wanted, len(history.steps))
        if changing == 0 and not safeguard.goes_on(iterate):
            return end(f"the {site} sets repeat" if history.steps[-1].sites else LINEAR, converged=True)
        if len(history.steps) == most:
            return end(f"{changing} {sites} still change after {allowed}", converged=False, advice=MORE)
        conditions = safeguard.allowed(conditions, wanted, iterate)


def _wanted[I: SitePairs](
    backend: Backend[I],
    rule: SetRule,
    parameters: Parameters,
    iterate: I,
    solved_with: SiteConditions | None,
) -> SiteConditions:
    """The next conditions by the rule. Ties keep theirs; after the own start they have none (collective)."""
    law, scales = rule.law(backend.chains, parameters.eps), backend.scales(iterate)
    segment = None if solved_with is None else law.segments(solved_with)
    p, flux = iterate.p, iterate.flux
    if solved_with is None and rule.forgets_start:
        deepest = backend.comm.allreduce(float(-p.min(initial=0.0)), MPI.MAX)
        p, flux = np.where((p > FAR * deepest) & law.plain, p, 0.0), np.zeros_like(flux)
    present = Present(segment, parameters.tie * scales[0], parameters.tie * scales[1])
    following = rule.following(law, p, flux, parameters.rho, present)
    if parameters.floating is not None:
        following = parameters.floating.held(law, following, iterate, backend.comm)
    return law.conditions(following)


def _clipped[I: SitePairs](backend: Backend[I], iterate: I, where: Mask) -> tuple[I, int]:
    """The iterate without the flux of these sites, and their number over all ranks (collective)."""
    number = backend.comm.allreduce(int(np.count_nonzero(where)))
    return (backend.without_flux(iterate, where) if number > 0 else iterate), number


def settled_change[I: SitePairs](backend: Backend[I], start: SiteConditions, biactive: int, given: int | None) -> I:
    """The change of a solution: one solve, or where biactive sites choose between two rays Algorithm 1 (collective).

    Args:
        backend: Solves for the change.
        start: The first rays.
        biactive: The number of biactive sites over all ranks; their sets may change by one site in an iteration.
        given: Iterations that the user allows, or None.

    Raises:
        NumericalFailure: If the sets of biactive sites do not settle.
    """
    if biactive == 0:
        return backend.solve(start)
    parameters = Parameters(max_iterations=max(Parameters.max_iterations, biactive, given or 0))
    outcome = iterate_sets(backend, ALGORITHM_1, parameters, start=start)
    if not outcome.converged:
        raise NumericalFailure(f"derivative: {outcome.reason}")
    return cast("I", outcome.iterate)


ENOUGH = 1e-4
"""Share of the fall that the slope of E promises, with which a step is taken."""
HALVINGS = 20
"""So often a step is halved at most; then the fall is rounding."""


class Descent[I: SitePairs]:
    """The way down from all sites in contact.

    Attributes:
        conditions: The next conditions.
    """

    def __init__(self, backend: Anchored[I], law: Chains):
        """Begin at the references of the laws, where weak springs then pull to (collective)."""
        self._backend, self._law = backend, law
        low, high, _, _ = law.extent()
        self._reach(np.clip(np.zeros(len(low)), low, high))
        backend.anchor()
        self._begins = True

    def _reach(self, p: Array, flux: Array | None = None) -> None:
        """Be at p, and find the flux there if it is not known (collective)."""
        law = self._law
        if flux is None:
            flux = self._backend.solve(SiteConditions(np.full(len(p), Condition.ZERO_TRACE, np.int8), value=p)).flux
        self._p, self._flux = p, flux
        left, right = ((each(law.p, p[:, None])).sum(axis=1) for each in (np.less, np.less_equal))
        corner = np.arange(law.corners)
        at = (corner >= left[:, None]) & (corner < right[:, None])
        self._segment: Indices = left + (at & (flux[:, None] < law.flux)).sum(axis=1)
        self.conditions = law.conditions(self._segment)

    def follow(self, iterate: I) -> SiteConditions:
        """Step towards the solution under the conditions, or as far as E falls; the next conditions (collective)."""
        if self._begins:
            self._begins = False
            return self.conditions
        segment, (p, flux), share = self._segment, (self._p, self._flux), 1.0
        low, high = (self._law.ends[0][np.arange(len(p)), segment + end] for end in (0, 1))
        at_start = self._slope(segment, p, flux)
        for _ in range(HALVINGS):
            wanted = p + share * (iterate.p - p)
            reached = np.clip(wanted, low, high)
            stopped = self._sum(reached != wanted) > 0
            self._reach(reached, None if stopped else flux + share * (iterate.flux - flux))
            moved = self._backend.measure * (reached - p)
            fall = self._sum((at_start + self._slope(segment, self._p, self._flux)) / 2 * moved)
            if not stopped or fall <= ENOUGH * self._sum(at_start * moved):
                break
            share /= 2
        return self.conditions

    def goes_on(self, iterate: I) -> bool:
        """Whether the springs still pull at the minimum; then they pull to it from now on (collective)."""
        pulled = self._backend.anchor()
        if pulled:
            low, high, _, _ = self._law.extent()
            self._reach(np.clip(iterate.p, low, high))
        self._begins = pulled
        return pulled

    def _slope(self, segment: Indices, p: Array, flux: Array) -> Array:
        """The derivative of E by each p, over |e|; 0 on vertical segments."""
        slope, value = (each[np.arange(len(p)), segment] for each in (self._law.slope, self._law.value))
        vertical = np.isinf(slope)
        return np.where(vertical, 0.0, flux - value + np.where(vertical, 0.0, slope) * p)

    def _sum(self, values: Array | Mask) -> float:
        return float(self._backend.comm.allreduce(float(values.sum())))


@dataclass
class _Safeguard[I: SitePairs]:
    """What notices cycles and ends them, see the module.

    Attributes:
        backend: The backend with the sites.
        law: Gives the law of each site.
        clips: Whether the algorithm still clips.
        remark: What was changed to end a cycle, in words; empty if nothing.
        descent: The way to the solution of a body that is not held under all sets, from a cycle on.
        moved: Whether the springs of the descent have moved, so that the same sets have another solution.
    """

    backend: Backend[I]
    law: Callable[[], Chains]
    clips: bool
    remark: str = ""
    descent: Descent[I] | None = None
    moved: bool = False
    _seen: list[SiteConditions] = field(default_factory=list)
    _places: Array | None = None  # from the first single change on
    _fewest: int = 0
    _last: int = 0

    def begin(self, *, anew: bool) -> None:
        """Forget what was seen if the law is another one: sets that repeat are no cycle then."""
        self._seen = [] if anew else self._seen

    def look(self, conditions: SiteConditions, wanted: SiteConditions, iterations: int) -> int:
        """Remember the conditions of an iteration; return how many sites the wanted ones change (collective)."""
        self._seen.append(conditions)
        self.moved = False
        *earlier, self._last = wanted.changes(self._seen, self.backend.comm).tolist()
        if self._last > 0 and 0 in earlier and self._places is None and self.descent is None:
            period = len(self._seen) - earlier.index(0)
            cycle = f"from iteration {iterations + 1} on: the sets cycle with period {period}"
            if self.clips:
                self.remark = f", without the clip (36) {cycle}"
                self.clips, self._seen = False, []
            elif (anchored := self.backend.anchored) is not None:
                self.remark += f", by descent on weak springs {cycle}"
                self._seen, self.descent = [], Descent(anchored, self.law())
            else:
                self.remark += f", by changing single {self.backend.noun[1]} {cycle}"
                self._places, self._fewest = self.backend.places(), self._last
        return self._last

    def goes_on(self, iterate: I) -> bool:
        """Whether the springs of the descent still pull (collective)."""
        self.moved = self.descent is not None and self.descent.goes_on(iterate)
        return self.moved

    def end(self) -> None:
        """Take weak springs away."""
        if self.descent is not None and self.backend.anchored is not None:
            self.backend.anchored.release()

    def allowed(self, conditions: SiteConditions, wanted: SiteConditions, iterate: I) -> SiteConditions:
        """The next conditions: the wanted ones, on all sites or on one, or those of the descent (collective)."""
        if self.descent is not None:
            return self.descent.follow(iterate)
        if self._places is None:
            return wanted
        all_may = self._last < self._fewest
        self._fewest = min(self._fewest, self._last)
        return wanted if all_may else self._one_changed(conditions, wanted, self._places)

    def _one_changed(self, conditions: SiteConditions, wanted: SiteConditions, places: Array) -> SiteConditions:
        """Conditions with one site changed: the last by its place, an order for any ranks (collective)."""
        changing = [(*places[i], i) for i in np.flatnonzero(conditions.differ(wanted))]
        *place, index = max(changing, default=(-1,))
        last = max(self.backend.comm.allgather(place))
        law = self.law()
        segment = law.segments(conditions)
        if place and place == last:
            segment[index] = law.segments(wanted)[index]
        return law.conditions(segment)
