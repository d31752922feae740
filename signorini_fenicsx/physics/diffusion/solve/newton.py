"""The penalty formulations (25) and (26) by PETSc SNES: RT0, P0 and the facet multiplier as one block system.

*The facet problem as a quadratic programme with p ≥ 0 on Γ_S, solved by PETSc SNESVI*.

½(∇_h u, ∇_h u) − (f_h, u) is minimised over Crouzeix-Raviart functions with u = 0 on Γ_D and facet means ≥ 0 on Γ_S.
For RT1 it is the energy of û in P1 on facets, and the means are those weighted by the hats. The minimiser is the
solution of (MLM-I)_h. It is found without the set rules and the active-set loop, so this is an independent check of
them.
"""

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import NonlinearProblem, assign
from petsc4py import PETSc

from signorini_fenicsx.base.arrays import Array, Indices
from signorini_fenicsx.base.tolerances import LINEAR
from signorini_fenicsx.base.tuning import Tuning
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Condition, Penalty, SiteConditions
from signorini_fenicsx.contact.history import OnStep, Outcome
from signorini_fenicsx.discrete.trace_multigrid import DIRECT_UP_TO as OF_VERTICES
from signorini_fenicsx.forms.mixed import flux_equation, load, mass_balance, trace_term
from signorini_fenicsx.forms.penalty import flux_penalty_law, trace_penalty_law
from signorini_fenicsx.linear.petsc import MUMPS_WORKSPACE, set_direct, snes_failure, solver_name, take_options
from signorini_fenicsx.physics.diffusion.discrete.data import Data
from signorini_fenicsx.physics.diffusion.discrete.spaces import Spaces
from signorini_fenicsx.physics.diffusion.solve.flux_backend import FluxBackend
from signorini_fenicsx.physics.diffusion.solve.hybrid import DIRECT_UP_TO, HybridBackend
from signorini_fenicsx.physics.diffusion.solve.recorder import Recorder
from signorini_fenicsx.physics.diffusion.solve.rt1_backend import RT1Backend
from signorini_fenicsx.physics.diffusion.solve.task import DiffusionTask, RT1Task

VI_PREFIX = "vi_"
"""Prefix of its PETSc options."""
DEFAULTS = MUMPS_WORKSPACE | {"snes_vi_zero_tolerance": "0.0"}
"""PETSc counts p as on its bound if it is within 1e-8 of it, an absolute distance that is large for small data."""


def solve_bound_constrained(task: DiffusionTask) -> Outcome:
    """Solve by the reduced-space active-set method of SNESVI, vinewtonrsls (collective).

    The user may set all SNES, KSP and PC options. The line search may give up where the sets cycle; then SNESVI goes on
    from there with full steps, and the reason says so.

    Raises:
        InputError: If PETSc refuses an option.
    """
    with task.watch.phase("assembly"):
        backend, large = _free(task)
        free = SiteConditions.everywhere(Condition.NO_FLUX, backend.sites)
        matrix, fixed, _, load = backend.imposed(free)
        (x, b), law = matrix.createVecs(), task.data.chains
        x.set(0.0)
        b.array_w[:] = load
        b.array_w[fixed] = 0.0
    low, high, *_ = law.extent()

    def reached(iterations: int) -> tuple[Iterate, SiteConditions]:
        """The present solution; a facet is in contact where p is at one of its bounds."""
        x.copy(backend.x)
        p = backend.means(x)
        conditions = law.conditions(np.where(p >= high, law.count, p > low))
        return replace(backend.recovered(conditions, refine=False), linear_iterations=iterations), conditions

    snes = _snes(matrix, b, (backend.spaces.site_kinds.unknown, low, high), task.max_iterations, large=large)
    recorder = Recorder(task.spaces, *reached(0), task.on_step)

    def record(snes: PETSc.SNES, iteration: int, _norm: float) -> None:
        if iteration > 0:
            recorder.add(*reached(snes.getKSP().getIterationNumber()))

    snes.setMonitor(record)
    failure = snes_failure(snes, lambda: snes.solve(None, x), VI_PREFIX, DEFAULTS)
    ending = failure or "SNESVI converged"
    if failure is not None and snes.getConvergedReason() == PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH:
        snes.getLineSearch().setType("basic")
        again = snes_failure(snes, lambda: snes.solve(None, x), VI_PREFIX, DEFAULTS)
        ending = f"{again or 'SNESVI converged'}, by full steps after {failure}"
        failure = again
    state = reached(snes.getKSP().getIterationNumber())
    name = f"{snes.getType()}+{solver_name(snes.getKSP())}"
    snes.destroy()
    for vector in (x, b):
        vector.destroy()  # after SNESVI on several ranks, PETSc's garbage collection would not free them
    return recorder.outcome(state, ending, (backend.name, backend.dofs, name), converged=failure is None)


def _free(task: DiffusionTask) -> tuple[FluxBackend, bool]:
    """The backend, whose own solver is not used, and whether an iterative one is the default (collective)."""
    unused = Tuning(direct_up_to=sys.maxsize, predict_from=sys.maxsize)
    backend: FluxBackend
    if isinstance(task, RT1Task):
        backend, most = RT1Backend(task.spaces, task.data, unused), OF_VERTICES[task.spaces.dim]
    else:
        backend, most = HybridBackend(task.spaces, task.data, tuning=unused), DIRECT_UP_TO
    return backend, task.tuning.is_large(backend.dofs, most)


def _snes(
    matrix: PETSc.Mat, b: PETSc.Vec, bounds: tuple[Indices, Array, Array], max_iterations: int, *, large: bool
) -> PETSc.SNES:
    """SNESVI for a linear system with bounds of some unknowns, see `solve_bound_constrained` (collective)."""
    snes = PETSc.SNES().create(matrix.getComm())

    def residual(snes: PETSc.SNES, x: PETSc.Vec, out: PETSc.Vec) -> None:
        matrix.mult(x, out)
        out.axpy(-1.0, b)

    snes.setFunction(residual, matrix.createVecLeft())
    snes.setJacobian(lambda snes, x, jacobian, preconditioner: None, matrix)
    lower, upper = matrix.createVecs()
    lower.set(-PETSc.INFINITY)
    upper.set(PETSc.INFINITY)
    sites, low, high = bounds
    lower.array_w[sites] = low
    upper.array_w[sites] = high
    snes.setVariableBounds(lower, upper)
    snes.setType("vinewtonrsls")
    snes.setTolerances(rtol=1e-11, atol=1e-200, stol=0.0, max_it=max_iterations)
    ksp, pc = snes.getKSP(), snes.getKSP().getPC()
    if large:
        ksp.setType("cg")
        ksp.setTolerances(rtol=LINEAR)
        pc.setType("gamg")
    else:
        set_direct(ksp, "cholesky")
    take_options(snes, VI_PREFIX, DEFAULTS)
    return snes


PREFIX = "newton_"
"""Prefix of its PETSc options."""
CONTINUATION = 10.0
"""Factor between successive ε when the direct start fails."""


def solve_by_newton(penalty: Penalty, task: DiffusionTask) -> Outcome:
    """(25) or (26) by SNES (collective).

    Raises:
        InputError: If PETSc refuses an option.
    """
    with task.watch.phase("assembly"):
        newton = PenaltyNewton(task.spaces, task.data, penalty, eps=task.eps, max_iterations=task.max_iterations)
    return newton.solve(task.on_step)


class PenaltyNewton:
    """Semismooth Newton for (MPε-I)_h or (MPε-II)_h by PETSc SNES.

    SNES gets the laws without 1/ε of `forms/penalty.py` and their derivative by UFL, for σ − σ_lift, u and p − ψ. The
    user may set all its options: -snes_monitor, -snes_linesearch_type bt, -newton_snes_type newtontr, …
    """

    def __init__(self, spaces: Spaces, data: Data, penalty: Penalty, *, eps: float, max_iterations: int):
        """Compile the forms and set up SNES (collective).

        Raises:
            InputError: If PETSc refuses an option.
        """
        self._spaces, self._data, self._penalty, self._eps = spaces, data, penalty, eps
        V, Q, Lambda = spaces.V, spaces.Q, spaces.Lambda
        self._fields = fem.Function(V, name="sigma"), fem.Function(Q, name="u"), fem.Function(Lambda, name="p")
        sigma, u, p = self._fields
        tau, v, q = ufl.TestFunction(V), ufl.TestFunction(Q), ufl.TestFunction(Lambda)
        self._eps_now = fem.Constant(spaces.mesh, eps)
        self._reset()
        law = trace_penalty_law if penalty is Penalty.TRACE else flux_penalty_law
        flux, n, dx, ds = sigma + data.sigma_lift, spaces.n, ufl.dx, spaces.ds
        of_data = trace_term(data.u_lift, tau, n, spaces.ds_dirichlet + ds)
        source = data.f_h if data.c_h is None else data.f_h - data.c_h * u
        residual = [
            flux_equation(flux, u, tau, dx, data.kappa_h) - trace_term(p, tau, n, ds) - of_data,  # (25a)
            mass_balance(flux, v, dx) + load(source, v, dx),  # (25b)
            law(sigma, p, q, self._eps_now, n, ds),
        ]
        self._problem = NonlinearProblem(
            residual,
            list(self._fields),
            kind="mpi",
            bcs=[fem.dirichletbc(fem.Function(V), spaces.neumann_dofs)],
            entity_maps=[spaces.entity_map],
            petsc_options_prefix="signorini_",  # required; with defaults DOLFINx would delete the user's options
        )
        self._snes = self._problem.solver
        self._set_defaults(max_iterations)
        self._snes.setOptionsPrefix("")
        take_options(self._snes, PREFIX)

    def _set_defaults(self, max_iterations: int) -> None:
        """Full Newton steps with MUMPS until a step is tiny; a small residual is no test, its set may be wrong."""
        snes = self._snes
        snes.setType("newtonls")
        snes.getLineSearch().setType("basic")
        snes.setTolerances(rtol=0.0, atol=0.0, stol=LINEAR, max_it=max_iterations)
        snes.setDivergenceTolerance(PETSc.UNLIMITED)
        set_direct(snes.getKSP(), "lu")

    def solve(self, on_step: OnStep = lambda step: None) -> Outcome:
        """Solve, directly or, if that fails, by continuation in ε from 1 down (collective)."""
        start = self._iterate()
        recorder = Recorder(self._spaces, start, self._conditions(start), on_step)

        def record(snes: PETSc.SNES, iteration: int, _norm: float) -> None:
            if iteration > 0:
                assign(snes.getSolution(), list(self._fields))
                iterate = self._iterate()
                recorder.add(iterate, self._conditions(iterate))

        failure = self._newton(self._eps, record)
        remark = ""
        if failure is not None and self._eps < 1:
            remark = f", by continuation from ε = 1: the direct start ended with {failure}"
            self._reset()
            stages = int(np.ceil(-np.log(self._eps) / np.log(CONTINUATION)))
            for exponent in range(stages + 1):
                failure = self._newton(self._eps ** (exponent / stages), record)
        self._snes.cancelMonitor()  # PETSc and this object hold each other: a cycle that Python cannot collect
        iterate = self._iterate()
        state, reason = (iterate, self._conditions(iterate)), (failure or "SNES converged") + remark
        solver = f"{self._snes.getType()}+{solver_name(self._snes.getKSP())}"
        system = "mixed", self._problem.x.getSize(), solver
        return recorder.outcome(state, reason, system, converged=failure is None)

    def _reset(self) -> None:
        """The start: 0, or without Γ_D contact everywhere: otherwise the first problem is a Neumann problem."""
        for field in self._fields:
            field.x.array[:] = 0.0
        if not self._spaces.has_dirichlet:
            self._fields[2].x.array[:] = -1.0

    def _newton(self, eps: float, record: Callable[[PETSc.SNES, int, float], None]) -> str | None:
        """One run of SNES from the current fields; return the reason of its failure, or None (collective)."""
        self._eps_now.value[...] = eps
        self._snes.cancelMonitor()
        take_options(self._snes, PREFIX)  # cancelling removed the user's monitors as well
        self._snes.setMonitor(record)
        return snes_failure(self._snes, self._problem.solve, PREFIX)

    def _iterate(self) -> Iterate:
        """A copy of the current fields, with the exact values that their facet conditions prescribe (collective)."""
        sigma, u, p = (field.copy() for field in self._fields)
        sigma.x.scatter_forward()
        u.x.scatter_forward()
        size = len(self._spaces.facets)
        trace = p.x.array[:size].astype(np.float64)
        flux = self._spaces.normal_flux(sigma)
        sigma.x.array[:] += self._data.sigma_lift.x.array
        linear_iterations = self._snes.getKSP().getIterationNumber()
        raw = Iterate(p=trace, flux=flux, linear_iterations=linear_iterations, sigma=sigma, u=u)
        p_clean, flux_clean = self._conditions(raw).clean(raw.p, raw.flux, self._data.conductance)
        return replace(raw, p=p_clean, flux=flux_clean)

    def _conditions(self, iterate: Iterate) -> SiteConditions:
        """The branch of min that each facet is on, as facet conditions."""
        p, flux = self._penalty.shift(iterate.p, iterate.flux, self._eps)
        if self._penalty is Penalty.TRACE:
            kind = np.where(flux < p, Condition.NO_FLUX, Condition.ROBIN)
        else:
            kind = np.where(p < flux, Condition.ZERO_TRACE, Condition.ROBIN)
        return SiteConditions(kind.astype(np.int8), self._penalty.beta(self._eps))
