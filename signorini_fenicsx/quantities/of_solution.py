"""Quantities of a solution of any physics."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from signorini_fenicsx.base.errors import InputError, check_kind, holding
from signorini_fenicsx.certificate.passed_on import pairs_without_bound
from signorini_fenicsx.discrete.rounding import LOST, lost_digits
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.quantities.beside import Beside
from signorini_fenicsx.quantities.bracket import Quantity
from signorini_fenicsx.quantities.kinds import Energy, Integral, Kind, Mean
from signorini_fenicsx.quantities.weighted import Weighted
from signorini_fenicsx.solving.physics import PHYSICS
from signorini_fenicsx.solving.solved import Solved


@dataclass(frozen=True)
class Quantities:
    """The quantities of a physics.

    Attributes:
        check: Refuses what is no quantity of a problem.
        energy: Gives the interval for the energy.
        integrals: The problems beside that of a solution for an integral or a mean.
        fluxes: Those for a flux, or a force or a moment.
        named_for: Of which solution quantities are, in words; empty if it is that of the problem itself.
    """

    check: Callable[[Domain, Any, Kind], None]
    energy: Callable[[Any], Quantity]
    integrals: Callable[[Any, Any], Beside[Any]]
    fluxes: Callable[[Any, Any], Beside[Any]]
    named_for: Callable[[Any], str]


def quantity(solution: Solved, kind: Kind, near: Quantity | None = None) -> Quantity:
    """The interval for a quantity, see `Solution.quantity` (collective).

    Raises:
        InputError: If it is not one of this problem, or both sides of a pair of surfaces are not on one process.
        NumericalFailure: If a linear solver fails; it holds the solution.
    """
    check_kind("solution", solution, Solved)
    check_quantities(solution.spaces.domain, solution.problem, [kind])
    if why := pairs_without_bound(solution.spaces):
        raise InputError(f"{type(kind).__name__}: {why}")
    physics: Quantities = PHYSICS[solution.physics].quantities
    with holding(solution):
        if isinstance(kind, Energy):
            interval: Quantity = physics.energy(solution)
        else:
            of = physics.integrals if isinstance(kind, Integral) else physics.fluxes
            interval = of(solution, kind).interval(near)
    interval = replace(interval, of=interval.of or physics.named_for(solution))
    if interval.proved and (names := lost_digits(solution)):
        return replace(interval, proved=False, reason=f"{', '.join(names)} {LOST}")
    return interval


def check_quantities(domain: Domain, problem: Any, kinds: Sequence[Kind]) -> None:
    """Refuse what are no quantities of a problem, before it is solved (collective).

    Args:
        domain: The mesh with its parts.
        problem: The problem, sorted by the kinds of its boundary.
        kinds: The quantities.

    Raises:
        InputError: If one is none of this problem.
    """
    for kind in kinds:
        check_kind("kind", kind, Kind)
        if (physics := PHYSICS[problem.boundary.physics].quantities) is None:
            raise InputError(f"{problem.boundary.physics}: no quantities are known")
        physics.check(domain, problem, kind)
        if isinstance(kind, Mean):
            Weighted.of(domain, kind).check_mean()
