"""The problem in time: C ∂u/∂t − ∇·(κ∇u) + cu = f with C ≥ 0, in equal steps from u = u_0 at t = 0.

With ∂u/∂t ≈ a u_n − Σ_k w_k u_(n−k) each step is a problem with c + aC for c and the load f + C Σ_k w_k u_(n−k), with
all data at the time of the step. u_(n−k) is in P0, and C has its mean on each cell there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.cell_shapes import corners
from signorini_fenicsx.discrete.contact_sets import Segments
from signorini_fenicsx.discrete.data_values import check_means
from signorini_fenicsx.discrete.datum import Datum, regional_datum
from signorini_fenicsx.expressions.given import parsed
from signorini_fenicsx.physics.diffusion.cell_laws import plus
from signorini_fenicsx.physics.diffusion.data import cell_means
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.physics.diffusion.spaces import Spaces
from signorini_fenicsx.solving.evolution import Evolution, Past


class DiffusionSteps:
    """The problems of the steps on a mesh.

    Attributes:
        spaces: The discrete spaces.
        capacity: Mean of C on each owned cell.
        initial: u_0.
    """

    def __init__(self, spaces: Spaces, problem: Problem, evolution: Evolution, start: Solution | None = None):
        """Read the data, and take means of C; u of a start takes the place of u_0 (collective).

        Raises:
            InputError: If a text cannot be read, or C or u_0 is not what it has to be.
        """
        dim = spaces.mesh.geometry.dim
        if start is not None:
            evolution = replace(evolution, initial=_carried(start, spaces))
        self.spaces, self._evolution, self._problem = spaces, evolution, problem.in_time(dim)
        try:
            capacity = parsed(evolution.capacity, "xyz"[:dim], "[time] capacity")
            self.capacity = self._means("capacity", regional_datum(spaces, "capacity", capacity))
            self.initial = regional_datum(spaces, "initial", parsed(evolution.initial, "xyz"[:dim], "[time] initial"))
        except InputError as error:
            raise InputError(str(error).replace("[problem]", "[time]")) from None
        comm = spaces.mesh.comm
        if (least := comm.allreduce(float(self.capacity.min(initial=np.inf)), MPI.MIN)) < 0:
            raise InputError(f"[time] capacity: must not be negative; its smallest mean over a cell is {least:.3g}")
        if not comm.allreduce(bool(self.capacity.any()), MPI.LOR):
            raise InputError("[time] capacity: is 0 everywhere; leave out [time]")

    def start(self) -> fem.Function:
        """The means of u_0 over the cells (collective).

        Raises:
            InputError: If they are not finite, or of no usable size.
        """
        u = fem.Function(self.spaces.Q, name="u")
        u.x.array[:] = self._means("initial", self.initial)
        return u

    def problem(self, step: int) -> Problem:
        """The problem of a step, without what it takes from those before.

        Raises:
            InputError: If c or C was given in Python.
        """
        return problem_of_step(self._problem, self._evolution, step, self.spaces.mesh.geometry.dim)

    def weights(self, step: int) -> tuple[float, ...]:
        """w_1, w_2, … of a step."""
        return self._evolution.formula(step)[1]

    def left_by(self, solution: Solution) -> fem.Function:
        """u_h."""
        return solution.u

    def kept(self, solution: Solution) -> dict[str, npt.NDArray]:
        """u_h, σ_h and ∇·σ_h, and the segments on which the step has ended."""
        on = solution.segments()
        cells = {} if on.cells is None else {"own": on.cells}
        return {**solution.in_cells(), **cells, "facet_own": on.segment}

    def again(self, step: int, kept: Callable[[int, str], npt.NDArray]) -> Past:
        """What the step after this one needs, see `solving.evolution.Steps` (collective)."""
        left = []
        for earlier in range(step, max(step - 2, 0), -1):
            u = fem.Function(self.spaces.Q, name="u")
            u.x.array[:] = kept(earlier, "u").ravel()
            left.append(u)
        cells = kept(step, "own") if self._problem.has_laws_inside else None
        return Past(step, left, Segments(self.spaces, kept(step, "facet_own"), cells))

    def memory(self, step: int, before: Sequence[fem.Function]) -> fem.Function:
        """The sum C Σ_k w_k u_(n−k) in P0, from the last u and those before it."""
        memory = fem.Function(self.spaces.Q, name="memory")
        weights = self.weights(step)
        for weight, u in zip(weights, before[: len(weights)], strict=True):
            memory.x.array[:] += weight * self.capacity * u.x.array
        return memory

    def _means(self, key: str, datum: Datum) -> Array:
        means = cell_means(self.spaces, datum)
        check_means(f"[time] {key}", "in the domain", means, self.spaces)
        return means


def problem_of_step(problem: Problem, evolution: Evolution, step: int, dim: int) -> Problem:
    """The problem of a step, without what it takes from those before, from one that `Problem.in_time` has read.

    Raises:
        InputError: If c or C was given in Python.
    """
    now, (a, _) = problem.at(evolution.time(step)), evolution.formula(step)
    return replace(now, c=plus(now.c, parsed(evolution.capacity, "xyz"[:dim], "[time] capacity"), a, "[time]"))


def _carried(solution: Solution, spaces: Spaces) -> fem.Function:
    """Another u_h in the centroids of these cells (collective).

    Raises:
        InputError: If a centroid is not in its mesh.
    """
    centroids = corners(spaces.mesh).mean(axis=1)
    u = fem.Function(spaces.Q, name="u")
    u.x.array[:] = solution.at(centroids).u
    outside = spaces.mesh.comm.allreduce(int(np.count_nonzero(np.isnan(u.x.array))))
    if outside > 0:
        raise InputError(
            f"the start, {solution.name}, has no u in the centroids of {outside} cells, which are outside of its mesh; "
            "take one on the same mesh"
        )
    return u
