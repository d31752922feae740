"""What a method reports: a step per iteration, and how it ended."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, Self

from mpi4py import MPI

from signorini_fenicsx.base import progress
from signorini_fenicsx.base.signals import LoopInterruption
from signorini_fenicsx.contact.backend import Iterate, SitePairs
from signorini_fenicsx.contact.chains import Condition, SiteConditions
from signorini_fenicsx.contact.residuals import Residuals

type OnStep = Callable[["Step"], None]


@dataclass(frozen=True)
class Step:
    """One row of the history: iteration n of the algorithm. The start solve is n = 0 and has no row.

    For sites see `chains`. Their numbers are sums over all ranks.

    Attributes:
        iteration: n, from 1.
        no_flux: Sites with σ·n = 0.
        zero_trace: Sites with p = 0.
        robin: Sites with σ·n + βp = 0.
        changed: Sites whose condition differs from iteration n − 1.
        clipped: Sites where Algorithm 3 set a negative σ·n to 0 (36).
        sigma_change: ‖σ^(n) − σ^(n−1)‖_V.
        u_change: ‖u^(n) − u^(n−1)‖_Q.
        linear_iterations: Iterations of the linear solver under these conditions. A set that repeats is not solved
            again; its row shows the iterations of its only solve.
        seconds: Wall time of the iteration.
        rough: Whether its solve stopped as soon as it asked for other sets, as those of a prediction do.
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
    rough: bool = False

    @property
    def sites(self) -> int:
        """The number of sites; a problem without any is linear."""
        return self.no_flux + self.zero_trace + self.robin


class FoundSets(Protocol):
    """Sets that were found with their solution, an `Outcome` or its traces alone."""

    @property
    def iterate(self) -> SitePairs:
        """The solution."""

    @property
    def conditions(self) -> SiteConditions:
        """The sets."""

    @property
    def converged(self) -> bool:
        """Whether they repeat."""


@dataclass(frozen=True)
class Outcome:
    """How a solve ended.

    Attributes:
        iterate: Last solution.
        conditions: Conditions under which it was computed, on the Γ_S facets of this rank; of a body, its sites.
        history: One step per iteration, those of a prediction on the same mesh first.
        reason: Why it ended, in words.
        converged: Whether the sets repeated; in a `Solution`, whether its residuals are small as well.
        backend: Name of the discrete system that was solved; SNES always uses the mixed one, SNESVI the hybrid one.
        dofs: Unknowns of the linear systems, over all ranks.
        linear_solver: Name of their solver.
        own_residual: Largest residual, scale-free, of the discrete problem that the method solves, if that is neither
            (9) nor a penalty formulation of it. It is judged instead of the KKT residuals.
        details: Further numbers that the method chose or found, such as ρ.
        kkt: KKT residuals, if the method has computed them.
    """

    iterate: Iterate
    conditions: SiteConditions
    history: list[Step]
    reason: str
    converged: bool
    backend: str
    dofs: int
    linear_solver: str
    own_residual: float | None = None
    details: dict[str, float] = field(default_factory=dict)
    kkt: Residuals | None = None

    @property
    def rough_steps(self) -> int:
        """The number of rough steps."""
        return sum(step.rough for step in self.history)

    @classmethod
    def interrupted(cls, by: LoopInterruption, backend: str, dofs: int = 0, linear_solver: str = "interrupted") -> Self:
        """The outcome of a run that was told to end, from its last state, with what is known of its backend."""
        return cls(*by.state, str(by), False, backend, dofs, linear_solver)

    def ended(self, failure: str | None) -> Self:
        """The outcome after its residuals have been judged."""
        return replace(self, converged=failure is None, reason=failure or self.reason)


class History:
    """The history while it grows: one step per iteration, whose conditions are compared with those before."""

    def __init__(self, comm: MPI.Comm, on_step: OnStep):
        """Begin without steps.

        Args:
            comm: Communicator.
            on_step: Called on all ranks with each step.
        """
        self.steps: list[Step] = []
        self._comm, self._on_step = comm, on_step
        self._last_conditions: SiteConditions | None = None
        self._began = time.perf_counter()

    def start_from(self, conditions: SiteConditions) -> None:
        """Take conditions for those before the next step; their solve, the start, is no step itself."""
        self._last_conditions = conditions

    def append(
        self,
        conditions: SiteConditions,
        change: tuple[float, float],
        state: Callable[[], tuple[Iterate, SiteConditions]],
        *,
        linear_iterations: int = 1,
        clipped: int = 0,
        rough: bool = False,
    ) -> None:
        """Record an iteration: its conditions, and the norms of its changes of σ and u (collective).

        If the step raises an interruption, this gets the state that the method has reached.
        """
        counts = conditions.counts(self._comm)
        changed = 0 if self._last_conditions is None else conditions.changes([self._last_conditions], self._comm)[0]
        now = time.perf_counter()
        step = Step(
            iteration=len(self.steps) + 1,
            no_flux=counts[Condition.NO_FLUX],
            zero_trace=counts[Condition.ZERO_TRACE],
            robin=counts[Condition.ROBIN],
            changed=int(changed),
            clipped=clipped,
            sigma_change=change[0],
            u_change=change[1],
            linear_iterations=linear_iterations,
            seconds=now - self._began,
            rough=rough,
        )
        self.steps.append(step)
        self._last_conditions, self._began = conditions, now
        progress.detail("iteration", step.iteration)
        try:
            self._on_step(step)
        except LoopInterruption as interruption:
            interruption.state = (*state(), self.steps)
            raise

    def outcome(
        self,
        state: tuple[Iterate, SiteConditions],
        reason: str,
        system: tuple[str, int, str],
        *,
        converged: bool,
        **about: Any,
    ) -> Outcome:
        """The outcome after these steps; of the system that was solved the name, the unknowns and their solver."""
        (iterate, conditions), (backend, dofs, solver) = state, system
        return Outcome(iterate, conditions, self.steps, reason, converged, backend, dofs, solver, **about)
