"""Loads in steps: an elastic body at rest at each time, with friction against what has slipped before.

The shear is within its bound, and against the way that u_t has gone since the last step: |σ_t| ≤ g, and −σ_t·(u_t − w)
= g|u_t − w| with w = u_t at the end of the last step. This holds at every vertex, also at one that was open.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.physics.elasticity.problem import ElasticProblem
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.physics.elasticity.spaces import ElasticSpaces
from signorini_fenicsx.solving.evolution import Evolution


class ElasticSteps:
    """The steps of an elastic problem on a mesh, see `solving.evolution.Steps`."""

    def __init__(self, spaces: ElasticSpaces, problem: ElasticProblem, evolution: Evolution):
        """Read the data.

        Raises:
            InputError: If a text cannot be read.
        """
        self._spaces, self._evolution = spaces, evolution
        self._problem = problem.in_time(spaces.dim)

    def start(self) -> Array:
        """No slip, at the sites with friction."""
        return np.zeros(len(self._spaces.slip_sites))

    def problem(self, step: int) -> ElasticProblem:
        """The problem at the time of a step."""
        return self._problem.at(self._evolution.time(step))

    def memory(self, _step: int, before: Sequence[Array]) -> Array:
        """The slip at the end of the last step."""
        return before[0]

    def left_by(self, solution: ElasticSolution) -> Array:
        """The slip at the end of this step."""
        return solution.slip.ravel()
