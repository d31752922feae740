"""The facet problem as a quadratic programme with p ≥ 0 on Γ_S, solved by PETSc SNESVI.

½(∇_h u, ∇_h u) − (f_h, u) is minimised over Crouzeix-Raviart functions with u = 0 on Γ_D and facet means ≥ 0 on Γ_S.
For RT1 it is the energy of û in P1 on facets, and the means are those weighted by the hats. The minimiser is the
solution of (MLM-I)_h. It is found without the set rules and the active-set loop, so this is an independent check of
them.
"""

import numpy as np
from petsc4py import PETSc

from signorini_fenicsx.base.tolerances import LINEAR
from signorini_fenicsx.contact.backend import Iterate
from signorini_fenicsx.contact.chains import Chains, Condition, SiteConditions
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.linear.petsc import MUMPS_WORKSPACE, set_direct, snes_failure, solver_name, take_options
from signorini_fenicsx.physics.diffusion.solve.facet_system import FacetSystem
from signorini_fenicsx.physics.diffusion.solve.linear_backend import FreeVertices
from signorini_fenicsx.physics.diffusion.solve.recorder import Recorder
from signorini_fenicsx.physics.diffusion.solve.task import DiffusionTask, LinearTask

PREFIX = "vi_"
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
        system: FacetSystem | FreeVertices
        if isinstance(task, LinearTask):
            system = FreeVertices(task.spaces, task.data, task.tuning)
        else:
            system = FacetSystem(task.spaces, task.data, task.tuning)
            system.apply(SiteConditions.everywhere(Condition.NO_FLUX, len(system.spaces.facets)))
    system.x.set(0.0)
    x = system.matrix.createVecRight()  # without ghosts: PETSc never frees a duplicate of a vector with ghosts
    x.set(0.0)
    law = task.data.chains
    snes = _snes(system, law, task.max_iterations)
    recorder = Recorder(system.spaces, *_recovered(system, law, 0), task.on_step)

    def record(snes: PETSc.SNES, iteration: int, _norm: float) -> None:
        if iteration > 0:
            x.copy(system.x)
            recorder.add(*_recovered(system, law, snes.getKSP().getIterationNumber()))

    snes.setMonitor(record)
    failure = snes_failure(snes, lambda: snes.solve(None, x), PREFIX, DEFAULTS)
    ending = failure or "SNESVI converged"
    if failure is not None and snes.getConvergedReason() == PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH:
        snes.getLineSearch().setType("basic")
        again = snes_failure(snes, lambda: snes.solve(None, x), PREFIX, DEFAULTS)
        ending = f"{again or 'SNESVI converged'}, by full steps after {failure}"
        failure = again
    x.copy(system.x)
    state = _recovered(system, law, snes.getKSP().getIterationNumber())
    name = f"{snes.getType()}+{solver_name(snes.getKSP())}"
    snes.destroy()
    for vector in (system.x, system.b):
        vector.destroy()  # after SNESVI on several ranks, PETSc's garbage collection would not free them
    return recorder.outcome(state, ending, (system.name, system.dofs, name), converged=failure is None)


def _snes(system: FacetSystem | FreeVertices, law: Chains, max_iterations: int) -> PETSc.SNES:
    """SNESVI for the system under its current conditions, with its bounds (collective)."""
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
    low, high, *_ = law.extent()
    lower.array_w[system.trace_dofs] = low
    upper.array_w[system.trace_dofs] = high
    snes.setVariableBounds(lower, upper)
    snes.setType("vinewtonrsls")
    snes.setTolerances(rtol=1e-11, atol=1e-200, stol=0.0, max_it=max_iterations)
    ksp, pc = snes.getKSP(), snes.getKSP().getPC()
    if system.large:
        ksp.setType("cg")
        ksp.setTolerances(rtol=LINEAR)
        pc.setType("gamg")
    else:
        set_direct(ksp, "cholesky")
    take_options(snes, PREFIX, DEFAULTS)
    return snes


def _recovered(
    system: FacetSystem | FreeVertices, law: Chains, linear_iterations: int
) -> tuple[Iterate, SiteConditions]:
    """The current solution; a facet is in contact where p is at one of its bounds."""
    p = system.x.array_r[system.trace_dofs]
    low, high, *_ = law.extent()
    conditions = law.conditions(np.where(p >= high, law.count, p > low))
    return system.recover(conditions, linear_iterations), conditions
