"""Slimane's stabilised form, and the Uzawa iteration whose steps are minimisations of this form.

Both minimise over the convex set Ṽ_h of fluxes with τ·n ≥ 0 on Γ_S. The minimisers satisfy a unilateral mixed problem:

    slimane            ½‖τ‖² + (1/2ε)‖∇·τ + f_h‖²,                      u = (1/ε)(∇·σ + f_h),
    mixed-uzawa-wang   ½‖τ‖² + (u^(n−1), ∇·τ + f_h) + (ρ/2)‖∇·τ + f_h‖², u^(n) = u^(n−1) + ρ(∇·σ^(n) + f_h).

Slimane's solution solves −Δu + εu = f: the residual of its mass balance is εu, which tends to 0 with ε. Uzawa's
iteration for the augmented Lagrangian of (MVI)_h ends only where ∇·σ + f_h = 0. It converges for any ρ > 0, by the
factor 1/(1 + ρλ_1) per step, where λ_1, the smallest eigenvalue of the mixed Laplacian, hardly depends on h. Without
the last term each step would be a minimisation with the mass matrix alone, but then ρ would be bounded by O(h²).
"""

import math
from dataclasses import replace

import numpy as np
import ufl
from dolfinx import fem

from signorini_fenicsx.base.text import counted
from signorini_fenicsx.base.tolerances import STEP
from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.contact.loop import Parameters, iterate_sets
from signorini_fenicsx.contact.set_rules import ALGORITHM_1
from signorini_fenicsx.forms.norms import l2
from signorini_fenicsx.physics.diffusion.solve.mixed import MixedBackend
from signorini_fenicsx.physics.diffusion.solve.recorder import Recorder
from signorini_fenicsx.physics.diffusion.solve.task import DiffusionTask, nothing_yet


def stabilised_form(task: DiffusionTask) -> Outcome:
    """Slimane's form by the active-set loop of Algorithm 1, with −ε(u, v) in the mass balance (collective).

    Raises:
        LinearSolveFailure: If the start cannot be solved.
    """
    spaces = task.spaces
    system = MixedBackend(spaces, task.data, stabilisation=task.eps)
    parameters = Parameters(task.rho or 1.0, task.eps, task.max_iterations)
    outcome = iterate_sets(system, replace(ALGORITHM_1, forgets_start=False), parameters, on_step=task.on_step)
    iterate = outcome.iterate
    load = fem.Function(spaces.Q)
    load.x.array[:] = task.data.f_h.x.array - task.eps * iterate.u.x.array
    kkt = replace(task, data=replace(task.data, f_h=load)).kkt(iterate, None)
    return replace(outcome, own_residual=float(np.max([*vars(kkt).values()])))


def minimisation_uzawa(task: DiffusionTask) -> Outcome:
    """The Uzawa iteration in u for (MVI)_h, from u^(0) = 0 (collective).

    Each minimisation starts from the facet sets of the one before, so most of them are one back substitution. The
    automatic ρ is |Ω|^(2/d), which like 1/λ_1 is the square of a length.

    Raises:
        LinearSolveFailure: If a linear system cannot be solved.
    """
    spaces = task.spaces
    length = spaces.length
    rho = task.rho or length**2
    system = MixedBackend(spaces, task.data, stabilisation=1 / rho)
    parameters = Parameters(max_iterations=task.max_iterations)
    iterate, conditions = nothing_yet(spaces)
    recorder = Recorder(spaces, iterate, conditions, task.on_step)
    failure: str | None = f"the mass balance does not hold after {counted(task.max_iterations, 'iteration')}"
    for _ in range(task.max_iterations):
        inner = iterate_sets(system, ALGORITHM_1, parameters, start=conditions)
        iterate, conditions = inner.iterate, inner.conditions
        system.before.x.array[:] = iterate.u.x.array
        recorder.add(iterate, conditions)
        if not inner.converged:
            failure = f"a minimisation did not end: {inner.reason}"
            break
        sigma_norm = math.sqrt(spaces.integrate(l2(iterate.sigma, ufl.dx)))
        if recorder.steps[-1].u_change * length <= STEP * rho * sigma_norm:
            failure = None
            break
    reason, solved = failure or "the mass balance holds", (system.name, system.dofs, system.solver())
    details = {"rho": rho, "rho_limit": math.inf}
    return recorder.outcome((iterate, conditions), reason, solved, converged=failure is None, details=details)
