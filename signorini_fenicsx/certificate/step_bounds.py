"""The certificates of the steps of a problem in time.

A step solves an elliptic problem with the load f + C Σ_k w_k u_(n−k). The bound is that of the distance to the exact
solution of this problem, with continuous functions for the computed u_(n−k): v of their own certificate, plus on each
cell a bubble that gives it the mean u_(n−k) there. What the errors of earlier steps do to a step is not in its bound.
With u_(n−k) itself, which jumps from cell to cell, the problem would be another one, and its bound about four times
larger. For k = n it is u_0 as it is given.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.parallel import collector_off
from signorini_fenicsx.certificate.certify import Certificate, certify
from signorini_fenicsx.discrete.points import CellPoints, cell_quadrature, owned_cells
from signorini_fenicsx.physics.diffusion.evolving import Instant
from signorini_fenicsx.physics.diffusion.solution import Solution

type InPoints = Callable[[CellPoints], Array]
"""Values of a function in points of cells."""
EXACT = 3
"""Largest degree of a polynomial u_0 whose square the quadrature integrates exactly."""


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
    def of(cls, solution: Solution, certificate: Certificate) -> Continuous:
        """That of a solution (collective)."""
        spaces, v = solution.spaces, certificate.v
        means = np.empty(len(certificate.coarse))
        for points in cell_quadrature(spaces.mesh, owned_cells(spaces.mesh), 2):
            means[points.cells] = points.means(points.quadratic(v)[:, :, 0])
        dim = spaces.mesh.topology.dim
        mean_of_product = math.factorial(dim) / math.factorial(2 * dim + 1)
        return cls(v, (solution.u.x.array - means) / mean_of_product)

    def __call__(self, points: CellPoints) -> Array:
        """Its values."""
        product = points.barycentric.prod(axis=2)
        found: Array = points.quadratic(self.v)[:, :, 0] + self.bubble[points.cells, None] * product
        return found


class StepBounds:
    """Certificates of one step after another, see the module."""

    def __init__(self) -> None:
        """Begin; then the first step is to be bounded."""
        self._before: list[InPoints] = []

    @collector_off()
    def certify(self, instant: Instant) -> Certificate:
        """Bound the error of a step after those before it; without these, their u is taken as it is (collective)."""
        steps, solution = instant.steps, instant.solution
        if instant.step == 1:
            self._before = [steps.initial.values]

        def memory(points: CellPoints) -> Array:
            known = zip(weights, before, strict=False)
            return steps.capacity[points.cells, None] * sum(weight * u(points) for weight, u in known)

        before = self._before
        weights = steps.weights(instant.step)
        certificate = certify(solution, memory=memory if len(before) >= len(weights) else None)
        of_start = instant.step <= len(weights)
        if of_start and (steps.initial.polynomial is None or steps.initial.polynomial > EXACT):
            by = tuple(sorted({*certificate.by_quadrature, "initial"}))
            certificate = replace(certificate, by_quadrature=by, guaranteed=False)
        self._before = [Continuous.of(solution, certificate), *before[:1]]
        return certificate
