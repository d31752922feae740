"""The facet problem as what it is, a quadratic programme with p ≥ 0 on Γ_S, by PETSc SNESVI.

½(∇_h u, ∇_h u) − (f_h, u) is minimised over Crouzeix-Raviart functions with u = 0 on Γ_D and facet means ≥ 0 on Γ_S.
Its solution is that of (MLM-I)_h, found without the set rules or the active-set loop: an independent nonlinear solver.
"""

from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from signorini_fenicsx.backends.contract import (
    Iterate,
    petsc_reason,
    refuse_options,
    set_direct,
    solver_name,
    take_options,
)
from signorini_fenicsx.backends.facet_system import FacetSystem
from signorini_fenicsx.base.signals import pass_on
from signorini_fenicsx.discrete.conditions import Condition, FacetConditions
from signorini_fenicsx.methods.loop import Outcome, Recorder, Step

ZERO_TOLERANCE = "snes_vi_zero_tolerance"
"""How near its bound p counts as on it: absolutely, 1e-8 by default, which is much for small data."""


def solve_bound_constrained(
    system: FacetSystem, *, max_iterations: int, on_step: Callable[[Step], None] = lambda step: None
) -> Outcome:
    """Solve by the reduced-space active-set method of SNESVI, vinewtonrsls (collective).

    All SNES, KSP and PC options are the user's, without a prefix. If its line search gives up, as it may where the
    sets cycle, it goes on from there with full steps, which is told in the reason.

    Args:
        system: The facet system; its vectors are destroyed.
        max_iterations: Iterations of SNES.
        on_step: Called on all ranks after each iteration.

    Raises:
        InputError: If PETSc refuses an option.
    """
    everywhere_free = FacetConditions(np.full(len(system.spaces.facets), Condition.NO_FLUX, dtype=np.int8))
    system.apply(everywhere_free)
    system.x.set(0.0)
    x = system.matrix.createVecRight()  # without ghosts: PETSc never frees a duplicate of a vector with ghosts
    x.set(0.0)
    snes = _snes(system, max_iterations)
    recorder = Recorder(system.spaces, *_recovered(system, 0), on_step)

    def record(snes: PETSc.SNES, iteration: int, _norm: float) -> None:
        if iteration > 0:
            x.copy(system.x)
            recorder.add(*_recovered(system, snes.getKSP().getIterationNumber()))

    snes.setMonitor(record)
    failure = _failure(snes, x)
    ending = failure or "SNESVI converged"
    if failure is not None and snes.getConvergedReason() == PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH:
        snes.getLineSearch().setType("basic")
        again = _failure(snes, x)
        ending = f"{again or 'SNESVI converged'}, by full steps after {failure}"
        failure = again
    x.copy(system.x)
    iterate, conditions = _recovered(system, snes.getKSP().getIterationNumber())
    name = f"{snes.getType()}+{solver_name(snes.getKSP())}"
    snes.destroy()
    for vector in (system.x, system.b):
        vector.destroy()  # SNESVI makes PETSc's queue of what Python lets go lose them on several ranks
    return Outcome(iterate, conditions, recorder.steps, ending, failure is None, "hybrid", system.dofs, name)


def _failure(snes: PETSc.SNES, x: PETSc.Vec) -> str | None:
    """Solve from x; why that failed, or None (collective)."""
    try:
        snes.solve(None, x)
    except PETSc.Error as error:
        pass_on(error)
        refuse_options(error)
        return f"PETSc: {petsc_reason(error)}"
    reason = snes.getConvergedReason()
    return None if reason > 0 else f"SNESVI stopped with PETSc's reason {reason}"


def _snes(system: FacetSystem, max_iterations: int) -> PETSc.SNES:
    """SNESVI on the system as it is applied now, with its bounds."""
    snes = PETSc.SNES().create(system.matrix.getComm())
    matrix, b = system.matrix, system.b

    def residual(snes: PETSc.SNES, x: PETSc.Vec, out: PETSc.Vec) -> None:
        matrix.mult(x, out)
        out.axpy(-1.0, b)

    snes.setFunction(residual, matrix.createVecLeft())
    snes.setJacobian(lambda snes, x, jacobian, preconditioner: None, matrix)
    lower, upper = matrix.createVecs()
    lower.set(-PETSc.INFINITY)
    upper.set(PETSc.INFINITY)
    lower.array_w[system.trace_dofs] = 0.0
    snes.setVariableBounds(lower, upper)
    snes.setType("vinewtonrsls")
    snes.setTolerances(rtol=1e-11, atol=1e-200, stol=0.0, max_it=max_iterations)
    ksp, pc = snes.getKSP(), snes.getKSP().getPC()
    if system.large:
        ksp.setType("cg")
        ksp.setTolerances(rtol=1e-12)
        pc.setType("gamg")
    else:
        set_direct(ksp, "cholesky")
    options = PETSc.Options()
    if not options.hasName(ZERO_TOLERANCE):
        options[ZERO_TOLERANCE] = 0.0
    take_options(snes)
    return snes


def _recovered(system: FacetSystem, linear_iterations: int) -> tuple[Iterate, FacetConditions]:
    """The present solution; a facet is in contact where p is at its bound."""
    p = system.x.array_r[system.trace_dofs]
    kind = np.where(p <= 0, Condition.ZERO_TRACE, Condition.NO_FLUX).astype(np.int8)
    conditions = FacetConditions(kind)
    return system.recover(conditions, linear_iterations), conditions
