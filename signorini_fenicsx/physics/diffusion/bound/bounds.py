"""What bounds the errors of scalar problems."""

from typing import Any

from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.certificate.certify import Bounds, no_bound
from signorini_fenicsx.physics.diffusion.bound.certify import certificate_of
from signorini_fenicsx.physics.diffusion.bound.of_field import field_bound
from signorini_fenicsx.physics.diffusion.bound.steps import StepBounds
from signorini_fenicsx.physics.diffusion.linear_solution import LinearSolution
from signorini_fenicsx.physics.diffusion.solution import Solution


def _of_solution(solution: Solution, **wanted: Any) -> Certificate:
    """The certificate of a solution; there is none of RT1 (collective)."""
    if isinstance(solution, LinearSolution):
        return no_bound(solution, "RT1")
    return certificate_of(solution, **wanted)


BOUNDS = Bounds(_of_solution, field_bound, StepBounds)
