"""Quantities of viscous flow from both sides: those of bodies, what flows out through parts, and the dissipation.

*Dissipation.* D = (2με(u), ε(u)) is the square of ‖dev σ‖, and so it is between (‖dev σ_h‖ ± bound)². That is of first
order. Where all that drives the flow is of one kind it follows from the least energy J, whose interval is of second
order. A flow that is multiplied by t > 0 has D and J multiplied by t² if loads, given velocities and the bounds of laws
are multiplied by t. Testing the equations with u gives:

- D + ∫g|u_t| + ∫g|u_n| = W(u), the work of the loads, if all given velocities are 0. Then J = ½D + ∫g|u_t| + ∫g|u_n| −
  W(u) = −½D.
- J = ½D if there are no loads and no bounds g.

`least` of an outlet is a given velocity, its `pressure` is a load.
"""

from dataclasses import replace
from typing import Any

from mpi4py import MPI

from signorini_fenicsx.base.errors import InputError
from signorini_fenicsx.certificate.certify import certify
from signorini_fenicsx.contact.laws import Friction
from signorini_fenicsx.meshes.domain import Domain
from signorini_fenicsx.physics.elasticity.bound.hidden import loads_of
from signorini_fenicsx.physics.elasticity.quantities import brackets as of_bodies
from signorini_fenicsx.physics.stokes.problem import Leak, Outflow, StokesProblem
from signorini_fenicsx.physics.stokes.solution import StokesSolution
from signorini_fenicsx.quantities.bracket import Quantity
from signorini_fenicsx.quantities.kinds import Dissipation, Flow, Flux, Force, Integral, Kind


def check(domain: Domain, problem: StokesProblem, kind: Kind) -> None:
    """Refuse what is no quantity of a flow (collective).

    Raises:
        InputError: If a name is unknown, or the quantity is not one of flow.
    """
    if isinstance(kind, Flux):
        raise InputError("Flux: viscous flow has Flow, Integral, Mean, Force, Moment, Dissipation and Energy")
    if isinstance(kind, Force) and (walls := set(kind.parts) & set(problem.support)):
        raise InputError(f"{type(kind).__name__}: none is there on '{min(walls)}', a wall with slip of beta > 0")
    if not isinstance(kind, Dissipation):
        of_bodies.check(domain, problem, _outwards(kind) if isinstance(kind, Flow) else kind)


def _outwards(kind: Flow) -> Integral:
    """The integral of u_n that a flow is."""
    return Integral(parts=kind.parts)


class _Flows(of_bodies.Integrals):
    """What flows out."""

    def discrete(self) -> float:
        """That of û, whose sum over the whole boundary is 0 (collective)."""
        flows = self.solution.flows()
        return float(sum(flows[part] for part in self.kind.parts))


class _Power:
    """The dissipation."""

    def __init__(self, solution: StokesSolution):
        self._solution = solution

    def interval(self, near: Quantity | None = None) -> Quantity:
        """The interval: the narrower one where there are two (collective)."""
        solution = self._solution
        certificate, size = certify(solution), solution.norms()["energy"]
        lower, upper = (max(size + sign * certificate.sigma_bound, 0.0) ** 2 for sign in (-1.0, 1.0))
        found = Quantity(size**2, lower, upper, certificate.proved, certificate.reservation or certificate.if_none)
        if factor := _of_energy(solution):
            energy = of_bodies.QUANTITIES.energy(solution)
            lower, upper = sorted(factor * end for end in (energy.lower, energy.upper))
            if upper - lower < found.width:
                found = replace(found, lower=lower, upper=upper, proved=energy.proved, reason=energy.reason)
        return found


def _of_energy(solution: StokesSolution) -> float:
    """D/J if that is known, else 0 (collective)."""
    data, spaces, laws = solution.data, solution.spaces, solution.problem.laws
    outlets = [law for law in laws if isinstance(law, Outflow)]
    others = [law for law in laws if not isinstance(law, Outflow | Leak | Friction)]
    bounds = [law.g for law in laws if isinstance(law, Leak | Friction)]
    loads = [data.f, *(datum for _, datum in loads_of(spaces, data))]
    at_rest = all(datum.number == 0 for datum in data.u_D.components) and all(law.least == 0 for law in outlets)
    at_rest &= data.gap.number == 0
    free = all(scalar.number == 0 for datum in loads for scalar in datum.scalars)
    free &= all(each == 0 for each in (*bounds, *(law.pressure for law in outlets)))
    known = not others and not data.supports.slip.any() and (at_rest or free)
    return (-2.0 if at_rest else 2.0) if spaces.mesh.comm.allreduce(bool(known), MPI.LAND) else 0.0


def _of_fluxes(solution: StokesSolution, kind: Any) -> Any:
    """What gives the interval of a quantity that is no integral."""
    if isinstance(kind, Dissipation):
        return _Power(solution)
    if isinstance(kind, Flow):
        return _Flows(solution, _outwards(kind))
    return of_bodies.Fluxes(solution, kind)


QUANTITIES = replace(of_bodies.QUANTITIES, check=check, fluxes=_of_fluxes)
"""The quantities that there are."""
