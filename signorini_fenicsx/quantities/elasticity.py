"""Intervals for quantities of elastic contact, see `bracket` for the theorem.

With ε(v), 𝔸 and g − v_n in the places of ∇v, κ⁻¹ and v − ψ, and the work of the friction as one more law, it is the
same. A force F = ⟨σn, w⟩ on parts where u is given, w a translation or a rotation, moves u_D there by ±τw.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from signorini_fenicsx.base import fenicsx
from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, NumericalFailure
from signorini_fenicsx.discrete.datum import datum_of, quadrature_degree
from signorini_fenicsx.expressions import TREES, to_ufl
from signorini_fenicsx.expressions.given import Given, parsed
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.elasticity.bound.certify import gap_of_cells, not_in_the_spaces
from signorini_fenicsx.physics.elasticity.bound.conforming import BestDisplacement
from signorini_fenicsx.physics.elasticity.bound.equilibrated import AdmissibleStress, admissible_stress
from signorini_fenicsx.physics.elasticity.bound.oscillation import load_oscillation
from signorini_fenicsx.physics.elasticity.problem import CoulombLaw, ElasticBoundary, ElasticProblem
from signorini_fenicsx.physics.elasticity.residuals import energy_squares, resultants
from signorini_fenicsx.physics.elasticity.solution import ElasticSolution
from signorini_fenicsx.quantities.bracket import UNBOUNDED, Ends, Half, Quantity, bracket
from signorini_fenicsx.quantities.kinds import Force, Integral, Kind, Mean, Moment
from signorini_fenicsx.quantities.shifts import added
from signorini_fenicsx.solving.options import Options
from signorini_fenicsx.solving.solver import Solver

type Posed = tuple[ElasticBoundary, ElasticProblem]
"""A problem with the parts of each kind of its boundary."""
QUADRATIC = 2
"""Degree of v."""


def quantity(solution: ElasticSolution, kind: Kind) -> Quantity:
    """The interval for a quantity (collective).

    Raises:
        InputError: If it is a step of a problem in time.
    """
    if solution.step is not None:
        raise InputError("quantities of a step of a problem in time have no bounds")
    return _Shifted(solution, kind).interval()


def check(domain: Domain, posed: Posed, kind: Kind) -> None:
    """Refuse what is no quantity of a problem (collective).

    Raises:
        InputError: If a name is unknown, or the quantity is not one of elastic contact.
    """
    if any(isinstance(law, CoulombLaw) for law in posed[1].laws):
        raise InputError("quantities have no bounds under Coulomb's friction, as its solution may not be unique")
    if posed[1].force or posed[1].moment:
        raise InputError("quantities have no bounds where a tool moves under a given force")
    if not isinstance(kind, Integral | Force):
        raise InputError(f"{type(kind).__name__}: elastic contact has Integral, Mean, Force and Moment")
    _moved(domain, posed, kind, 0.0)


def _moved(domain: Domain, posed: Posed, kind: Integral | Force, tau: float) -> Posed:
    """The problem with data that differ by τ (collective).

    Raises:
        InputError: As `check`.
    """
    boundary, problem = posed
    dim = domain.mesh.geometry.dim
    if isinstance(kind, Integral):
        if kind.region or kind.parts:
            raise InputError("integrals of displacements are over all of Ω")
        along = _direction(kind.direction, dim)
        f = [
            added(domain, component, kind.weight, tau * share)
            for component, share in zip(_components(problem.f, dim), along, strict=True)
        ]
        return boundary, replace(problem, f=f)
    motion = _motion(kind, dim)
    u_D = dict(problem.u_D) if isinstance(problem.u_D, Mapping) else {"": problem.u_D}
    for part in kind.parts:
        if part not in domain.facets:
            raise InputError(f"unknown part '{part}'; there are {', '.join(domain.facets)}")
        if part in boundary.touching_on(problem.touching).contact or part in boundary.neumann:
            raise InputError(f"forces have bounds on parts where u is given, and '{part}' is none")
        own = _components(u_D.get(part, u_D.get("")), dim)
        u_D[part] = [added(domain, given, rigid, tau) for given, rigid in zip(own, motion, strict=True)]
    return boundary, replace(problem, u_D=u_D)


def _direction(given: Sequence[float] | None, dim: int) -> list[float]:
    """The direction as numbers.

    Raises:
        InputError: If there is not one for each coordinate.
    """
    if given is None or len(given) != dim:
        raise InputError(f"direction: needs {dim} numbers, such as [{', '.join(['1', *'0' * (dim - 1)])}]")
    return [float(each) for each in given]


def _motion(kind: Force, dim: int) -> list[Given]:
    """The rigid motion that belongs to a force or a moment."""
    if not isinstance(kind, Moment):
        return list(_direction(kind.direction, dim))
    if dim == 2:
        return ["-y", "x"]
    a, b, c = _direction(kind.direction, dim)
    return [f"{b!r}*z - {c!r}*y", f"{c!r}*x - {a!r}*z", f"{a!r}*y - {b!r}*x"]


def _components(given: Any, dim: int) -> list[Given]:
    """A vector as a list.

    Raises:
        InputError: If it is a function of points.
    """
    if given is None:
        return [0.0] * dim
    if callable(given) and not hasattr(given, "ufl_shape"):
        raise InputError("quantities need data that are numbers, texts or UFL, not functions of points")
    return [given[i] for i in range(dim)]


@dataclass(frozen=True)
class _Side:
    """A problem with data that differ, solved.

    Attributes:
        solution: Its solution.
        y: Its stress.
        v: The displacement nearest to it.
        past: Why v is not admissible; empty if it is.
    """

    solution: ElasticSolution
    y: AdmissibleStress
    v: fem.Function
    past: str


class _Shifted:
    """Problems on either side of that of a solution, with data that differ by ±τ, and what they say."""

    def __init__(self, solution: ElasticSolution, kind: Any):
        self.solution, self.spaces, self.kind = solution, solution.spaces, kind
        self.domain, self.comm = solution.spaces.domain, solution.spaces.mesh.comm
        self.posed: Posed = (solution.boundary, solution.problem)
        self._solver: Solver[ElasticSolution] = Solver(self.domain, self.posed)
        self._options = Options(tuning=solution.options.tuning)

    def interval(self) -> Quantity:
        """The interval (collective)."""
        size = self.solution.norms()["energy"]
        first = 2.0 ** round(math.log2(size)) if size > 0 else 1.0
        found = bracket(self.ends, first, self._of_discrete())
        if not math.isfinite(found.width) and isinstance(self.kind, Force):
            return replace(found, reason=f"{UNBOUNDED}: {found.reason}")
        if isinstance(self.kind, Mean):
            return found.divided(self._integral(None))
        return found

    def _of_discrete(self) -> float:
        """The quantity of the discrete solution (collective)."""
        if isinstance(self.kind, Force):
            return self._force(self.solution, self.solution.stresses)
        return math.nan

    def ends(self, tau: float) -> Ends:
        """The bounds from one τ (collective)."""
        try:
            below, above = self._side(-tau), self._side(tau)
        except (NumericalFailure, InputError) as failure:
            return Ends(-math.inf, math.inf, 0.0, f"a problem beside it: {failure}")
        found = []
        for sign in (-1.0, 1.0):
            of_y, of_v = (above, below) if (sign > 0) is not isinstance(self.kind, Force) else (below, above)
            half = self._half(of_v, of_y)
            value = (
                self._force(of_y.solution, of_y.y.stresses) if isinstance(self.kind, Force) else self._integral(of_v.v)
            )
            found.append((value + sign * half.value / tau, half))
        (lower, one), (upper, other) = found
        size = above.solution.norms()["energy"]
        apart = above.solution.stresses - below.solution.stresses
        squares = self.comm.allreduce(float(energy_squares(self.spaces, self.solution.data, apart).sum()))
        PETSc.garbage_cleanup(self.comm)
        shares = (self._half(below, below).of_cells + self._half(above, above).of_cells) / tau
        scale = 2 * tau * size / math.sqrt(squares) if squares > 0 else 0.0
        return Ends(lower, upper, scale, one.reason or other.reason, shares)

    def _side(self, tau: float) -> _Side:
        """The problem with data that differ by τ, solved (collective)."""
        solution = self._solver.solve(_moved(self.domain, self.posed, self.kind, tau), self._options)
        y = admissible_stress(solution)
        v, past = BestDisplacement(solution.spaces, solution.data, y, solution.spaces.split, QUADRATIC).minimum()
        return _Side(solution, y, v, past)

    def _half(self, of_v: _Side, of_y: _Side) -> Half:
        """The right side of the theorem for the v and the y of two problems (collective).

        What the linear solver leaves of the jumps of y counts like a load.
        """
        solution, y = of_y.solution, of_y.y
        if of_v.past or not math.isfinite(y.distance):
            why = of_v.past or "the linear solver leaves too much of the balance of the stress"
            return Half(math.inf, why, np.zeros(len(self.spaces.order)))
        problem = BestDisplacement(solution.spaces, solution.data, y, solution.spaces.split, QUADRATIC)
        mismatch, contact = gap_of_cells(solution, y, problem, of_v.v)
        oscillation = load_oscillation(solution.spaces, solution.data, y.stresses)
        squares = (np.sqrt(np.maximum(mismatch, 0.0)) + oscillation) ** 2
        total, at_sites = self.comm.allreduce(np.array([squares.sum(), contact.sum()])).tolist()
        missing = not_in_the_spaces(solution.data)
        reason = f"{', '.join(missing)} not in the discrete spaces" if missing else ""
        value = (math.sqrt(total) + y.distance) ** 2 / 4 + max(at_sites, 0.0)
        return Half(value, reason, squares / 4 + np.maximum(contact, 0.0))

    def _force(self, solution: ElasticSolution, stresses: Array) -> float:
        """⟨σn, w⟩ on the parts (collective)."""
        found = resultants(solution.spaces, solution.data, stresses)
        total = np.sum([found[part] for part in self.kind.parts], axis=0)
        dim = self.spaces.dim
        if not isinstance(self.kind, Moment):
            return float(total[:dim] @ _direction(self.kind.direction, dim))
        return float(total[2] if dim == 2 else total[3:] @ _direction(self.kind.direction, dim))

    def _integral(self, v: fem.Function | None) -> float:
        """∫ weight·v·direction, or for None ∫ weight (collective)."""
        dim, mesh = self.spaces.dim, self.spaces.split.mesh if v is None else v.function_space.mesh
        weight = parsed(self.kind.weight, "xyz"[:dim], "weight")
        if not isinstance(weight, TREES):
            raise InputError("weight: must be a number or a text")
        degree = QUADRATIC + quadrature_degree(datum_of(self.spaces, "weight", weight))
        dx = ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": degree})
        of_v = fem.Constant(mesh, 1.0)
        if v is not None:
            of_v = ufl.dot(v, ufl.as_vector(_direction(self.kind.direction, dim)))
        form = fenicsx.form(to_ufl(weight, ufl.SpatialCoordinate(mesh)) * of_v * dx)
        return float(self.comm.allreduce(fem.assemble_scalar(form)))
