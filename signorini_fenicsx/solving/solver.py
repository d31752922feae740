"""From a case to its solution: mesh, spaces, backend, active-set loop, KKT check."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace

from mpi4py import MPI
from petsc4py import PETSc

from signorini_fenicsx.backends.contract import Backend, LinearSolveFailure
from signorini_fenicsx.backends.facet_system import FacetSystem
from signorini_fenicsx.backends.hybrid import HybridBackend
from signorini_fenicsx.backends.mixed import MixedBackend
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.parallel import Stopwatch, peak_memory
from signorini_fenicsx.base.signals import LoopInterruption
from signorini_fenicsx.cases.case import Case
from signorini_fenicsx.cases.discretisation import check_solvability, discrete_data, mesh_case, same_domain
from signorini_fenicsx.discrete.conditions import FacetConditions
from signorini_fenicsx.discrete.contact_sets import FacetSet
from signorini_fenicsx.discrete.data import Data, Problem, project_data
from signorini_fenicsx.discrete.kkt import TOLERANCE, KKTResiduals, kkt_residuals
from signorini_fenicsx.discrete.spaces import Spaces, build_spaces
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.methods.bound_constrained import solve_bound_constrained
from signorini_fenicsx.methods.loop import Outcome, Step, iterate_sets
from signorini_fenicsx.methods.newton import PenaltyNewton
from signorini_fenicsx.methods.registry import ALGORITHMS, Algorithm, By
from signorini_fenicsx.solving.prediction import (
    contact_without_dirichlet,
    predicted_sets,
    rule_of,
    settle_sets,
    transferred,
    worth_predicting,
)
from signorini_fenicsx.solving.solution import Solution

BACKENDS: dict[str, Callable[[Spaces, Data], Backend]] = {"hybrid": HybridBackend, "mixed": MixedBackend}


def solve(
    case: Case,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    domain: Domain | None = None,
    problem: Problem | None = None,
    algorithm: Algorithm | None = None,
    backend: Callable[[Spaces, Data], Backend] | None = None,
    start: Solution | None = None,
    on_step: Callable[[Step], None] = lambda step: None,
) -> Solution:
    """Solve a case (collective).

    Args:
        case: The problem, its discretisation and algorithm.
        comm: Communicator to run on, if there is no mesh yet.
        domain: Mesh to solve on, instead of the case's own.
        problem: Data on that mesh, instead of the case's.
        algorithm: Instead of the case's.
        backend: Instead of the case's.
        start: Solution whose contact set is taken for the first one.
        on_step: Called on all ranks after each iteration.

    Raises:
        InputError: If the case cannot be discretised as asked.
        NumericalFailure: If the sets do not settle or the result violates a KKT condition; its `solution` holds the
            last state.
    """
    watch = Stopwatch()
    own_mesh = domain is None
    domain = domain or mesh_case(case, comm)
    comm = domain.mesh.comm
    watch.lap("mesh")
    spaces = build_spaces(domain, case.boundary.signorini, case.boundary.neumann)
    data = discrete_data(case, spaces) if problem is None else project_data(spaces, problem)
    check_solvability(spaces, data)
    algorithm = algorithm or ALGORITHMS[case.solve.algorithm]
    # What is solved for is u − constant: beside a large constant ∇u would be rounding. −εu is not blind to it.
    constant = 0.0 if algorithm.stabilised else data.common_constant(spaces)
    run = _Run(case, algorithm, backend or BACKENDS[case.solve.backend], spaces, data.less(spaces, constant))
    watch.lap("assembly")
    contact = None
    if start is not None:
        run.check_start(start)
        contact = start.contact_set()
    elif own_mesh and domain.mesh.topology.dim == 2 and worth_predicting(case, run.algorithm, spaces):
        contact = predicted_sets(case, run.algorithm, comm)  # in 3D so coarse a mesh sees too little for what it costs
    watch.lap("prediction")
    try:
        outcome = run.outcome(contact, watch, on_step)
    except LoopInterruption as interruption:
        outcome = Outcome(*interruption.state, str(interruption), False, case.solve.backend, 0, "interrupted")
    watch.lap("solve")

    kkt = run.residuals(outcome)
    if run.is_imprecise(outcome, kkt):
        watch.lap("kkt")
        outcome = run.by_saddle_point(outcome, kkt, on_step)
        watch.lap("solve")
        kkt = run.residuals(outcome)
    iterate = outcome.iterate
    iterate.u.x.array[:] += constant
    PETSc.garbage_cleanup(comm)  # in parallel PETSc only queues what Python lets go
    watch.lap("kkt")
    failure = _failure(outcome, kkt)
    solution = Solution(
        case=case,
        algorithm=run.algorithm,
        spaces=spaces,
        data=data,
        sigma=iterate.sigma,
        u=iterate.u,
        p=spaces.multiplier(iterate.p + data.psi_h),
        conditions=outcome.conditions,
        history=outcome.history,
        kkt=kkt,
        reason=failure or outcome.reason,
        converged=failure is None,
        backend=outcome.backend,
        dofs=outcome.dofs,
        linear_solver=outcome.linear_solver,
        own_residual=outcome.own_residual,
        details=outcome.details,
        rough_steps=outcome.rough_steps,
        timings=watch.longest(comm),
        peak_memory=peak_memory(comm),
    )
    if failure is not None:
        raise NumericalFailure(failure, solution)
    return solution


def _failure(outcome: Outcome, kkt: KKTResiduals) -> str | None:
    """Why an outcome is not a solution: by the residual of its own problem, if it has one, else by those of (9)."""
    if not outcome.converged:
        return outcome.reason
    if outcome.own_residual is None:
        return kkt.violation()
    within = outcome.own_residual <= TOLERANCE
    return None if within else f"the residual of its own problem is {outcome.own_residual:.1e}, above {TOLERANCE:g}"


@dataclass(frozen=True)
class _Run:
    """A discrete problem and what solves it."""

    case: Case
    algorithm: Algorithm
    backend: Callable[[Spaces, Data], Backend]
    spaces: Spaces
    data: Data

    def check_start(self, start: Solution) -> None:
        """Make sure that a solution can be started from (collective).

        Raises:
            InputError: If the domains differ, or the algorithm has no sets to start from.
        """
        if not same_domain(self.case, self.spaces.domain, start.case, start.spaces.domain):
            other, own = start.case.geometry, self.case.geometry
            raise InputError(f"the start was solved on '{other.name}', not on '{own.name}'")
        if self.algorithm.by is not By.SETS:
            raise InputError(
                f"{self.case.solve.algorithm} has no facet sets to start from; use alg1, alg2, alg3 or alg4"
            )

    def outcome(self, contact: FacetSet | None, watch: Stopwatch, on_step: Callable[[Step], None]) -> Outcome:
        """Set up the solver, run it and let it go (collective)."""
        options, algorithm, spaces, data = self.case.solve, self.algorithm, self.spaces, self.data
        max_iterations = self._max_iterations()
        if algorithm.by is By.CLASSICAL:
            if not spaces.has_dirichlet:
                raise InputError(f"{options.algorithm} needs a part of the boundary where u = u_D")
            from signorini_fenicsx.methods.classical import CLASSICAL, Task  # SciPy is slow to import

            task = Task(spaces, data, options.rho, options.eps, max_iterations, on_step)
            return CLASSICAL[options.algorithm](task)
        if algorithm.by is By.SNES and algorithm.penalty is not None:
            newton = PenaltyNewton(spaces, data, algorithm.penalty, eps=options.eps, max_iterations=max_iterations)
            watch.lap("assembly")
            return newton.solve(on_step)
        if algorithm.by is By.SNESVI:
            system = FacetSystem(spaces, data)
            watch.lap("assembly")
            return solve_bound_constrained(system, max_iterations=max_iterations, on_step=on_step)
        backend = self.backend(spaces, data)
        watch.lap("assembly")
        return self._by_sets(backend, contact, watch, on_step)

    def residuals(self, outcome: Outcome) -> KKTResiduals:
        """KKT residuals of an outcome (collective)."""
        found, spaces, data = outcome.iterate, self.spaces, self.data
        p = spaces.multiplier(found.p + data.psi_h)
        return kkt_residuals(spaces, found.sigma, found.u, p, data, self.algorithm.penalty, self.case.solve.eps)

    def is_imprecise(self, outcome: Outcome, kkt: KKTResiduals) -> bool:
        """Whether rounding spoils a result of the facet system, as it does in κ∇u for large κ and bad cells."""
        direct = outcome.backend == HybridBackend.name and outcome.linear_solver.startswith("preonly+cholesky")
        by_sets = self.algorithm.by is By.SETS and outcome.converged
        return direct and by_sets and not kkt.stationarity <= TOLERANCE

    def by_saddle_point(self, outcome: Outcome, kkt: KKTResiduals, on_step: Callable[[Step], None]) -> Outcome:
        """Go on from an outcome's sets with the mixed backend, whose unknown is the flux itself (collective)."""
        again = self._iterate(MixedBackend(self.spaces, self.data), outcome.conditions, on_step)
        steps = [replace(step, iteration=len(outcome.history) + step.iteration) for step in again.history]
        remark = f"by the saddle point, because the facet system left stationarity {kkt.stationarity:.1e}"
        return replace(again, history=outcome.history + steps, reason=f"{again.reason}, {remark}")

    def _max_iterations(self) -> int:
        return self.case.solve.max_iterations or self.algorithm.max_iterations

    def _iterate(self, backend: Backend, start: FacetConditions | None, on_step: Callable[[Step], None]) -> Outcome:
        """The active-set loop from these conditions, or from the algorithm's own start (collective)."""
        return iterate_sets(
            backend,
            self.algorithm,
            rho=self.case.solve.rho or 1.0,
            eps=self.case.solve.eps,
            max_iterations=self._max_iterations(),
            predicted=start,
            on_step=on_step,
        )

    def _by_sets(
        self, backend: Backend, contact: FacetSet | None, watch: Stopwatch, on_step: Callable[[Step], None]
    ) -> Outcome:
        """The active-set loop from a prediction, or from a cold start where there is none or it fails (collective)."""
        case, algorithm, spaces = self.case, self.algorithm, self.spaces
        predicted, steps = None, 0
        with contextlib.suppress(LinearSolveFailure):
            if isinstance(backend, HybridBackend) and backend.iterative and worth_predicting(case, algorithm, spaces):
                predicted, steps = settle_sets(backend, algorithm, case, contact)
            elif contact is not None:
                predicted = transferred(contact, spaces, rule_of(case, algorithm))
            watch.lap("prediction")
            if predicted is not None:
                outcome = replace(self._iterate(backend, predicted, on_step), rough_steps=steps)
                if outcome.converged:
                    return outcome
        cold = self._iterate(backend, contact_without_dirichlet(spaces), on_step)
        if predicted is None:
            return cold
        return replace(cold, reason=f"{cold.reason}, from a cold start because the predicted one failed")
