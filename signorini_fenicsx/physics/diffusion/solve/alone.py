"""The methods for diffusion alone, by the names of the functions that run them, see `methods/registry.py`."""

from collections.abc import Callable, Mapping

from signorini_fenicsx.contact.history import Outcome
from signorini_fenicsx.physics.diffusion.solve.classical.mixed_uzawa import flux_uzawa, half_uzawa, trace_uzawa
from signorini_fenicsx.physics.diffusion.solve.classical.over_relaxation import over_relaxation
from signorini_fenicsx.physics.diffusion.solve.classical.primal_sets import primal_dual_active_set, primal_penalty
from signorini_fenicsx.physics.diffusion.solve.classical.primal_uzawa import primal_uzawa
from signorini_fenicsx.physics.diffusion.solve.classical.quadratic import quadratic_programme
from signorini_fenicsx.physics.diffusion.solve.classical.stabilised import minimisation_uzawa, stabilised_form
from signorini_fenicsx.physics.diffusion.solve.newton import solve_bound_constrained, solve_by_newton

METHODS: Mapping[str, Callable[..., Outcome]] = {
    method.__name__: method
    for method in (
        *(solve_by_newton, solve_bound_constrained, quadratic_programme),
        *(primal_uzawa, over_relaxation, primal_dual_active_set, primal_penalty),
        *(flux_uzawa, trace_uzawa, half_uzawa, minimisation_uzawa, stabilised_form),
    )
}
