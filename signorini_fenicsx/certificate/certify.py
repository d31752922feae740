"""The bound of a solution of any physics, and of a function that the user has.

*How wrong a function of the user is*: bounds of the energy error of any v ∈ H¹, from the flux of the program.

v is continuous and quadratic on each cell; who made it and how makes no difference. With |w|² = (κ∇w, ∇w), and the flux
σ_h of the program and the bound b of ‖σ − σ_h‖, see `certificate`,

    m − b ≤ |v − u| ≤ m + b,   m = ‖κ^½∇v − κ^-½σ_h‖,

because κ^½∇v − κ^-½σ_h = κ^½∇(v − u) + κ^-½(σ − σ_h). This needs nothing of v. If v is admissible, m² is a part of
2 gap(v, y), and |v − u| ≤ √(2 gap) + osc, where nothing is added but what laws add. Let ṽ be admissible: quadratic
functions between the bounds of u with |ṽ − v| about as small as it can be, then with u_D and bounds themselves, see
`physics/diffusion/bound/conforming.py`. Then

    |v − u| ≤ √(2 gap(ṽ, y)) + osc + δ,   δ = |ṽ − v|, the distance of the repair.

The smaller of both upper bounds counts. Elastic displacements have the first one alone, with ℂε(v), and a stress σ_h.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast, overload

import numpy as np
from dolfinx import fem

from signorini_fenicsx.base.arrays import Array
from signorini_fenicsx.base.errors import InputError, check_kind, holding
from signorini_fenicsx.base.owned import function_of
from signorini_fenicsx.base.parallel import Stopwatch, collector_off
from signorini_fenicsx.certificate.certificate import Certificate
from signorini_fenicsx.certificate.passed_on import pairs_without_bound
from signorini_fenicsx.discrete.rounding import LOST, lost_digits
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.solving.physics import PHYSICS
from signorini_fenicsx.solving.solved import Solved
from signorini_fenicsx.solving.solver import solve


@dataclass(frozen=True)
class FieldBound:
    """How wrong a function v is.

    Attributes:
        bound: Upper bound of |v − u|.
        lower: Lower bound of |v − u|.
        relative: bound/‖σ_h‖.
        repair: δ, the distance to an admissible function; None for displacements.
        repaired: √(2 gap(ṽ, y)) + osc + δ; None for displacements.
        by_flux: m + b.
        guaranteed: Whether `bound` and `lower` are proved: all data are enclosed and resolved.
        reason: Why they are not; empty if they are.
        indicator: ‖κ^½∇v − κ^-½σ_h‖ on each cell; an estimate there, and only all of them together are a bound.
        solution: The solution whose flux it is.
        certificate: The bound of this solution.
    """

    bound: float
    lower: float
    relative: float
    repair: float | None
    repaired: float | None
    by_flux: float
    guaranteed: bool
    reason: str
    indicator: fem.Function
    solution: Solved
    certificate: Certificate

    def __repr__(self) -> str:
        trust = "guaranteed" if self.guaranteed else f"not guaranteed: {self.reason}"
        return f"<{type(self).__name__}: {self.lower:.4g} ≤ energy error ≤ {self.bound:.4g}, {trust}>"

    def summary(self) -> dict[str, Any]:
        """All numbers and words of the bound, ready for JSON."""
        names = ("bound", "lower", "relative", "repair", "repaired", "by_flux", "guaranteed", "reason")
        return {name: getattr(self, name) for name in names}


@collector_off()
def bound_field(solution: Solved, v: fem.Function) -> FieldBound:
    """Bound the energy error of a function (collective).

    Args:
        solution: A solution of the problem on the same mesh; the more exact it is, the sharper the bounds.
        v: A continuous function, linear or quadratic on each cell: a `Function` of Lagrange elements of degree 1 or 2
            on `domain.mesh`, with up-to-date ghost values.

    Raises:
        InputError: If it is another function, or the problem has no such bound.
        NumericalFailure: If a linear solver fails; it holds the solution.
    """
    bounds = PHYSICS[solution.physics].bound
    if bounds is None:
        raise InputError(f"{solution.physics}: no bound of functions is known")
    if why := pairs_without_bound(solution.spaces):
        raise InputError(f"v: {why}")
    _check(solution, v)
    with holding(solution):
        bound: FieldBound = bounds.of_field(solution, v)
    if bound.guaranteed and (names := lost_digits(solution)):
        return replace(bound, guaranteed=False, reason=f"{', '.join(names)} {LOST}")
    return bound


def _check(solution: Solved, v: fem.Function) -> None:
    """Refuse what is no continuous function of the problem (collective).

    Raises:
        InputError: If it is none.
    """
    if solution.step is not None:
        raise InputError("functions of a step of a problem in time have no bounds")
    check_kind("v", v, fem.Function)
    space, mesh = v.function_space, solution.spaces.mesh
    if space.mesh is not mesh:
        raise InputError("v: must be on the mesh of the domain, `domain.mesh`; interpolate it there")
    element, shape = space.ufl_element(), solution.u.ufl_shape
    lagrange = element.element_family is not None and element.family_name == "P" and not element.discontinuous
    degree = element.embedded_superdegree
    if not lagrange or degree not in (1, 2) or v.ufl_shape != shape:
        kind = "a vector" if shape else "a scalar"
        raise InputError(f"v: must be {kind} of continuous Lagrange elements of degree 1 or 2, not {element}")


def bound_by_parts(
    solution: Solved,
    certificate: Certificate,
    squares: tuple[Array, Array],
    size: float,
    repair: float | None = None,
    of_repaired: Certificate | None = None,
) -> FieldBound:
    """The bounds of a v from m² per owned cell, at most and at least, and of a scalar the repair (collective)."""
    spaces, (most, least), b = solution.spaces, squares, certificate.sigma_bound
    m, of_least = np.sqrt(spaces.mesh.comm.allreduce(np.array([most.sum(), least.sum()]))).tolist()
    repaired = None if of_repaired is None or repair is None else of_repaired.bound + repair
    by_flux, trusted = m + b, certificate
    bound = by_flux
    if of_repaired is not None and repaired is not None and repaired < by_flux:
        bound, trusted = repaired, of_repaired
    indicator = function_of(spaces.Q, np.sqrt(most), "error_of_v")
    reasons = (
        each.if_none or each.reservation or (each.of and f"it is the {each.error}") for each in (certificate, trusted)
    )
    reason = next(filter(None, reasons), "")
    return FieldBound(
        bound=bound,
        lower=max(of_least - b, 0.0),
        relative=bound / size if size > 0 else math.inf,
        repair=repair,
        repaired=repaired,
        by_flux=by_flux,
        guaranteed=not reason,
        reason=reason,
        indicator=indicator,
        solution=solution,
        certificate=certificate,
    )


@dataclass(frozen=True)
class Bounds:
    """What bounds the errors of a physics; all of it is collective.

    Attributes:
        of_solution: Gives the certificate of a solution, with `for_signorini` of that to the problem without penalty.
        of_field: Gives the bound of a function, from a solution on its mesh.
        of_steps: Begins with the certificates of the steps of a problem in time; its `certify` takes one after another.
            None where that of a step is that of its solution.
    """

    of_solution: Callable[..., Certificate]
    of_field: Callable[[Any, fem.Function], FieldBound]
    of_steps: Callable[[], Any] | None = None


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
    problem, v)` is about a function that any program has made, see above. It solves the problem for the flux.

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
    why = pairs_without_bound(solution.spaces) if bounds else f"none is known for {solution.physics}"
    if bounds is None or why:
        spaces = solution.spaces
        nowhere = np.zeros(len(spaces.cell_measures), dtype=bool)
        return Certificate(nowhere, fem.Function(spaces.Q, name="indicator"), solution.u, if_none=why)
    with watch.phase("certificate"), holding(solution):
        certificate = certify(bounds)
        names = lost_digits(solution) if certificate.proved else ()
    if names:
        about = {key: value for key, value in certificate.about.items() if key != "guaranteed_for"}
        certificate = replace(certificate, proved=False, by_quadrature=names, lacking=LOST, about=about)
    return replace(certificate, seconds=watch.longest(solution.spaces.mesh.comm)["certificate"])
