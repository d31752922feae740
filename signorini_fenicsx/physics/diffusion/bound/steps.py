"""The certificates of the steps of a scalar problem in time.

A step solves an elliptic problem with the load f + C Σ_k w_k u_(n−k). The bound is that of the distance to the exact
solution of this problem, with continuous functions for the computed u_(n−k): v of their own certificate, plus on each
cell a bubble that gives it the mean u_(n−k) there, with RT1 a bubble times a linear function that gives it the moments
of u_(n−k) against linear functions, so that both have one Π₁. What the errors of earlier steps do to a step is not in
its bound. With u_(n−k) itself, which jumps from cell to cell, the problem would be another one, and its bound about
four times larger. With a law of storage the content of the steps before is C times that plus a θ with the right means,
which is linear on each cell, like the η of their certificates. For k = n it is the content of u_0 as it is given, in
each point: Cu_0 and the least θ that u_0 allows. In the place of a C that varies are quadratics, and a bound of what
they leave. A step with soils is the problem with the last κ and with what soils store linear around the last u, cu less
a load that is constant on each cell, as is what it takes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.owned import cell_dofs, owned_cells
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.discrete.datum import Datum
from signorini_fenicsx.discrete.points import CellPoints, Points, cell_quadrature
from signorini_fenicsx.expressions.simplices import constant
from signorini_fenicsx.physics.diffusion.bound.certify import (
    Admissible,
    certificate_of,
    gap_parts,
    summed,
)
from signorini_fenicsx.physics.diffusion.bound.laws import Goal
from signorini_fenicsx.physics.diffusion.bound.local_fields import OF_LOAD, Projection
from signorini_fenicsx.physics.diffusion.bound.local_fields import at_points as of_projection
from signorini_fenicsx.physics.diffusion.bound.oscillation import Memory
from signorini_fenicsx.physics.diffusion.bound.reaction import Term, at_points, near_quadratics
from signorini_fenicsx.physics.diffusion.evolution import DiffusionSteps
from signorini_fenicsx.physics.diffusion.solution import Solution
from signorini_fenicsx.solving.evolving import Instant

type InPoints = Callable[[CellPoints], Array]
"""Values of a function in points of cells."""


@dataclass(frozen=True)
class Continuous:
    """A continuous function near u_h with its means over the cells, of RT1 with its moments against hats.

    Attributes:
        v: The v of a certificate.
        bubble: Coefficient of the bubble on each owned cell, shape (cells, 1); of RT1 in its vertices.
    """

    v: fem.Function
    bubble: Array

    @classmethod
    def of(cls, solution: Solution, v: fem.Function) -> "Continuous":
        """The continuous function of a solution and the v of its certificate (collective)."""
        spaces, dim = solution.spaces, solution.spaces.mesh.topology.dim
        bubble = np.empty((len(spaces.cell_measures), dim + 1 if spaces.degree else 1))
        for points in cell_quadrature(spaces.mesh, owned_cells(spaces.mesh), dim + 1 + 2 * spaces.degree):
            hats, weights = cls._hats(points, bubble.shape[1])[0], points.weights
            products = np.einsum("q,qv,qw->vw", weights * points.barycentric[0].prod(axis=1), hats, hats)
            off = solution.u_at(points) - points.bernstein(v)[:, :, 0]
            bubble[points.cells] = np.linalg.solve(products, hats.T @ (weights * off).T).T
        return cls(v, bubble)

    @staticmethod
    def _hats(points: Points, number: int) -> Array:
        """The hats of the vertices in points, shape (n or 1, points, vertices), or 1 instead of them."""
        return points.barycentric if number > 1 else np.ones((1, points.shape[1], 1))

    def largest(self) -> Array:
        """Bounds of its size on the owned cells."""
        nodes = self.v.x.array[cell_dofs(self.v.function_space)]
        corners = self.v.function_space.mesh.topology.dim + 1
        return np.asarray(np.abs(nodes).max(axis=1) + np.abs(self.bubble).max(axis=1) / corners**corners)

    def __call__(self, points: Points) -> Array:
        """Values of the datum in points."""
        hats, product = self._hats(points, self.bubble.shape[1]), points.barycentric.prod(axis=2)
        linear = np.einsum("nqv,nv->nq", hats, self.bubble[points.cells])
        return points.bernstein(self.v)[:, :, 0] + linear * product


@dataclass(frozen=True)
class _Content:
    """The content after a step.

    Attributes:
        values: It in points of cells, with a P2 function in the place of C.
        missed: What this leaves of it, per owned cell; None if that is nothing.
        term: It as one term; None where it is not known as one.
    """

    values: InPoints
    missed: Array | None = None
    term: Term | None = None


class StepBounds:
    """Certificates of one step of diffusion after another, see the module."""

    def __init__(self) -> None:
        """Begin; then the first step is to be bounded."""
        self._before: list[_Content] = []
        self._start: Datum | None = None

    def certify(self, instant: Instant) -> Certificate:
        """Bound the error of a step after those before it; without these, their u is taken as it is (collective)."""
        steps, solution = cast(DiffusionSteps, instant.steps), instant.solution
        if solution.data.stored is not None:  # what it takes, less what it stores, is constant on each cell
            return certificate_of(solution)
        if instant.step == 1:
            self._start, ones = steps.start_given(), np.ones(len(steps.capacity))
            given = self._start
            as_term = None if given is None else Term("initial", given, lambda points: np.ones(points.shape), ones)
            self._before = [_Content(_at_start(steps, self._start), term=as_term)]
        weights = steps.weights(instant.step)
        memory = None
        if len(self._before) >= len(weights):
            memory = self._memory(weights, from_start=instant.step <= len(weights), initial=steps.initial)
        with np.errstate(all="ignore"):
            admissible = Admissible.of(solution, Goal.of(solution, for_signorini=False))
            parts = gap_parts(admissible, admissible, admissible.goal, memory)
        certificate = summed(admissible, parts)
        content = _content(instant, Continuous.of(solution, certificate.v), parts.of_laws, admissible)
        self._before = [content, *self._before[:1]]
        return certificate

    def _memory(self, weights: Sequence[float], *, from_start: bool, initial: Datum) -> Memory:
        """What a step takes from those before."""
        terms = list(zip(weights, self._before, strict=False))

        def values(points: CellPoints) -> Array:
            return np.asarray(sum(weight * content.values(points) for weight, content in terms))

        missed = [abs(weight) * content.missed for weight, content in terms if content.missed is not None]
        left = np.asarray(sum(missed)) if missed else None
        known = [_times(weight, content.term) for weight, content in terms if content.term is not None]
        memory = Memory(values, left, terms=tuple(known) if len(known) == len(terms) else ())
        return replace(memory, initial=self._start or initial, factor=weights[-1]) if from_start else memory


def _times(weight: float, term: Term) -> Term:
    """A multiple of a term."""
    return replace(term, q=lambda points: weight * term.q(points), size=abs(weight) * term.size)


def _at_start(steps: DiffusionSteps, given: Datum | None) -> InPoints:
    """The content at the start; without a text of it C has its means, as have the data of θ."""
    if given is not None:
        return given.values

    def content(points: CellPoints) -> Array:
        u = steps.initial.values(points)
        stored = steps.capacity[points.cells, None] * u
        for part, chains in steps.storage:
            of_cells = np.zeros((len(steps.capacity), points.shape[1]))
            of_cells[points.cells] = u
            theta = np.stack([-chains.ends_at(column)[0] for column in of_cells[part.rows].T], axis=1)
            of_cells[:] = 0.0
            of_cells[part.rows] = theta
            stored += of_cells[points.cells]
        return stored

    return content


def _content(instant: Instant, u: Continuous, load: Projection | None, admissible: Admissible) -> _Content:
    """The content after a step, with the means that the step has left and the load of its laws in Ω (collective)."""
    steps = cast(DiffusionSteps, instant.steps)
    theta, a = steps.theta(instant.solution), steps.rate(instant.step)
    stores = np.zeros(len(theta), dtype=bool)
    for part, _ in steps.storage:
        stores[part.rows] = True
    capacity, missed, largest = constant(steps.capacity, admissible.metric.jacobian.shape[1]), None, u.largest()
    if steps.given.polynomial != 0:
        capacity, rest, _ = near_quadratics("capacity", steps.given, admissible.metric, admissible.resolution, largest)
        missed = rest * largest

    def content(points: CellPoints) -> Array:
        cells = points.cells
        stored = at_points(capacity, points) * u(points) + theta[cells, None]
        if load is not None and steps.storage:
            linear = load.coefficients[cells, : admissible.metric.jacobian.shape[1]] * stores[cells, None]
            of_cells = Projection(linear, load.rest[cells])
            stored -= of_projection(of_cells, points.mesh.basix_cell(), OF_LOAD, points.points) / a
        return stored

    return _Content(content, missed, None if steps.storage else Term("capacity", steps.given, u, largest))
