"""The certificates of the steps of a scalar problem in time.

A step solves an elliptic problem with the load f + C Σ_k w_k u_(n−k). The bound is that of the distance to the exact
solution of this problem, with continuous functions for the computed u_(n−k): v of their own certificate, plus on each
cell a bubble that gives it the mean u_(n−k) there. What the errors of earlier steps do to a step is not in its bound.
With u_(n−k) itself, which jumps from cell to cell, the problem would be another one, and its bound about four times
larger. For k = n it is u_0 as it is given. With a law of storage the content of the steps before is C times that plus
a θ with the right means, which is linear on each cell, like the η of their certificates; at the start it is constant.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import owned_cells, owned_values
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.discrete.points import CellPoints, cell_quadrature
from signorini_fenicsx.physics.diffusion.bound.certify import Admissible, gap_parts, summed
from signorini_fenicsx.physics.diffusion.bound.laws import Goal
from signorini_fenicsx.physics.diffusion.bound.local_fields import OF_LOAD, Projection, at_points
from signorini_fenicsx.physics.diffusion.bound.oscillation import Memory
from signorini_fenicsx.physics.diffusion.evolution import DiffusionSteps
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.solving.evolving import Instant

type InPoints = Callable[[CellPoints], Array]
"""Values of a function in points of cells."""


@dataclass(frozen=True)
class Continuous:
    """A continuous function near u_h with its means over the cells.

    Attributes:
        v: The quadratic of a certificate.
        bubble: Coefficient of the bubble on each owned cell.
    """

    v: fem.Function
    bubble: Array

    @classmethod
    def of(cls, solution: Solution, v: fem.Function) -> Continuous:
        """The continuous function of a solution and the v of its certificate (collective)."""
        spaces = solution.spaces
        means = np.empty(len(spaces.cell_measures))
        for points in cell_quadrature(spaces.mesh, owned_cells(spaces.mesh), 2):
            means[points.cells] = points.means(points.quadratic(v)[:, :, 0])
        dim = spaces.mesh.topology.dim
        mean_of_product = math.factorial(dim) / math.factorial(2 * dim + 1)
        return cls(v, (owned_values(solution.u) - means) / mean_of_product)

    def __call__(self, points: CellPoints) -> Array:
        """Values of the datum in points."""
        product = points.barycentric.prod(axis=2)
        values: Array = points.quadratic(self.v)[:, :, 0] + self.bubble[points.cells, None] * product
        return values


class StepBounds:
    """Certificates of one step of diffusion after another, see the module."""

    def __init__(self) -> None:
        """Begin; then the first step is to be bounded."""
        self._before: list[InPoints] = []

    def certify(self, instant: Instant) -> Certificate:
        """Bound the error of a step after those before it; without these, their u is taken as it is (collective)."""
        steps, solution = cast(DiffusionSteps, instant.steps), instant.solution
        if instant.step == 1:
            self._before = [_at_start(steps)]

        before, weights = self._before, steps.weights(instant.step)

        def values(points: CellPoints) -> Array:
            return np.asarray(sum(weight * content(points) for weight, content in zip(weights, before, strict=False)))

        memory = None
        if len(before) >= len(weights):
            of_start = instant.step <= len(weights) and not steps.storage
            memory = Memory(values, steps.initial, weights[-1] * steps.capacity) if of_start else Memory(values)
        with np.errstate(all="ignore"):
            own = Admissible.of(solution, Goal.of(solution, for_signorini=False))
            parts = gap_parts(own, own, own.goal, memory)
        certificate = summed(own, parts)
        self._before = [_content(instant, Continuous.of(solution, certificate.v), parts.of_laws), *before[:1]]
        return certificate


def _at_start(steps: DiffusionSteps) -> InPoints:
    """The content at the start: of a storage its means."""
    if not steps.storage:
        return lambda points: steps.capacity[points.cells, None] * steps.initial.values(points)
    start = owned_values(steps.start())
    return lambda points: np.broadcast_to(start[points.cells, None], points.shape)


def _content(instant: Instant, u: InPoints, load: Projection | None) -> InPoints:
    """The content after a step, with the means that the step has left and the load of its laws in Ω (collective)."""
    steps = cast(DiffusionSteps, instant.steps)
    theta, a = steps.theta(instant.solution), steps.rate(instant.step)
    stores = np.zeros(len(theta), dtype=bool)
    for part, _ in steps.storage:
        stores[part.rows] = True

    def content(points: CellPoints) -> Array:
        cells = points.cells
        stored = steps.capacity[cells, None] * u(points) + theta[cells, None]
        if load is not None and steps.storage:
            of_cells = Projection(load.coefficients[cells] * stores[cells, None], load.rest[cells])
            stored -= at_points(of_cells, points.mesh.basix_cell(), OF_LOAD, points.points) / a
        return stored

    return content
