"""Predicted sets from which a large problem starts: updates by solves that stop early, or on patches.

A prediction changes only the number of steps. The result is the same, because the loop ends only when the sets repeat.
"""

from dataclasses import dataclass
from functools import cached_property, partial

from signorini_fenicsx.base import progress
from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.contact.backend import Backend, Inexact, Iterate, SitePairs
from signorini_fenicsx.contact.chains import Chains, SiteConditions
from signorini_fenicsx.contact.history import History
from signorini_fenicsx.contact.set_rules import Present, SetRule
from signorini_fenicsx.methods.task import Task

NOTHING = -1.0
"""Size of p or σ·n below which it is rounding: nothing is."""


@dataclass(frozen=True)
class Prediction:
    """A set rule whose sets are settled by solves for traces.

    Attributes:
        rule: The algorithm.
        task: The problem, with ρ, ε and the sizes from which it works differently.
        backend: The backend.
        inexact: Its solves, each from the last solution.
    """

    rule: SetRule
    task: Task
    backend: Backend[Iterate]
    inexact: Inexact

    @property
    def law(self) -> Chains:
        """The present law of each site, changed by the penalty if there is one."""
        return self.rule.law(self.backend.chains, self.task.eps)

    def wanted(self, law: Chains, segment: Indices, p: Array, flux: Array) -> SiteConditions:
        """The next conditions by the rule, from p and σ·n per site with each site on a segment."""
        present = Present(segment, NOTHING, NOTHING)
        return law.conditions(self.rule.following(law, p, flux, self.task.rho or 1.0, present))

    def settle(self, conditions: SiteConditions, history: History) -> "Settled":
        """Solve until the sets repeat; each solve stops as soon as the next sets are known (collective).

        Ends early if a step changes at least as many sites as two steps before.

        Args:
            conditions: Those to start from.
            history: Gets a rough step for each solve that was stopped early, except the start.

        Returns:
            The last conditions. If the sets repeated, the backend holds the solution under these.

        Raises:
            LinearSolveFailure: If the linear solver breaks down.
        """
        backend, law = self.backend, self.law
        changed: list[int] = []
        iterate: Iterate | None = None
        while len(changed) < 3 or changed[-1] < changed[-3]:
            watch = _Watch(self, law, conditions)
            wanted = self.wanted(law, watch.segment, *self.inexact.solve_until(conditions, watch))
            changed.append(int(wanted.changes([conditions], backend.comm)[0]))
            progress.detail("set update", len(changed))
            if changed[-1] == 0:
                break
            before, iterate = iterate, self.inexact.reached(conditions)
            if iterate is not None and before is not None:
                state, spent = partial(backend.in_mixed_spaces, iterate, conditions), iterate.linear_iterations
                change = backend.change(iterate, before)
                history.append(conditions, change, state, linear_iterations=spent, rough=True)
            conditions = self._settled_nearby(law, conditions, wanted)
        return Settled(self, conditions, iterate)

    def _settled_nearby(self, law: Chains, conditions: SiteConditions, wanted: SiteConditions) -> SiteConditions:
        """Follow the sets by solves on a patch around the facets that change, if this patch is small (collective).

        Where σ·n and p both vanish at the edge of the contact set, the edge moves by one facet per step. On a patch
        such steps are cheap.
        """
        tuning = self.task.tuning
        layers = tuning.layers[self.task.spaces.mesh.topology.dim]
        solve = self.inexact.solve_near(conditions.differ(wanted), layers, tuning.patch_share)
        if solve is None:
            return wanted
        for _ in range(tuning.patch_steps):
            conditions = wanted
            wanted = self.wanted(law, law.segments(conditions), *solve(conditions))
            if wanted.changes([conditions], self.backend.comm)[0] == 0:
                break
        return wanted


@dataclass(frozen=True)
class Settled:
    """Sets that were settled, and their traces if these are asked for, see `contact.history.FoundSets`.

    Attributes:
        conditions: The sets.
        before: The last iterate that was stopped early, if there is one.
    """

    prediction: Prediction
    conditions: SiteConditions
    before: Iterate | None

    @cached_property
    def iterate(self) -> SitePairs:
        """The traces under these sets (collective when first used)."""
        return SitePairs(*self.prediction.inexact.solve_until(self.conditions, lambda *_: False), 0)

    @cached_property
    def converged(self) -> bool:
        """Whether the sets repeat (collective when first used)."""
        law = self.prediction.law
        wanted = self.prediction.wanted(law, law.segments(self.conditions), self.iterate.p, self.iterate.flux)
        return wanted.same(self.conditions, self.prediction.backend.comm)


class _Watch:
    """What stops a solve once its iterates ask for other sets than its own and these hardly change any more.

    Attributes:
        segment: The segment of each site in this solve.
    """

    def __init__(self, prediction: Prediction, law: Chains, conditions: SiteConditions):
        self._prediction, self._law, self._conditions = prediction, law, conditions
        self._last, self._steady = conditions, 0
        self.segment = law.segments(conditions)

    def __call__(self, p: Array, flux: Array) -> bool:
        """Look at the next iterate; return whether to stop (collective)."""
        wanted, tuning = self._prediction.wanted(self._law, self.segment, p, flux), self._prediction.task.tuning
        comm = self._prediction.backend.comm
        changing, moved = wanted.changes([self._conditions, self._last], comm).tolist()
        self._last = wanted
        self._steady = self._steady + 1 if moved <= tuning.leeway * changing else 0
        return changing > 0 and self._steady >= tuning.patience
