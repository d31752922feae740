"""The bound of a solution of any physics."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.certificate.certify import Certificate
from signorini_fenicsx.certificate.certify import certify as certify_diffusion
from signorini_fenicsx.certificate.certify_elastic import certify_elastic
from signorini_fenicsx.solving.solved import Solved

BOUNDS: dict[str, Callable[[Any, bool], Certificate]] = {
    "diffusion": lambda solution, for_signorini: certify_diffusion(solution, for_signorini=for_signorini),
    "elasticity": lambda solution, _: certify_elastic(solution),
}
"""The bounds of the physics that have one."""


@collector_off()
def certify(solution: Any, *, for_signorini: bool = False) -> Certificate:
    """Bound the energy error of a converged solution, see `certificate.certify` and `certify_elastic` (collective).

    Args:
        solution: The solution.
        for_signorini: Of a method with a penalty, bound the error to the solution of the problem without.

    Raises:
        InputError: If the solution has not converged, or is none that can be bounded.
    """
    check_kind("solution", solution, Solved)
    if solution.physics not in BOUNDS:
        return _none(solution)
    return BOUNDS[solution.physics](solution, for_signorini)


def _none(solution: Solved) -> Certificate:
    """No bound (collective)."""
    spaces, infinite = solution.spaces, math.inf
    return Certificate(
        bound=infinite,
        sigma_bound=infinite,
        gap=infinite,
        oscillation=infinite,
        remainder=infinite,
        relative=infinite,
        guaranteed=False,
        by_quadrature=(),
        unresolved=(),
        coarse=np.zeros(len(spaces.cell_measures), dtype=bool),
        indicator=fem.Function(spaces.Q, name="indicator"),
        v=solution.u,
        if_none=f"none is known for {solution.physics}",
    )
