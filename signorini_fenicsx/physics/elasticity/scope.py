"""For which elastic problems there is a theorem."""

from collections.abc import Mapping
from typing import Any

from signorini_fenicsx.physics.elasticity.problem import ElasticProblem


def outside(problem: ElasticProblem) -> str:
    """Why the proof is not for a problem, in words; empty if it is."""
    along_axes = _has_list(problem.young) or _has_list(problem.poisson)
    reasons = {
        "with other laws than contact and friction": bool(problem.normal),
        "with rigid tools under a force or from a surface": bool(problem.surface or problem.force or problem.moment),
        "on elastic supports": bool(problem.support),
        "of orthotropic bodies": along_axes or problem.shear is not None or problem.axes is not None,
        "with pairs of surfaces that share no nodes": bool(problem.boundary.pairs),
        "with an initial stress": problem.initial_stress is not None,
    }
    reasons_that_hold = [reason for reason, holds in reasons.items() if holds]
    return f"the proof is not for elastic problems {reasons_that_hold[0]}" if reasons_that_hold else ""


def _has_list(given: Any) -> bool:
    """Whether a modulus has three values somewhere."""
    values = given.values() if isinstance(given, Mapping) else [given]
    return any(isinstance(value, list | tuple) for value in values)
