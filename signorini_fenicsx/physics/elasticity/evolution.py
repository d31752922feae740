"""Loads in steps: an elastic body at rest at each time, with friction against what has slipped before.

The shear is within its bound, and against the way that u_t has gone since the last step: |σ_t| ≤ g, and −σ_t·(u_t − w)
= g|u_t − w| with w = u_t at the end of the last step. This holds at every vertex, also at one that was open.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt
from ufl import Form

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import NumericalFailure
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.physics.elasticity.discrete.friction import FromBefore
from signorini_fenicsx.physics.elasticity.discrete.spaces import ElasticSpaces
from signorini_fenicsx.physics.elasticity.problem import ElasticProblem
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.solving.evolution import Evolution, Past


class ElasticSteps:
    """The steps of an elastic problem on a mesh, see `solving.evolution.Steps`.

    Attributes:
        spaces: The discrete spaces.
    """

    def __init__(self, spaces: ElasticSpaces, problem: ElasticProblem, evolution: Evolution):
        """Read the data.

        Raises:
            InputError: If a text cannot be read.
        """
        self.spaces, self._evolution = spaces, evolution
        self._problem = problem.in_time(spaces.dim)

    def start(self) -> Array:
        """No slip, at the sites with friction."""
        return np.zeros(len(self.spaces.site_kinds["slip"]))

    def problem(self, step: int, _before: Sequence[Array] = ()) -> ElasticProblem:
        """The problem at the time of a step."""
        return self._problem.at(self._evolution.time(step))

    def touching(self, _problem: ElasticProblem, _solution: ElasticSolution) -> None:
        """None: there are no laws with memory that are curves."""

    def memory(self, _step: int, before: Sequence[Array]) -> FromBefore:
        """The slip at the end of the last step."""
        return FromBefore(before[0])

    def by_earlier(self, step: int, by: Mapping[str, Array]) -> Sequence[tuple[int, Array]]:
        """The derivatives by the slip of the last step, see `solving.evolution.Steps`."""
        return [(step - 1, by["slipped"])] if step > 1 else []

    def functional(self, _solution: ElasticSolution, by: Array) -> Array:
        """The derivatives by û_t at the sites with friction."""
        return by

    def at_start(self, _by: Array) -> Form:
        """A form without terms: the slip before the first step is 0."""
        return Form([])

    def left_by(self, solution: ElasticSolution) -> Array:
        """The slip at the end of this step."""
        return solution.slipped

    def of_step(self, _solution: ElasticSolution, _earlier: Mapping[str, float] | None = None) -> dict[str, float]:
        """No number: all are of the solution itself."""
        return {}

    def halved(self, _failure: NumericalFailure) -> None:
        """None: a step without time is not easier if it is shorter."""

    def kept(self, solution: ElasticSolution) -> dict[str, npt.NDArray]:
        """For each vertex of Γ_C its segments, its slip as a vector and the bound of the shear."""
        kinds, segments = self.spaces.site_kinds, solution.segments()
        normal, along = kinds.spread(segments.segment)
        slip = kinds["slip"].spread(self.spaces.along(solution.slipped))
        on_facets = {"own": normal.astype(np.int64), "own_slip": along, "slip": slip, **segments.carried}
        return {f"facet_{key}": rows for key, rows in on_facets.items()}

    def again(self, step: int, kept: Callable[[int, str], npt.NDArray]) -> Past:
        """What the step after this one needs, see `solving.evolution.Steps` (collective)."""
        spaces = self.spaces
        segment, along, slip, bound = (kept(step, f"facet_{key}") for key in ("own", "own_slip", "slip", "bound"))
        segments = Segments(spaces, spaces.site_kinds.gathered(segment, along).astype(np.int64), {"bound": bound})
        return Past(step, [spaces.in_frames(slip[spaces.rough_rows])], segments)
