"""A set rule as a method: a predicted start for large problems, the loop, and at the end a precise flux."""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Indices
from signorini_fenicsx.base.errors import InputError, LinearSolveFailure, NumericalFailure
from signorini_fenicsx.contact.backend import Iterate, SitePairs
from signorini_fenicsx.contact.chains import Chains, SiteConditions
from signorini_fenicsx.contact.history import History, Outcome
from signorini_fenicsx.contact.loop import Parameters, iterate_sets
from signorini_fenicsx.contact.set_rules import SetRule
from signorini_fenicsx.methods.prediction import Prediction, Settled
from signorini_fenicsx.methods.task import Task


def solve_by_sets(rule: SetRule, task: Task) -> Outcome:
    """Run a set rule with the task's backend (collective).

    Raises:
        InputError: If PETSc refuses an option.
        LinearSolveFailure: If the start cannot be solved.
    """
    return _Sets(rule, task).found()


class _Sets:
    """The sets of a task, as far as they are known: from another mesh, settled by traces, found by the loop.

    An outer method may change the laws of the backend, and settle them or run the loop again from the last segments.
    """

    def __init__(self, rule: SetRule, task: Task):
        """Make the backend (collective).

        Raises:
            InputError: If PETSc refuses an option.
        """
        with task.watch.phase("assembly"):
            self._backend = task.backend(task.spaces, task.data)
        self._rule, self._task = rule, task
        self._parameters = Parameters(task.rho or 1.0, task.eps, task.max_iterations, floating=task.floating())
        self._history = History(self._backend.comm, task.on_step)
        self._start: SiteConditions | None = None
        self._before: Iterate | None = None
        self._segment: Indices | None = None  # of the last solve

    @property
    def _law(self) -> Chains:
        """The law of each site, changed by the penalty if there is one."""
        return self._rule.law(self._backend.chains, self._task.eps)

    @property
    def _first(self) -> SiteConditions | None:
        """The conditions to go on from: those of the start, or the last segments under the present laws."""
        return self._start if self._segment is None else self._law.conditions(self._segment)

    def found(self, *, decided: bool = False) -> Outcome:
        """Run the loop from predicted sets, and if these fail without them (collective).

        Args:
            decided: Whether the algorithm's own start counts as a decision, so that p and the flux after it count.

        Raises:
            LinearSolveFailure: If the own start cannot be solved.
        """
        predicted = False
        with contextlib.suppress(LinearSolveFailure):
            predicted = self.predicted()
            if predicted:
                outcome = self._made_precise(self._task.solved(self._backend, self._loop), check=True)
                if outcome.converged and (outcome.kkt is None or outcome.kkt.violation() is None):
                    return outcome
        self._start, self._before, self._segment = self._task.own_start(self._backend), None, None
        if decided and self._start is None:
            self._start = self._law.conditions(self._rule.first(self._law))
        cold = self._task.solved(self._backend, self._loop)
        if predicted:
            cold = replace(cold, reason=f"{cold.reason}, from a cold start because the predicted one failed")
        return self._made_precise(cold)

    def predicted(self) -> bool:
        """Take the sets of the task's start or of a coarser mesh, and settle those of large problems (collective).

        Returns:
            Whether there are any.
        """
        task, backend, inexact, start = self._task, self._backend, self._backend.inexact, self._task.start
        if inexact is not None and not (task.predict and (task.is_large(backend) or inexact.cheap)):
            inexact = None
        coarsens = start is None and task.predict and task.coarser is not None
        factor = task.coarsening(backend) if coarsens else None
        if start is None and inexact is None and factor is None:
            return False
        with task.watch.phase("prediction"):
            if factor is not None:
                start = self._on_coarser_mesh(factor)
            if start is not None:
                segment = task.begin(backend, start)
                self._start = self._law.conditions(np.minimum(segment, self._law.count))
            if inexact is not None:
                own = self._law.conditions(self._rule.first(self._law))
                self._start = self._start or task.own_start(backend) or own
                self._history.start_from(self._start)
                prediction = Prediction(self._rule, task, backend, inexact)
                task.settled(backend, partial(self._settle, prediction))
        return self._start is not None

    def _on_coarser_mesh(self, factor: float) -> Any:
        """What is found on a mesh that is coarser by this factor, itself predicted; None if nothing (collective)."""
        assert self._task.coarser is not None
        with contextlib.suppress(InputError, NumericalFailure):
            task = self._task.coarser(factor)
            sets = _Sets(self._rule, task)
            if task.whole:
                outcome = sets.found(decided=True)
                sets._start = outcome.conditions if outcome.converged else None
            else:
                sets.predicted()
            PETSc.garbage_cleanup(task.spaces.mesh.comm)  # in parallel PETSc frees objects only here
            return None if sets._start is None else task.found(sets._backend, sets._law.segments(sets._start))
        return None

    def _settle(self, prediction: Prediction) -> Settled:
        """Settle the sets under the present laws (collective)."""
        first = self._first
        assert first is not None
        settled = prediction.settle(first, self._history)
        self._start, self._before = settled.conditions, settled.before
        self._segment = self._law.segments(settled.conditions)
        return settled

    def _loop(
        self, segment: Indices | None = None, follow: Callable[[SitePairs], bool] = lambda iterate: False
    ) -> Outcome:
        """Run the loop, see `methods.task.Loop` (collective)."""
        self._segment = self._segment if segment is None else segment
        outcome = iterate_sets(
            self._backend,
            self._rule,
            self._parameters,
            start=self._first,
            before=self._before,
            history=self._history,
            follow=follow,
        )
        self._before = outcome.iterate
        self._segment = self._law.segments(outcome.conditions)
        return outcome

    def _made_precise(self, outcome: Outcome, *, check: bool = False) -> Outcome:
        """The outcome with its KKT residuals; if these are too large, a precise backend goes on (collective).

        Without a precise backend the residuals are left out, unless they are asked for.
        """
        task, backend = self._task, self._backend
        if not outcome.converged or (backend.precise is None and not check):
            return outcome
        with task.watch.phase("kkt"):
            kkt = task.kkt(outcome.iterate, self._rule.penalty)
        if (violation := kkt.violation()) is None or backend.precise is None:
            return replace(outcome, kkt=kkt)
        start, precise = outcome.conditions, backend.precise()
        again = iterate_sets(precise, self._rule, self._parameters, start=start, history=self._history)
        way = "with more corrections" if precise is backend else "by the saddle point"
        remark = f"{way}, because the facet system left {violation}"
        return replace(again, reason=f"{again.reason}, {remark}")
