"""Steps in time of water in soil: ∂θ(h − z)/∂t − ∇·(κ∇h) = f, with what soils store for the content.

A step is a problem for a κ and a content that depend on u, see `discrete/storing.py`; one whose u is not found is done
in halves. The history is the θ that the balance of a step has, so that no water is lost.
"""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array, Mask
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.base.owned import cell_dofs, sums_at
from signorini_fenicsx.base.tolerances import ROUNDING
from signorini_fenicsx.expressions import exactly
from signorini_fenicsx.physics.diffusion.discrete.quasilinear import quasilinear_of
from signorini_fenicsx.physics.diffusion.discrete.rt1_data import projected
from signorini_fenicsx.physics.diffusion.discrete.spaces import RT1Spaces, Spaces
from signorini_fenicsx.physics.diffusion.discrete.storing import Storing, WaterBefore, from_places, in_places
from signorini_fenicsx.physics.diffusion.evolution import DiffusionSteps, Left
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.solving.evolution import Evolution, Past


@dataclass(frozen=True)
class Wet(Left):
    """What a step with soils leaves besides.

    Attributes:
        traces: û on the facets of the owned cells.
    """

    traces: Array


class SoilSteps(DiffusionSteps):
    """The problems of the steps on a mesh, with soils in all of it or a part."""

    def __init__(self, spaces: Spaces, problem: Problem, evolution: Evolution, start: Solution | None = None):
        """Read the data; u of a start takes the place of u_0 (collective).

        Raises:
            InputError: If a text cannot be read, u_0 is not what it has to be, or something does not go with soils.
        """
        c = problem.in_time(spaces.mesh.geometry.dim).c
        for present, what, instead in (
            (evolution.capacity is not None, "[time] capacity: soils say what is stored", "leave it out"),
            (problem.has_laws_inside, "[time]: with soils there are no laws in Ω", "leave out the law or the obstacle"),
            (c != exactly(0), "[problem] c: with soils in time there is none", "leave it out"),
        ):
            if present:
                raise InputError(f"{what}; {instead}")
        self._of_u = quasilinear_of(spaces, problem.kappa, problem.form)
        super().__init__(spaces, problem, evolution, start)

    def start(self) -> Wet:
        """θ for the means of u_0, and these as û (collective).

        Raises:
            InputError: If they are not finite, or of no usable size.
        """
        u, spaces = self._means("initial", self.initial), self.spaces
        if isinstance(spaces, RT1Spaces):
            u = projected(spaces, self.initial)
        theta, columns = (
            self._of_u.content(in_places(spaces, u))[0],
            self.remembered.start(self._evolution.time(1), self._before),
        )
        return Wet(self._stored(theta), columns, self._of_u.traces_of_values(u))

    def _stored(self, theta: Array) -> fem.Function:
        """The content, from θ in the places of the owned cells (collective)."""
        return self.spaces.scalar(from_places(self.spaces, theta))

    def left_by(self, solution: Solution) -> Wet:
        """θ and û (collective)."""
        return Wet(self._stored(self.theta(solution)), self._columns(solution), _storing(solution).traces)

    def theta(self, solution: Solution) -> Array:
        """The θ that the balance of a step has, in the places of the owned cells, see `storing`."""
        stored = solution.data.stored
        assert stored is not None
        return _storing(solution).left(solution.u_values, *stored)

    def of_step(self, solution: Solution, earlier: Mapping[str, float] | None = None) -> dict[str, float]:
        """The water there is, what flowed in, and its balance (collective).

        The error of mass is what the content has grown less what flowed in, or more, beside all that flowed; 0 where it
        is the rounding of the content, as of soil without flow.
        """
        storing, measures, done = _storing(solution), self.spaces.cell_measures, earlier or {}
        theta, f, before = (each.mean(axis=1) for each in (self.theta(solution), storing.f, storing.before))
        flow = np.append(solution.cell_flux.leaving[self._outer], measures * f)
        stored = measures @ (storing.rate * theta - before)
        sums = np.array([measures @ theta, stored, flow.sum(), np.abs(flow).sum()])
        content, stored, inflow, gross = self.spaces.mesh.comm.allreduce(sums).tolist()
        whole, details = max(abs(stored), gross), solution.outcome.details
        lacking = abs(stored - inflow)
        off = lacking / whole if lacking > ROUNDING * storing.rate * content else 0.0
        return {
            "content": content,
            "inflow": done.get("inflow", 0.0) + inflow / storing.rate,
            "mass_error": max(done.get("mass_error", 0.0), off),
            "content_change": max(done.get("content_change", 0.0), details["content_change"]),
            "linear_solves": done.get("linear_solves", 0) + int(details["linear_solves"]),
            "parts": done.get("parts", 0) + 1,
        }

    @cached_property
    def _outer(self) -> Mask:
        """Mask of the facets of the owned cells on the boundary (collective)."""
        space = self.spaces.crouzeix_raviart
        dofs = cell_dofs(space)
        return np.asarray(sums_at(space.dofmap.index_map, dofs)[dofs] == 1)

    def halved(self, failure: NumericalFailure) -> "SoilSteps | None":
        """The same with twice as many steps of implicit Euler, unless something else has failed."""
        sought = failure.solution is None or "content_change" in failure.solution.outcome.details
        if not sought:
            return None
        finer = copy(self)
        finer._evolution = replace(self._evolution, steps=2 * self._evolution.steps, scheme="implicit-euler")
        return finer

    def kept(self, solution: Solution) -> dict[str, npt.NDArray]:
        """What other steps keep, with θ and û."""
        return super().kept(solution) | {"theta": self.theta(solution), "traces": _storing(solution).traces}

    def again(self, step: int, kept: Callable[[int, str], npt.NDArray]) -> Past:
        """What the step after this one needs, see `solving.evolution.Steps` (collective)."""
        earlier = range(step, max(step - 2, 0), -1)
        past = super().again(step, kept)
        contents = [self._stored(kept(each, "theta").reshape(len(self.capacity), -1)) for each in earlier]
        left = [
            Wet(content, one.columns, kept(each, "traces"))
            for content, one, each in zip(contents, past.left, earlier, strict=True)
        ]
        return replace(past, left=left)

    def memory(self, step: int, before: Sequence[Left]) -> WaterBefore:
        """Σ_k w_k θ_(n−k), and the last û."""
        last = before[0]
        assert isinstance(last, Wet)
        return WaterBefore(super().memory(step, before), last.traces, self.rate(step))


def _storing(solution: Solution) -> Storing:
    """What soils store in the step of a solution."""
    assert solution.data.quasilinear is not None
    assert solution.data.quasilinear.storing is not None
    return solution.data.quasilinear.storing
