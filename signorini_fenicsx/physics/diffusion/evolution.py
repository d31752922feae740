"""The problem in time: C ∂u/∂t − ∇·(κ∇u) + cu = f with C ≥ 0, in equal steps from u = u_0 at t = 0.

With ∂u/∂t ≈ a u_n − Σ_k w_k u_(n−k) each step is a problem with c + aC for c and the load f + C Σ_k w_k u_(n−k), with
all data at the time of the step. u_(n−k) is in P0, and C has its mean on each cell there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.discrete.data_values import check_means
from signorini_fenicsx.discrete.datum import Datum, regional_datum
from signorini_fenicsx.expressions import TREES, Binary, Tree, exactly
from signorini_fenicsx.expressions.given import Given, parsed
from signorini_fenicsx.physics.diffusion.data import cell_means
from signorini_fenicsx.physics.diffusion.problem import Problem
from signorini_fenicsx.physics.diffusion.spaces import Spaces

SCHEMES = {"implicit-euler": (1.0, (1.0,)), "bdf2": (1.5, (2.0, -0.5))}
"""aτ and w_kτ of each scheme. The first step is always one of implicit Euler, as there is only one u before it."""


@dataclass(frozen=True)
class Evolution:
    """What a problem in time has besides its data, which may have t in them.

    Attributes:
        end: The last time.
        steps: Number of steps.
        initial: u_0, or one for each region of the mesh.
        capacity: C ≥ 0, or one for each region of the mesh.
        scheme: "implicit-euler" or "bdf2".
    """

    end: float
    steps: int
    initial: Given | Mapping[str, Given] = 0.0
    capacity: Given | Mapping[str, Given] = 1.0
    scheme: str = "implicit-euler"

    def __post_init__(self) -> None:
        """Refuse what is no evolution.

        Raises:
            InputError: If a value is not valid.
        """
        if not 0 < self.end < np.inf:
            raise InputError(f"[time] end: must be a time > 0, not {self.end!r}")
        if not isinstance(self.steps, int) or self.steps < 1:
            raise InputError(f"[time] steps: must be a whole number ≥ 1, not {self.steps!r}")
        if self.scheme not in SCHEMES:
            raise InputError(f"[time] scheme: unknown '{self.scheme}'; use one of {', '.join(SCHEMES)}")

    def time(self, step: int) -> float:
        """The time after so many steps."""
        return self.end * step / self.steps

    def formula(self, step: int) -> tuple[float, tuple[float, ...]]:
        """A and w_1, w_2, … of a step; the first has number 1."""
        a, weights = SCHEMES[self.scheme if step > 1 else "implicit-euler"]
        rate = self.steps / self.end
        return a * rate, tuple(w * rate for w in weights)

    def problem(self, problem: Problem, step: int, dim: int) -> Problem:
        """The problem of a step, without what it takes from those before, from one that `Problem.in_time` has read.

        Raises:
            InputError: If c or C was given in Python.
        """
        now, (a, _) = problem.at(self.time(step)), self.formula(step)
        return replace(now, c=_plus(now.c, parsed(self.capacity, "xyz"[:dim], "[time] capacity"), a))


class Steps:
    """The problems of the steps on a mesh.

    Attributes:
        capacity: Mean of C on each owned cell.
        initial: u_0.
    """

    def __init__(self, spaces: Spaces, problem: Problem, evolution: Evolution):
        """Read the data, and take means of C (collective).

        Raises:
            InputError: If a text cannot be read, or C or u_0 is not what it has to be.
        """
        dim = spaces.mesh.geometry.dim
        self._spaces, self._evolution, self._problem = spaces, evolution, problem.in_time(dim)
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
        u = fem.Function(self._spaces.Q, name="u")
        u.x.array[:] = self._means("initial", self.initial)
        return u

    def problem(self, step: int) -> Problem:
        """The problem of a step, see `Evolution.problem`."""
        return self._evolution.problem(self._problem, step, self._spaces.mesh.geometry.dim)

    def weights(self, step: int) -> tuple[float, ...]:
        """w_1, w_2, … of a step."""
        return self._evolution.formula(step)[1]

    def memory(self, step: int, before: list[fem.Function]) -> fem.Function:
        """The sum C Σ_k w_k u_(n−k) in P0, from the last u and those before it."""
        memory = fem.Function(self._spaces.Q, name="memory")
        weights = self.weights(step)
        for weight, u in zip(weights, before[: len(weights)], strict=True):
            memory.x.array[:] += weight * self.capacity * u.x.array
        return memory

    def _means(self, key: str, datum: Datum) -> Array:
        means = cell_means(self._spaces, datum)
        check_means(f"[time] {key}", "in the domain", means, self._spaces)
        return means


def _plus(c: Given | Mapping[str, Given], capacity: Given | Mapping[str, Given], a: float) -> dict[str, Tree] | Tree:
    """The sum c + aC of trees, or of tables of them by region."""
    if isinstance(c, Mapping) or isinstance(capacity, Mapping):
        names = dict.fromkeys(name for table in (c, capacity) if isinstance(table, Mapping) for name in table)
        return {name: _sum(_of(c, name), _of(capacity, name), a) for name in names}
    return _sum(c, capacity, a)


def _of(given: Given | Mapping[str, Given], region: str) -> Given:
    return given.get(region, exactly(0.0)) if isinstance(given, Mapping) else given


def _sum(c: Given, capacity: Given, a: float) -> Tree:
    if not isinstance(c, TREES) or not isinstance(capacity, TREES):
        raise InputError("[time]: c and capacity must be numbers or texts")
    return Binary("+", c, Binary("*", exactly(a), capacity))
