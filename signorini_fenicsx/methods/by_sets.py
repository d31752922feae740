"""A set rule as a method: a predicted start for large problems, the loop, and at the end a precise flux."""

import contextlib
from dataclasses import replace

from signorini_fenicsx.base.errors import LinearSolveFailure
from signorini_fenicsx.contact.backend import Backend, Iterate
from signorini_fenicsx.contact.conditions import SiteConditions
from signorini_fenicsx.contact.history import History, Outcome
from signorini_fenicsx.contact.loop import Parameters, iterate_sets
from signorini_fenicsx.contact.set_rules import SetRule
from signorini_fenicsx.methods.prediction import Prediction, contact_without_dirichlet
from signorini_fenicsx.methods.task import Task


def solve_by_sets(rule: SetRule, task: Task) -> Outcome:
    """Run a set rule with the task's backend (collective).

    Raises:
        InputError: If PETSc refuses an option.
        LinearSolveFailure: If the start cannot be solved.
    """
    with task.watch.phase("assembly"):
        backend = task.backend(task.spaces, task.data)
    parameters = Parameters(task.rho or 1.0, task.eps, task.max_iterations, floating=task.floating())
    history = History(backend.comm, task.on_step)
    predicted: SiteConditions | None = None
    with contextlib.suppress(LinearSolveFailure):
        predicted, before = _predicted(backend, rule, parameters, task, history)
        if predicted is not None:
            outcome = iterate_sets(backend, rule, parameters, start=predicted, before=before, history=history)
            outcome = _made_precise(outcome, backend, rule, parameters, task, history, check=True)
            if outcome.converged and (outcome.kkt is None or outcome.kkt.violation() is None):
                return outcome
    start = contact_without_dirichlet(task.spaces, backend.chains)
    cold = iterate_sets(backend, rule, parameters, start=start, history=history)
    if predicted is not None:
        cold = replace(cold, reason=f"{cold.reason}, from a cold start because the predicted one failed")
    return _made_precise(cold, backend, rule, parameters, task, history)


def _predicted(
    backend: Backend[Iterate], rule: SetRule, parameters: Parameters, task: Task, history: History
) -> tuple[SiteConditions | None, Iterate | None]:
    """Predicted sets, or those of the task, and the iterate before them; None if there are none (collective)."""
    prediction = Prediction(rule, parameters.rho, parameters.eps, task.coarser, task.tuning)
    spaces = task.spaces
    with task.watch.phase("prediction"):
        earlier, inexact, worth_it = task.start, backend.inexact, task.predict and prediction.is_worth_it(spaces)
        if earlier is None and task.predict and task.in_cells:
            earlier = prediction.with_laws_inside(spaces)
        elif earlier is None and worth_it:
            earlier = prediction.from_coarser_mesh(spaces)
        if inexact is not None and (worth_it or (task.predict and inexact.cheap)):
            first = prediction.start(spaces, backend.chains, earlier)
            history.start_from(first)
            return prediction.settle(backend, inexact, spaces, first, history)
        if earlier is not None:
            return prediction.transferred(earlier, spaces, prediction.law(backend.chains)), None
    return None, None


def _made_precise(
    outcome: Outcome,
    backend: Backend[Iterate],
    rule: SetRule,
    parameters: Parameters,
    task: Task,
    history: History,
    *,
    check: bool = False,
) -> Outcome:
    """The outcome with its KKT residuals; if these are too large, a precise backend goes on (collective).

    Without a precise backend the residuals are left out, unless they are asked for.
    """
    if not outcome.converged or (backend.precise is None and not check):
        return outcome
    with task.watch.phase("kkt"):
        kkt = task.kkt(outcome.iterate, rule.penalty)
    if (violation := kkt.violation()) is None or backend.precise is None:
        return replace(outcome, kkt=kkt)
    start = outcome.conditions.and_cells(outcome.iterate.cells)
    again = iterate_sets(backend.precise(), rule, parameters, start=start, history=history)
    remark = f"by the saddle point, because the facet system left {violation}"
    return replace(again, reason=f"{again.reason}, {remark}")
