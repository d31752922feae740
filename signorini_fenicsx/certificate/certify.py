"""The bound of a solution of any physics, and of a function that the user has."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast, overload

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arguments import check_kind
from signorini_fenicsx.base.errors import holding
from signorini_fenicsx.base.parallel import Stopwatch, collector_off
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.certificate.of_field import FieldBound, bound_field
from signorini_fenicsx.discrete.rounding import LOST, lost_digits
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.solving.physics import PHYSICS
from signorini_fenicsx.solving.solved import Solved
from signorini_fenicsx.solving.solver import solve


@dataclass(frozen=True)
class Bounds:
    """What bounds the errors of a physics; all of it is collective.

    Attributes:
        of_solution: Gives the certificate of a solution, with `for_signorini` of that to the problem without penalty.
        of_field: Gives the bound of a function, from a solution on its mesh.
        of_steps: Begins with the certificates of the steps of a problem in time; its `certify` takes one after another.
    """

    of_solution: Callable[..., Certificate]
    of_field: Callable[[Any, fem.Function], FieldBound]
    of_steps: Callable[[], Any]


@overload
def certify(solution: Solved, *, for_signorini: bool = False) -> Certificate: ...


@overload
def certify(solution: Solved, *, v: fem.Function) -> FieldBound: ...


@overload
def certify(solution: Domain, problem: Any, v: fem.Function) -> FieldBound: ...


@collector_off()
def certify(
    solution: Solved | Domain, problem: Any = None, v: fem.Function | None = None, *, for_signorini: bool = False
) -> Certificate | FieldBound:
    """Bound the energy error of a converged solution, or of any continuous function (collective).

    `certify(solution)` is about the solution, see `certificate_of` of its physics; `certify(domain,
    problem, v)` is about a function that any program has made, see `of_field`. It solves the problem for the flux.

    Args:
        solution: The solution; or the mesh with its parts, to solve the problem on.
        problem: With a mesh, the problem.
        v: The function, linear or quadratic on each cell, on the mesh of the domain.
        for_signorini: Of a method with a penalty, bound the error to the solution of the problem without.

    Raises:
        InputError: If the solution has not converged, or is none that can be bounded; if v is not such a function.
        NumericalFailure: If a linear solver fails; it holds the solution.
    """
    if isinstance(solution, Domain) and problem is not None:
        check_kind("v", v, fem.Function)
        solved: Solved = solve(solution, problem)
    else:
        check_kind("solution", solution, Solved, hint="; with a Domain give the problem and v as well")
        solved = cast(Solved, solution)
    if v is not None:
        return bound_field(solved, v)
    return certified(solved, lambda bounds: bounds.of_solution(solved, for_signorini=for_signorini))


def certified(solution: Solved, certify: Callable[[Bounds], Certificate]) -> Certificate:
    """The certificate that the bounds of the physics give, with its seconds; no bound if there is none (collective).

    Raises:
        NumericalFailure: If a linear solver fails; it holds the solution.
    """
    bounds, watch = PHYSICS[solution.physics].bound, Stopwatch()
    if bounds is None:
        return no_bound(solution)
    with watch.phase("certificate"), holding(solution):
        certificate = certify(bounds)
        names = lost_digits(solution) if certificate.proved else ()
    if names:
        about = {key: value for key, value in certificate.about.items() if key != "guaranteed_for"}
        certificate = replace(certificate, proved=False, by_quadrature=names, lacking=LOST, about=about)
    return replace(certificate, seconds=watch.longest(solution.spaces.mesh.comm)["certificate"])


def no_bound(solution: Solved, why: str = "") -> Certificate:
    """No bound, and why (collective)."""
    spaces, infinite = solution.spaces, math.inf
    return Certificate(
        bound=infinite,
        sigma_bound=infinite,
        gap=infinite,
        oscillation=infinite,
        remainder=infinite,
        relative=infinite,
        proved=False,
        by_quadrature=(),
        unresolved=(),
        coarse=np.zeros(len(spaces.cell_measures), dtype=bool),
        indicator=fem.Function(spaces.Q, name="indicator"),
        v=solution.u,
        if_none=why or f"none is known for {solution.physics}",
    )
