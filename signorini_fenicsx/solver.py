"""From a case to its solution: mesh, spaces, backend, active-set loop, KKT check."""

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from forms.norms import l2
from signorini_fenicsx.active_set import Outcome, Step, iterate_sets, settle_sets
from signorini_fenicsx.algorithms import ALGORITHMS, Algorithm, By
from signorini_fenicsx.backend import Backend, LinearSolveFailure
from signorini_fenicsx.bound_constrained import solve_bound_constrained
from signorini_fenicsx.case import Case
from signorini_fenicsx.conditions import Condition, FacetConditions
from signorini_fenicsx.contact_sets import FacetSet, hausdorff
from signorini_fenicsx.data import Data, Problem, project_data, quadrature
from signorini_fenicsx.errors import InputError, NumericalFailure
from signorini_fenicsx.expressions import parse_expression
from signorini_fenicsx.facet_system import FacetSystem
from signorini_fenicsx.geometry import SHAPES, Domain, build_domain, estimated_cells, expected_cells, own_domain
from signorini_fenicsx.hybrid import HybridBackend
from signorini_fenicsx.kkt import TOLERANCE, KKTResiduals, kkt_residuals
from signorini_fenicsx.mixed import MixedBackend
from signorini_fenicsx.newton import PenaltyNewton
from signorini_fenicsx.parallel import peak_memory
from signorini_fenicsx.sampling import curve_gap, sampled
from signorini_fenicsx.spaces import Spaces, build_spaces

BACKENDS: dict[str, Callable[[Spaces, Data], Backend]] = {"hybrid": HybridBackend, "mixed": MixedBackend}

EXACT_CONTACT = 1e-12
"""An exact u of less than this on Γ_S, relative to its maximum there, is contact."""
PREDICT_FROM = 60_000
"""Facets of the mesh from which the sets are predicted; below, a cold start costs nothing."""
COARSENING = 4.0
"""Mesh size, in multiples of its own, of the mesh on which the sets of a large problem are predicted."""


@dataclass(frozen=True)
class Solution:
    """A discrete solution and how it was found. Functions hold owned and up-to-date ghost values.

    Attributes:
        case: What was solved.
        algorithm: Its algorithm.
        spaces: The discrete spaces; `spaces.mesh` is the mesh.
        data: f and u_D, and their means.
        sigma: Flux σ_h in RT0.
        u: u_h in P0.
        p: Trace p_h in P0(Γ_S), on the facet submesh.
        conditions: Final conditions of the Γ_S facets of this rank.
        history: One step per iteration of the algorithm.
        kkt: Residuals of the discrete Signorini problem.
        reason: Why it ended, in words.
        converged: Whether the facet sets repeated and all residuals are small.
        backend: Name of the discrete system it was solved with; SNES always takes the mixed one, SNESVI the hybrid one.
        dofs: Unknowns of the linear system.
        linear_solver: Name of the linear solver.
        own_residual: Residual of the discrete problem that a classical method solves instead of (9), None for others.
        details: Numbers that the algorithm chose or found, such as ρ.
        rough_steps: Set updates by rough solves that went before the history.
        timings: Seconds per phase, the longest over all ranks.
        peak_memory: Bytes that the processes have held at most so far, summed over ranks.
    """

    case: Case
    algorithm: Algorithm
    spaces: Spaces
    data: Data
    sigma: fem.Function
    u: fem.Function
    p: fem.Function
    conditions: FacetConditions
    history: list[Step]
    kkt: KKTResiduals
    reason: str
    converged: bool
    backend: str
    dofs: int
    linear_solver: str
    own_residual: float | None = None
    details: dict[str, float] = field(default_factory=dict)
    rough_steps: int = 0
    timings: dict[str, float] = field(default_factory=dict)
    peak_memory: int = 0

    def norms(self) -> dict[str, float]:
        """L² norms of σ, ∇·σ, u over Ω and of p, σ·n over Γ_S (collective)."""
        spaces = self.spaces
        squares = {
            "sigma_L2": l2(self.sigma, ufl.dx),
            "div_sigma_L2": l2(ufl.div(self.sigma), ufl.dx),
            "u_L2": l2(self.u, ufl.dx),
            "p_L2": l2(self.p, spaces.ds),
            "flux_L2": l2(ufl.dot(self.sigma, spaces.n), spaces.ds),
        }
        return {name: float(np.sqrt(spaces.integrate(square))) for name, square in squares.items()}

    def errors(self) -> dict[str, float] | None:
        """Errors where the solution is known, else None (collective).

        L² norms of those of σ, ∇·σ, u over Ω and of p over Γ_S, and the Hausdorff distance of the contact set to the
        facets in whose midpoints the exact u is 0.
        """
        if self.case.exact.u is None:
            return None
        spaces = self.spaces
        u = parse_expression(self.case.exact.u, ufl.SpatialCoordinate(spaces.mesh))
        metadata = quadrature(u)
        dx = ufl.Measure("dx", domain=spaces.mesh, metadata=metadata)
        squares = {
            "sigma_L2": l2(self.data.kappa * ufl.grad(u) - self.sigma, dx),
            "div_sigma_L2": l2(self.data.f + ufl.div(self.sigma), dx),
            "u_L2": l2(u - self.u, dx),
            "p_L2": l2(u - self.p, spaces.ds(metadata=metadata)),
        }
        norms = {name: float(np.sqrt(spaces.integrate(square))) for name, square in squares.items()}
        return norms | {"contact_hausdorff": hausdorff(self.contact_set(), self._exact_contact_set(self.case.exact.u))}

    def _exact_contact_set(self, u: str) -> FacetSet:
        gamma = self.spaces.Lambda
        trace = fem.Function(gamma)
        points = gamma.element.interpolation_points
        trace.interpolate(fem.Expression(parse_expression(u, ufl.SpatialCoordinate(gamma.mesh)), points))
        values = trace.x.array[: len(self.spaces.facets)]
        largest = gamma.mesh.comm.allreduce(np.abs(values).max(initial=0.0), MPI.MAX)
        return FacetSet(self.spaces, values - self.data.psi_h <= EXACT_CONTACT * largest)

    def contact_set(self) -> FacetSet:
        """The Γ_S facets in contact, by their final condition."""
        return FacetSet(self.spaces, self.conditions.kind == self.algorithm.contact)

    def contact(self) -> tuple[int, float]:
        """Number and measure of the Γ_S facets in contact (collective)."""
        touching = self.contact_set().inside
        comm = self.spaces.mesh.comm
        count = comm.allreduce(int(np.count_nonzero(touching)))
        return count, float(comm.allreduce(self.spaces.facet_measure[touching].sum()))

    def violation(self) -> dict[str, float]:
        """What ε leaves of the Signorini condition, ‖[p − ψ]_-‖_Λ and ‖[σ·n − q_S]_-‖_Λ, or of (9b) (collective)."""
        spaces, data = self.spaces, self.data
        gap = self.p.x.array[: len(spaces.facets)] - data.psi_h
        excess = spaces.normal_flux(self.sigma) - data.q_Sh
        negative = [spaces.facet_measure @ np.minimum(values, 0) ** 2 for values in (gap, excess)]
        trace, flux = np.sqrt(spaces.mesh.comm.allreduce(np.array(negative))).tolist()
        left = {"trace": trace, "flux": flux}
        if self.algorithm.stabilised:
            left["mass_balance"] = float(np.sqrt(spaces.integrate(l2(ufl.div(self.sigma) + self.data.f_h, ufl.dx))))
        return left

    def summary(self) -> dict[str, Any]:
        """Everything about the run that fits into numbers, ready for JSON (collective)."""
        spaces, solve = self.spaces, self.case.solve
        contact_facets, contact_measure = self.contact()
        own = {} if self.own_residual is None else {"own_residual": self.own_residual}
        errors = self.errors()
        return {
            "case": self.case.name,
            "title": self.case.title,
            "algorithm": solve.algorithm,
            "backend": self.backend,
            "linear_solver": self.linear_solver,
            "h": spaces.domain.h,
            "cells": spaces.mesh.topology.index_map(spaces.mesh.topology.dim).size_global,
            "signorini_facets": spaces.Lambda.dofmap.index_map.size_global,
            "dofs": self.dofs,
            "contact_facets": contact_facets,
            "contact_measure": contact_measure,
            "iterations": len(self.history),
            "rough_steps": self.rough_steps,
            "converged": self.converged,
            "reason": self.reason,
            "norms": self.norms(),
            **({} if errors is None else {"errors": errors}),
            "kkt": vars(self.kkt),
            **own,
            **({"eps": solve.eps, "violation": self.violation()} if self.algorithm.has_eps else {}),
            "details": self.details,
            "timings": self.timings,
            "peak_memory": self.peak_memory,
            "ranks": spaces.mesh.comm.size,
        }


class Stopwatch:
    """Wall time per phase."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, phase: str) -> None:
        """Add the time since the last lap to a phase."""
        now = time.perf_counter()
        self.seconds[phase] = self.seconds.get(phase, 0.0) + now - self._last
        self._last = now

    def longest(self, comm: MPI.Comm) -> dict[str, float]:
        """Each phase's longest time over the ranks (collective)."""
        values = np.array(list(self.seconds.values()))
        comm.Allreduce(MPI.IN_PLACE, values, op=MPI.MAX)
        return dict(zip(self.seconds, values.tolist(), strict=True))


def discrete_data(case: Case, spaces: Spaces) -> Data:
    """The data of a case and their means (collective).

    Raises:
        InputError: If one of them cannot be used, see `project_data`.
    """
    return project_data(spaces, case.problem.on(ufl.SpatialCoordinate(spaces.mesh)))


def mesh_case(case: Case, comm: MPI.Comm) -> Domain:
    """Mesh the domain of a case, or read its mesh (collective).

    Raises:
        InputError: If there is no mesh with the case's h, or the file's mesh does not suit the case.
    """
    geometry = case.geometry
    if geometry.shape is not None:
        return build_domain(comm, geometry.shape, case.solve.h, mesh=geometry.mesh, diagonal=geometry.diagonal)
    domain = own_domain(comm, geometry.file or "", case.file_h, case.boundary.model_dump(exclude_none=True))
    case.check_dimension(domain.mesh.topology.dim)
    return domain


def rough_cells(case: Case) -> float:
    """About how many cells the mesh of a case has, without making it; a file is read (rank 0).

    Raises:
        InputError: If the file or its mesh cannot be used.
    """
    geometry = case.geometry
    if geometry.shape is not None:
        return estimated_cells(SHAPES[geometry.shape], case.solve.h)
    return expected_cells(geometry.file or "", case.file_h)


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
    run = _Run(
        case, algorithm or ALGORITHMS[case.solve.algorithm], backend or BACKENDS[case.solve.backend], spaces, data
    )
    watch.lap("assembly")
    predicted = None
    if start is not None:
        predicted = run.transferred(start)
    elif own_mesh and domain.mesh.topology.dim == 2 and run.predicts():
        predicted = run.predicted()  # in 3D a mesh so coarse sees too little and costs more than it saves
    watch.lap("prediction")
    outcome = run.outcome(predicted, watch, on_step)
    watch.lap("solve")

    kkt = run.residuals(outcome)
    if run.is_imprecise(outcome, kkt):
        watch.lap("kkt")
        outcome = run.by_saddle_point(outcome, kkt, on_step)
        watch.lap("solve")
        kkt = run.residuals(outcome)
    iterate = outcome.iterate
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


def check_solvability(spaces: Spaces, data: Data) -> None:
    """Without Γ_D the total load decides (collective).

    The flux leaves through Γ_S alone: ∫ (σ·n − q_S) on Γ_S = −m with m = ∫f + ∫g_N + ∫q_S, and must not be negative. If
    it is 0, u is a solution of the Neumann problem that any large constant may be added to.

    Raises:
        InputError: If there is no solution, or more than one.
    """
    if not spaces.has_dirichlet and data.total_load >= 0:
        verdict = "there is no solution" if data.total_load > 0 else "u is not unique"
        raise InputError(
            "no part of the boundary is left to u = u_D, and the total load ∫f + ∫g_N + ∫q_S is "
            f"{data.total_load:.3g}: {verdict}; it must be negative, or part of the boundary in Γ_D"
        )


def _failure(outcome: Outcome, kkt: KKTResiduals) -> str | None:
    """Why an outcome is not a solution: by the residual of its own problem, if it has one, else by those of (9)."""
    if not outcome.converged:
        return outcome.reason
    if outcome.own_residual is None:
        return kkt.violation()
    within = outcome.own_residual <= TOLERANCE
    return None if within else f"the residual of its own problem is {outcome.own_residual:.1e}, above {TOLERANCE:g}"


def same_domain(case: Case, domain: Domain, other_case: Case, other: Domain) -> bool:
    """Whether two meshes are of one domain: by the name of the shape; with files, by bounding boxes (collective)."""
    if case.geometry.shape is not None and other_case.geometry.shape is not None:
        return case.geometry.shape == other_case.geometry.shape
    if domain.mesh.topology.dim != other.mesh.topology.dim:
        return False
    distance = np.abs(domain.box() - other.box()).max()
    return bool(distance <= curve_gap(domain) + curve_gap(other))


@dataclass(frozen=True)
class _Run:
    """A discrete problem and what solves it."""

    case: Case
    algorithm: Algorithm
    backend: Callable[[Spaces, Data], Backend]
    spaces: Spaces
    data: Data

    def predicts(self) -> bool:
        """Whether the sets are worth a prediction."""
        facets = self.spaces.V.dofmap.index_map.size_global
        return self.case.solve.predict and self.algorithm.by is By.SETS and facets >= PREDICT_FROM

    def predicted(self) -> FacetConditions | None:
        """Conditions of the same case on a coarser mesh, which are predicted likewise if that is large (collective).

        None if there is no such mesh, or no solution on it. The prediction changes the number of steps only: the loop
        ends where the sets repeat, wherever it starts.
        """
        with contextlib.suppress(InputError, NumericalFailure):
            coarse = solve(self.case.with_values({"solve.h": COARSENING * self.case.solve.h}), self.spaces.mesh.comm)
            return self.transferred(coarse)
        return None

    def transferred(self, start: Solution) -> FacetConditions:
        """The contact set of another solution as conditions of this algorithm (collective).

        A facet is taken to be in contact where the other's facet at its midpoint is.

        Raises:
            InputError: If the domains differ, or the algorithm has no sets to start from.
        """
        spaces, geometry, other = self.spaces, self.case.geometry, start.case.geometry
        if not same_domain(self.case, spaces.domain, start.case, start.spaces.domain):
            raise InputError(f"the start was solved on '{other.name}', not on '{geometry.name}'")
        if self.algorithm.by is not By.SETS:
            raise InputError(
                f"{self.case.solve.algorithm} has no facet sets to start from; use alg1, alg2, alg3 or alg4"
            )
        (sample,) = sampled([start.contact_set().indicator()], spaces.Lambda.mesh, start.spaces.domain, degree=0)
        contact = np.rint(sample.x.array[: len(spaces.facets)])
        # either p or σ·n is 0
        return self.algorithm.next_conditions(1 - contact, contact, 1.0, self.case.solve.eps)

    def outcome(self, predicted: FacetConditions | None, watch: Stopwatch, on_step: Callable[[Step], None]) -> Outcome:
        """Set up the solver, run it and let it go (collective)."""
        options, algorithm, spaces, data = self.case.solve, self.algorithm, self.spaces, self.data
        max_iterations = self._max_iterations()
        if algorithm.by is By.CLASSICAL:
            if not spaces.has_dirichlet:
                raise InputError(f"{options.algorithm} needs a part of the boundary where u = u_D")
            from signorini_fenicsx.classical import CLASSICAL, Task  # SciPy is slow to import

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
        return self._by_sets(backend, predicted, watch, on_step)

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

    def _parameters(self) -> dict[str, float]:
        return {"rho": self.case.solve.rho or 1.0, "eps": self.case.solve.eps}

    def _iterate(self, backend: Backend, start: FacetConditions | None, on_step: Callable[[Step], None]) -> Outcome:
        """The active-set loop from these conditions, or from the algorithm's own start (collective)."""
        return iterate_sets(
            backend,
            self.algorithm,
            **self._parameters(),
            max_iterations=self._max_iterations(),
            predicted=start,
            on_step=on_step,
        )

    def _by_sets(
        self,
        backend: Backend,
        predicted: FacetConditions | None,
        watch: Stopwatch,
        on_step: Callable[[Step], None],
    ) -> Outcome:
        """The active-set loop from a prediction, or from a cold start where there is none or it fails (collective)."""
        spaces = self.spaces
        in_contact = np.full(len(spaces.facets), Condition.ZERO_TRACE, dtype=np.int8)
        first = None if spaces.has_dirichlet else FacetConditions(in_contact)  # others might be Neumann problems

        with contextlib.suppress(LinearSolveFailure):
            steps = 0
            if isinstance(backend, HybridBackend) and backend.iterative and self.predicts():
                predicted, steps = settle_sets(backend, self.algorithm, **self._parameters(), start=predicted or first)
                watch.lap("prediction")
            if predicted is not None:
                outcome = replace(self._iterate(backend, predicted, on_step), rough_steps=steps)
                if outcome.converged:
                    return outcome
        cold = self._iterate(backend, first, on_step)
        if predicted is None:
            return cold
        return replace(cold, reason=f"{cold.reason}, from a cold start because the predicted one failed")
